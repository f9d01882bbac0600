"""The ring of a vehicle among several: by the rule for each target, by the places, and by operators."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from msgspec.structs import replace as replaced

from agents.ring.chooser import RingChooser, Wanted
from agents.settings.config import AgentConfig, RingConfig
from agents.settings.sections import DecisionSettings
from agents.team.messages import RingChoice
from estimation.state import TargetEstimate
from tests.support.estimates import target_spread

Maker = Callable[..., AgentConfig]
NORTH, SOUTH = (30.0, 20.0), (30.0, -20.0)
RULE = DecisionSettings(importance_min=0.6, threat_max=0.5, distance_max_m=40.0)
TICK_S = 0.1


def target(at_m: tuple[float, float], importance: float = 0.9, threat: float = 0.1) -> TargetEstimate:
    return TargetEstimate(0.0, np.array([*at_m, 0.0, 0.0]), target_spread(), 0.0, importance, threat)


TARGETS = {"north": target(NORTH), "south": target(SOUTH)}


@pytest.fixture
def config(make_config: Maker) -> Callable[..., AgentConfig]:
    def make(vehicle_id: int, places: tuple[int, int] = (2, 3), ids: tuple[int, ...] = (1, 2, 3, 4, 5)) -> AgentConfig:
        whole = make_config(vehicle_id=vehicle_id, slots=ids, decision=RULE)
        rings = [
            RingConfig(name, name, n, whole.encirclement) for name, n in zip(("north", "south"), places, strict=True)
        ]
        return replace(whole, rings=tuple(rings), targets=("north", "south"))

    return make


def choices(
    configs: Mapping[int, AgentConfig],
    places_m: Mapping[int, tuple[float, float]],
    targets: Mapping[str, TargetEstimate],
    choosers: Mapping[int, RingChooser],
    ticks: range = range(40),
    *,
    on_ring: bool = False,
) -> dict[int, Wanted | None]:
    """Run the choosers of a team whose members all hear each other; return what each wants in the end."""
    wanted: dict[int, Wanted | None] = {}
    for tick in ticks:
        now_s = 100.0 + tick * TICK_S
        for i, chooser in choosers.items():
            wanted[i] = chooser.choose(configs[i], places_m[i], targets, now_s, on_ring=on_ring)
        sent = {i: RingChoice(None, chooser.payload(now_s)) for i, chooser in choosers.items()}
        for i, chooser in choosers.items():
            assert all(chooser.receive(j, each, now_s) for j, each in sent.items() if j != i)
    return wanted


def test_each_takes_the_nearest_ring_with_a_place(config: Callable[..., AgentConfig]) -> None:
    configs = {i: config(i) for i in (1, 2, 3, 4, 5)}
    choosers = {i: RingChooser(each) for i, each in configs.items()}
    # Three are nearer to the north, where there are two places: the one that loses least goes south.
    places_m = {1: (20.0, 12.0), 2: (20.0, 8.0), 3: (20.0, 2.0), 4: (20.0, -8.0), 5: (20.0, -12.0)}
    wanted = choices(configs, places_m, TARGETS, choosers)
    assert {i: each and each.ring for i, each in wanted.items()} == {1: 0, 2: 0, 3: 1, 4: 1, 5: 1}


@pytest.mark.parametrize(
    "spoilt",
    [target(NORTH, importance=0.6), target(NORTH, threat=0.5), target((60.1, 0.0)), None],
    ids=["not important", "too dangerous", "too far", "not known"],
)
def test_a_vehicle_in_formation_bids_for_no_ring_that_the_rule_forbids(
    config: Callable[..., AgentConfig], spoilt: TargetEstimate | None
) -> None:
    one = config(1, (5, 5))
    targets = {} if spoilt is None else {"north": spoilt}
    assert choices({1: one}, {1: (20.0, 0.0)}, targets, {1: RingChooser(one)})[1] is None
    assert choices({1: one}, {1: (20.0, 0.0)}, targets | {"south": target(SOUTH)}, {1: RingChooser(one)})[1] == Wanted(
        1, assigned=False
    )


def test_noise_at_a_threshold_changes_nothing_once_the_rule_was_met(config: Callable[..., AgentConfig]) -> None:
    one, random = config(1, (5, 5)), np.random.default_rng(4)
    chooser, found = RingChooser(one), []
    for tick in range(600):
        seen = {"north": target(NORTH, importance=0.6 + random.normal(0.0, 0.01))}
        wanted = chooser.choose(one, (20.0, 0.0), seen, 100.0 + tick * TICK_S, on_ring=False)
        found.append(wanted)
    assert set(found[50:]) == {Wanted(0, assigned=False)}
    revision = chooser.revision
    fallen = {"north": target(NORTH, importance=0.5)}
    found = [chooser.choose(one, (20.0, 0.0), fallen, 160.0 + tick * TICK_S, on_ring=False) for tick in range(20)]
    assert found[-1] is None
    assert chooser.revision > revision


def test_a_vehicle_leaves_a_ring_whose_target_lost_its_importance_only_for_a_place_elsewhere(
    config: Callable[..., AgentConfig],
) -> None:
    fallen = TARGETS | {"north": target(NORTH, importance=0.2)}
    for south_places, ring in ((2, 1), (1, 0)):
        configs = {1: config(1, (2, south_places), (1, 2)), 2: config(2, (2, south_places), (1, 2)).on_ring(1)}
        choosers = {i: RingChooser(each) for i, each in configs.items()}
        places_m = {1: (25.0, 15.0), 2: (20.0, -20.0)}
        before = choices(configs, places_m, TARGETS, choosers, on_ring=True)
        assert before == {1: Wanted(0, assigned=False), 2: Wanted(1, assigned=False)}
        after = choices(configs, places_m, fallen, choosers, range(40, 140), on_ring=True)
        assert after == {1: Wanted(ring, assigned=False), 2: Wanted(1, assigned=False)}


def test_an_operator_assigns_a_ring_against_the_rule_and_another_makes_room(config: Callable[..., AgentConfig]) -> None:
    configs = {1: config(1, (1, 1), (1, 2)), 2: config(2, (1, 1), (1, 2)).on_ring(1)}
    choosers = {i: RingChooser(each) for i, each in configs.items()}
    places_m = {1: (20.0, 20.0), 2: (20.0, -20.0)}
    choices(configs, places_m, TARGETS, choosers, on_ring=True)
    choosers[1].assigned = 1
    after = choices(configs, places_m, TARGETS, choosers, range(40, 140), on_ring=True)
    assert after == {1: Wanted(1, assigned=True), 2: Wanted(0, assigned=False)}
    choosers[1].assigned = None
    flown = {1: configs[1].on_ring(1), 2: configs[2].on_ring(0)}
    moved_m = {1: (20.0, -20.0), 2: (20.0, 20.0)}
    again = choices(flown, moved_m, TARGETS, choosers, range(140, 240), on_ring=True)
    assert again == {1: Wanted(1, assigned=False), 2: Wanted(0, assigned=False)}


def test_an_assigned_vehicle_has_its_place_before_others_that_want_it_by_the_rule(
    config: Callable[..., AgentConfig],
) -> None:
    configs = {i: config(i, (1, 1), (1, 2)) for i in (1, 2)}
    choosers = {i: RingChooser(each) for i, each in configs.items()}
    choosers[1].assigned = 1
    far_m, near_m = (-60.0, 0.0), (25.0, -15.0)
    wanted = choices(configs, {1: far_m, 2: near_m}, {"south": target(SOUTH)}, choosers)
    assert wanted == {1: Wanted(1, assigned=True), 2: None}


def test_a_vehicle_keeps_its_ring_unless_one_that_can_fly_only_there_has_waited_for_long(
    config: Callable[..., AgentConfig],
) -> None:
    """Vehicle 1 is on the north ring and could fly on both; vehicle 2 comes, which decides for the north alone."""
    configs = {1: config(1, (1, 1), (1, 2)).on_ring(0), 2: config(2, (1, 1), (1, 2))}
    choosers = {i: RingChooser(each) for i, each in configs.items()}
    wanted: dict[float, dict[int, int | None]] = {}
    for tick in range(300):
        now_s = tick * TICK_S
        one = choosers[1].choose(configs[1], (30.0, 10.0), TARGETS, 100.0 + now_s, on_ring=True)
        seen = {"north": TARGETS["north"]} if tick >= 50 else {}
        two = choosers[2].choose(configs[2], (25.0, 10.0), seen, 100.0 + now_s, on_ring=False)
        wanted[round(now_s, 1)] = {1: one and one.ring, 2: two and two.ring}
        for i, j in ((1, 2), (2, 1)):
            choosers[i].receive(j, RingChoice(None, choosers[j].payload(100.0 + now_s)), 100.0 + now_s)
        if one is not None:
            configs[1] = configs[1].on_ring(one.ring)
        if two is not None:
            configs[2] = configs[2].on_ring(two.ring)
    assert wanted[4.0] == {1: 0, 2: None}
    assert wanted[14.5] == {1: 0, 2: None}
    assert wanted[18.0] == {1: 1, 2: 0}
    assert wanted[29.9] == {1: 1, 2: 0}
    assert [each[1] for each in wanted.values()].count(0) < 180  # it changes once


def test_one_that_leaves_gives_its_place_to_another_and_one_that_holds_keeps_it(
    config: Callable[..., AgentConfig],
) -> None:
    configs = {i: config(i, (1, 2), (1, 2)) for i in (1, 2)}
    choosers = {i: RingChooser(each) for i, each in configs.items()}
    places_m = {1: (25.0, 15.0), 2: (25.0, 10.0)}
    before = choices(configs, places_m, TARGETS, choosers)
    assert before == {1: Wanted(0, assigned=False), 2: Wanted(1, assigned=False)}
    for tick, leaves in ((40, False), (140, True)):
        for now_s in np.arange(100.0 + tick * TICK_S, 110.0 + tick * TICK_S, TICK_S).tolist():
            if leaves:
                choosers[1].withdraw(now_s)
            wanted = choosers[2].choose(configs[2], places_m[2], TARGETS, now_s, on_ring=False)
            choosers[2].receive(1, RingChoice(None, choosers[1].payload(now_s)), now_s)
        assert wanted == Wanted(0 if leaves else 1, assigned=False)


def test_a_ring_is_kept_while_its_target_is_not_seen(config: Callable[..., AgentConfig]) -> None:
    one = config(1)
    chooser = RingChooser(one)
    choices({1: one}, {1: (20.0, 20.0)}, TARGETS, {1: chooser}, on_ring=True)
    unseen = choices({1: one}, {1: (20.0, 20.0)}, {}, {1: chooser}, range(40, 140), on_ring=True)
    assert unseen[1] == Wanted(0, assigned=False)


def test_vehicles_engage_from_as_far_outside_a_larger_ring(config: Callable[..., AgentConfig]) -> None:
    one = config(1)
    place_m, farther_m = (NORTH[0] - 42.0, NORTH[1]), one.encirclement.radius_m + 3.0
    assert choices({1: one}, {1: place_m}, {"north": target(NORTH)}, {1: RingChooser(one)})[1] is None
    larger = one.encirclement.model_copy(update={"radius_m": farther_m})
    flown = one.with_flown(0, larger)
    assert choices({1: flown}, {1: place_m}, {"north": target(NORTH)}, {1: RingChooser(one)})[1] is not None


def test_bids_of_another_mission_are_refused(config: Callable[..., AgentConfig]) -> None:
    chooser, peer = RingChooser(config(1)), RingChooser(config(2))
    good = RingChoice(None, peer.payload(100.0))
    assert chooser.receive(2, good, 100.0)
    assert not chooser.receive(2, replaced(good, bids=good.bids + b"\x00"), 100.0)
    assert not chooser.receive(2, replaced(good, bids=b""), 100.0)
    assert not chooser.receive(9, good, 100.0)
