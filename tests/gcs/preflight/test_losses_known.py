"""How long losses are counted before they decide about a connection."""

import asyncio

import pytest

from agents.shell.clock import WallClock, link_s
from gcs.link.rates import Losses, RateController, Rates
from gcs.preflight.link_facts import are_known, known_losses


@pytest.mark.parametrize(
    ("losses", "bytes_s", "known", "known_after_40_s"),
    [
        (Losses(), None, True, True),
        (Losses(90.0), 11520.0, False, False),
        (Losses(200.0, 4.0, 2.0), None, False, True),
        (Losses(600.0, 20.0, 12.0), 11520.0, True, True),
        (Losses(600.0, 60.0, 15.0), 3840.0, False, False),
        (Losses(600.0, 60.0, 12.0), 1920.0, False, True),
    ],
)
def test_frames_or_bursts_decide_and_a_refusal_in_doubt_is_put_off(
    losses: Losses, bytes_s: float | None, known: bool, known_after_40_s: bool
) -> None:
    full = Rates(telemetry_hz=20.0, status_hz=2.0, setpoint_hz=20.0)
    pace = RateController(full, 1, bytes_s, automatic=True, telemetry_s=1.0, offboard_s=1.0)
    rates = pace.rates
    assert are_known(losses, pace, 10.0) is known
    assert are_known(losses, pace, 40.0) is known_after_40_s
    assert are_known(losses, pace, 90.0)
    assert pace.rates is rates, "the connection keeps its rates"


async def test_losses_are_counted_for_as_long_where_the_speed_of_the_clock_is_set_meanwhile() -> None:
    clock = WallClock(1.0)
    since_s = link_s(clock) - 90.0
    clock.set_speed(0.9)
    pace = RateController(Rates(20.0, 2.0, 20.0), 1, 1920.0, telemetry_s=1.0, offboard_s=1.0)
    losses = Losses(600.0, 60.0, 12.0)
    assert await asyncio.wait_for(known_losses(lambda: losses, pace, clock, since_s), 5.0) == losses
