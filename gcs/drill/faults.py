"""The drills: each fault, how it is brought about and taken back, and what should come of it.

What the failsafe table knows - reactions and grace times - is taken from there and from the mission.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import hypot
from signal import SIGKILL, SIGSTOP
from typing import Generic, TypeVar

from agents.safety.failsafe import (
    ROWS,
    Condition,
    Reaction,
    grace_s,
)
from agents.tactics import Tactic
from gcs.drill.flight import DrillFlight
from gcs.drill.injected_faults import Ailments
from gcs.drill.judge import Expectation
from gcs.drill.stubs import StubFlight
from gcs.errors import InputError
from gcs.mission.mission import Mission
from sitl.autopilot.modes import NavMode

OUT_OF_OFFBOARD_S = 2.0
"""Who has nobody behind it any more is out of offboard within this time [wall s]."""
MARGIN_S = 0.5
"""How much later than the table says a reaction may be seen [wall s]: it takes ticks, and words on the bus."""
HEARTBEAT_S, BATTERY_S = 1.0, 2.0
"""How often an autopilot tells its mode, and its battery [s]."""
CUT_S = 5.0
JUMP_M = 10.0
LOSS, BUS_DELAY_S, LINK_DELAY_S = 0.5, 0.3, 0.1
BORNE_S = 20.0
"""For how long the team has to bear what it should bear [mission s]."""
RESPACED_S = 60.0
"""How long the others may take to close a gap [mission s]."""

Flight = TypeVar("Flight", bound=DrillFlight)
REACH_SHARE = 1.2
"""A target that is farther away is reached late, or never."""

_TACTICS = {
    Reaction.ASIDE: Tactic.ASIDE.value,
    Reaction.HOLD: Tactic.HOLD.value,
    Reaction.RETURN: Tactic.RETURN_AND_LAND.value,
    Reaction.LAND: Tactic.LAND.value,
    Reaction.STAND_DOWN: Tactic.PILOT_OVERRIDE.value,
}


@dataclass(slots=True)
class Crew:
    """Who is who in a flight: who encircles the target, who has landed for good, and whom things happen to."""

    mission: Mission
    spent: set[int] = field(default_factory=set)

    @property
    def everybody(self) -> tuple[int, ...]:
        """All vehicles that still fly."""
        return tuple(i for i in self.mission.ids if i not in self.spent)

    @property
    def one(self) -> int:
        """The one that things happen to: the last in line, who leads the last of all. Somebody must still fly."""
        return max(self.everybody, key=lambda i: (i != self.mission.formation.leader, self.mission.ids.index(i)))

    @property
    def others(self) -> tuple[int, ...]:
        """All but that one."""
        return tuple(i for i in self.everybody if i != self.one)

    @property
    def on_ring(self) -> tuple[int, ...]:
        """Those that encircle the target."""
        return tuple(i for i in self.everybody if self.tactic(i) == Tactic.ENCIRCLE.value)

    def tactic(self, vehicle: int) -> str:
        """Return what a vehicle does while all is well: it encircles a target that is within its reach."""
        mission, member = self.mission, self.mission.vehicle(vehicle)
        wanted = member.decision
        config = mission.agent_config(member)
        (x, y), (dx, dy) = config.line_start_m, config.slot_offset_m(vehicle, mission.formation.leader)
        away_m = hypot(mission.target.start_m[0] - x - dx, mission.target.start_m[1] - y - dy)
        worth_it = mission.target.importance > wanted.importance_min and mission.target.threat < wanted.threat_max
        engages = worth_it and away_m < REACH_SHARE * wanted.distance_max_m
        return Tactic.ENCIRCLE.value if engages else Tactic.FORMATION.value


@dataclass(frozen=True, slots=True)
class Drill(Generic[Flight]):
    """One fault: `expect` says what should come of it, given the crew and the flight's speed.

    It takes `least` vehicles in the air. After one that `ends` the flight nobody flies on; one that `spends` a vehicle
    has it land. `by_wall` says on which clock its times are told, the wall's or the mission's. It is taken back after
    `undo_after_s` [wall s], or once it has been seen; what is no reaction is watched for `watched_s` [mission s].
    Where the estimate `settles`, nobody is sent back to the mission before it has. It may be the autopilot alone
    that reacts, `by_autopilot`: to silence.
    """

    fault: str
    expected: str
    inject: Callable[[Flight, Crew], None]
    expect: Callable[[Crew, float], Expectation]
    undo_after_s: float | None = None
    by_wall: bool = False
    ends: bool = False
    spends: bool = False
    watched_s: float = 0.0
    least: int = 1
    settles: bool = False
    by_autopilot: bool = False

    def unfit(self, mission: Mission) -> str:
        """Return why a mission cannot have this drill, empty if it can."""
        if len(mission.ids) < self.least:
            return f"takes {self.least} vehicles"
        if self.by_autopilot and any(each.section.autopilot != "px4" for each in mission.vehicles):
            return "ArduPilot's stub does not play the failsafe for a silent ground station (FS_GCS_ENABLE)"
        return ""


def by_table(
    condition: Condition, who: Callable[[Crew], tuple[int, ...]], *, found_within_s: float = 0.0
) -> Callable[[Crew, float], Expectation]:
    """Expect the first reaction of a row of the failsafe table; `found_within_s` of mission time to find out."""
    row = ROWS[condition]

    def expect(crew: Crew, speed: float) -> Expectation:
        config = crew.mission.agent_config(crew.mission.vehicle(crew.one))
        flies_on = row.reactions[0] is Reaction.DEGRADE
        grace = grace_s(row, config) / (1.0 if row.by_wall else speed)
        return Expectation(
            who(crew),
            tuple(i for i in crew.everybody if flies_on or i not in who(crew)),
            grace + found_within_s / speed + MARGIN_S,
            tactic=_TACTICS.get(row.reactions[0]),
            alert=condition.value,
            leaves_offboard=row.reactions[0] is Reaction.STAND_DOWN,
            stands_back=row.reactions[0] is Reaction.STAND_DOWN,
            separation_m=crew.mission.safety.separation_m,
        )

    return expect


def _told(condition: Condition) -> str:
    return f"{ROWS[condition].reactions[0].value} ({condition.value})"


def _jump(crew: Crew, speed: float) -> Expectation:
    within_s = crew.mission.own_filter.gate_timeout_s
    return by_table(Condition.ESTIMATOR_JUMPED, the_one, found_within_s=within_s)(crew, speed)


def dead(crew: Crew, _speed: float) -> Expectation:
    """Expect that all are out of offboard, for nobody is behind them any more."""
    return Expectation(
        crew.everybody, (), OUT_OF_OFFBOARD_S, leaves_offboard=True, separation_m=crew.mission.safety.separation_m
    )


def cut(crew: Crew, speed: float) -> Expectation:
    """Expect that one whose link is cut leaves offboard, is not taken back, and that the others close the gap."""
    return Expectation(
        (crew.one,),
        crew.others,
        OUT_OF_OFFBOARD_S / speed + MARGIN_S,
        leaves_offboard=True,
        at_last=Tactic.PILOT_OVERRIDE.value,
        respacing=tuple(i for i in crew.others if i in crew.on_ring),
        separation_m=crew.mission.safety.separation_m,
    )


def _borne(crew: Crew, _speed: float) -> Expectation:
    return Expectation(
        (),
        crew.everybody,
        None,
        separation_m=crew.mission.safety.separation_m,
        radius_m=crew.mission.encirclement.radius_m,
    )


def the_one(crew: Crew) -> tuple[int, ...]:
    """Return the one that things happen to."""
    return (crew.one,)


def _peer_missed(crew: Crew, speed: float) -> Expectation:
    return by_table(Condition.PEER_SILENT, lambda crew: crew.others)(crew, speed)


def kill(flight: DrillFlight, _crew: Crew) -> None:
    """Kill the flying process."""
    flight.leave()
    flight.signal(SIGKILL)


def stop(flight: DrillFlight, _crew: Crew) -> None:
    """Stop the flying process."""
    flight.leave()
    flight.signal(SIGSTOP)


def _hang(flight: StubFlight, _crew: Crew) -> None:
    flight.leave()
    flight.ail(Ailments(hang="interpreter"))


def _ail(ailments: Callable[[Crew, float], Ailments]) -> Callable[[StubFlight, Crew], None]:
    return lambda flight, crew: flight.ail(ailments(crew, flight.speed))


def _delay(flight: StubFlight, _crew: Crew) -> None:
    flight.ail(Ailments(delay_s=BUS_DELAY_S / flight.speed))
    for stub in flight.stubs.values():
        stub.faults.link_delay_s = LINK_DELAY_S / flight.speed


def _silence_motion(flight: StubFlight, crew: Crew) -> None:
    flight.stubs[crew.one].faults.motion_silent = True


def _cut_link(flight: StubFlight, crew: Crew) -> None:
    flight.stubs[crew.one].faults.link_cut = True


def _jump_inwards(flight: StubFlight, crew: Crew) -> None:
    """Let it believe itself among the others: what it does about that leads away from them."""
    places = {i: stub.autopilot.airframe.position_m for i, stub in flight.stubs.items()}
    x, y, _ = places[crew.one]
    away_x, away_y = (sum(place[axis] - (x, y)[axis] for place in places.values()) for axis in (0, 1))
    away_m = hypot(away_x, away_y) or 1.0
    flight.stubs[crew.one].faults.estimate_offset_m = (JUMP_M * away_x / away_m, JUMP_M * away_y / away_m, 0.0)


def _take(flight: StubFlight, crew: Crew) -> None:
    flight.stubs[crew.one].autopilot.select(NavMode.HOLD)


def _drain(fraction: Callable[[Mission], float]) -> Callable[[StubFlight, Crew], None]:
    def drain(flight: StubFlight, crew: Crew) -> None:
        flight.stubs[crew.one].autopilot.battery_fraction = fraction(crew.mission)

    return drain


DRILLS: tuple[Drill[StubFlight], ...] = (
    Drill(
        "half of all messages lost",
        f"all fly on for {BORNE_S:g} s",
        _ail(lambda _crew, _speed: Ailments(loss=LOSS)),
        _borne,
        watched_s=BORNE_S,
    ),
    Drill(
        "latency",
        f"all fly on for {BORNE_S:g} s (bus {BUS_DELAY_S:g} s, link {LINK_DELAY_S:g} s each way)",
        _delay,
        _borne,
        watched_s=BORNE_S,
    ),
    Drill(
        "one vehicle not heard",
        f"the others: {_told(Condition.PEER_SILENT)}",
        _ail(lambda crew, _speed: Ailments(unheard=(crew.one,))),
        _peer_missed,
        by_wall=True,
        least=2,
    ),
    Drill(
        "nobody hears anybody",
        f"all: {_told(Condition.PEERS_SILENT)}",
        _ail(lambda crew, _speed: Ailments(unheard=crew.everybody)),
        by_table(Condition.PEERS_SILENT, lambda crew: crew.everybody),
        by_wall=True,
        least=2,
    ),
    Drill(
        "telemetry frozen",
        _told(Condition.TELEMETRY_STALE),
        _silence_motion,
        by_table(Condition.TELEMETRY_STALE, the_one),
        by_wall=True,
    ),
    Drill("GPS jump", _told(Condition.ESTIMATOR_JUMPED), _jump_inwards, _jump, settles=True),
    Drill(
        "foreign mode",
        _told(Condition.PILOT_TOOK_OVER),
        _take,
        by_table(Condition.PILOT_TOOK_OVER, the_one, found_within_s=HEARTBEAT_S),
    ),
    Drill(
        "target lost",
        f"all on the ring: {_told(Condition.TARGET_STALE)}",
        _ail(lambda _crew, _speed: Ailments(blind=True)),
        by_table(Condition.TARGET_STALE, lambda crew: crew.on_ring),
    ),
    Drill(
        "link cut",
        f"out of offboard, and not back after {CUT_S:g} s; the others close the gap",
        _cut_link,
        cut,
        undo_after_s=CUT_S,
        spends=True,
        by_autopilot=True,
    ),
    Drill(
        "battery low",
        _told(Condition.BATTERY_LOW),
        _drain(lambda mission: (mission.failsafe.battery_low + mission.failsafe.battery_critical) / 2.0),
        by_table(Condition.BATTERY_LOW, the_one, found_within_s=BATTERY_S),
        spends=True,
    ),
    Drill(
        "battery critical",
        _told(Condition.BATTERY_CRITICAL),
        _drain(lambda mission: mission.failsafe.battery_critical * 0.8),
        by_table(Condition.BATTERY_CRITICAL, the_one, found_within_s=BATTERY_S),
        spends=True,
    ),
    Drill("killed agent", "all out of offboard", kill, dead, by_wall=True, ends=True, by_autopilot=True),
    Drill("frozen agent", "all out of offboard", stop, dead, by_wall=True, ends=True, by_autopilot=True),
    Drill("frozen interpreter", "all out of offboard", _hang, dead, by_wall=True, ends=True, by_autopilot=True),
)
"""In the order in which one flight can have them: what a vehicle comes back from, what it lands for, what ends all."""


def chosen(faults: Sequence[str]) -> tuple[Drill[StubFlight], ...]:
    """Return the drills of these faults, all if none is named; raises InputError for a fault that there is not."""
    names = [fault.replace("-", " ").lower() for fault in faults]
    known = {drill.fault.lower(): drill for drill in DRILLS}
    unknown = [fault for fault, name in zip(faults, names, strict=True) if name not in known]
    if unknown:
        told = ", ".join(drill.fault.replace(" ", "-") for drill in DRILLS)
        raise InputError([f"--fault: there is no drill {fault!r} (there are {told})" for fault in unknown])
    return tuple(drill for drill in DRILLS if not names or drill.fault.lower() in names)
