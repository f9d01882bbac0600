"""How the faults of drills are injected into a flight on stub vehicles."""

from collections.abc import Callable, Sequence
from math import cos, hypot, pi, sin
from signal import SIGKILL, SIGSTOP

from estimation.frames import Triple
from gcs.drill.flight import DrillFlight
from gcs.drill.injected_faults import InjectedFaults
from gcs.drill.roles import Roles
from gcs.drill.stubs import StubFlight
from gcs.mission.mission import Mission
from sitl.autopilot.modes import NavMode

BUS_DELAY_S, LINK_DELAY_S = 0.3, 0.1
JUMP_M, LIE_M = 10.0, 5.0
LINES = 36
"""Along how many lines through a vehicle its estimate may jump."""
PUSHED_SHARE = 2.0
"""How far a vehicle is pushed from where it should be, as a share of what is tolerated."""
ROOM_SHARE = 2.0
"""How far from the others a lie has to leave the subject, as a share of the separation."""


def kill(flight: DrillFlight, _roles: Roles) -> None:
    """Kill the flying process."""
    flight.abandon()
    flight.signal(SIGKILL)


def stop(flight: DrillFlight, _roles: Roles) -> None:
    """Stop the flying process."""
    flight.abandon()
    flight.signal(SIGSTOP)


def hang(flight: StubFlight, _roles: Roles) -> None:
    """Let the interpreter of the flying process hang."""
    flight.abandon()
    flight.inject(InjectedFaults(hang="interpreter"))


def inject(faults: Callable[[Roles, float], InjectedFaults]) -> Callable[[StubFlight, Roles], None]:
    """Return an injection of faults into the flying process, by the roles and the speed."""
    return lambda flight, roles: flight.inject(faults(roles, flight.speed))


def delay(flight: StubFlight, _roles: Roles) -> None:
    """Delay all messages, and all links in both directions."""
    flight.inject(InjectedFaults(delay_s=BUS_DELAY_S / flight.speed))
    for stub in flight.stubs.values():
        stub.faults.link_delay_s = LINK_DELAY_S / flight.speed


def silence_motion(flight: StubFlight, roles: Roles) -> None:
    """Let the subject's autopilot send no motion."""
    flight.stubs[roles.subject].faults.motion_silent = True


def cut_link(flight: StubFlight, roles: Roles) -> None:
    """Cut the subject's link."""
    flight.stubs[roles.subject].faults.link_cut = True


def jump_aside(flight: StubFlight, roles: Roles) -> None:
    """Offset its estimate along the line on which neither the estimate nor its correction comes near the others."""
    places = {i: stub.autopilot.airframe.position_m for i, stub in flight.stubs.items()}
    x, y = clearest_line(places.pop(roles.subject), list(places.values()))
    flight.stubs[roles.subject].faults.estimate_offset_m = (JUMP_M * x, JUMP_M * y, 0.0)


def clearest_line(place_m: Triple, others_m: Sequence[Triple]) -> tuple[float, float]:
    """Return the direction, of length 1, of the line through a place that passes the others the farthest away."""
    away = [(x - place_m[0], y - place_m[1]) for x, y, _ in others_m]
    lines = [(cos(turn), sin(turn)) for turn in (pi * step / LINES for step in range(LINES))]
    return max(lines, key=lambda line: min((abs(line[0] * y - line[1] * x) for x, y in away), default=0.0))


def _from_the_others(flight: StubFlight, roles: Roles) -> tuple[float, float]:
    """Return the direction, of length 1, from the others to the subject."""
    places = {i: stub.autopilot.airframe.position_m for i, stub in flight.stubs.items()}
    x, y, _ = places[roles.subject]
    away_x, away_y = (sum((x, y)[axis] - place[axis] for place in places.values()) for axis in (0, 1))
    away_m = hypot(away_x, away_y)
    return (away_x / away_m, away_y / away_m) if away_m else (1.0, 0.0)


def push_outwards(flight: StubFlight, roles: Roles) -> None:
    """Push it away from the others, in a steady state by so many metres."""
    away_x, away_y = _from_the_others(flight, roles)
    vehicle = roles.mission.vehicle(roles.subject)
    push_m_s2 = PUSHED_SHARE * roles.mission.failsafe.following_m * vehicle.true_plant.x.a0_per_s2
    flight.stubs[roles.subject].faults.push_m_s2 = (push_m_s2 * away_x, push_m_s2 * away_y)


def disturb_estimator(ratio: float) -> Callable[[StubFlight, Roles], None]:
    """Return an injection of a test ratio into the report of the subject's estimator."""

    def disturb(flight: StubFlight, roles: Roles) -> None:
        flight.stubs[roles.subject].faults.estimator_ratio = ratio

    return disturb


def exhaust(flight: StubFlight, roles: Roles) -> None:
    """Let it report less flight time than its reserve."""
    flight.stubs[roles.subject].faults.endurance_s = max(roles.mission.failsafe.reserve_s, 1.0)


def _lie_m(flight: StubFlight, roles: Roles) -> tuple[float, float]:
    """Return how far off the subject is said to be: nearer to the others, but not so near that they have to evade."""
    away_x, away_y = _from_the_others(flight, roles)
    x, y = -LIE_M * away_x, -LIE_M * away_y
    places = {i: stub.autopilot.airframe.position_m for i, stub in flight.stubs.items()}
    subject_x, subject_y, _ = places[roles.subject]
    away_m = [hypot(places[i][0] - subject_x - x, places[i][1] - subject_y - y) for i in roles.others]
    room = min(away_m) >= ROOM_SHARE * roles.mission.safety.separation_m
    return (x, y) if room else (-x, -y)


def lie(flight: StubFlight, roles: Roles) -> None:
    """Let it report another place than its own."""
    flight.inject(InjectedFaults(liars=(roles.subject,), lie_m=_lie_m(flight, roles)))


def impersonate(flight: StubFlight, roles: Roles) -> None:
    """Let a second source send states in its name, from another place."""
    flight.inject(InjectedFaults(impostors=(roles.subject,), lie_m=_lie_m(flight, roles)))


def select_hold(flight: StubFlight, roles: Roles) -> None:
    """Select hold for the subject, as another ground station does."""
    flight.stubs[roles.subject].autopilot.select(NavMode.HOLD)


def drain(fraction: Callable[[Mission], float]) -> Callable[[StubFlight, Roles], None]:
    """Return an injection that leaves a share of the subject's battery."""

    def leave(flight: StubFlight, roles: Roles) -> None:
        flight.stubs[roles.subject].autopilot.battery_fraction = fraction(roles.mission)

    return leave
