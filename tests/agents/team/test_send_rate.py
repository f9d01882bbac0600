"""When a vehicle's state is sent: often while peers need it, else in the rhythm of a heartbeat."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from agents.team.messages import CommandedRing, MemberState, NeighbourAngle, TargetPackage
from agents.team.send_rate import HEARTBEAT_S, SendRate, goes_on, place_goes_on

RATE_HZ = 20.0
SIGHTING = TargetPackage(1, 0.0, (0.0, 0.0), (1.0, 0.0, 1.0), 0.8, 0.2, (2,))
PLACE = NeighbourAngle(1, 10.0, 0.5, 0.1, 20.0, 1.0, 1.0, 3.0, 0.1)
STATE = MemberState(1, 10.0, "encircle", (1.0, 2.0), (0.5, -0.5), (1.5, 1.5), (0.4, -0.4), angle=PLACE)


def steady(time_s: float) -> MemberState:
    """Return the state that goes on as `STATE` said."""
    step_s = time_s - STATE.time_s
    return replace(
        STATE,
        time_s=time_s,
        position_m=(1.0 + 0.5 * step_s, 2.0 - 0.5 * step_s),
        aim_m=(1.5 + 0.4 * step_s, 1.5 - 0.4 * step_s),
        angle=replace(PLACE, time_s=time_s, reference_rad=3.0 + 0.1 * step_s),
    )


@dataclass
class Sender:
    """Sends in the ticks in which a state is due."""

    rate: SendRate
    often: bool = False

    def sends(self, state: MemberState) -> bool:
        return self.rate.may(state.time_s) and self.rate.due(state, often=self.often)

    def sent_s(self, from_s: float, to_s: float, **changes: Any) -> list[float]:
        ticks = np.arange(round(from_s * RATE_HZ), round(to_s * RATE_HZ)) / RATE_HZ
        return [time_s for time_s in ticks.tolist() if self.sends(replace(steady(time_s), **changes))]


def settled() -> Sender:
    """Return a sender that has sent `STATE` and what repeats it; its last state is of 10.8 s."""
    sender = Sender(SendRate(RATE_HZ))
    sender.sent_s(10.0, 10.95)
    return sender


def test_what_is_new_is_repeated_at_the_full_rate_and_what_goes_on_is_a_heartbeat() -> None:
    sent_s = Sender(SendRate(RATE_HZ)).sent_s(10.0, 12.0)
    assert np.diff(sent_s)[:4] == pytest.approx(0.1)
    assert np.diff(sent_s)[4:] == pytest.approx(HEARTBEAT_S)


@pytest.mark.parametrize(
    "changes",
    [
        {"tactic": "hold"},
        {"alert": "battery low"},
        {"shape": "wedge", "shaped_s": 11.0},
        {"ring": CommandedRing(12.0, 11.0)},
        {"angle": None},
        {"altitude_m": 0.25},
        {"position_sigma_m": 0.15},
    ],
)
def test_a_change_is_sent_at_once_and_repeated(changes: dict[str, Any]) -> None:
    assert settled().sent_s(10.95, 11.55, **changes) == pytest.approx([10.95, 11.05, 11.15, 11.25, 11.35])


def test_a_sighting_is_sent_at_once() -> None:
    assert settled().sent_s(10.95, 11.0, sightings=(SIGHTING,)) == [10.95]
    assert settled().sent_s(10.95, 11.0) == []


def test_a_clock_that_was_set_back_does_not_silence() -> None:
    assert settled().sends(steady(3.0))


@pytest.mark.parametrize(
    ("field", "within", "beyond"),
    [
        ("position_m", 0.09, 0.11),
        ("velocity_m_s", 0.19, 0.21),
        ("aim_m", 0.49, 0.51),
    ],
)
@pytest.mark.parametrize("axis", [0, 1])
def test_motion_goes_on_within_its_tolerance(field: str, within: float, beyond: float, axis: int) -> None:
    state = steady(10.3)
    for off, goes in ((within, True), (-within, True), (beyond, False), (-beyond, False)):
        value = list(getattr(state, field))
        value[axis] += off
        assert goes_on(STATE, replace(state, **{field: tuple(value)})) is goes


def test_in_formation_others_keep_station_on_the_setpoint() -> None:
    before, state = (replace(each, tactic="formation") for each in (STATE, steady(10.3)))
    x, y = state.aim_m
    assert goes_on(before, replace(state, aim_m=(x + 0.09, y)))
    assert not goes_on(before, replace(state, aim_m=(x + 0.11, y)))


@pytest.mark.parametrize(("off_m", "goes"), [(0.0, True), (0.019, True), (-0.019, True), (0.021, False)])
def test_a_reference_goes_on_at_its_rate_across_the_wrap(off_m: float, goes: bool) -> None:
    later = replace(PLACE, time_s=12.0, reference_rad=3.2 - 2.0 * np.pi + off_m / PLACE.radius_m)
    assert place_goes_on(PLACE, later) is goes


@pytest.mark.parametrize(
    "changes",
    [{"rate_share": 0.98}, {"radius_share": 1.02}, {"reference_rad": None}],
    ids=lambda each: next(iter(each)),
)
def test_a_ring_that_is_less_and_a_reference_that_ends_do_not_go_on(changes: dict[str, Any]) -> None:
    assert not place_goes_on(PLACE, replace(PLACE, **changes))
    assert not place_goes_on(replace(PLACE, **changes), PLACE)
