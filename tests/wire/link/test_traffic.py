"""Traffic that one vehicle's autopilot passes on: both vehicles know of it, keep clear, and a replay does the same."""

import asyncio
import json
from collections.abc import Callable
from math import hypot, inf
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from estimation.frames import Triple
from gcs.flight.stubs import stub_configs
from gcs.flightlog.reader import read_log
from gcs.mission.file import load_mission
from gcs.replay.cores import replay
from sitl.mavlink_constants import Outgoing
from sitl.server.server import Stub
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.wire import running, served, until

pytestmark = pytest.mark.wire

KEPT_M, SPEED_M_S, AWAY_M, HEADING_CDEG = 15.0, 5.0, 60.0, 27000
NEAR = ("[safety]\n", f"[safety]\ntraffic_distance_m = {KEPT_M}\n")
VALID = 1 | 2 | 4 | 8 | 16
"""Coordinates, altitude, heading, velocity and call sign."""


def adsb(place: tuple[int, int, int]) -> Outgoing:
    """The report of an aircraft that flies west."""
    latitude, longitude, altitude_mm = place
    moves = HEADING_CDEG, round(SPEED_M_S * 100.0), 0
    fields = (0x4B1234, latitude, longitude, 1, altitude_mm, *moves, b"HB-XYZ", 1, 0, VALID, 7000)
    return mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE, fields


def apart_m(stub: Stub, place_m: Triple) -> float:
    x, y, _ = stub.autopilot.airframe.position_m
    return hypot(x - place_m[0], y - place_m[1])


async def test_both_keep_clear_of_an_aircraft_that_one_hears_and_a_replay_is_the_same(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    path = with_first_vehicles(mission_file("case2", LOW, NEAR), 2)
    mission, log = load_mission(path), tmp_path / "traffic.mcap"
    frame, nearest_m = mission.mission_frame(), dict.fromkeys((1, 2), inf)
    async with served(stub_configs(mission), inf) as stubs:
        command = ("fly", path, "--json", "--duration", "25", "--log", str(log))
        async with running(*command) as process:
            flight = asyncio.create_task(process.communicate())
            await until(lambda: flight.done() or all(not each.landed for each in stubs.vehicles.values()))
            began_s = heard_s = stubs.clock.now_s()
            while not flight.done() and (since_s := stubs.clock.now_s() - began_s) < 28.0:
                place_m = (AWAY_M - SPEED_M_S * since_s, 2.0, 5.0)  # x points east
                for vehicle, stub in stubs.stubs.items():
                    nearest_m[vehicle] = min(nearest_m[vehicle], apart_m(stub, place_m))
                if stubs.clock.now_s() >= heard_s:
                    heard_s += 1.0
                    place = frame.geodetic_from_mission(place_m)
                    degrees_e7 = round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7)
                    stubs.stubs[1].hear(adsb((*degrees_e7, round(place.altitude_m * 1e3))))
                await stubs.clock.sleep(0.2)
            out, err = await flight
    result = json.loads(out)
    moved = {each["vehicle"] for each in result["events"] if "traffic" in each.get("guard", {}).get("causes", ())}
    assert moved == {1, 2}, err.decode()
    assert min(nearest_m.values()) > 0.9 * KEPT_M, nearest_m
    played = replay(read_log(log))
    assert played.same
    assert played.other_versions == ()
    assert all(each.compared == each.identical > 200 for each in played.vehicles)
