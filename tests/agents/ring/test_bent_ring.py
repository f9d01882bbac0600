"""The bend of the ring around zones: its distances by shapely, its rates by differences, and its sides."""

from math import cos, inf, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import LinearRing, Point, Polygon

from agents.ring.bent_ring import BEARINGS, Bender, RingBend, RingBends
from agents.safety.routes import passing_room_m
from agents.settings.sections import EncirclementSettings, NoFlySection, SafetySettings

RING = EncirclementSettings(radius_m=10.0, angular_rate_rad_s=0.1)
SAFETY = SafetySettings(separation_m=3.0, keep_out_m=3.0)
ROOM_M = passing_room_m(1.2 * 1.0, SAFETY)


def disc(x: float, y: float, radius_m: float) -> NoFlySection:
    return NoFlySection(name="disc", center_m=(x, y), radius_m=radius_m)


def flown(bend: RingBend, radius_m: float = 10.0) -> LinearRing:
    angles = np.linspace(0.0, 2.0 * pi, 4000, endpoint=False)
    out_m = radius_m + bend.at(angles)[0]
    return LinearRing(np.stack((out_m * np.cos(angles), out_m * np.sin(angles)), axis=1))


def bent(*zones: NoFlySection, safety: SafetySettings = SAFETY, places: float = 3.0) -> RingBend | None:
    return Bender(zones, RING, safety, places).bend((0.0, 0.0))


@given(turn=st.floats(-pi, pi), off_m=st.floats(6.0, 14.0), radius_m=st.floats(0.5, 2.0))
def test_the_ring_keeps_the_room_to_a_zone_and_its_speed_and_acceleration(
    turn: float, off_m: float, radius_m: float
) -> None:
    bend = bent(disc(off_m * cos(turn), off_m * sin(turn), radius_m))
    assert bend is not None
    zone = Point(off_m * cos(turn), off_m * sin(turn)).buffer(radius_m, quad_segs=64)
    assert flown(bend).distance(zone) >= ROOM_M - 0.02
    times_s = np.arange(0.0, 2.0 * pi / 0.1, 0.1)
    out_m = 10.0 + bend.at(0.1 * times_s)[0]
    path = np.stack((out_m * np.cos(0.1 * times_s), out_m * np.sin(0.1 * times_s)), axis=1)
    velocity = np.gradient(path, 0.1, axis=0)
    assert np.hypot(*velocity.T).max() <= 0.95 * 3.0 + 0.02
    acceleration = np.gradient(velocity, 0.1, axis=0)
    assert np.hypot(*acceleration.T).max() <= 0.8 * 2.0 + 0.1


def test_the_change_with_the_bearing_is_that_of_the_bend() -> None:
    bend = bent(disc(10.0, 0.0, 1.0), disc(-9.0, 3.0, 1.5))
    assert bend is not None
    for bearing in np.linspace(-4.0, 7.0, 50).tolist():
        (before, after), _ = bend.at(np.array([bearing - 0.02, bearing + 0.02]))
        assert bend.at_one(bearing)[1] == pytest.approx((after - before) / 0.04, abs=0.4)
    assert abs(bend.off_m[BEARINGS // 4]) < 0.1, "far from zones it is a circle"


def test_it_passes_on_the_side_that_is_nearer_and_possible() -> None:
    farther_out, farther_in = bent(disc(11.0, 0.0, 1.0)), bent(disc(9.0, 0.0, 1.0))
    assert farther_out is not None
    assert farther_in is not None
    assert farther_out.off_m[0] < 0.0 < farther_in.off_m[0]
    # Inside it would be nearer than the keep-out disc.
    outside = bent(disc(11.0, 0.0, 1.0), safety=SAFETY.model_copy(update={"keep_out_m": 9.0}))
    assert outside is not None
    assert outside.off_m.min() >= 0.0
    fence = ((-11.9, -11.9), (11.9, -11.9), (11.9, 11.9), (-11.9, 11.9))
    inside = bent(disc(9.0, 0.0, 1.0), safety=SAFETY.model_copy(update={"fence_m": fence}))
    assert inside is not None
    assert inside.off_m.max() <= 0.0


def test_where_neither_side_is_possible_there_is_none() -> None:
    wall = NoFlySection(name="wall", polygon_m=((5.0, -1.0), (40.0, -1.0), (40.0, 1.0), (5.0, 1.0)))
    assert bent(wall, safety=SAFETY.model_copy(update={"keep_out_m": 4.0})) is None
    assert bent(wall, places=20.0) is None, "inside there is no room for 20"
    assert bent(disc(2.0, 0.0, 2.5)) is not None, "a zone over the target is within the ring"


def test_outside_of_a_zone_it_passes_one_behind_it_outside_as_well() -> None:
    house = NoFlySection(name="house", polygon_m=((3.0, -2.0), (11.0, -2.0), (11.0, 2.0), (3.0, 2.0)))
    behind = disc(13.6, 0.0, 1.0)
    bend = bent(house, behind)
    assert bend is not None
    ring = flown(bend)
    assert min(ring.distance(Point(13.6, 0.0).buffer(1.0)), ring.distance(Polygon(house.polygon_m))) >= ROOM_M - 0.02


def test_the_room_outside_is_up_to_the_next_zone() -> None:
    bend = bent(disc(16.0, 0.0, 1.0))
    assert bend is not None
    assert not bend.off_m.any()
    assert bend.room_at_m(0.0) == pytest.approx(16.0 - 1.0 - ROOM_M - 10.0, abs=0.1)
    assert bend.room_at_m(0.0, pi) == bend.room_at_m(0.0)
    assert bend.room_at_m(pi) == inf


def test_with_a_target_that_moves_the_bend_changes_without_a_jump() -> None:
    bends = RingBends([disc(10.0, 0.0, 1.0)], RING, SAFETY, 3.0)
    before = bends.about((0.0, 0.0), 0.0).off_m
    for tick in range(1, 100):
        after = bends.about((0.0, 0.03 * tick), 0.1 * tick).off_m
        assert np.abs(after - before).max() < 0.5
        before = after
    moved = Bender([disc(10.0, 0.0, 1.0)], RING, SAFETY, 3.0).bend((0.0, 2.97))
    assert moved is not None
    assert np.abs(before - moved.off_m).max() < 1.0


def test_corners_of_a_zone_count_at_bearings_between_the_grids() -> None:
    spike = NoFlySection(name="spike", polygon_m=((9.0, 0.05), (14.0, 0.0), (14.0, 0.1)))
    bend = bent(spike)
    assert bend is not None
    assert flown(bend).distance(Polygon(spike.polygon_m)) >= ROOM_M - 0.05
