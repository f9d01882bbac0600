"""What a flight over sockets tells its cores of battery, bus and loop, and what the vehicles make of it."""

import asyncio
from collections.abc import Callable
from io import StringIO

import pytest
from rich.console import Console

from agents.outputs import CoreStatus
from agents.shell.bus.zenoh_session import ZenohSession
from agents.shell.outcome import Ending
from gcs.console.live import LiveView
from gcs.flight.flight import Flight, fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.metrics.journal import Journal
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.support.mission_text import LOW
from tests.support.wire import StubWatch, served, until

pytestmark = pytest.mark.wire

SPEED = 5.0
QUICK = (
    "[target]\n",
    "[failsafe]\nbattery_s = 2.0\nbus_lost_s = 0.5\npeer_silent_s = 1.0\n\n[target]\n",
)


@pytest.fixture
def mission(mission_file: Callable[..., str]) -> Mission:
    return load_mission(mission_file("case2", QUICK, LOW))


async def test_a_low_battery_comes_home_and_a_closed_bus_steps_aside(
    mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = StubWatch(monkeypatch)
    sessions: dict[int, ZenohSession] = {}
    latest: dict[int, CoreStatus] = {}
    notes: list[str] = []
    appear, note = ZenohSession.appear, Journal.note

    def appeared(session: ZenohSession, name: str, topic: str) -> None:
        sessions[int(name)] = session
        appear(session, name, topic)

    def noted(journal: Journal, status: CoreStatus, tick_us: float) -> None:
        latest[status.vehicle_id] = status
        notes.extend(f"{status.vehicle_id}: {each.text}" for each in status.notes if each.kind == "failsafe")
        note(journal, status, tick_us)

    monkeypatch.setattr(ZenohSession, "appear", appeared)
    monkeypatch.setattr(Journal, "note", noted)

    split = mission.vehicles[:1], mission.vehicles[1:]

    def tactics() -> list[str]:
        return [latest[i].tactic.value if i in latest else "" for i in (1, 2, 3)]

    async with served(stub_configs(mission), SPEED):
        # The vehicles of one process share a session: the first is flown by itself.
        plans = (FlightPlan(mission, 40.0, each, speed=SPEED) for each in split)
        flights: asyncio.Future[list[Flight]] = asyncio.gather(
            *(fly(plan, LiveView(Console(file=StringIO()))) for plan in plans)
        )
        try:
            await until(lambda: tactics() == ["formation"] * 3)
            await asyncio.sleep(0.5)
            assert notes == []
            watch.vehicles[3].battery_fraction = 0.15
            await until(lambda: tactics() == ["formation", "formation", "return and land"], 5.0, "coming home")
            assert latest[3].alert == "battery low"
            await until(lambda: {each.sender: each.alert for each in latest[2].peers}.get(3) == "battery low", 1.0)
            assert sessions[1] is not sessions[2] is sessions[3]
            sessions[1].close()
            await until(lambda: tactics()[0] == "aside", 3.0, "stepping aside")
            assert latest[1].alert == "bus lost"
            await until(lambda: latest[2].alert == "peer silent", 3.0, "missing the other")
            assert tactics()[1] == "formation"
            outcomes = {i: outcome for flight in await flights for i, outcome in flight.outcomes.items()}
        finally:
            flights.cancel()
            await asyncio.gather(flights, return_exceptions=True)
    assert (outcomes[3].ending, outcomes[3].reason) == (Ending.BATTERY, "battery low")
    assert [outcomes[i].ending for i in (1, 2)] == [Ending.COMPLETED] * 2
    assert not any(vehicle.armed for vehicle in watch.vehicles.values())
    assert not [each for each in notes if "late ticks" in each or "clock" in each], notes
