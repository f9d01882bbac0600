"""Measure how long a ring takes to space its vehicles evenly again after losses.

First table: one of 3 to 32 vehicles on the rings of joins_from_a_line.py is lost, that is its agent ends and it hovers
where it is, or is commanded to return. Second table: a published simulation's ring of ten (soliton_encirclement_v3) of
20 m at up to 10 m/s and 4 m/s2, each of which fails once a minute on average, hovers for 8 s, and comes back. All fly
the stub's plant. Measured is the true motion; a time that the next change of members cuts off counts as a lower bound.
Exit code 1 if a ring of the first table needs longer than 10 s and longer than its least time at half a metre a second,
or comes nearer than the separation.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import inf, pi, tau
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.ring.transition import transition_of
from agents.team.messages import OperatorCommand
from estimation.state import POSITION, Vector
from gcs.mission.mission import Mission
from sitl.simulation.simulation import Absence
from tests.experiments.arguments import parser, positive
from tests.experiments.joins_from_a_line import FASTEST_M_S, NETWORK, RING_M_S, TEAMS
from tests.experiments.membership import SPACING_DEG, separation_left_m, settled_s
from tests.experiments.membership_scenes import Scene, flown
from tests.support.mission_text import Content, content, parsed
from tests.support.ring_mission import ring_mission

TABLES = ("losses", "failures")
LEAVES_S, BACK_S, AFTER_S = 30.0, 50.0, 30.0
HOME_M = 20.0
"""How far outside the ring the one starts that leaves: it returns there."""
IN_TIME_S, SLOW_M_S = 10.0, 0.5

FAILING, RADIUS_M, SPEED_M_S, ACCELERATION_M_S2 = 10, 20.0, 10.0, 4.0
MEAN_S, OFF_S = 60.0, 8.0
APART_M = 4.0
"""The least distance between random starts, which in the published simulation may be anywhere."""
EVEN_SHARE, EVEN_FOR_S = 0.05, 5.0
"""The published simulation's settling, of one vehicle: the gaps ahead and behind differ by at most this share of their
sum for this time, for the first time in the flight.
"""


def on_ring(count: int, duration_s: float) -> Content:
    """Return a mission whose vehicles start evenly spaced, a metre outside the ring."""
    ports = list(range(14540, 14540 + count))
    mission = content(ring_mission(count, duration_s, ports, [port + 1000 for port in ports]))
    mission["network"] |= {"range_m": 1000.0, "delay_s": NETWORK.delay_s}
    return mission


def places(scene: Scene, seed: int) -> tuple[Vector, NDArray[np.complex128], float]:
    """Fly a scene; return the times (T,), the places about the target (T, N), and the separation that is left."""
    flight = flown(scene, seed)
    about_m = flight.motion[..., POSITION] @ np.array([1.0, 1.0j])  # the target rests at the origin
    return flight.time_s, about_m, separation_left_m(scene, flight)


def spaced(places_m: NDArray[np.complex128]) -> NDArray[np.bool_]:
    """Return when (T,) all gaps are even within the tolerance."""
    turns = np.sort(np.angle(places_m), axis=1)
    gaps = np.diff(turns, axis=1, append=turns[:, :1] + tau)
    return np.asarray(np.degrees(np.abs(gaps - tau / places_m.shape[1])).max(axis=1) <= SPACING_DEG)


def ring_of(count: int) -> Mission:
    """Return the mission of a ring that loses one."""
    mission = on_ring(count, LEAVES_S + AFTER_S)
    ring = mission["encirclement"]
    ring |= {"angular_rate_rad_s": RING_M_S / ring["radius_m"], "speed_max_m_s": FASTEST_M_S}
    mission["vehicles"][0]["start_m"] = [ring["radius_m"] + HOME_M, 0.0]
    return parsed(mission)


def least_s(mission: Mission) -> float:
    """Return how long the farthest vehicle needs to its place after a loss, from rest to rest at SLOW_M_S."""
    count, ring = len(mission.ids), mission.encirclement
    way_m = ring.radius_m * pi * (count - 2) / (count * (count - 1))
    return way_m / SLOW_M_S + SLOW_M_S / transition_of(ring).acceleration_m_s2


def one_leaves(lost: bool, count: int) -> tuple[float, float]:
    """Return after how long the others are evenly spaced, and the separation that is left."""
    absences = (Absence(1, LEAVES_S),) if lost else ()
    told = () if lost else (OperatorCommand(LEAVES_S, "rtl", 1, "tower", 0),)
    time_s, places_m, left_m = places(Scene(ring_of(count), absences, LEAVES_S + AFTER_S, LEAVES_S, told=told), 0)
    after = time_s >= LEAVES_S
    return settled_s(time_s[after] - LEAVES_S, spaced(places_m[after][:, 1:])), left_m


class Setting(NamedTuple):
    """Changes of `[encirclement]` and `[tuning.encirclement]` of the ring whose vehicles fail."""

    name: str
    encirclement: Content
    tuning: Content


SETTINGS = (
    Setting("by default", {}, {}),
    Setting(
        "quick, by settings",
        {"spacing_speed_max_m_s": SPEED_M_S},
        {"spacing_gain_per_s": 0.65, "smoothing_time_s": 1.0},
    ),
    Setting(
        "at the limits",
        {"spacing_speed_max_m_s": SPEED_M_S, "spacing_acceleration_max_m_s2": ACCELERATION_M_S2},
        {"spacing_gain_per_s": 0.65, "smoothing_time_s": 1.0},
    ),
)


@dataclass(frozen=True)
class Failures:
    """One flight: after each change of its members the time to settle, or to the next change with False.

    `first_s` are the times from which each vehicle is evenly spaced as in the published simulation, inf if never;
    `spaced_share` is the share of the time in which all gaps are even.
    """

    waits: tuple[tuple[float, bool], ...]
    first_s: tuple[float, ...]
    spaced_share: float
    separation_left_m: float


def ring_of_ten(setting: Setting, duration_s: float) -> Content:
    """Return the ring of the published simulation, at its limits; as there, it does not turn."""
    mission = on_ring(FAILING, duration_s)
    limits = {"speed_max_m_s": SPEED_M_S, "acceleration_max_m_s2": ACCELERATION_M_S2}
    mission["encirclement"] |= limits | {"radius_m": RADIUS_M, "angular_rate_rad_s": 0.0} | setting.encirclement
    mission["safety"] |= limits
    mission["tuning"] = {"encirclement": setting.tuning}
    return mission


def placed(mission: Content, places_m: NDArray[np.complex128]) -> Content:
    """Return the mission with other starts, about the target."""
    for vehicle, place in zip(mission["vehicles"], places_m.tolist(), strict=True):
        vehicle |= {"start_m": [place.real, place.imag], "slot_m": [place.real - RADIUS_M, place.imag]}
    return mission


def one_fails(setting: Setting) -> Failures:
    """Fly ten that are evenly spaced, of which one fails and comes back when the others have closed up."""
    places_m = RADIUS_M * np.exp(1j * tau / FAILING * np.arange(FAILING))
    mission = placed(ring_of_ten(setting, BACK_S + AFTER_S), places_m)
    return changed(mission, (Absence(1, LEAVES_S, BACK_S),), 0)


def all_fail(setting: Setting, duration_s: float, seed: int) -> Failures:
    """Fly ten that start anywhere near the ring; each fails and comes back again and again."""
    random = np.random.default_rng([14, seed])
    bearings_rad = np.zeros(FAILING)
    while np.diff(bearings_rad, append=bearings_rad[0] + tau).min() * RADIUS_M < APART_M:
        bearings_rad = np.sort(random.uniform(0.0, tau, FAILING))
    places_m = RADIUS_M * random.uniform(0.9, 1.1, FAILING) * np.exp(1j * bearings_rad)
    absences = []
    for vehicle_id in range(1, FAILING + 1):
        at_s = float(random.exponential(MEAN_S))
        while at_s < duration_s:
            absences.append(Absence(vehicle_id, at_s, at_s + OFF_S))
            at_s += OFF_S + float(random.exponential(MEAN_S))
    return changed(placed(ring_of_ten(setting, duration_s), places_m), tuple(absences), seed)


def changed(mission: Content, absences: tuple[Absence, ...], seed: int) -> Failures:
    """Fly a mission with failures and measure."""
    scene = Scene(parsed(mission), absences, mission["mission"]["duration_s"], 0.0)
    time_s, places_m, left_m = places(scene, seed)
    there, even = scene.there(time_s), np.zeros(time_s.size, dtype=np.bool_)
    changes = np.flatnonzero((there[1:] != there[:-1]).any(axis=1)) + 1
    waits = []
    for begin, end in pairwise([0, *changes.tolist(), time_s.size]):
        even[begin:end] = spaced(places_m[begin:end][:, there[begin]])
        took_s = settled_s(time_s[begin:end] - time_s[begin], even[begin:end])
        waits.append((took_s, True) if took_s < inf else (float(time_s[end - 1] - time_s[begin]), False))
    turns = np.where(there, np.angle(places_m), np.nan)
    first_s = tuple(first_even_s(time_s, turns, own) for own in range(turns.shape[1]))
    return Failures(tuple(waits[1:]), first_s, float(even.mean()), left_m)


def first_even_s(time_s: Vector, turns: Vector, own: int) -> float:
    """Return when a vehicle begins to be between its neighbours, as the published simulation counts; inf if never.

    `turns` are the bearings (T, N), NaN where a vehicle is absent.
    """
    ahead = (np.delete(turns, own, axis=1) - turns[:, [own]]) % tau
    lead, lag = np.nanmin(ahead, axis=1, initial=tau), tau - np.nanmax(ahead, axis=1, initial=0.0)
    even = ~np.isnan(turns[:, own]) & (np.abs(lead - lag) <= EVEN_SHARE * (lead + lag))
    samples = round(EVEN_FOR_S / float(time_s[1] - time_s[0]))
    held = np.flatnonzero(np.convolve(even, np.ones(samples), "valid") == samples)
    return float(time_s[held[0]]) if held.size else inf


def quantiles_s(waits: Sequence[tuple[float, bool]], shares: Sequence[float]) -> list[float]:
    """Return quantiles of times of which those with False are lower bounds (Kaplan and Meier); inf where unknown."""
    left, found = 1.0, [inf] * len(shares)
    for place, (took_s, known) in enumerate(sorted(waits, key=lambda wait: (wait[0], not wait[1]))):
        left *= 1.0 - known / (len(waits) - place)
        reached = [1.0 - left >= share - 1e-9 for share in shares]
        found = [min(each, took_s) if there else each for each, there in zip(found, reached, strict=True)]
    return found


def losses() -> bool:
    """Print the table of rings that lose one; return whether all are in time and apart."""
    print("| vehicles | radius | least time | lost: spaced after | separation | returns: spaced after | separation | |")
    print(f"{'|---' * 8}|", flush=True)
    kept = True
    with ProcessPoolExecutor() as pool:
        flights = [pool.map(partial(one_leaves, lost), TEAMS) for lost in (True, False)]
        for count, lost, told in zip(TEAMS, *flights, strict=True):
            mission = ring_of(count)
            least = least_s(mission)
            well = all(took_s <= max(IN_TIME_S, least) and left_m >= 0.0 for took_s, left_m in (lost, told))
            cells = [f"{took_s:.1f} s | {left_m:+.2f} m" for took_s, left_m in (lost, told)]
            radius = f"{mission.encirclement.radius_m:.1f} m"
            print(
                f"| {count} | {radius} | {least:.1f} s | {' | '.join(cells)} | {'' if well else 'missed'} |", flush=True
            )
            kept = kept and well
    return kept


def failures(count: int, duration_s: float) -> None:
    """Print the table of the ring whose vehicles fail and come back."""
    print(
        "| ten | one loss | one return | changes | cut off | quartiles | first even: median | all even | separation |"
    )
    print(f"{'|---' * 9}|", flush=True)
    with ProcessPoolExecutor() as pool:
        alone = pool.map(one_fails, SETTINGS)
        draws = [pool.map(partial(all_fail, each, duration_s), range(count)) for each in SETTINGS]
        for setting, one, flights in zip(SETTINGS, alone, map(list, draws), strict=True):
            waits = [wait for flight in flights for wait in flight.waits]
            single = [f"{took_s:.1f} s" if known else "not" for took_s, known in one.waits]
            cut_off = np.mean([not known for _, known in waits])
            quartiles = ", ".join(f"{each:.1f}" for each in quantiles_s(waits, (0.25, 0.5, 0.75)))
            first_s = np.median([each for flight in flights for each in flight.first_s])
            even = np.mean([flight.spaced_share for flight in flights])
            left_m = min(flight.separation_left_m for flight in (one, *flights))
            print(
                f"| {setting.name} | {' | '.join(single)} | {len(waits)} | {cut_off:.0%} | {quartiles} s "
                f"| {first_s:.1f} s | {even:.0%} | {left_m:+.2f} m |",
                flush=True,
            )


def main(tables: Sequence[str], count: int, duration_s: float) -> int:
    """Print the tables."""
    kept = losses() if "losses" in tables else True
    if "failures" in tables:
        failures(count, duration_s)
    return 0 if kept else 1


if __name__ == "__main__":
    reader = parser("ring_losses", __doc__)
    reader.add_argument("tables", nargs="*", default=TABLES, help="losses, failures (default: both)")
    reader.add_argument("--seeds", type=int, default=4, help="flights with failures (default: %(default)s)")
    reader.add_argument("--duration", type=positive, default=300.0, help="their length [s] (default: %(default)s)")
    given = reader.parse_args()
    sys.exit(main(given.tables, given.seeds, given.duration))
