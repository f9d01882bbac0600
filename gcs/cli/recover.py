"""`cordon recover`: vehicles that are in the air come home."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

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
    land: Annotated[bool, Parameter(negative="", help="Land each vehicle where it is, instead of at its start_m.")] = (
        False
    )
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

    Ctrl-C: hold, land, disarm; twice: land at once. A flight that still runs is commanded by `cordon command`.

    Example: cordon recover px4-trio

    Example: cordon recover px4-trio --land --leave 2 --yes
    """
    from gcs.flight.supervisor import is_supervised, supervise

    hold_back()
    require_answer(options.mission, options.changes, options.take_from_pilot, options.leave, yes=options.yes)
    return _recover(options) if is_supervised() else supervise(json=options.json)


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

    code = run_flight(plan, RecordingOptions(options.log, options.recorded), judge)
    assert plan.recovery is not None
    result = plan.recovery.record.result(plan.mission)
    for line in result.lines:
        print_line(line)
    if options.json:
        print_result(result.to_json())
    return code


def _plan(options: RecoveryOptions) -> "FlightPlan":
    from gcs.console.terminal import print_line
    from gcs.flight.plan import FlightPlan, TeamRecovery
    from gcs.flight.recovery import HOLDS_S, homeward
    from gcs.flight.request import require_governed
    from gcs.flight.stubs import lockstep_clock

    file = bus_mission(options.mission, options.changes)
    require_known(file, options.take_from_pilot, options.leave)
    mission, told = homeward(file, land=options.land)
    if told:
        print_line(told, "yellow")
    vehicles = tuple(each for each in mission.vehicles if each.id not in options.leave)
    if not vehicles:
        raise InputError(["--leave: no vehicle of the mission is left to bring home"])
    clock = lockstep_clock(mission, mission.ids)
    require_governed(options.speed, only_stubs=clock is not None, advice="it needs `cordon sitl --lockstep`")
    recovery = TeamRecovery(options.take_from_pilot, confirmed=options.yes)
    return FlightPlan(mission, HOLDS_S, vehicles, options.speed, clock=clock, recovery=recovery)
