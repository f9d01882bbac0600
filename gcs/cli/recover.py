"""`cordon recover`: vehicles that are in the air come home."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gcs.cli.added import NOT_DESCRIBED, AddedVehicleOptions, enlarged, given_options
from gcs.cli.options import (
    Changes,
    Json,
    Leave,
    Log,
    MissionName,
    Recorded,
    Speed,
    TakeFromPilot,
    TakeWithoutAsking,
    bus_mission,
    chosen_vehicle,
    require_answer,
    require_known,
)
from gcs.errors import Exit, InputError
from gcs.signals import hold_back

if TYPE_CHECKING:
    from gcs.flight.plan import FlightPlan
    from gcs.metrics.record import FlightRecord
    from gcs.mission.mission import Mission


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryOptions:
    """Options of `cordon recover`."""

    mission: MissionName = field(kw_only=False)
    changes: Changes = ()
    only: Annotated[
        tuple[int, ...],
        Parameter(
            negative="",
            show_default=False,
            help="Bring home only this vehicle, while others of the team may still fly; may be repeated.",
        ),
    ] = ()
    add: Annotated[
        int | None,
        Parameter(help="Id of a vehicle that is not in the mission file and had joined the flight (`cordon rejoin`)."),
    ] = None
    land: Annotated[bool, Parameter(negative="", help="Land each vehicle where it is, instead of at its start_m.")] = (
        False
    )
    described: AddedVehicleOptions = NOT_DESCRIBED
    take_from_pilot: TakeFromPilot = ()
    leave: Leave = ()
    yes: TakeWithoutAsking = False
    speed: Speed = None
    log: Log = None
    recorded: Recorded = True
    json: Json = False


def recover(options: RecoveryOptions) -> int:
    """Bring home vehicles that are in the air: after a killed `cordon fly`, a dead laptop, or another ground station.

    Connects to all vehicles of the mission, shows what it finds, and asks once. Those in the air then hold where they
    are, return to their start_m in layers of height, and land one after another. A vehicle that a pilot flies keeps its
    pilot. A vehicle that is armed on the ground, has another autopilot or no position is refused: then nothing is sent
    to any.

    With --only other vehicles of the team may still fly: those that are brought home keep apart from them. With --add
    the team has a vehicle more, as it was described to `cordon rejoin --add`.

    Ctrl-C: hold, land, disarm; twice: land at once. A vehicle that is still flown is commanded by `cordon command`.

    Example: cordon recover px4-trio

    Example: cordon recover px4-trio --land --leave 2 --yes

    Example: cordon recover px4-trio --add 4 --only 4 --start 0,-9 --url udpin://127.0.0.1:14543 --profile px4
    """
    from gcs.flight.supervisor import is_supervised, supervise

    hold_back()
    require_answer(lambda: _mission(options), yes=options.yes)
    return _recover(options) if is_supervised() else supervise(json=options.json)


def _mission(options: RecoveryOptions) -> "Mission":
    """Return the mission, with the vehicle of --add; raises InputError, whose faults name options."""
    mission = bus_mission(options.mission, options.changes)
    if options.add is not None:
        faults = list[str]()
        if options.add in mission.ids:
            faults.append(f"--add: vehicle {options.add} is in the mission: recover it without --add")
        if options.described.url is None:
            faults.append("--url: with --add the vehicle needs its connection")
        mission = enlarged(mission, options.add, options.described, faults, named="--add")
    elif given := given_options(options.described):
        raise InputError([f"{option}: it needs --add" for option in given])
    require_known(mission, options.take_from_pilot, options.leave)
    for each in options.only:
        chosen_vehicle(mission, each, "--only")
    if options.only and options.leave:
        raise InputError(["--leave: not with --only, which leaves all others"])
    if others := {*options.take_from_pilot} - {*options.only} if options.only else ():
        raise InputError([f"--take-from-pilot: vehicle {each} is not given by --only" for each in sorted(others)])
    return mission


def _recover(options: RecoveryOptions) -> Exit:
    from gcs.cli.output import print_result
    from gcs.console.terminal import print_line
    from gcs.flight.recording import RecordingOptions
    from gcs.flight.run import run_flight
    from gcs.metrics.ending import TeamEnding

    plan = _plan(options)

    def judge(_flown: "Mission", record: "FlightRecord") -> Exit:
        ended = TeamEnding.of(record.endings)
        if ended is not None and not ended.is_early:
            print_line(ended.headline, "bold green")
        return Exit.HOLDS  # no ring and no formation were flown: who has not come home is reported by vehicle

    code = run_flight(plan, RecordingOptions(options.log, options.recorded), judge, options.mission, options.changes)
    assert plan.recovery is not None
    result = plan.recovery.record.result(plan.mission)
    for line in result.lines:
        print_line(line)
    if options.json:
        print_result(result.to_json())
    return code


def _plan(options: RecoveryOptions) -> "FlightPlan":
    from gcs.console.terminal import print_line
    from gcs.flight.equipment import WithoutSensors
    from gcs.flight.plan import FlightPlan, TeamRecovery
    from gcs.flight.recovery import HOLDS_S, homeward
    from gcs.flight.request import require_governed
    from gcs.flight.stubs import lockstep_clock

    mission, told = homeward(_mission(options), land=options.land)
    if told:
        print_line(told, "yellow")
    taken = options.only or [each for each in mission.ids if each not in options.leave]
    vehicles = tuple(each for each in mission.vehicles if each.id in taken)
    if not vehicles:
        raise InputError(["--leave: no vehicle of the mission is left to bring home"])
    clock = lockstep_clock(mission, taken)
    require_governed(options.speed, only_stubs=clock is not None, advice="it needs `cordon sitl --lockstep`")
    recovery = TeamRecovery(options.take_from_pilot, confirmed=options.yes, beside=bool(options.only))
    equipment = WithoutSensors() if options.only else None
    return FlightPlan(mission, HOLDS_S, vehicles, options.speed, equipment=equipment, clock=clock, recovery=recovery)
