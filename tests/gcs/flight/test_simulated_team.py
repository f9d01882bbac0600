"""Whole teams below the wire: an agent is started again, vehicles return on layers, and one reports its own fault."""

import asyncio
from math import dist

import pytest

from agents.flight_end import FlightEnd
from gcs.flight.faults.catalogue import required_fault
from gcs.flight.faults.team_faults import TeamInFlight
from gcs.mission.mission import Mission
from tests.support.mission_text import LOW_M, content, parsed, put
from tests.support.simulated_loop import run_simulated
from tests.support.simulated_team import SimulatedTeam

FORMATION = ["formation"] * 3


def low_flight(**changes: dict[str, object]) -> Mission:
    """Case 2, flown low for short take-offs and landings, with changed values of its sections."""
    mission = content()
    for index in range(3):
        mission = put(mission, ("vehicles", index, "altitude_m"), LOW_M)
    for section, values in changes.items():
        for key, value in values.items():
            mission = put(mission, (section, key), value)
    return parsed(mission)


class Landings:
    """In which order the vehicles of a team disarm, and how high each one was."""

    def __init__(self) -> None:
        self.team: SimulatedTeam | None = None
        self.order: list[int] = []
        self.highest_m: dict[int, float] = {}
        self._armed: set[int] = set()

    def step(self) -> None:
        assert self.team is not None
        autopilots = {i: link.autopilot for i, link in self.team.links.items()}
        armed = {i for i, autopilot in autopilots.items() if autopilot.armed}
        self.order += sorted(self._armed - armed)
        self._armed = armed
        for i, autopilot in autopilots.items():
            self.highest_m[i] = max(self.highest_m.get(i, 0.0), autopilot.airframe.height_m)


async def landed(mission: Mission, landings: Landings) -> SimulatedTeam:
    """Fly a mission for 10 s and to its end."""
    async with SimulatedTeam(mission, step=landings.step) as team:
        landings.team = team
        await team.begin(10.0)
        outcomes = [await flight for flight in team.flights.values()]
        assert [outcome.how for outcome in outcomes] == [FlightEnd.LANDED] * 3
    return team


def test_an_agent_that_is_started_again_joins_the_mission_that_has_begun() -> None:
    async def fly() -> None:
        async with SimulatedTeam(low_flight()) as team:
            await team.begin()
            await team.until(lambda: team.tactics() == FORMATION)
            began_s = team.agents[1].start_s
            await team.end(3)
            assert not team.links[3].autopilot.armed
            assert team.tactics()[:2] == ["formation", "formation"]
            del team.newest[3]
            await team.begin(vehicles=(3,))
            await team.until(lambda: team.tactics() == FORMATION)
            assert began_s is not None
            assert team.agents[3].start_s == began_s, "the mission's start, not one of its own"

    run_simulated(fly())


def test_vehicles_return_on_layers_of_their_own_and_land_in_order() -> None:
    choreography: dict[str, object] = {"layer_m": 3.0, "landing": "return", "landing_order": [3, 1, 2]}
    mission, landings = low_flight(choreography=choreography), Landings()
    team = run_simulated(landed(mission, landings))
    assert landings.order == [3, 1, 2]
    assert landings.highest_m == pytest.approx({1: LOW_M + 6.0, 2: LOW_M + 9.0, 3: LOW_M + 6.0}, abs=0.5), (
        "3 took off to its layer there"
    )
    for vehicle in mission.vehicles:
        assert dist(team.links[vehicle.id].autopilot.airframe.position_m[:2], vehicle.section.start_m) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "alert"), [("not following", "not following"), ("GPS jump", "estimator jumped")])
def test_a_vehicle_that_reports_its_own_fault_raises_no_alarm_of_the_others(fault: str, alert: str) -> None:
    """One cause, one alarm: the others name it under their own quantities."""

    async def fly() -> None:
        async with SimulatedTeam(low_flight(target={"start_m": [7.0, -4.0]})) as team:
            await team.begin()
            began_s = await team.until(lambda: team.tactics() == ["encircle"] * 3, 120.0)
            await team.until_s(began_s + 10.0)
            places_m = {i: link.autopilot.airframe.position_m for i, link in team.links.items()}
            injection = required_fault(fault).inject(TeamInFlight(team.mission, 3, (1, 2, 3), places_m))
            team.links[3].inject(injection.vehicles[3])
            alerts, explained = {1: set[str](), 2: set[str](), 3: set[str]()}, set[str]()
            injected_s = asyncio.get_running_loop().time()
            while asyncio.get_running_loop().time() < injected_s + 12.0:
                for i, status in team.newest.items():
                    alerts[i].add(status.alert)
                    if i != 3 and status.outlook is not None:
                        explained.update(status.outlook.also)
                await asyncio.sleep(0.1)
            assert alert in alerts[3]
            assert (alerts[1], alerts[2]) == ({""}, {""})
            assert f"vehicle 3 {alert}" in explained
            team.stop.request()
            team.stop.request()

    run_simulated(fly())
