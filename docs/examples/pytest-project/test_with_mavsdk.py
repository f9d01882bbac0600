"""The flight by MAVSDK, on three stub vehicles."""

import asyncio
from itertools import combinations
from math import dist

import pytest
from my_mavsdk_flight import fly


def test_three_vehicles_fly_to_their_places_and_land(cordon_stubs):
    team = cordon_stubs("case2", vehicles=3)
    heights_m, closest_m = [], []

    async def scenario():
        # They stand in a line to the north, and fly east: they keep apart in any order of take-off.
        flights = [asyncio.create_task(fly(vehicle.url, 0.0, 3.0 + vehicle.id, 5.0)) for vehicle in team]

        def all_landed():
            places_m = [vehicle.truth().position_m for vehicle in team]
            heights_m.append(min(z for _, _, z in places_m))
            closest_m.append(min(dist(one, other) for one, other in combinations(places_m, 2)))
            return all(flight.done() and flight.result() is None for flight in flights)  # raises what ended a flight

        await team.until(all_landed, within_s=900.0)

    asyncio.run(scenario())
    assert max(heights_m) > 4.5
    assert min(closest_m) > 3.0
    for vehicle in team:
        state = vehicle.truth()
        assert not state.armed
        assert state.ned_m == pytest.approx((0.0, 3.0 + vehicle.id, 0.0), abs=0.5)


def test_a_vehicle_whose_link_is_cut_returns(cordon_stubs):
    team = cordon_stubs("case2", vehicles=1)

    async def scenario():
        flight = asyncio.create_task(fly(team[1].url, 30.0, 0.0, 5.0))
        await team.until(lambda: flight.done() or team[1].truth().ned_m[0] > 5.0, within_s=900.0)
        assert team[1].truth().mode == "Offboard"
        team.inject(1, "link-cut")
        await team.until(lambda: team[1].truth().mode == "Return", within_s=5.0)
        flight.cancel()

    asyncio.run(scenario())
