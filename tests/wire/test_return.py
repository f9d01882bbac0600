"""A member whose agent ends in flight and is started again: it joins the mission that has begun."""

import asyncio
from collections.abc import Callable, Sequence
from io import StringIO

import pytest
from rich.console import Console

from gcs.console.live import LiveView
from gcs.flight.flight import Flight, fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission, MissionVehicle
from tests.support.mission_text import LOW
from tests.support.wire import served, until

pytestmark = pytest.mark.wire

SPEED = 5.0


class Terminal:
    """What one `cordon fly` flies, and shows."""

    def __init__(self, mission: Mission, vehicles: Sequence[MissionVehicle], patch: pytest.MonkeyPatch) -> None:
        view = LiveView(Console(file=StringIO()))
        self.tactics: dict[int, str] = {}
        self.said: list[str] = []
        patch.setattr(view, "update", lambda rows, *_: self.tactics.update({r.vehicle_id: r.tactic for r in rows}))
        patch.setattr(view, "print_line", lambda text, *_: self.said.append(text))
        plan = FlightPlan(mission, 400.0, tuple(vehicles), speed=SPEED)
        self.flight: asyncio.Task[Flight] = asyncio.create_task(fly(plan, view))

    async def in_formation(self, count: int) -> None:
        await until(lambda: list(self.tactics.values()) == ["formation"] * count or self.flight.done(), 30.0)
        assert not self.flight.done(), self.flight.result()

    async def end(self) -> None:
        self.flight.cancel()
        await asyncio.gather(self.flight, return_exceptions=True)


async def test_an_agent_that_is_started_again_joins_the_mission_that_has_begun(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = load_mission(mission_file("case2", ('name = "case2"', 'name = "joined"'), LOW))
    async with served(stub_configs(mission), SPEED):
        stay, leave = (Terminal(mission, some, monkeypatch) for some in (mission.vehicles[:2], mission.vehicles[2:]))
        try:
            await asyncio.gather(stay.in_formation(2), leave.in_formation(1))
            await leave.end()
            assert stay.tactics == {1: "formation", 2: "formation"}
            leave = Terminal(mission, mission.vehicles[2:], monkeypatch)
            await leave.in_formation(1)
            # On the mission's clock, not on one of its own: that would begin at nought again.
            started_s = next(
                float(said.partition(" s:")[0]) for said in leave.said if said.endswith("formation: start")
            )
            assert started_s > 5.0
        finally:
            await asyncio.gather(stay.end(), leave.end())
