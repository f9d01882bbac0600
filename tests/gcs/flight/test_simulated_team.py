"""Whole teams below the wire: a vehicle is taken by a pilot, runs low, loses its bus, or its agent is started again."""

import asyncio
from math import dist

import pytest

from agents.flight_end import FlightEnd
from gcs.flight.faults.catalogue import required_fault
from gcs.flight.faults.team_faults import TeamInFlight
from gcs.mission.mission import Mission
from sitl.autopilot.modes import NavMode
from tests.support.mission_text import LOW_M, content, parsed, put
from tests.support.simulated_loop import run_simulated
from tests.support.simulated_team import SimulatedTeam

FORMATION = ["formation"] * 3
QUICK: dict[str, object] = {"bus_lost_s": 0.5, "peer_silent_s": 1.0}
QUICK_TUNING: dict[str, object] = {"failsafe": {"battery_s": 2.0}}


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
    """In which order the vehicles of a team disarm, how high the others are then, and how high each one was."""

    def __init__(self) -> None:
        self.team: SimulatedTeam | None = None
        self.order: list[int] = []
        self.still_up_m: list[list[float]] = []
        self.highest_m: dict[int, float] = {}
        self._armed: set[int] = set()

    def step(self) -> None:
        assert self.team is not None
        autopilots = {i: link.autopilot for i, link in self.team.links.items()}
        armed = {i for i, autopilot in autopilots.items() if autopilot.armed}
        for i in sorted(self._armed - armed):
            self.order.append(i)
            heights_m = [autopilot.airframe.height_m for autopilot in autopilots.values()]
            self.still_up_m.append([height_m for height_m in heights_m if height_m > 0.0])
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


def test_who_takes_a_vehicle_keeps_it_until_a_command_and_it_is_not_landed_at_the_end() -> None:
    async def fly() -> None:
        async with SimulatedTeam(low_flight()) as team:
            await team.begin(60.0)
            await team.until(lambda: team.tactics() == FORMATION)
            taken, kept = team.links[3].autopilot, team.links[2].autopilot
            taken.select(NavMode.HOLD)
            taken_s = await team.until(lambda: team.tactics()[2] == "pilot override", 1.0)
            received = taken.setpoints_received
            await team.until_s(taken_s + 5.0)
            assert taken.setpoints_received == received, "setpoints after the pilot override"
            assert taken.mode is NavMode.HOLD
            assert team.tactics() == ["formation", "formation", "pilot override"]

            team.command("resume", 3)
            await team.until(lambda: taken.mode is NavMode.OFFBOARD, 3.0)
            assert taken.setpoints_received > received

            # The leader is taken as well, and nobody gives it back.
            kept.select(NavMode.HOLD)
            await team.until(lambda: team.tactics()[1] == "pilot override", 1.0)
            outcomes = {vehicle: await flight for vehicle, flight in team.flights.items()}
            endings = {vehicle: outcome.how for vehicle, outcome in outcomes.items()}
            assert endings == {1: FlightEnd.LANDED, 2: FlightEnd.PILOT, 3: FlightEnd.LANDED}
            assert [link.autopilot.armed for link in team.links.values()] == [False, True, False]
            assert kept.mode is NavMode.HOLD
            assert "'hold'" in outcomes[2].reason

    run_simulated(fly())


def test_a_low_battery_comes_home_and_a_lost_bus_steps_aside() -> None:
    async def fly() -> None:
        async with SimulatedTeam(low_flight(failsafe=QUICK, tuning=QUICK_TUNING)) as team:
            await team.begin(40.0)
            await team.until(lambda: team.tactics() == FORMATION)
            team.links[3].autopilot.battery_fraction = 0.15
            await team.until(lambda: team.tactics() == ["formation", "formation", "return and land"], 5.0)
            await team.until(
                lambda: {each.sender: each.alert for each in team.newest[2].peers}[3] == "battery low", 1.0
            )
            team.buses[1].break_off()
            await team.until(lambda: team.tactics()[0] == "aside", 1.0)
            assert team.newest[1].alert == "bus lost"
            await team.until(lambda: team.newest[2].alert == "peer silent", 3.0)
            assert team.tactics()[1] == "formation"
            outcomes = {vehicle: await flight for vehicle, flight in team.flights.items()}
            assert (outcomes[3].how, outcomes[3].reason) == (FlightEnd.BATTERY, "battery low")
            assert [outcomes[vehicle].how for vehicle in (1, 2)] == [FlightEnd.LANDED] * 2
            assert not any(link.autopilot.armed for link in team.links.values())

    run_simulated(fly())


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


def test_vehicles_too_near_to_land_together_land_one_by_one() -> None:
    landings = Landings()
    run_simulated(landed(low_flight(safety={"separation_m": 3.6}), landings))
    assert landings.order == [1, 2, 3]
    assert landings.still_up_m == [pytest.approx([LOW_M] * waiting, abs=0.5) for waiting in (2, 1, 0)]


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


def test_an_abort_hovers_then_lands_by_itself_unless_resumed() -> None:
    async def fly() -> None:
        async with SimulatedTeam(low_flight(safety={"abort_hover_s": 5.0})) as team:
            await team.begin()
            aborted_s = await team.until(lambda: team.tactics() == FORMATION)
            for vehicle in team.mission.ids:
                team.command("abort", vehicle)
            await team.until(lambda: team.tactics() == ["hold"] * 3, 0.5)
            team.command("resume", 1)
            team.command("abort", 2)
            await team.until(lambda: team.tactics() == ["formation", "land", "hold"], 0.5)
            await team.until(lambda: team.tactics()[2] == "land", 6.0)
            assert asyncio.get_running_loop().time() - aborted_s >= 5.0
            await team.until(lambda: [x.autopilot.armed for x in team.links.values()] == [True, False, False])
            assert team.tactics()[0] == "formation"
            endings = {vehicle: (await team.flights[vehicle]).how for vehicle in (2, 3)}
            assert endings == {2: FlightEnd.ABORTED, 3: FlightEnd.ABORTED}

    run_simulated(fly())


def test_on_its_way_up_one_vehicle_is_landed_and_another_killed() -> None:
    async def fly() -> None:
        async with SimulatedTeam(low_flight()) as team:
            await team.begin()
            autopilots = {vehicle: link.autopilot for vehicle, link in team.links.items()}
            await team.until(lambda: not any(autopilot.landed for autopilot in autopilots.values()))
            team.command("land", 2)
            team.command("kill", 3)
            await team.until(lambda: not autopilots[3].armed, 0.5)
            await team.until(lambda: autopilots[2].mode is NavMode.LAND, 3.0)
            assert autopilots[1].armed, "nobody else was meant"
            outcomes = {vehicle: await flight for vehicle, flight in team.flights.items()}
            assert outcomes[3].flew
            # The start needs all vehicles: without the others the first one lands.
            endings = {vehicle: outcome.how for vehicle, outcome in outcomes.items()}
            assert endings == {1: FlightEnd.REFUSED, 2: FlightEnd.OPERATOR, 3: FlightEnd.KILLED}
            assert outcomes[1].reason.endswith(": 2, 3")
            assert not any(autopilot.armed for autopilot in autopilots.values())

    run_simulated(fly())


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "alert"), [("not following", "not following"), ("GPS jump", "estimator jumped")])
def test_a_vehicle_that_reports_its_own_fault_raises_no_alarm_of_the_others(fault: str, alert: str) -> None:
    """One cause, one alarm: the others name it under their own quantities."""

    async def fly() -> None:
        async with SimulatedTeam(low_flight(target={"start_m": [7.0, -4.0]})) as team:
            await team.begin()
            began_s = await team.until(lambda: team.tactics() == ["encircle"] * 3, 120.0)
            await team.until_s(began_s + 30.0)
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
