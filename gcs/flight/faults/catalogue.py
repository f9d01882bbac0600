"""The faults by name, and the change that each of them makes to a team in flight."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import cos, hypot, pi, sin
from signal import SIGKILL, SIGSTOP

from estimation.frames import Triple
from gcs.errors import InputError
from gcs.flight.faults.names import FaultName, as_option
from gcs.flight.faults.team_faults import Injection, TeamFaults, TeamInFlight
from gcs.mission.mission import Mission
from sitl.faults import VehicleFaults, VehicleInjection

LOSS = 0.5
BUS_DELAY_S, LINK_DELAY_S = 0.3, 0.1
JUMP_M, HEIGHT_JUMP_M, POSITION_OFFSET_M = 10.0, 6.0, 5.0
RATIO_DEGRADED, RATIO_FAILING = 0.8, 2.0
LINES = 36
"""Number of directions in which an estimate may jump."""
PUSHED_SHARE = 2.0
"""How far a vehicle is pushed off its setpoint, as a multiple of the tolerated distance."""
ROOM_SHARE = 2.0
"""Least distance of a falsified position from the other vehicles, as a multiple of the separation."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault: its injection, how many airborne vehicles it needs, and whether it affects the whole team."""

    name: FaultName
    inject: Callable[[TeamInFlight], Injection]
    vehicles_min: int = 1
    of_team: bool = False

    @property
    def option(self) -> str:
        """The name on the command line."""
        return as_option(self.name)


def fault_named(text: str) -> Fault | None:
    """Return the fault of a name, with hyphens or spaces and in any case; None for an unknown name."""
    return _BY_OPTION.get(as_option(text).lower())


def required_fault(text: str) -> Fault:
    """Return the fault of a name; raises InputError for an unknown one."""
    if (fault := fault_named(text)) is None:
        known = ", ".join(each.option for each in FAULTS)
        raise InputError([f"--fault: there is no fault {text!r}; the faults are {known}"])
    return fault


def _of_team(make: Callable[[TeamInFlight], TeamFaults]) -> Callable[[TeamInFlight], Injection]:
    return lambda scene: Injection(team=make(scene))


def _of_subject(make: Callable[[TeamInFlight], VehicleFaults]) -> Callable[[TeamInFlight], Injection]:
    return lambda scene: Injection(vehicles={scene.subject: VehicleInjection(make(scene))})


def _latency(scene: TeamInFlight) -> Injection:
    """Delay all messages, and all links in both directions."""
    late = VehicleInjection(VehicleFaults(link_delay_s=LINK_DELAY_S))
    return Injection(TeamFaults(delay_s=BUS_DELAY_S), dict.fromkeys(scene.mission.ids, late))


def _jump_aside(scene: TeamInFlight) -> VehicleFaults:
    """Offset its estimate along the line on which neither the jump nor its correction comes near the others."""
    x, y = clearest_line(scene.places_m[scene.subject], [scene.places_m[i] for i in scene.others])
    return VehicleFaults(estimate_offset_m=(JUMP_M * x, JUMP_M * y, 0.0))


def _move_origin(scene: TeamInFlight) -> VehicleFaults:
    """Move the origin of its positions: a setpoint that is not converted leads it as far as a jump does."""
    x, y = clearest_line(scene.places_m[scene.subject], [scene.places_m[i] for i in scene.others])
    return VehicleFaults(origin_moved_m=(JUMP_M * x, JUMP_M * y, 0.0))


def clearest_line(place_m: Triple, others_m: Sequence[Triple]) -> tuple[float, float]:
    """Return the unit vector of the line through a position that passes the others at the largest distance."""
    away = [(x - place_m[0], y - place_m[1]) for x, y, _ in others_m]
    lines = [(cos(turn), sin(turn)) for turn in (pi * step / LINES for step in range(LINES))]
    return max(lines, key=lambda line: min((abs(line[0] * y - line[1] * x) for x, y in away), default=0.0))


def _from_the_others(scene: TeamInFlight) -> tuple[float, float]:
    """Return the unit vector from the others to the subject."""
    x, y, _ = scene.places_m[scene.subject]
    away_x, away_y = (sum((x, y)[axis] - scene.places_m[i][axis] for i in scene.others) for axis in (0, 1))
    away_m = hypot(away_x, away_y)
    return (away_x / away_m, away_y / away_m) if away_m else (1.0, 0.0)


def _push_outwards(scene: TeamInFlight) -> VehicleFaults:
    """Push it away from the others, in the steady state by `PUSHED_SHARE` of the tolerated distance."""
    away_x, away_y = _from_the_others(scene)
    vehicle = scene.mission.vehicle(scene.subject)
    push_m_s2 = PUSHED_SHARE * scene.mission.failsafe.following_m * vehicle.true_plant.x.a0_per_s2
    return VehicleFaults(push_m_s2=(push_m_s2 * away_x, push_m_s2 * away_y))


def _position_offset_m(scene: TeamInFlight) -> tuple[float, float]:
    """Return the offset of the subject's falsified position: nearer to the others, but outside their separation."""
    away_x, away_y = _from_the_others(scene)
    x, y = -POSITION_OFFSET_M * away_x, -POSITION_OFFSET_M * away_y
    subject_x, subject_y, _ = scene.places_m[scene.subject]
    places_m = [scene.places_m[i] for i in scene.others]
    away_m = [hypot(other[0] - subject_x - x, other[1] - subject_y - y) for other in places_m]
    room = min(away_m) >= ROOM_SHARE * scene.mission.safety.separation_m
    return (x, y) if room else (-x, -y)


def _falsify_position(scene: TeamInFlight) -> TeamFaults:
    """Make it report a position that is not its own."""
    return TeamFaults(
        falsified_positions=frozenset({scene.subject}), position_offset_m={scene.subject: _position_offset_m(scene)}
    )


def _impersonate(scene: TeamInFlight) -> TeamFaults:
    """Let a second source send states under its id, with another position."""
    return TeamFaults(
        impostors=frozenset({scene.subject}), position_offset_m={scene.subject: _position_offset_m(scene)}
    )


def _nearly_empty(mission: Mission) -> float:
    """Return the charge of a battery that is critical."""
    return mission.failsafe.battery_critical * 0.8


def _drain(fraction: Callable[[Mission], float]) -> Callable[[TeamInFlight], Injection]:
    """Return a fault that leaves a share of the subject's battery."""
    return lambda scene: Injection(vehicles={scene.subject: VehicleInjection(battery_fraction=fraction(scene.mission))})


FAULTS: tuple[Fault, ...] = (
    Fault("half of all messages lost", _of_team(lambda _: TeamFaults(loss=LOSS)), of_team=True),
    Fault("latency", _latency, of_team=True),
    Fault("stranger", lambda _: Injection(unauthorised_client=True), vehicles_min=2, of_team=True),
    Fault("flood", _of_team(lambda scene: TeamFaults(flooders=frozenset({scene.subject}))), vehicles_min=2),
    Fault("impostor", _of_team(_impersonate), vehicles_min=2),
    Fault("liar", _of_team(_falsify_position), vehicles_min=2),
    Fault("one vehicle not heard", _of_team(lambda scene: TeamFaults(not_received=frozenset({scene.subject}))), 2),
    Fault("nobody hears anybody", _of_team(lambda scene: TeamFaults(not_received=frozenset(scene.airborne))), 2, True),
    Fault("telemetry frozen", _of_subject(lambda _: VehicleFaults(motion_silent=True))),
    Fault("GPS jump", _of_subject(_jump_aside)),
    Fault("origin moved", _of_subject(_move_origin)),
    Fault("height jumped", _of_subject(lambda _: VehicleFaults(height_jump_m=HEIGHT_JUMP_M))),
    Fault("estimator degraded", _of_subject(lambda _: VehicleFaults(estimator_ratio=RATIO_DEGRADED))),
    Fault("estimator failing", _of_subject(lambda _: VehicleFaults(estimator_ratio=RATIO_FAILING))),
    Fault("not following", _of_subject(_push_outwards)),
    Fault("foreign mode", lambda scene: Injection(vehicles={scene.subject: VehicleInjection(selects_hold=True)})),
    Fault("target lost", _of_team(lambda _: TeamFaults(blind=True)), of_team=True),
    Fault("link cut", _of_subject(lambda _: VehicleFaults(link_cut=True))),
    Fault("lost in the air", _of_subject(lambda _: VehicleFaults(link_cut=True))),
    Fault("battery low", _drain(lambda m: (m.failsafe.battery_low + m.failsafe.battery_critical) / 2.0)),
    Fault("battery critical", _drain(_nearly_empty)),
    Fault("second battery", _of_subject(lambda s: VehicleFaults(second_battery=_nearly_empty(s.mission)))),
    Fault("no way home", _of_subject(lambda s: VehicleFaults(endurance_s=max(s.mission.failsafe.reserve_s, 1.0)))),
    Fault("killed agent", lambda _: Injection(signal=SIGKILL), of_team=True),
    Fault("frozen agent", lambda _: Injection(signal=SIGSTOP), of_team=True),
    Fault("frozen interpreter", _of_team(lambda _: TeamFaults(hang="interpreter")), of_team=True),
)
_BY_OPTION: Mapping[str, Fault] = {fault.option.lower(): fault for fault in FAULTS}


def vehicle_injections(scene: TeamInFlight) -> dict[str, VehicleInjection]:
    """Return the faults that affect the subject alone, by their options: the injection of each into the subject."""
    possible = [fault for fault in FAULTS if fault.vehicles_min <= len(scene.airborne)]
    injections = {fault.option: fault.inject(scene) for fault in possible}
    return {
        option: made.vehicles[scene.subject]
        for option, made in injections.items()
        if scene.subject in made.vehicles and made == Injection(vehicles=made.vehicles)
    }
