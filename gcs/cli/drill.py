"""`cordon drill`: injected faults and the measured reactions to them."""

import asyncio
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from gcs.cli.options import RESULT, Json, MissionName, file_or_folder, loaded_mission
from gcs.errors import Exit, InputError
from gcs.flight.faults.names import OPTIONS


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class DrillOptions:
    """Options of `cordon drill`."""

    mission: MissionName = field(kw_only=False)
    fault: Annotated[
        tuple[str, ...],
        Parameter(
            negative="",
            show_default=False,
            help=f"Only this fault; may be repeated: {', '.join(OPTIONS)}.",
        ),
    ] = ()
    log: Annotated[
        Path | None,
        Parameter(
            validator=file_or_folder,
            group=RESULT,
            help="Record the flights in this folder, one log for each flight.",
        ),
    ] = None
    json: Json = False


def drill(options: DrillOptions) -> Exit:
    """Inject faults into a simulated team and measure its reactions. No real vehicle flies.

    Example: cordon drill ardupilot-trio --fault battery-low --fault killed-agent
    """
    from agents.ports import VehicleRefusedError
    from gcs.cli.output import check_folder, print_result
    from gcs.console.terminal import STDERR, print_problem
    from gcs.drill.faults import chosen
    from gcs.drill.run import DrillProgress, DrillRun, drill_table, drills_json
    from gcs.drill.stubs import StubFlight
    from gcs.mission.planner import require_loaded
    from gcs.mission.simulation import only_simulated

    drills, mission = chosen(options.fault), loaded_mission(options.mission)
    require_loaded(mission, None, "cordon drill")
    if faults := only_simulated(mission):
        raise InputError(faults)
    if options.log is not None:
        check_folder("--log", options.log)
    fly = partial(StubFlight, logs=options.log, profile_texts=mission.profile_texts)
    try:
        rows = asyncio.run(DrillRun(options.mission, fly, drills, DrillProgress(STDERR, len(drills))).run())
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    STDERR.print(drill_table(mission.mission.name, rows))
    if options.json:
        print_result(drills_json(mission.mission.name, rows))
    return Exit.VERDICT_FAILED if any(row.holds is False for row in rows) else Exit.HOLDS
