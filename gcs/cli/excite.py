"""`cordon excite`: a flight for identification."""

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gcs.cli.options import (
    RESULT,
    Json,
    Log,
    MissionName,
    Recorded,
    Speed,
    bus_mission,
    chosen_vehicle,
)
from gcs.errors import Exit
from gcs.metrics.json_output import json_output
from gcs.signals import hold_back

if TYPE_CHECKING:
    from agents.control.excitation import Preview
    from gcs.metrics.record import FlightRecord
    from gcs.mission.mission import Mission


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ExciteOptions:
    """Options of `cordon excite`."""

    mission: MissionName = field(kw_only=False)
    vehicle: Annotated[int | None, Parameter(help="The vehicle to fly, in place of the mission's first.")] = None
    sitl: Annotated[bool, Parameter(negative="", help="Fly a bundled stub vehicle: no hardware needed.")] = False
    speed: Speed = None
    preview: Annotated[
        bool,
        Parameter(negative="", group=RESULT, help="Show the space, time and speed that the flight takes; do not fly."),
    ] = False
    log: Log = None
    recorded: Recorded = True
    json: Json = False


def excite(options: ExciteOptions) -> int:
    """Fly one vehicle for identification: steps and swept sines inside a box, configured by `[excitation]`.

    Guard, failsafes, preflight and Ctrl-C work as in `cordon fly`. `cordon identify` reads the log.

    Example: cordon excite shaped-trio --vehicle 1 --preview
    """
    hold_back()
    from gcs.flight.supervisor import is_supervised, supervise

    return _excite(options) if options.preview or is_supervised() else supervise()


def _excite(options: ExciteOptions) -> Exit:
    from agents.control.excitation import preview
    from gcs.cli.output import print_result
    from gcs.console.terminal import STDERR
    from gcs.flight.excitation import preview_dict, preview_view
    from gcs.flight.plan import FlightPlan
    from gcs.flight.recording import RecordingOptions
    from gcs.flight.request import require_governed
    from gcs.flight.run import run_flight
    from gcs.mission.file import excitation_mission

    whole = bus_mission(options.mission)
    vehicle = whole.vehicles[0] if options.vehicle is None else chosen_vehicle(whole, options.vehicle, "--vehicle")
    mission = excitation_mission(whole, vehicle.id)
    planned = preview(mission.agent_config(mission.vehicles[0]))
    STDERR.print(preview_view(mission, planned))
    if options.preview:
        if options.json:
            print_result(json_output(preview_dict(mission, planned)))
        return Exit.HOLDS
    require_governed(options.speed, only_stubs=options.sitl, advice="it needs --sitl: a real vehicle does not wait")
    speed = options.speed or (1.0 if options.sitl else None)
    plan = FlightPlan(mission, mission.mission.duration_s, mission.vehicles, speed, mission.ids if options.sitl else ())

    def judge(_flown: "Mission", record: "FlightRecord") -> Exit:
        return _present(mission, planned, record, json=options.json)

    return run_flight(plan, RecordingOptions(options.log, options.recorded), judge)


def _present(mission: "Mission", planned: "Preview", record: "FlightRecord", *, json: bool) -> Exit:
    """Show the flight beside its preview; the verdict fails if a part is missing."""
    from gcs.cli.output import print_result
    from gcs.console.terminal import STDERR, print_line
    from gcs.flight.excitation import flown_excitation, flown_view, preview_dict

    flown = flown_excitation(mission, record)
    STDERR.print(flown_view(planned, flown))
    if flown.parts_missing:
        print_line(f"not flown, or not completed: {', '.join(flown.parts_missing)}", "yellow")
    if json:
        print_result(json_output({**preview_dict(mission, planned), "flown": asdict(flown)}))
    return Exit.VERDICT_FAILED if flown.parts_missing else Exit.HOLDS
