"""Which rings in a peer's state a vehicle flies: those that an operator could command it to fly."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from agents.core import VehicleCore
from agents.inputs import Message
from agents.ring.chooser import RingChooser
from agents.ring.commanded_rings import NOTED_AGAIN_S, CommandedRings
from agents.settings.config import AgentConfig, RingConfig
from agents.settings.sections import NoFlySection, SafetySettings
from agents.team.messages import MISSION_RING, CommandedRing, MemberState, OperatorCommand, RingChoice, RingValues

Maker = Callable[..., AgentConfig]
Place = tuple[float, float]
LIAR = 3
SQUARE_M = ((-30.0, -30.0), (30.0, -30.0), (30.0, 30.0), (-30.0, 30.0))


def at(*places_m: Place, names: tuple[str | None, ...] = (None,)) -> Callable[[str | None], Place | None]:
    """Return where the targets of these names are; others are not known."""
    return dict(zip(names, places_m, strict=False)).get


HERE = at((0.0, 0.0))


def taken(
    config: AgentConfig,
    rings: dict[int, CommandedRing],
    target_m: Callable[[str | None], Place | None] = HERE,
) -> tuple[list[int], list[str]]:
    """Return the rings of a peer's state that a vehicle takes, and what it notes of the others."""
    flyable, refusals = CommandedRings(config).of_peer(LIAR, rings, config, target_m, 20.0)
    return flyable, [each.text for each in refusals]


def radius(radius_m: float, at_s: float = 10.0) -> CommandedRing:
    return CommandedRing(radius_m, at_s)


def altitude(altitude_m: float) -> CommandedRing:
    return CommandedRing(altitude_m=altitude_m, altitude_s=10.0)


def test_a_ring_that_leaves_the_fence_is_not_taken_from_a_peer(make_config: Maker) -> None:
    """From (10, 0) it is 20 m to the side x = 30 of the square."""
    config, there = make_config(safety={"fence_m": SQUARE_M}), at((10.0, 0.0))
    assert taken(config, {0: radius(19.5)}, there) == ([0], [])
    numbers, (text,) = taken(config, {0: radius(20.5)}, there)
    assert (numbers, "vehicle 3's state" in text, "at most 20.0 m" in text) == ([], True, True)
    assert taken(config, {0: radius(19.5)}, at()) == ([], []), "it waits until the target is known"
    assert taken(make_config(), {0: radius(19.5)}, at()) == ([0], []), "without a fence it does not"


def test_a_ring_that_cannot_bend_around_a_zone_of_its_heights_is_refused(make_config: Maker) -> None:
    """From 13 m on the target is in a zone, outside of which there is no room inside the fence; below all is free."""
    zone = NoFlySection(name="crane", center_m=(5.0, 0.0), radius_m=29.0, floor_m=13.0)
    fence_m = SQUARE_M[0], (120.0, -30.0), (120.0, 30.0), SQUARE_M[3]
    config = make_config(safety=SafetySettings(no_fly=(zone,), fence_m=fence_m))
    rings = CommandedRings(config)
    assert not rings.refusal(0, altitude(11.0), config, HERE)
    said = rings.refusal(0, altitude(13.0), config, HERE)
    assert said == "the ring cannot bend around 'crane': choose another radius, rate or altitude"
    assert taken(config, {0: altitude(13.0)})[0] == []
    assert not rings.refusal(0, altitude(13.0), config, at((90.0, 0.0))), "the zone is far from there"


def stacked(config: AgentConfig, *, shared: bool = False) -> AgentConfig:
    """Return a configuration on the first of two rings of 10 m about one target, at altitudes of 8 and 14 m."""
    rings = [
        RingConfig(name, "", 2, config.encirclement.model_copy(update={"altitude_m": altitude_m}), shared)
        for name, altitude_m in (("low", 8.0), ("high", 14.0))
    ]
    return replace(config, safety=config.safety.model_copy(update={"vertical_separation_m": 3.0}), rings=tuple(rings))


def test_a_ring_that_cuts_another_is_not_taken_from_a_peer(make_config: Maker) -> None:
    config = stacked(make_config()).on_ring(0)
    assert taken(config, {1: altitude(11.0)}) == ([1], [])
    numbers, (text,) = taken(config, {1: altitude(10.9)})
    assert (numbers, "ring 'high'" in text, "ring 'low'" in text) == ([], True, True)
    assert taken(config, {0: altitude(7.0), 1: altitude(10.5)}) == ([0, 1], []), "they are possible together"
    assert taken(config, {0: altitude(12.0), 1: altitude(9.0)}) == ([0, 1], []), "also one above the other"
    numbers, texts = taken(config, {0: altitude(7.0), 1: radius(1000.0)})
    assert (numbers, len(texts)) == ([0], 1), "one that is impossible does not keep the other"
    assert taken(stacked(config, shared=True), {1: altitude(8.0)}) == ([1], [])


def test_rings_about_two_targets_stay_a_separation_apart(make_config: Maker) -> None:
    """The targets are 30 m from each other, and each ring has 10 m; the separation is 3 m."""
    config, names = make_config(safety={"separation_m": 3.0}), ("east", "west")
    rings = tuple(RingConfig(name, name, 2, config.encirclement) for name in names)
    config = replace(config, rings=rings, targets=names)
    both = at((15.0, 0.0), (-15.0, 0.0), names=names)
    assert taken(config, {1: radius(16.9)}, both) == ([1], [])
    numbers, (text,) = taken(config, {1: radius(17.1)}, both)
    assert (numbers, "2.9 m from ring 'east'" in text) == ([], True)
    assert taken(config, {1: radius(17.1)}, at((15.0, 0.0), names=names)) == ([1], []), "where the other is not known"


@pytest.mark.parametrize(
    ("limits", "ring"),
    [
        ({"altitude_high": 20.0}, altitude(25.0)),
        ({"altitude_high": 20.0}, CommandedRing(altitude_m=19.0, altitude_s=10.0, tilt_deg=20.0, tilt_s=10.0)),
        ({}, CommandedRing(angular_rate_rad_s=-5.0, rate_s=10.0)),
        ({}, CommandedRing(25.0, 10.0, 0.2, 10.0)),
    ],
)
def test_limits_of_height_climb_and_speed_hold_for_a_peers_ring(
    make_config: Maker, limits: dict[str, float], ring: CommandedRing
) -> None:
    """20 degrees at 10 m rise by 3.6 m; 0.2 rad/s at 25 m are 5 m/s, where 3 are possible."""
    config = make_config(lowest_between_m=(1.0, limits.get("altitude_high")))
    commanded = CommandedRings(config)
    flyable, _ = commanded.of_peer(LIAR, {0: ring}, config, HERE, 20.0)
    for number in flyable:
        commanded.newest[number] = ring
    flown = commanded.flown(0, commanded.newest[0]).encirclement
    assert abs(flown.angular_rate_rad_s) * flown.radius_m <= flown.speed_max_m_s
    assert limits.get("altitude_high", 1e3) >= flown.lowest_m(config.lowest_m) + flown.rise_m


def test_a_peer_that_lies_does_not_fill_the_log(make_config: Maker) -> None:
    config = make_config()
    commanded, noted = CommandedRings(config), 0
    for tick in range(300):
        ring = radius(500.0 + tick, 10.0 + 0.1 * tick)
        _, refusals = commanded.of_peer(LIAR, {0: ring}, config, HERE, 20.0 + 0.1 * tick)
        noted += len(refusals)
    assert noted == 30.0 / NOTED_AGAIN_S


def test_a_ring_that_was_refused_is_flown_once_it_is_possible(make_config: Maker) -> None:
    """The vehicle hears of the upper ring's new altitude before it hears of that of the lower ring."""
    config = stacked(make_config(vehicle_id=2, slots=(1, 2, 3)))
    core, upper, both = VehicleCore(config), (MISSION_RING, altitude(10.0)), (altitude(6.0), altitude(10.0))
    for at_s, rings in ((20.0, upper), (21.0, both)):
        bids = RingChooser(replace(config, vehicle_id=1)).payload(at_s)
        core.take(Message(at_s, state(at_s, RingChoice(0, bids, rings))))
    notes = core.tick(21.1).status.notes
    assert [(each.ring.name, each.ring.altitude_m) for each in notes if each.ring] == [("low", 6.0), ("high", 10.0)]
    assert "ring 'high'" in notes[0].text
    assert [each.text.partition(":")[0] for each in notes[1:]] == ["the ring 'low'", "the ring 'high'"]


def state(time_s: float, choice: RingChoice) -> MemberState:
    zero = (0.0, 0.0)
    return MemberState(1, time_s, "encircle", zero, zero, zero, zero, choice=choice)


def test_an_operators_ring_that_cuts_another_is_refused_by_the_vehicle(make_config: Maker) -> None:
    config = stacked(make_config(vehicle_id=2, slots=(1, 2, 3)))
    core = VehicleCore(config)
    for number, altitude_m in enumerate((9.0, 12.0)):
        values = RingValues(altitude_m=altitude_m)
        core.take(Message(20.0, OperatorCommand(20.0, "ring", None, "tower", number, ring=values, ring_number=1)))
    outcomes = [each.command for each in core.tick(20.1).status.notes if each.command]
    assert [each.is_refused for each in outcomes] == [True, False]
    assert "ring 'low'" in outcomes[0].did
