"""A team indoors, over sockets: no GPS, and vehicles whose local frames begin in different places."""

import asyncio
from collections.abc import Callable
from math import dist

import pytest

from agents.flight_end import FlightEnd
from gcs.flight.flight import fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from gcs.preflight.findings import Grade
from gcs.preflight.link_facts import gather_facts
from gcs.preflight.preflight import preflight
from sitl.server.shared_clock import new_clock
from tests.support.flights import unseen_view
from tests.support.mission_text import with_first_vehicles
from tests.support.wire import stub_process

pytestmark = pytest.mark.wire

SPEED = 5.0
DURATION_S = 20.0
INDOORS = (
    ('layer_m = 3.0\nlanding = "return"', 'landing = "in_place"'),
    ("latitude_deg = 47.397742\nlongitude_deg = 8.545594\naltitude_m = 488.0\n", "local = true\n"),
    ("altitude_m = 8.0", "altitude_m = 2.0"),
    ("start_m = [0.0, 4.0]", "start_m = [0.0, 4.0]\norigin_m = [-3.0, 1.5, -0.5]"),
    ("distance_max_m = 15.0", "distance_max_m = 0.5"),
)
"""Line abreast along x, 0.5 m/s; vehicle 1 takes its place from another corner than where it stands."""


async def test_a_team_without_gps_ends_up_where_the_mission_says(mission_file: Callable[..., str]) -> None:
    mission = load_mission(with_first_vehicles(mission_file("px4-trio", *INDOORS), 2))
    assert [config.gps for config in stub_configs(mission)] == [False, False]
    with new_clock(SPEED) as name, stub_process(stub_configs(mission), name) as stubs:
        findings = preflight(mission, await gather_facts(mission))
        assert [each for each in findings if each.grade is Grade.REFUSE] == []
        plan = FlightPlan(mission, DURATION_S, mission.vehicles, speed=SPEED, clock=name)
        flight = await fly(plan, unseen_view())
        record = await asyncio.to_thread(stubs.stop)
    assert [each.how for each in flight.outcomes.values()] == [FlightEnd.LANDED] * 2, flight.outcomes
    assert flight.record is not None
    for track, place in zip(record.tracks, ((0.0, 4.0), (0.0, 0.0)), strict=True):
        x, y, z = track.position_m[-1].tolist()
        along_m = mission.formation.speed_m_s * DURATION_S
        assert dist((x, y), (place[0] + along_m, place[1])) < 2.0, "landed at the end of the line"
        assert z == 0.0
        assert max(track.position_m[:, 2]) == pytest.approx(2.0, abs=0.1)
