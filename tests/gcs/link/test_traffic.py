"""ADS-B and Remote ID as they arrive: positions and motions in the mission frame, and what is left out."""

import json
from math import radians
from types import SimpleNamespace
from typing import Any

import pytest

from agents.team.messages import TRAFFIC_MAX, Aircraft
from estimation.frames import Geodetic, MissionFrame
from gcs.link.traffic import AGED_S, BASIC_ID, KNOWN_MAX, LOCATION, TrafficReceiver

FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(90.0))
SYSTEM, ALL_VALID = 4, 31
# 1e-3 degrees of latitude are 111.2 m; x is east, y is north.
PLANE = {
    "ICAO_address": 0x4B1234, "lat": 473987420, "lon": 85455940, "altitude_type": 1, "altitude": 598000,
    "heading": 9000, "hor_velocity": 6000, "ver_velocity": 100, "callsign": "HB-XYZ\0\0\0", "emitter_type": 1,
    "tslc": 2, "flags": ALL_VALID, "squawk": 7000,
}  # fmt: skip
ADDRESS = [7] * 20
DRONE = {
    "id_or_mac": ADDRESS, "direction": 18000, "speed_horizontal": 500, "latitude": 473968420, "longitude": 85455940,
    "altitude_geodetic": 560.0, "height_reference": 0, "height": 40.0,
}  # fmt: skip
NAMED = {"id_or_mac": ADDRESS, "uas_id": [*b"1581F4", 0, 0]}


class Receiver:
    """What a vehicle hears, at times of a clock."""

    def __init__(self) -> None:
        self.now_s = 50.0
        self.traffic = TrafficReceiver(SYSTEM, FRAME, lambda: self.now_s)

    def hears(self, name: str, fields: Any, system_id: int = SYSTEM) -> bool:
        text = fields if isinstance(fields, str) else json.dumps(fields)
        return self.traffic.take(SimpleNamespace(system_id=system_id, message_name=name, fields_json=text))

    def plane(self, **changes: Any) -> bool:
        return self.hears("ADSB_VEHICLE", PLANE | changes)

    @property
    def nearest(self) -> tuple[Aircraft, ...]:
        return self.traffic.nearest((0.0, 0.0, 8.0))


def test_an_aircraft_is_where_its_report_says_in_the_mission_frame() -> None:
    receiver = Receiver()
    assert receiver.plane()
    (plane,) = receiver.nearest
    assert (plane.label, plane.time_s) == ("HB-XYZ", 48.0)
    assert plane.position_m == pytest.approx((0.0, 111.2), abs=0.1)
    assert plane.velocity_m_s == pytest.approx((60.0, 0.0), abs=1e-9)
    assert plane.altitude_m == pytest.approx(110.0)
    assert receiver.plane(flags=1)
    (plane,) = receiver.nearest
    assert (plane.label, plane.velocity_m_s, plane.altitude_m) == ("4B1234", (0.0, 0.0), None), "what is not valid"


def test_a_drone_has_its_serial_number_once_it_is_known_and_its_height_above_take_off() -> None:
    receiver = Receiver()
    assert receiver.hears(LOCATION, DRONE)
    (drone,) = receiver.nearest
    assert drone.label == "drone 070707"
    assert drone.position_m == pytest.approx((0.0, -100.1), abs=0.2)
    assert drone.velocity_m_s == pytest.approx((0.0, -5.0), abs=1e-9)
    assert drone.altitude_m == 40.0
    assert not receiver.hears(BASIC_ID, NAMED)
    assert receiver.hears(LOCATION, DRONE | {"height": -1000.0, "direction": 36100})
    (drone,) = receiver.nearest
    assert (drone.label, drone.velocity_m_s, drone.altitude_m) == ("1581F4", (0.0, 0.0), None)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("ADSB_VEHICLE", "{"),
        ("ADSB_VEHICLE", {}),
        ("ADSB_VEHICLE", PLANE | {"lat": None}),
        ("ADSB_VEHICLE", PLANE | {"lat": 2_000_000_000}),
        ("ADSB_VEHICLE", PLANE | {"flags": ALL_VALID & ~1}),
        ("ADSB_VEHICLE", PLANE | {"lat": 490000000}),
        ("ADSB_VEHICLE", PLANE | {"hor_velocity": "fast"}),
        (LOCATION, DRONE | {"latitude": 0, "longitude": 0}),
        (LOCATION, DRONE | {"id_or_mac": "x"}),
        (LOCATION, DRONE | {"height": None}),
    ],
)
def test_what_is_malformed_or_far_away_is_left_out(name: str, fields: Any) -> None:
    receiver = Receiver()
    assert not receiver.hears(name, fields)
    assert receiver.nearest == ()
    assert not receiver.hears("ADSB_VEHICLE", PLANE, system_id=SYSTEM + 1)


def test_the_number_is_bounded_the_nearest_count_and_old_ones_are_forgotten() -> None:
    receiver = Receiver()
    for number in range(2 * KNOWN_MAX):
        receiver.plane(ICAO_address=number, lat=473977420 + 1000 * (number + 1), callsign="", tslc=0)
    labels = {each.label for each in receiver.nearest}
    assert labels == {f"{number:06X}" for number in range(TRAFFIC_MAX)}
    receiver.now_s += AGED_S + 0.1
    assert receiver.nearest == ()
    assert receiver.plane(), "there is room again"
