"""Flights of stubs in this process: without a terminal, and ended with their context."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from io import StringIO

from rich.console import Console

from agents.shell.clock import MissionClock
from gcs.console.live import LiveView
from gcs.flight.flight import FlightOutcome, fly
from gcs.flight.plan import FlightPlan
from gcs.preflight.findings import Finding
from tests.support.wire import until


def unseen_view(output: StringIO | None = None) -> LiveView:
    """Return a view without a terminal, which writes its lines to `output`."""
    return LiveView(Console(file=StringIO() if output is None else output))


@asynccontextmanager
async def flying(
    plan: FlightPlan, view: LiveView | None = None, found: list[Finding] | None = None
) -> AsyncIterator[asyncio.Task[FlightOutcome]]:
    """Fly; the flight ends with the context."""
    flight = asyncio.create_task(fly(plan, view or unseen_view(), (found if found is not None else []).extend))
    try:
        yield flight
    finally:
        flight.cancel()
        await asyncio.gather(flight, return_exceptions=True)


async def in_flight(
    flight: asyncio.Task[FlightOutcome], condition: Callable[[], bool], waiting_for: str, clock: MissionClock
) -> None:
    """Wait for a condition, at most 300 s on the clock, while a flight goes on."""
    await until(lambda: flight.done() or condition(), 300.0, waiting_for, clock=clock)
    assert not flight.done(), flight.result()
