"""How long losses are counted before they decide about a connection."""

import pytest

from gcs.link.rates import Losses, RateController, Rates
from gcs.preflight.link_facts import are_known


@pytest.mark.parametrize(
    ("losses", "bytes_s", "known"),
    [
        (Losses(), None, True),
        (Losses(90.0), 11520.0, False),
        (Losses(310.0), 11520.0, True),
        (Losses(200.0, 4.0, 2.0), None, False),
        (Losses(600.0, 20.0, 12.0), 11520.0, True),
        (Losses(600.0, 60.0, 12.0), 1920.0, False),
    ],
)
def test_frames_or_bursts_decide_and_a_refusal_is_put_off(losses: Losses, bytes_s: float | None, known: bool) -> None:
    full = Rates(telemetry_hz=20.0, status_hz=2.0, setpoint_hz=20.0)
    pace = RateController(full, 1, bytes_s, automatic=True, telemetry_s=1.0, offboard_s=1.0)
    rates = pace.rates
    assert are_known(losses, pace) is known
    assert pace.rates is rates, "the connection keeps its rates"
