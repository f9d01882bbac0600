"""Whole teams below the wire: a vehicle is taken by a pilot, runs low, loses its bus, or its agent is started again."""

from agents.shell.outcome import Ending
from gcs.mission.mission import Mission
from sitl.autopilot.modes import NavMode
from tests.support.mission_text import LOW_M, content, parsed, put
from tests.support.simulated_loop import run_simulated
from tests.support.simulated_team import SimulatedTeam

FORMATION = ["formation"] * 3


def low_flight(**failsafe: float) -> Mission:
    """Case 2, flown low for short take-offs and landings, with other grace times."""
    mission = content()
    for index in range(3):
        mission = put(mission, ("vehicles", index, "altitude_m"), LOW_M)
    return parsed(put(mission, ("failsafe",), failsafe))


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
            endings = {vehicle: outcome.ending for vehicle, outcome in outcomes.items()}
            assert endings == {1: Ending.COMPLETED, 2: Ending.PILOT_OVERRIDE, 3: Ending.COMPLETED}
            assert [link.autopilot.armed for link in team.links.values()] == [False, True, False]
            assert kept.mode is NavMode.HOLD
            assert "'hold'" in outcomes[2].reason

    run_simulated(fly())


def test_a_low_battery_comes_home_and_a_lost_bus_steps_aside() -> None:
    async def fly() -> None:
        async with SimulatedTeam(low_flight(battery_s=2.0, bus_lost_s=0.5, peer_silent_s=1.0)) as team:
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
            assert (outcomes[3].ending, outcomes[3].reason) == (Ending.BATTERY, "battery low")
            assert [outcomes[vehicle].ending for vehicle in (1, 2)] == [Ending.COMPLETED] * 2
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
