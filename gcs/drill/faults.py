"""The drills: each fault, how it is injected and cleared, and the expected reaction.

Reactions and grace times come from the failsafe table and from the mission.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import hypot

from agents.safety.failsafe import ROWS, Condition, Reaction, grace_s
from agents.tactics import Tactic
from gcs.autopilots.registry import autopilot_of
from gcs.drill.judge import Expectation
from gcs.flight.faults.catalogue import BUS_DELAY_S, LINK_DELAY_S, fault_named, required_fault
from gcs.flight.faults.failing_equipment import FLOOD_HZ
from gcs.flight.faults.team_faults import last_in_line
from gcs.mission.mission import Mission

REACH_SHARE = 1.2
"""A target farther away is reached late or never."""


@dataclass(slots=True)
class Roles:
    """The roles in one flight; `landed` are the vehicles that have landed for good."""

    mission: Mission
    landed: set[int] = field(default_factory=set)

    @property
    def airborne(self) -> tuple[int, ...]:
        """All vehicles in flight."""
        return tuple(i for i in self.mission.ids if i not in self.landed)

    @property
    def subject(self) -> int:
        """The vehicle that faults are injected into."""
        return last_in_line(self.mission, self.airborne)

    @property
    def others(self) -> tuple[int, ...]:
        """All airborne vehicles but the subject."""
        return tuple(i for i in self.airborne if i != self.subject)

    @property
    def on_ring(self) -> tuple[int, ...]:
        """The vehicles that encircle the target."""
        return tuple(i for i in self.airborne if self.tactic(i) == Tactic.ENCIRCLE.value)

    def tactic(self, vehicle: int) -> str:
        """Return a vehicle's tactic without faults: it encircles a target within its reach."""
        mission, member = self.mission, self.mission.vehicle(vehicle)
        decision = member.decision
        config = mission.agent_config(member)
        (x, y), (dx, dy) = config.line_start_m, config.slot_offset_m(vehicle, mission.formation.leader)
        away_m = hypot(mission.target.start_m[0] - x - dx, mission.target.start_m[1] - y - dy)
        accepted = mission.target.importance > decision.importance_min and mission.target.threat < decision.threat_max
        engages = accepted and away_m < REACH_SHARE * decision.distance_max_m
        return Tactic.ENCIRCLE.value if engages else Tactic.FORMATION.value


MARGIN_S = 0.5
"""Tolerance for a reaction to be observed: ticks and messages take time."""
HEARTBEAT_S, BATTERY_S = 1.0, 2.0
"""Period of an autopilot's mode and battery reports."""
CUT_S = 5.0
GIVEN_UP_S = 120.0
"""Within this time an agent without a link has given up leaving offboard and landing its vehicle."""
PUSHED_S = 3.0
"""Time until half of the deviation shows in a comparison, for the bundled stub plants."""
ESTIMATOR_S = 1.0
"""Period of the requested estimator reports."""
ORIGIN_S = 1.0
"""An origin that has moved is read again within this time."""
FLOODED_S = 1.0
"""A flood is detected within this time."""
CONTRADICTED_S = 1.0
"""Within this time several contradictory messages have been received."""
TOLERATED_S = 20.0
"""Time for which the team has to fly on under a fault that requires no reaction."""
RESPACED_S = 60.0
"""Time limit for the vehicles on the ring to become evenly spaced."""

_TACTICS = {
    Reaction.ASIDE: Tactic.ASIDE.value,
    Reaction.HOLD: Tactic.HOLD.value,
    Reaction.RETURN: Tactic.RETURN_AND_LAND.value,
    Reaction.LAND: Tactic.LAND.value,
    Reaction.HAND_OVER: Tactic.PILOT_OVERRIDE.value,
}


@dataclass(frozen=True, slots=True)
class Drill:
    """One fault: `expect` returns the expected reaction, given the roles. Times are those of the team\'s clock.

    A drill that `ends_flight` is the flight's last; after one that `lands_subject` the others fly on. The fault is
    cleared after `undo_after_s`, or once the reaction was observed; if none is expected, the team is watched for
    `watched_s`. With `waits_for_spacing` the drill begins once the ring is evenly spaced; with `waits_for_estimate` the
    subject resumes once its estimate has settled.
    """

    fault: str
    expected: str
    expect: Callable[[Roles], Expectation]
    undo_after_s: float | None = None
    ends_flight: bool = False
    lands_subject: bool = False
    watched_s: float = 0.0
    waits_for_spacing: bool = False
    waits_for_estimate: bool = False

    @property
    def vehicles_min(self) -> int:
        """The number of airborne vehicles that it needs."""
        fault = fault_named(self.fault)
        return 1 if fault is None else fault.vehicles_min

    def unsuitable(self, mission: Mission) -> str:
        """Return why this drill is not possible in a mission, empty if it is."""
        return f"needs {self.vehicles_min} vehicles" if len(mission.ids) < self.vehicles_min else ""


def by_table(
    condition: Condition, who: Callable[[Roles], tuple[int, ...]], *, found_within_s: float = 0.0
) -> Callable[[Roles], Expectation]:
    """Expect the first reaction of a row of the failsafe table, detected within `found_within_s` of mission time."""
    row = ROWS[condition]

    def expect(roles: Roles) -> Expectation:
        config = roles.mission.agent_config(roles.mission.vehicle(roles.subject))
        flies_on = row.reactions[0] is Reaction.DEGRADE
        grace = grace_s(row, config)
        return Expectation(
            who(roles),
            tuple(i for i in roles.airborne if flies_on or i not in who(roles)),
            grace + found_within_s + MARGIN_S,
            tactic=_TACTICS.get(row.reactions[0]),
            alert=condition.value,
            leaves_offboard=row.reactions[0] is Reaction.HAND_OVER,
            stands_back=row.reactions[0] is Reaction.HAND_OVER,
            separation_m=roles.mission.safety.separation_m,
        )

    return expect


def _reaction(condition: Condition) -> str:
    return f"{ROWS[condition].reactions[0].value} ({condition.value})"


def _jump(roles: Roles) -> Expectation:
    within_s = roles.mission.vehicle(roles.subject).own_filter.gate_timeout_s
    return by_table(Condition.ESTIMATOR_JUMPED, the_subject, found_within_s=within_s)(roles)


def _out_of_offboard_s(roles: Roles, vehicles: tuple[int, ...]) -> dict[int, float]:
    """Return the time limit for each vehicle's autopilot to leave offboard by itself."""
    return {i: autopilot_of(roles.mission.vehicle(i).autopilot).leaves_offboard_s for i in vehicles}


def agents_ended(roles: Roles) -> Expectation:
    """Expect that all vehicles leave offboard: their agents have ended."""
    limits_s = _out_of_offboard_s(roles, roles.airborne)
    return Expectation(
        roles.airborne,
        (),
        max(limits_s.values()),
        limits_s=limits_s,
        leaves_offboard=True,
        separation_m=roles.mission.safety.separation_m,
    )


def cut(roles: Roles) -> Expectation:
    """Expect that the subject, its link cut, leaves offboard and does not return, and that the others close the gap."""
    return Expectation(
        (roles.subject,),
        roles.others,
        _out_of_offboard_s(roles, (roles.subject,))[roles.subject] + MARGIN_S,
        leaves_offboard=True,
        at_last=Tactic.PILOT_OVERRIDE.value,
        respacing=tuple(i for i in roles.others if i in roles.on_ring),
        separation_m=roles.mission.safety.separation_m,
    )


def _lost(roles: Roles) -> Expectation:
    """Expect that the subject, its link cut for good, is reported as unaccounted for, and that the others fly on."""
    config = roles.mission.agent_config(roles.mission.vehicle(roles.subject))
    grace = grace_s(ROWS[Condition.TELEMETRY_STALE], config)
    return Expectation(
        (roles.subject,),
        roles.others,
        grace + config.failsafe.escalation_s + GIVEN_UP_S,
        leaves_offboard=True,
        is_unaccounted=True,
        separation_m=roles.mission.safety.separation_m,
    )


def _tolerated(roles: Roles) -> Expectation:
    return Expectation(
        (),
        roles.airborne,
        None,
        separation_m=roles.mission.safety.separation_m,
        radius_m=roles.mission.encirclement.radius_m,
    )


def the_subject(roles: Roles) -> tuple[int, ...]:
    """Return the vehicle that the fault is injected into."""
    return (roles.subject,)


def _drill(
    fault: str,
    condition: Condition,
    who: Callable[[Roles], tuple[int, ...]],
    found_within_s: float = 0.0,
    *,
    whose: str = "",
    more: str = "",
    **flags: bool,
) -> Drill:
    """Return a drill whose expected reaction, of `whose`, is that of the failsafe table to a condition."""
    expected = f"{whose}{ROWS[condition].reactions[0].value} ({condition.value}){more}"
    return Drill(fault, expected, by_table(condition, who, found_within_s=found_within_s), **flags)


def _others(roles: Roles) -> tuple[int, ...]:
    return roles.others


DRILLS: tuple[Drill, ...] = (
    Drill(
        "half of all messages lost",
        f"all fly on for {TOLERATED_S:g} s",
        _tolerated,
        watched_s=TOLERATED_S,
    ),
    Drill(
        "latency",
        f"all fly on for {TOLERATED_S:g} s (bus {BUS_DELAY_S:g} s, link {LINK_DELAY_S:g} s each way)",
        _tolerated,
        watched_s=TOLERATED_S,
    ),
    Drill(
        "stranger",
        f"all fly on for {TOLERATED_S:g} s",
        _tolerated,
        watched_s=TOLERATED_S,
    ),
    _drill(
        "flood",
        Condition.BUS_FLOODED,
        _others,
        FLOODED_S,
        whose="the others: ",
        more=f" ({FLOOD_HZ:g} messages a second)",
    ),
    _drill("impostor", Condition.PEER_DOUBTFUL, _others, CONTRADICTED_S, whose="the others: "),
    _drill("liar", Condition.PEER_DOUBTFUL, _others, CONTRADICTED_S, whose="the others: "),
    _drill("one vehicle not heard", Condition.PEER_SILENT, _others, whose="the others: "),
    _drill("nobody hears anybody", Condition.PEERS_SILENT, lambda roles: roles.airborne, whose="all: "),
    _drill("telemetry frozen", Condition.TELEMETRY_STALE, the_subject),
    Drill(
        "GPS jump",
        _reaction(Condition.ESTIMATOR_JUMPED),
        _jump,
        waits_for_spacing=True,
        waits_for_estimate=True,
    ),
    _drill(
        "origin moved", Condition.ORIGIN_MOVED, the_subject, ORIGIN_S, waits_for_spacing=True, waits_for_estimate=True
    ),
    Drill(
        "height jumped",
        _reaction(Condition.ESTIMATOR_JUMPED),
        _jump,
        waits_for_estimate=True,
    ),
    _drill("estimator degraded", Condition.ESTIMATOR_DEGRADED, the_subject, ESTIMATOR_S),
    _drill("estimator failing", Condition.ESTIMATOR_FAILING, the_subject, ESTIMATOR_S),
    _drill("not following", Condition.NOT_FOLLOWING, the_subject, PUSHED_S, waits_for_estimate=True),
    _drill("foreign mode", Condition.MODE_CHANGED, the_subject, HEARTBEAT_S),
    _drill("target lost", Condition.TARGET_STALE, lambda roles: roles.on_ring, whose="all on the ring: "),
    Drill(
        "link cut",
        f"out of offboard, and not back after {CUT_S:g} s; the others close the gap",
        cut,
        undo_after_s=CUT_S,
        lands_subject=True,
    ),
    _drill("battery low", Condition.BATTERY_LOW, the_subject, BATTERY_S, lands_subject=True),
    _drill("battery critical", Condition.BATTERY_CRITICAL, the_subject, BATTERY_S, lands_subject=True),
    _drill("second battery", Condition.BATTERY_CRITICAL, the_subject, BATTERY_S, lands_subject=True),
    _drill("no way home", Condition.NO_WAY_HOME, the_subject, BATTERY_S, lands_subject=True),
    Drill("lost in the air", "out of offboard, and reported as unaccounted for", _lost, lands_subject=True),
    Drill("killed agent", "all out of offboard", agents_ended, ends_flight=True),
    Drill("frozen agent", "all out of offboard", agents_ended, ends_flight=True),
    Drill("frozen interpreter", "all out of offboard", agents_ended, ends_flight=True),
)
"""In an order that one flight allows: first those that a vehicle resumes from, then those after which it lands, and
last those that end the flight."""


def chosen(faults: Sequence[str]) -> tuple[Drill, ...]:
    """Return the drills of these faults, all if none is named; raises InputError for an unknown fault."""
    names = {required_fault(each).name for each in faults}
    return tuple(drill for drill in DRILLS if not names or drill.fault in names)
