"""Another MAVLink vehicle as the target of a team: a stub that stands where it stands."""

from collections.abc import Callable
from dataclasses import replace
from urllib.parse import urlsplit

import pytest

from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from tests.support.flights import flying, in_flight, unseen_view
from tests.support.mission_text import LOW
from tests.support.wire import served

pytestmark = pytest.mark.wire

SPEED, TARGET_ID, PLACE_M = 10.0, 40, (9.0, 1.0)
NAMED = f'[target]\nsource = "mavlink"\nurl = "udpin://127.0.0.1:14550"\nsystem_id = {TARGET_ID}\n'
"""On a port that the maker of mission files changes for a free one."""


async def test_a_vehicle_that_says_where_it_is_is_encircled(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = load_mission(mission_file("case2", LOW, ("[target]\n", NAMED)))
    view = unseen_view()
    radii: dict[int, float] = {}
    monkeypatch.setattr(
        view, "update", lambda rows, *_: radii.update({row.vehicle_id: row.radius_m or 0.0 for row in rows})
    )
    team = stub_configs(mission)
    port = urlsplit(mission.target.url or "").port or 0
    target = replace(team[0], vehicle_id=TARGET_ID, client_port=port, start_position_m=PLACE_M)
    async with served([*team, target], SPEED) as stubs:
        plan = FlightPlan(mission, 120.0, mission.vehicles, speed=SPEED, clock=stubs.clock.name)
        async with flying(plan, view) as flight:
            await in_flight(
                flight, lambda: all(9.0 < radii.get(i, 0.0) < 11.0 for i in mission.ids), "a ring", stubs.clock
            )
