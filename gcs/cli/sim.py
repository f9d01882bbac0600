"""`cordon sim`: a mission in simulated time."""

import gc
from dataclasses import dataclass, field
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.options import RESULT, Duration, Json, Log, MissionName, Plot, loaded_mission
from gcs.errors import Exit
from gcs.signals import hold_back, pending


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class SimOptions:
    """What `cordon sim` is given."""

    mission: MissionName = field(kw_only=False)
    seed: Annotated[
        int | None,
        Parameter(help="Seed of noise, delay and loss, in place of the mission's.", validator=Number(gte=0)),
    ] = None
    duration: Duration = None
    log: Log = None
    json: Json = False
    plot: Plot = None
    timing: Annotated[
        bool | None,
        Parameter(
            group=RESULT,
            help="Whether the JSON holds wall times. By default it does unless --seed is given: a seed determines the "
            "result byte for byte.",
        ),
    ] = None


def sim(options: SimOptions) -> Exit:
    """Fly a mission in one process with simulated time: deterministic, far faster than real time.

    Example: cordon sim case2-field --seed 7 --plot flight.png
    """
    hold_back()
    from gcs.cli.output import SimulationProgress, check_plot, present
    from gcs.console.terminal import print_problem
    from gcs.flight.simulated import fly_simulated

    check_plot(options.plot)
    mission = loaded_mission(options.mission)
    flown_s = options.duration or mission.mission.duration_s
    seed = mission.mission.seed if options.seed is None else options.seed
    recording = None
    if options.log is not None:
        from gcs.flight.recording import report_log
        from gcs.flight.simulation_log import simulation_recording

        recording = simulation_recording(mission, options.log, seed, flown_s)

    def update(time_s: float) -> None:
        if pending():
            raise KeyboardInterrupt
        progress.update(time_s)

    gc.freeze()  # modules stay until the end: a full collection would traverse them for 60 ms, within a tick
    try:
        with SimulationProgress(mission.mission.name, flown_s) as progress:
            record = fly_simulated(mission, seed, flown_s, update, recording)
    except KeyboardInterrupt:
        print_problem("the simulation was interrupted")
        return Exit.ENDED_IN_FLIGHT
    timed = options.seed is None if options.timing is None else options.timing
    verdict = present(mission, record, json=options.json, plot=options.plot, timed=timed)
    if recording is not None:
        report_log(recording.writer)
    return verdict
