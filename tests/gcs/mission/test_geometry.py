"""Missions that do not fit into their own limits: each is refused, with the geometry in the message."""

import pytest

from gcs.mission.geometry import areas, nearest_other
from tests.support.mission_text import changed, faults, parsed

Changes = dict[tuple[str | int, ...], object]

# case2: starts at x = 0, y = 4, 0 and -4; the target goes from (35, -5) to (95, -5) within a ring of 10 m.
BOX: list[list[float]] = [[-5.0, -20.0], [110.0, -20.0], [110.0, 10.0], [-5.0, 10.0]]


def fenced(*corners: tuple[float, float], **more: object) -> Changes:
    fence: Changes = {("safety", "fence_m"): [list(corner) for corner in corners]}
    return fence | {("safety", key): value for key, value in more.items()}


def box(left: float = -5.0, right: float = 110.0, low: float = -20.0, high: float = 10.0) -> Changes:
    return fenced((left, low), (right, low), (right, high), (left, high))


APART: Changes = {("vehicles", i, "slot_m"): [0.0, 4.0 * i] for i in range(3)}
REFUSED: dict[str, tuple[Changes, list[str]]] = {
    "the last corner is the first": (
        fenced((-5.0, -20.0), (110.0, -20.0), (110.0, 10.0), (-5.0, 10.0), (-5.0, -20.0)),
        ["safety.fence_m: corners 4 and 0 are the same, (-5, -20)"],
    ),
    "crossed edges": (
        fenced((-5.0, -20.0), (110.0, 10.0), (110.0, -20.0), (-5.0, 10.0)),
        ["safety.fence_m: the edges from corner 0 and from corner 2 meet: order the corners"],
    ),
    "one start outside": (
        box(high=3.75),
        [
            "vehicles[0].start_m: (0, 4) is 0.25 m outside of safety.fence_m",
            "safety.fence_m: the ring of 10.0 m around it is 1.25 m outside, with the target at (35, -5) after 0 s",
        ],
    ),
    "the target's path": (
        box(right=34.0),
        ["safety.fence_m: the target's path is 1.00 m outside, with the target at (35, -5) after 0 s"],
    ),
    "too near": (
        {("vehicles", i, "slot_m"): [0.0, y] for i, y in enumerate((0.0, 2.5, 8.0))},
        ["vehicles[1].slot_m: 2.50 m from vehicles[0]'s, less than safety.separation_m = 3.0 m"],
    ),
    "missing": (
        {("vehicles", 0, "slot_m"): [0.0, 0.0], ("vehicles", 2, "slot_m"): [9.0, 0.0]},
        ["vehicles[1].slot_m: this key is missing; vehicles[0] has one: all have one, or none"],
    ),
    "a free formation without places": (
        {("formation", "shape"): "free"},
        ["formation.shape: a free formation needs every vehicle's slot_m, and none has one"],
    ),
    "a wedge too near, with places for a free formation": (
        APART | {("formation", "spacing_m"): 1.0, ("formation", "shape"): "wedge"},
        ["formation.spacing_m: 1.0 m is less than safety.separation_m = 3.0 m"],
    ),
    "starts nearer than the separation": (
        {("vehicles", 1, "start_m"): [0.0, 1.5]},
        ["vehicles[1].start_m: 2.50 m from vehicles[0], less than safety.separation_m = 3.0 m"],
    ),
    "a ring without room for its vehicles": (
        {("encirclement", "radius_m"): 1.7},
        [
            "encirclement.radius_m: 3 vehicles on a ring of 1.7 m are 2.94 m apart, "
            "less than safety.separation_m = 3.0 m; it takes 1.74 m"
        ],
    ),
    "a gap that leaves the others too little": (
        {("vehicles", 1, "gap"): 50.0},
        [
            "vehicles[1].gap: with 50.0 of 52 in all the gap of vehicles[0] on a ring of 10.0 m is 1.21 m, "
            "less than safety.separation_m = 3.0 m; at most 18.86, or encirclement.radius_m = 24.85"
        ],
    ),
    "a gap that is too narrow": (
        {("vehicles", 2, "gap"): 0.05},
        [
            "vehicles[2].gap: with 0.05 of 2.05 in all the gap of vehicles[2] on a ring of 10.0 m is 1.53 m, "
            "less than safety.separation_m = 3.0 m; at least 0.11, or encirclement.radius_m = 19.6"
        ],
    ),
    "two gaps that are too narrow": (
        {("vehicles", 1, "gap"): 0.05, ("vehicles", 2, "gap"): 0.05},
        [
            "vehicles[1].gap: with 0.05 of 1.1 in all the gap of vehicles[1] on a ring of 10.0 m is 2.85 m, "
            "less than safety.separation_m = 3.0 m; encirclement.radius_m = 10.55"
        ],
    ),
    "a gap of nothing": ({("vehicles", 0, "gap"): 0.0}, ["vehicles[0].gap: it must be greater than 0 (given: 0.0)"]),
    "no room between keep-out and ring": (
        {("safety", "keep_out_m"): 10.0},
        ["safety.keep_out_m: 10.0 m about the target leaves no room for the ring of encirclement.radius_m = 10.0 m"],
    ),
    "slower than ring and formation": (
        {("safety", "speed_max_m_s"): 0.1},
        [
            "safety.speed_max_m_s: 0.1 m/s is less than the 0.50 m/s of the ring",
            "safety.speed_max_m_s: 0.1 m/s is less than the 0.20 m/s of the formation",
        ],
    ),
    "too little acceleration for the ring": (
        {("safety", "acceleration_max_m_s2"): 0.02},
        ["safety.acceleration_max_m_s2: 0.02 m/s² is less than v²/R = 0.03 m/s² of the ring"],
    ),
    "setpoints slower than vehicles": (
        {("safety", "speed_max_m_s"): 4.0, ("tuning", "safety", "setpoint_speed_max_m_s"): 3.9},
        [
            "tuning.safety.setpoint_speed_max_m_s: at 3.9 m/s setpoints cannot keep up with vehicles at "
            "safety.speed_max_m_s = 4.0 m/s"
        ],
    ),
    "an altitude band upside down": (
        {("safety", "altitude_min_m"): 8.0, ("safety", "altitude_max_m"): 8.0},
        ["safety.altitude_min_m: 8.0 m is not below altitude_max_m = 8.0 m"],
    ),
    "below the band": (
        {("safety", "altitude_min_m"): 8.0, ("vehicles", 1, "altitude_m"): 7.5},
        ["vehicles[1].altitude_m: 7.5 m is below safety.altitude_min_m = 8.0 m"],
    ),
    "layers above the band": (
        {("safety", "altitude_max_m"): 13.0, ("choreography", "layer_m"): 2.0},
        ["safety.altitude_max_m: 13.0 m is below the highest layer, 14 m, of choreography.layer_m = 2.0 m"],
    ),
}


def test_what_does_not_fit_or_contradicts_is_refused(subtests: pytest.Subtests) -> None:
    for name, (changes, expected) in REFUSED.items():
        with subtests.test(name):
            assert faults(changed(changes)) == expected


@pytest.mark.parametrize("corners", [BOX, BOX[::-1]])
def test_a_fence_about_everything_is_accepted_in_either_sense(corners: list[list[float]]) -> None:
    mission = parsed(changed({("safety", "fence_m"): corners}))
    assert mission.safety.fence_m == tuple((x, y) for x, y in corners)


def test_a_concave_fence_may_go_around_what_is_not_needed() -> None:
    around = ((-5.0, -20.0), (110.0, -20.0), (110.0, 10.0), (12.0, 10.0))
    corners = (*around, (10.0, -10.0), (8.0, 10.0), (-5.0, 10.0))
    assert parsed(changed(fenced(*corners))).safety.fence_m == corners


def test_as_near_as_the_ring_needs_is_near_enough() -> None:
    parsed(changed(box(right=105.0, low=-15.0, high=5.0)))
    assert len(faults(changed(box(right=104.9)))) == 1


def test_the_ring_is_followed_until_it_first_leaves_the_fence() -> None:
    """At 0.1 m/s the ring's edge, at x = 45 at first, meets x = 60 after 150 s."""
    (fault,) = faults(changed(box(right=60.0)))
    words = fault.removeprefix("safety.fence_m: the ring of 10.0 m around it is ").replace(",", " ").split()
    outside_m, after_s = float(words[0]), float(words[-2])
    assert 150.0 <= after_s <= 150.0 + 600.0 / 199.0 + 0.5
    assert outside_m == pytest.approx(0.1 * after_s - 15.0, abs=0.06)


def test_a_ring_that_reaches_over_a_dent_is_refused() -> None:
    dent = fenced((-5.0, -20.0), (110.0, -20.0), (110.0, 10.0), (66.0, 10.0), (65.0, -1.0), (64.0, 10.0), (-5.0, 10.0))
    (fault,) = faults(changed(dent))
    # The target comes within 10 m of the dent's tip, 4 m beside its path, where it is sqrt(100 - 16) m before it.
    assert fault.startswith("safety.fence_m: the ring of 10.0 m around it is 0.")
    after_s = float(fault.split()[-2])
    assert 0.1 * after_s == pytest.approx(30.0 - 84.0**0.5, abs=0.35)


def test_a_shape_may_be_other_than_free_although_there_are_places_for_it() -> None:
    (unknown,) = faults(changed({("formation", "shape"): "diamond"}))
    assert unknown.startswith("formation.shape: it must be 'line', 'column', 'wedge' or 'free'")
    wedge = parsed(changed(APART | {("formation", "shape"): "wedge"}))
    assert wedge.agent_config(wedge.vehicles[0]).shape == "wedge"
    assert parsed(changed(APART)).agent_config(wedge.vehicles[0]).shape == "free"


def test_who_keeps_station_on_a_neighbour_can_hear_it() -> None:
    slots: Changes = {("vehicles", i, "slot_m"): [0.0, 40.0 * i] for i in range(3)}
    far = slots | {("network", "range_m"): 30.0}
    told = "m from vehicles[{}]'s, its neighbour in line order, and out of network.range_m = 30 m"
    one, other = faults(changed(far))
    assert one.startswith("vehicles[1].slot_m: 40 " + told.format(0))
    assert other.startswith("vehicles[2].slot_m: 40 " + told.format(1))
    parsed(changed(far | {("formation", "station"): "line"}))


@pytest.mark.parametrize(("shape", "apart_m"), [("line", 30.0), ("wedge", 30.0), ("column", 60.0)])
def test_neighbours_in_every_shape_hear_each_other(shape: str, apart_m: float) -> None:
    spaced: Changes = {("formation", "spacing_m"): 30.0, ("formation", "shape"): shape}
    (told,) = faults(changed(spaced | {("network", "range_m"): apart_m - 0.1}))
    assert told.startswith("formation.spacing_m: 30 m")
    assert f" {shape} up to {apart_m:g} m apart, out of network.range_m = {apart_m - 0.1:g} m" in told
    heard = parsed(changed(spaced | {("network", "range_m"): apart_m + 0.1}))
    shapes = heard.agent_config(heard.vehicles[0]).shapes
    assert shapes == (("line", "wedge") if apart_m == 30.0 else ("line", "column", "wedge"))
    parsed(changed(spaced | {("network", "range_m"): 28.0, ("formation", "station"): "line"}))


def test_neighbours_on_the_ring_hear_each_other() -> None:
    (told,) = faults(changed({("network", "range_m"): 19.9}))
    assert told.startswith("encirclement.radius_m: the first two vehicles on a ring of 10 m are 20 m apart")
    assert "network.range_m = 19.9 m" in told
    parsed(changed({("network", "range_m"): 20.1}))


def test_the_default_range_follows_the_mission() -> None:
    """200 m, or what neighbours need: opposite each other on the ring, or the next in the formation."""
    rows: list[tuple[Changes, float]] = [
        ({}, 200.0),
        ({("encirclement", "radius_m"): 150.0, ("encirclement", "angular_rate_rad_s"): 0.01}, 300.0),
        ({("formation", "spacing_m"): 250.0}, 250.0),
        ({("formation", "spacing_m"): 130.0, ("formation", "shape"): "column"}, 260.0),
        ({("formation", "spacing_m"): 250.0, ("formation", "station"): "line"}, 200.0),
        ({("vehicles", i, "slot_m"): [0.0, 210.0 * i] for i in range(3)}, 210.0),
        ({("network", "range_m"): 185.0}, 185.0),
    ]
    for changes, range_m in rows:
        mission = parsed(changed(changes))
        assert mission.range_m == range_m, changes
        assert mission.agent_config(mission.vehicles[0]).communication_radius_m == range_m
        explicit = parsed(changed(changes | {("network", "range_m"): range_m}))
        assert explicit.identity == mission.identity


def test_the_nearest_other_vehicle_is_the_one_at_the_shortest_horizontal_distance() -> None:
    places_m = {1: (0.0, 0.0), 2: (3.0, 4.0), 7: (-4.0, 0.0)}
    assert nearest_other(1, places_m) == (7, 4.0)
    assert nearest_other(2, places_m) == (1, 5.0)
    assert nearest_other(7, places_m) == (1, 4.0)
    assert nearest_other(3, places_m) is None, "its own place is not known"
    assert nearest_other(1, {1: (0.0, 0.0)}) is None
    assert nearest_other(1, {1: (0.0, 0.0), 2: (0.0, 0.0)}) == (2, 0.0), "one at the same place"


def test_each_vehicle_has_the_fence_that_holds_for_it() -> None:
    wider: list[list[float]] = [[-9.0, -30.0], [120.0, -30.0], [120.0, 30.0], [-9.0, 30.0]]
    mission = parsed(changed(box() | {("vehicles", 1, "fence_m"): wider}))
    of = areas([vehicle.section for vehicle in mission.vehicles], mission.safety)
    assert [of[vehicle_id].clearance_m((0.0, 0.0), 8.0) for vehicle_id in mission.ids] == [5.0, 9.0, 5.0]
    assert of[1].clearance_m((-7.0, 0.0), 8.0) == -2.0
    without = parsed(changed({}))
    assert areas([vehicle.section for vehicle in without.vehicles], without.safety) == {}
