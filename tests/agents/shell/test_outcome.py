"""How a vehicle's flight ended: whatever brings it down is named, the operator's commands with who gave them."""

import asyncio
from collections.abc import Callable

import pytest

from agents.flight_end import FlightEnd
from agents.shell.life import Phase
from agents.shell.outcome import BY_OPERATOR, Outcome, Stop
from tests.support.fake_flight import FakeFlight
from tests.support.simulated_loop import run_simulated

DURATION_S = 60.0
FLYING_S = 5.0
BETWEEN_TICKS_S = 20.05
"""A mission of this length ends between two ticks."""


def ended(disturb: Callable[[FakeFlight], object], duration_s: float = DURATION_S) -> Outcome:
    """Disturb a flight on its mission, and return its outcome."""

    async def main() -> Outcome:
        flight = FakeFlight()
        await flight.begin(duration_s)
        await flight.until(Phase.FLYING)
        await asyncio.sleep(FLYING_S)
        disturb(flight)
        return await flight.outcome()

    return run_simulated(main())


def twice(flight: FakeFlight) -> None:
    flight.link.change(battery=0.05)
    asyncio.get_running_loop().call_later(1.0, lambda: flight.command("hold"))


CAUSES: dict[str, tuple[Callable[[FakeFlight], object], tuple[FlightEnd, str]]] = {
    "land": (lambda flight: flight.command("land"), (FlightEnd.OPERATOR, "land by test")),
    "abort": (lambda flight: flight.command("abort"), (FlightEnd.ABORTED, "abort by the operator")),
    "battery critical": (lambda flight: flight.link.change(battery=0.05), (FlightEnd.BATTERY, "battery critical")),
    "battery low": (lambda flight: flight.link.change(battery=0.18), (FlightEnd.BATTERY, "battery low")),
    "held meanwhile": (twice, (FlightEnd.BATTERY, "battery critical")),
    "Ctrl-C": (lambda flight: flight.stop.request(), (FlightEnd.OPERATOR, "the operator ended the flight")),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_what_ended_the_flight_is_its_outcome(cause: str) -> None:
    disturb, expected = CAUSES[cause]
    outcome = ended(disturb)
    assert (outcome.how, outcome.reason) == expected
    assert outcome.flew


def test_a_mission_that_is_over_while_the_vehicle_comes_down_was_not_completed() -> None:
    def return_at_last(flight: FakeFlight) -> None:
        assert flight.agent.start_s is not None
        over_s = flight.agent.start_s + BETWEEN_TICKS_S - flight.clock.now_s()
        asyncio.get_running_loop().call_later(over_s - 0.02, lambda: flight.command("rtl"))

    assert ended(return_at_last, BETWEEN_TICKS_S).reason == "rtl by test"


def test_a_vehicle_that_resumed_completes_its_mission() -> None:
    def abort_and_resume(flight: FakeFlight) -> None:
        flight.command("abort")
        flight.command("resume")

    assert ended(abort_and_resume, BETWEEN_TICKS_S) == Outcome(FlightEnd.LANDED, flew=True)


def test_a_stop_keeps_the_reason_of_its_first_request() -> None:
    stop = Stop()
    stop.request(Outcome(FlightEnd.WATCHDOG, "its supervisor was gone"))
    stop.request()
    assert stop.outcome == Outcome(FlightEnd.WATCHDOG, "its supervisor was gone")
    assert stop.hurried.is_set()
    by_default = Stop()
    by_default.request()
    assert by_default.outcome is BY_OPERATOR
