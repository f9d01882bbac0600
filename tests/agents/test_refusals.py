"""Places that one vehicle is not sent to: near rings as flown and as commanded, and near places that others need."""

from collections.abc import Callable

import pytest

from agents.refusals import place_refusal
from agents.settings.config import AgentConfig
from agents.settings.sections import NoFlySection, SafetySettings
from agents.tactics import Tactic
from agents.team.messages import Goal, MemberState, NeighbourAngle

TARGET_M = (40.0, 0.0)


def refusal(config: AgentConfig, place: Goal, *peers: MemberState, height_m: float = 8.0) -> str:
    return place_refusal(place, config, height_m, (20.0, 20.0), lambda _name: TARGET_M, peers)


def on_ring(sender: int, radius_m: float) -> MemberState:
    here = (TARGET_M[0] - radius_m, 0.0)
    angle = NeighbourAngle(sender, 5.0, 3.14159, 0.05, radius_m)
    return MemberState(sender, 5.0, Tactic.ENCIRCLE.value, here, (0.0, 0.0), here, (0.0, 0.0), angle=angle)


@pytest.mark.parametrize(
    ("commanded_m", "flown_m", "out_m", "is_refused"),
    [
        (10.0, 10.0, 12.9, True),
        (10.0, 10.0, 13.1, False),
        (10.0, 10.0, 6.9, False),
        (18.0, 10.0, 10.0, True),
        (18.0, 10.0, 14.0, True),
        (18.0, 10.0, 20.9, True),
        (18.0, 10.0, 21.1, False),
    ],
)
def test_a_ring_is_kept_free_where_it_is_flown_and_where_it_is_going(
    make_config: Callable[..., AgentConfig], commanded_m: float, flown_m: float, out_m: float, is_refused: bool
) -> None:
    config = make_config(safety={"separation_m": 3.0}).with_ring(radius_m=commanded_m)
    said = refusal(config, Goal(TARGET_M[0], out_m), on_ring(1, flown_m), on_ring(3, flown_m))
    assert (f"from the ring of {commanded_m:g} m: 3 m at least are needed" in said) is is_refused
    assert bool(said) is is_refused


def test_a_bent_ring_is_kept_free_where_it_is_bent_to(make_config: Callable[..., AgentConfig]) -> None:
    zone = NoFlySection(name="mast", center_m=(TARGET_M[0], 11.0), radius_m=1.0)
    safety = SafetySettings(separation_m=2.0, no_fly=(zone,))
    config = make_config(safety=safety, encirclement={"speed_max_m_s": 5.0, "acceleration_max_m_s2": 3.0})
    across_m = [k / 2.0 for k in range(8, 40)]
    near_m = [out_m for out_m in across_m if "from the ring" in refusal(config, Goal(TARGET_M[0], out_m))]
    assert near_m[0] < 7.5, "the mast is passed on the inside: a circle would be kept free from 8 m on"


def test_landing_places_of_others_are_kept_free(make_config: Callable[..., AgentConfig]) -> None:
    starts_m = ((0.0, 4.0), (0.0, 0.0), (0.0, -4.0))
    config = make_config(home_m=starts_m[1], rally_m=((100.0, 50.0),), starts_m=starts_m, safety={"separation_m": 3.0})
    for lands in (False, True):
        assert "1.5 m from a landing place of vehicle 1" in refusal(config, Goal(0.0, 5.5, lands))
        assert "1.0 m from a landing place of vehicle 3" in refusal(config, Goal(100.0, 45.0, lands))
        assert not refusal(config, Goal(0.3, 0.0, lands))
        assert not refusal(config, Goal(100.0, 50.0, lands))


def test_no_zone_is_below_where_a_vehicle_lands(make_config: Callable[..., AgentConfig]) -> None:
    zone = NoFlySection(name="crowd", center_m=(0.0, 30.0), radius_m=5.0, ceiling_m=4.0)
    config = make_config(safety=SafetySettings(no_fly=(zone,)))
    assert not refusal(config, Goal(0.0, 30.0))
    assert "'crowd'" in refusal(config, Goal(0.0, 30.0, lands=True))
