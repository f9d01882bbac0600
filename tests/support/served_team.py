"""A team's vehicles, served as stubs of a test's own process on a governed clock, as they truly are."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from itertools import combinations
from math import dist, inf

from gcs.flight.stubs import prepared_configs
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from sitl.autopilot.autopilot import StubAutopilot
from sitl.server.governed_clock import GovernedClock
from tests.support.wire import Served, served

FAST = 10.0
HOLDS = {"COM_OBL_RC_ACT": 5}
"""The vehicles hold once no setpoints arrive."""
UNLIKE = (
    ("start_m = [0.0, 4.0]", "start_m = [0.0, 4.0]\ntrue_scale = { a0 = 1.15, a1 = 0.9 }"),
    ("start_m = [0.0, 0.0]", "start_m = [0.0, 0.0]\ntrue_scale = { a0 = 0.88, a1 = 1.1 }"),
    ("start_m = [0.0, -4.0]", "start_m = [0.0, -4.0]\ntrue_scale = { a0 = 1.1, a1 = 1.1 }"),
)
"""A change of case2: its vehicles' plants are off by up to 15 %."""


HEIGHTS_OFF_M = 0.5
"""How far two vehicles above each other may be off their layers, in sum."""


class Team:
    """The vehicles as they truly are, and the least distance of any two in the air while it is `watched`.

    `least_level_m` is the least horizontal distance of two that are not above each other by the vertical separation.
    """

    def __init__(self, path: str, mission: Mission, stubs: Served) -> None:
        self.path, self.mission, self.stubs = path, mission, stubs
        self.clock: GovernedClock = stubs.clock
        self.least_m = self.least_level_m = inf

    @property
    def vehicles(self) -> dict[int, StubAutopilot]:
        """Their autopilots, by system id."""
        return self.stubs.vehicles

    def place_m(self, i: int) -> tuple[float, ...]:
        return tuple(self.vehicles[i].airframe.position_m)

    @property
    def aloft(self) -> set[int]:
        return {i for i, each in self.vehicles.items() if each.armed and not each.landed}

    def off_start_m(self, i: int) -> float:
        return dist(self.place_m(i)[:2], self.mission.vehicle(i).section.start_m)

    async def _watch(self) -> None:
        above_m = self.mission.safety.vertical_separation_m - HEIGHTS_OFF_M
        while True:
            for one, other in combinations(map(self.place_m, sorted(self.aloft)), 2):
                self.least_m = min(self.least_m, dist(one, other))
                if abs(one[2] - other[2]) < above_m:
                    self.least_level_m = min(self.least_level_m, dist(one[:2], other[:2]))
            await self.clock.sleep(0.1)

    @asynccontextmanager
    async def watched(self) -> AsyncIterator[None]:
        watching = asyncio.create_task(self._watch())
        yield
        watching.cancel()


@asynccontextmanager
async def team_of(
    path: str, starts_m: Mapping[int, tuple[float, float]] = {}, system_ids: Mapping[int, int] = {}
) -> AsyncIterator[Team]:
    """Serve a mission's vehicles; some stand elsewhere, or have another system id than the mission says."""
    mission = load_mission(path)
    configs = [
        replace(
            each,
            parameters=HOLDS if each.autopilot == "px4" else {},
            start_position_m=starts_m.get(each.vehicle_id, each.start_position_m),
            vehicle_id=system_ids.get(each.vehicle_id, each.vehicle_id),
        )
        for each in prepared_configs(mission, mission.ids, 1.0)
    ]
    async with served(configs, FAST) as stubs:
        yield Team(path, mission, stubs)
