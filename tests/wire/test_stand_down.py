"""The pilot wins: who changes a vehicle's flight mode has it, until an operator sends the vehicle back by command."""

import asyncio
from collections.abc import Callable
from io import StringIO

import pytest
from rich.console import Console

from agents.shell.outcome import Ending
from gcs.console.command_client import CommandClient
from gcs.console.live import LiveView
from gcs.flight.flight import Flight, fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from sitl.autopilot.modes import NavMode
from sitl.server.process import unix_clock
from sitl.server.server import serve
from tests.support.mission_text import LOW
from tests.support.wire import StubWatch, until

pytestmark = pytest.mark.wire

SPEED = 4.0


@pytest.fixture
def mission(mission_file: Callable[..., str]) -> Mission:
    """Return case2 on ports of its own."""
    return load_mission(mission_file("case2", ('name = "case2"', 'name = "stand-down"'), LOW))


async def test_who_takes_a_vehicle_keeps_it_until_a_command_and_it_is_not_landed_at_the_end(
    mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = StubWatch(monkeypatch)
    rows: dict[int, str] = {}
    view = LiveView(Console(file=StringIO()))
    monkeypatch.setattr(view, "update", lambda team, *_: rows.update({row.vehicle_id: row.tactic for row in team}))
    stop = asyncio.Event()
    stubs = asyncio.create_task(serve(stub_configs(mission), speed=SPEED, now_s=unix_clock(SPEED), stop=stop))
    plan = FlightPlan(mission, 60.0, mission.vehicles, speed=SPEED)
    flight: asyncio.Task[Flight] = asyncio.create_task(fly(plan, view))
    try:
        await until(lambda: list(rows.values()) == ["formation"] * 3)
        await asyncio.sleep(1.0)
        taken = watch.vehicles[3]
        taken.select(NavMode.HOLD)
        told_s = await until(lambda: rows[3] == "pilot override", 2.0) + 0.1  # those still in the sockets arrive first
        await asyncio.sleep(1.5)
        assert watch.received_since(3, told_s) == 0, "setpoints after standing down"
        assert taken.mode is NavMode.HOLD
        assert (rows[1], rows[2]) == ("formation", "formation")

        answers = await CommandClient(mission).command("resume", (3,), 3)
        assert answers[3] is not None
        await until(lambda: taken.mode is NavMode.OFFBOARD, 3.0)
        assert watch.received_since(3, told_s) > 0

        # The leader is taken as well, and nobody gives it back.
        kept = watch.vehicles[2]
        kept.select(NavMode.HOLD)
        await until(lambda: rows[2] == "pilot override", 2.0)
        outcomes = (await flight).outcomes
    finally:
        flight.cancel()
        stop.set()
        await asyncio.gather(stubs, flight, return_exceptions=True)
    endings = {vehicle_id: outcome.ending for vehicle_id, outcome in outcomes.items()}
    assert endings == {1: Ending.COMPLETED, 2: Ending.PILOT_OVERRIDE, 3: Ending.COMPLETED}
    assert kept.armed, "left in the air to whoever took it"
    assert "'hold'" in outcomes[2].reason
