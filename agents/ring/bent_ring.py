"""The ring bent around no-fly zones: how far it is from its circle at each bearing, outwards positive.

Seen from the target, a zone with its room covers an interval of radii at each of its bearings. The ring passes each
zone outside or inside of that interval: of the ways that speed, acceleration, separation, keep-out disc and fence
allow, it takes the one nearest to the circle. What a side demands is widened by an angle to either side, and then
averaged over that angle with the weights of a squared cosine: so the bend is smooth, and nowhere less than demanded.
"""

from collections.abc import Iterable, Sequence
from itertools import product
from math import cos, inf, pi, sin, tau
from typing import Final

import numpy as np

from agents.ring.detour import MARGIN_M
from agents.ring.feasibility import RESERVE
from agents.ring.place import chord_m, even_places, weights_of
from agents.safety.routes import flown_zones, passing_room_m, shapes_of, wider
from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings, NoFlySection, SafetySettings
from estimation.state import Vector
from estimation.vectors import Pair

BEARINGS: Final = 360
_STEP_RAD = tau / BEARINGS
_WIDTHS = (9, 12, 16, 21, 28, 37, 50, 66, 88)
"""In steps: the angles over which a bend may begin and end."""
_SIDES_MAX: Final = 8
"""With more zones on the ring, it passes all of them on one side."""
_ACCELERATION_SHARES = (0.5, 0.8)
"""The shares of the acceleration that a bend may take: the second one if there is none with the first. The rest is for
corrections.
"""
_FASTER: Final = 1.2
"""By how much a vehicle on the ring may be faster than it, for the room to zones."""
_REBUILT_M: Final = 0.3
_BLENDED_S: Final = 2.0
"""The ring is bent anew when the target has moved so far, and changes to that over this time."""


class RingBend:
    """The bend at `BEARINGS` bearings from 0: by how much the ring is farther out, its change with the bearing, and how
    far outside of the bent ring a vehicle may wait.
    """

    def __init__(self, off_m: Vector, room_m: Vector) -> None:
        self.off_m: Final = off_m
        self.slope_m_rad: Final[Vector] = (np.roll(off_m, -1) - np.roll(off_m, 1)) / (2.0 * _STEP_RAD)
        self.room_m: Final = room_m

    def at(self, bearings_rad: Vector) -> tuple[Vector, Vector]:
        """Return the bend [m] and its change [m/rad] at bearings (n,)."""
        place = bearings_rad / _STEP_RAD
        whole = np.floor(place)
        share, low = place - whole, whole.astype(np.int64) % BEARINGS
        high = (low + 1) % BEARINGS
        off_m = self.off_m[low] + share * (self.off_m[high] - self.off_m[low])
        return off_m, self.slope_m_rad[low] + share * (self.slope_m_rad[high] - self.slope_m_rad[low])

    def at_one(self, bearing_rad: float) -> Pair:
        """Return the same at one bearing."""
        off_m, slope_m_rad = self.at(np.array((bearing_rad,)))
        return off_m.item(), slope_m_rad.item()

    def room_at_m(self, *bearings_rad: float) -> float:
        """Return the least room outside of the ring at bearings."""
        return min([self.room_m.item(round(each / _STEP_RAD) % BEARINGS) for each in bearings_rad])

    def towards(self, other: "RingBend", share: float) -> "RingBend":
        """Return the bend on its way to another one."""
        return RingBend(self.off_m + share * (other.off_m - self.off_m), np.minimum(self.room_m, other.room_m))


class Bender:
    """Bends one ring around zones; `places` is how many vehicles, evenly spaced, it has to have room for."""

    def __init__(
        self, zones: Sequence[NoFlySection], ring: EncirclementSettings, safety: SafetySettings, places: float
    ) -> None:
        self._radius_m, self._rate_rad_s = ring.radius_m, abs(ring.angular_rate_rad_s)
        room_m = passing_room_m(_FASTER * self._rate_rad_s * ring.radius_m, safety)
        self._shapes = shapes_of(zones, room_m)
        self._fence_shapes = wider(safety.fence_m, -room_m) if safety.fence_m else None
        self._speed_m_s = RESERVE * min(ring.speed_max_m_s, safety.speed_max_m_s)
        most_m_s2 = min(ring.acceleration_max_m_s2, safety.acceleration_max_m_s2)
        self._acceleration_m_s2 = most_m_s2
        self._least_m = max(
            ring.radius_min_m + MARGIN_M,
            safety.keep_out_m + MARGIN_M if safety.keep_out_m else 0.0,
            (safety.separation_m + MARGIN_M) / chord_m(1.0, places) if places > 1.0 else 0.0,
        )
        self._windows = {width: _window(width) for width in _WIDTHS}

    def bend(self, centre_m: Pair) -> RingBend | None:
        """Return the bend about a centre, None if no side of some zone can be passed.

        Only where there is none with the zones outside of the circle left outside does it bend around these, too.
        """
        for around, share in product((False, True), _ACCELERATION_SHARES):
            if (found := self._bend(centre_m, share * self._acceleration_m_s2, around=around)) is not None:
                return found
        return None

    def _bend(self, centre_m: Pair, most_m_s2: float, *, around: bool) -> RingBend | None:
        low_m, high_m = self._intervals(centre_m)
        reach_m = self._reach_m(centre_m)
        # A ring that keeps the room to all zones anyway is a circle.
        sides = [self._fixed_side(low, high) for low, high in zip(low_m, high_m, strict=True)]
        if around:
            farthest_m = max([high_m[k].max() for k, side in enumerate(sides) if side >= 0], default=0.0)
            sides = [0 if side < 0 and low_m[k].min() < farthest_m else side for k, side in enumerate(sides)]
        open_ = [k for k, side in enumerate(sides) if side == 0]
        best, best_cost = None, inf
        for choice in _choices(len(open_)):
            chosen = dict(zip(open_, choice, strict=True))
            outside = [k for k, side in enumerate(sides) if chosen.get(k, side) > 0]
            inside = [k for k in range(len(sides)) if k not in outside]
            least_m = np.maximum(high_m[outside].max(axis=0, initial=0.0), self._least_m)
            most_m = np.minimum(low_m[inside].min(axis=0, initial=inf), reach_m)
            off_m, cost = self._smoothed(least_m, most_m, most_m_s2, best_cost)
            if off_m is not None:
                radius_m = self._radius_m + off_m
                next_m = np.where(low_m > radius_m, low_m, inf).min(axis=0, initial=inf)
                best, best_cost = RingBend(off_m, np.minimum(next_m, reach_m) - radius_m), cost
        return best

    def _fixed_side(self, low_m: Vector, high_m: Vector) -> int:
        """Return 1 for a zone that is inside of the ring at all of its bearings, -1 outside, 0 if it is on it."""
        if bool((high_m <= self._radius_m).all()):
            return 1
        if low_m.min() <= self._least_m:
            return 1
        return -1 if bool((low_m >= self._radius_m).all()) else 0

    def _smoothed(
        self, least_m: Vector, most_m: Vector, acceleration_m_s2: float, below: float
    ) -> tuple[Vector | None, float]:
        """Return the bend nearest to the circle between two radii at each bearing, and its cost, None without one."""
        if bool((least_m > most_m).any()):
            return None, inf
        outwards, inwards = np.maximum(least_m - self._radius_m, 0.0), np.maximum(self._radius_m - most_m, 0.0)
        for width in _WIDTHS:
            off_m = _smooth(outwards, self._windows[width]) - _smooth(inwards, self._windows[width])
            cost = float(np.abs(off_m).sum())
            if cost >= below:
                break
            radius_m = self._radius_m + off_m
            fits = bool((radius_m >= least_m - 1e-6).all()) and bool((radius_m <= most_m + 1e-6).all())
            if fits and self._is_flyable(radius_m, acceleration_m_s2):
                return off_m, cost
        return None, inf

    def _is_flyable(self, radius_m: Vector, acceleration_m_s2: float) -> bool:
        """Return whether speed and acceleration suffice at the ring's rate w: r' = w dr/dphi, and (3) of the paper."""
        slope = (np.roll(radius_m, -1) - np.roll(radius_m, 1)) / (2.0 * _STEP_RAD)
        curvature = (np.roll(radius_m, -1) - 2.0 * radius_m + np.roll(radius_m, 1)) / _STEP_RAD**2
        fastest_m_s = self._rate_rad_s * np.hypot(radius_m, slope).max()
        most_m_s2 = self._rate_rad_s**2 * np.hypot(curvature - radius_m, 2.0 * slope).max()
        return bool(fastest_m_s <= self._speed_m_s) and bool(most_m_s2 <= acceleration_m_s2)

    def _intervals(self, centre_m: Pair) -> tuple[Vector, Vector]:
        """Return the least and the largest radius of each zone at each bearing, (zones, BEARINGS); inf, -inf off it."""
        low_m = np.full((len(self._shapes), BEARINGS), inf)
        high_m = np.full((len(self._shapes), BEARINGS), -inf)
        for number, corners_m in enumerate(self._shapes):
            low_m[number], high_m[number], crossings = _crossed(corners_m, centre_m)
            low_m[number][crossings % 2 == 1] = 0.0  # the target is in the room of the zone
        return low_m, high_m

    def _reach_m(self, centre_m: Pair) -> Vector:
        """Return the distance of the fence, less the room, at each bearing."""
        if self._fence_shapes is None:
            return np.full(BEARINGS, inf)
        for corners_m in self._fence_shapes:
            least_m, _, crossings = _crossed(corners_m, centre_m)
            if bool((crossings % 2 == 1).all()):
                return least_m
        return np.zeros(BEARINGS)


def _choices(count: int) -> Iterable[tuple[int, ...]]:
    """Return the sides, 1 outside and -1 inside, on which so many zones may be passed."""
    return product((1, -1), repeat=count) if count <= _SIDES_MAX else ((1,) * count, (-1,) * count)


def _crossed(corners_m: Vector, centre_m: Pair) -> tuple[Vector, Vector, Vector]:
    """Return the least and the largest radius at which rays (BEARINGS,) cross a polygon (n, 2), and how often."""
    bearings_rad = np.arange(BEARINGS) * _STEP_RAD
    x, y = np.cos(bearings_rad)[:, None], np.sin(bearings_rad)[:, None]
    (x1, y1), (x2, y2) = (corners_m - centre_m).T, (np.roll(corners_m, -1, axis=0) - centre_m).T
    # Half-open, so that a ray through a corner crosses one of its edges.
    side1, side2 = x * y1 - y * x1, x * y2 - y * x2
    crosses = (side1 >= 0.0) != (side2 >= 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = side1 / (side1 - side2)
        along = x * (x1 + share * (x2 - x1)) + y * (y1 + share * (y2 - y1))
    crosses &= along > 0.0
    return (
        np.where(crosses, along, inf).min(axis=1, initial=inf),
        np.where(crosses, along, -inf).max(axis=1, initial=-inf),
        crosses.sum(axis=1),
    )


def _window(width: int) -> Vector:
    """Return the weights (2 width + 1,) of a squared cosine, in sum 1."""
    weights = np.cos(np.arange(-width, width + 1) / (width + 1) * pi / 2.0) ** 2
    return np.asarray(weights / weights.sum(), dtype=np.float64)


def _smooth(wanted: Vector, weights: Vector) -> Vector:
    """Return a smooth function of the bearing that is nowhere less than the one wanted."""
    width = len(weights) // 2
    if not wanted.any():
        return np.zeros(BEARINGS)
    around = np.concatenate((wanted[-2 * width :], wanted, wanted[: 2 * width]))
    widened = np.lib.stride_tricks.sliding_window_view(around, 2 * width + 1).max(axis=1)
    return np.asarray(np.convolve(widened, weights, mode="valid"), dtype=np.float64)


class RingBends:
    """The bend of the ring about a target that moves: found anew when it has moved, and changed to smoothly."""

    def __init__(
        self, zones: Sequence[NoFlySection], ring: EncirclementSettings, safety: SafetySettings, places: float
    ) -> None:
        self._safety = safety
        self.change(zones, ring, places)

    def change(self, zones: Sequence[NoFlySection], ring: EncirclementSettings, places: float) -> None:
        """Bend the ring of other settings, with so many places, around other zones from now on."""
        self._bender = Bender(zones, ring, self._safety, places)
        self._centre_m: Pair | None = None
        self._before = self._after = self._flown = _CIRCLE
        self._changed_s = -inf

    def about(self, centre_m: Pair, now_s: float) -> RingBend:
        """Return the bend about a centre; where there is none, the last one: then it is the guard that decides."""
        last_m = self._centre_m
        if last_m is None or abs(centre_m[0] - last_m[0]) + abs(centre_m[1] - last_m[1]) > _REBUILT_M:
            self._centre_m = centre_m
            found = self._bender.bend(centre_m) or _CIRCLE
            self._before = found if last_m is None else self._flown
            self._after, self._changed_s = found, now_s
        share = min(1.0, (now_s - self._changed_s) / _BLENDED_S)
        if share >= 1.0:
            self._flown = self._after
        else:
            self._flown = self._before.towards(self._after, share)
        return self._flown


def places_on(config: AgentConfig) -> float:
    """Return how many vehicles, evenly spaced, the ring of a configuration has to have room for."""
    return float(config.places) if config.rings else even_places(weights_of(config.slots, config.gaps))


def bend_of(config: AgentConfig, centre_m: Pair) -> RingBend | None:
    """Return the bend of a configuration's ring about a centre, a circle where no zone is in its way.

    None if no side of some zone can be passed.
    """
    zones = flown_zones(config)
    return Bender(zones, config.encirclement, config.safety, places_on(config)).bend(centre_m) if zones else _CIRCLE


_CIRCLE = RingBend(np.zeros(BEARINGS), np.full(BEARINGS, inf))


def waiting_places_m(centre_m: Pair, radius_m: float, aside_m: float, bend: RingBend) -> list[Pair]:
    """Return places about a centre, every 15 degrees, on the circle outside of a bent ring on which vehicles wait."""
    x, y = centre_m
    places = []
    for k in range(0, BEARINGS, BEARINGS // 24):
        out_m = radius_m + bend.off_m.item(k) + max(0.0, min(aside_m, bend.room_m.item(k)))
        places.append((x + out_m * cos(k * _STEP_RAD), y + out_m * sin(k * _STEP_RAD)))
    return places
