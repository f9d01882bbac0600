"""The flight by pymavlink, on three stub vehicles; each flies in a thread of its own."""

from concurrent.futures import Future
from threading import Thread

import pytest
from my_pymavlink_flight import fly


def in_thread(function, *arguments):
    """Call a function in a thread that does not outlive the tests; return the future of its result."""
    future = Future()

    def call():
        try:
            future.set_result(function(*arguments))
        except Exception as error:
            future.set_exception(error)

    Thread(target=call, daemon=True).start()
    return future


def test_three_vehicles_fly_to_their_places_and_land(cordon_stubs):
    team = cordon_stubs("case2", vehicles=3)
    heights_m = []
    flights = [in_thread(fly, vehicle.pymavlink_url, 4.0, vehicle.id, 5.0) for vehicle in team]

    def all_landed():
        heights_m.append(min(vehicle.truth().position_m[2] for vehicle in team))
        return all(flight.done() and flight.result() is None for flight in flights)  # raises what ended a flight

    team.wait_until(all_landed, within_s=900.0)
    assert max(heights_m) > 4.5
    for vehicle in team:
        state = vehicle.truth()
        assert not state.armed
        assert state.ned_m == pytest.approx((4.0, vehicle.id, 0.0), abs=0.5)
