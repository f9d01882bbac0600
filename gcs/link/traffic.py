"""Aircraft that a vehicle's receivers hear and its autopilot passes on: ADS-B, and Remote ID (OpenDroneID)."""

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from math import cos, dist, radians, sin
from typing import Any

from agents.team.messages import TRAFFIC_MAX, Aircraft
from agents.team.text import printable
from estimation.frames import Geodetic, MissionFrame, Triple

ADSB_VEHICLE, ADSB_VEHICLE_HZ = 246, 5.0
LOCATION, BASIC_ID = "OPEN_DRONE_ID_LOCATION", "OPEN_DRONE_ID_BASIC_ID"
AGED_S = 10.0
RANGE_M = 10_000.0
"""Aircraft farther than this from the mission's origin are left out: at 80 m/s they are two minutes away."""
KNOWN_MAX, LABEL_MAX = 64, 20
_COORDINATES, _ALTITUDE, _HEADING, _VELOCITY, _CALLSIGN = 1, 2, 4, 8, 16
"""The flags of ADSB_VEHICLE for what of it is valid."""
_DIRECTION_UNKNOWN, _SPEED_UNKNOWN, _HEIGHT_UNKNOWN_M = 36100, 25500, -1000.0
_OVER_TAKE_OFF = 0

Fields = Mapping[str, Any]


class TrafficReceiver:
    """Collects the newest report of each aircraft, as those of one vehicle; `now_s` is the mission's clock.

    A drone's position and its serial number come in messages of their own, with the same address. Its height is that
    above its take-off, taken as that above the mission's origin: its altitudes are above the ellipsoid, or by a
    barometer without a reference pressure. A frame without a position on Earth has no traffic.
    """

    def __init__(self, system_id: int, frame: MissionFrame, now_s: Callable[[], float]) -> None:
        self._system_id, self._frame, self._now_s = system_id, frame, now_s
        self._known: dict[str, Aircraft] = {}
        self._labels: dict[str, str] = {}

    def take(self, message: Any) -> bool:
        """Take a message of MAVSDK's; return whether it is a valid report of an aircraft near enough."""
        with suppress(ValueError, KeyError, TypeError, OverflowError):  # malformed bytes are dropped here
            if message.system_id != self._system_id:
                return False
            fields = json.loads(message.fields_json)
            if message.message_name == BASIC_ID:
                self._name(fields)
                return False
            report = self._drone(fields) if message.message_name == LOCATION else self._plane(fields)
            return report is not None and self._add(*report)
        return False

    def nearest(self, place_m: Triple | None) -> tuple[Aircraft, ...]:
        """Return the newest reports of the nearest aircraft, at most `TRAFFIC_MAX`; forget the old ones."""
        now_s, (x, y, _) = self._now_s(), place_m or (0.0, 0.0, 0.0)
        self._known = {key: each for key, each in self._known.items() if abs(now_s - each.time_s) <= AGED_S}
        if not self._known:
            return ()
        near = sorted(self._known.values(), key=lambda each: dist(each.position_m, (x, y)))[:TRAFFIC_MAX]
        return tuple(sorted(near, key=lambda each: each.label))

    def _add(self, key: str, aircraft: Aircraft) -> bool:
        is_full = key not in self._known and len(self._known) >= KNOWN_MAX
        if is_full or dist(aircraft.position_m, (0.0, 0.0)) > RANGE_M:
            return False
        self._known[key] = aircraft
        return True

    def _plane(self, fields: Fields) -> tuple[str, Aircraft] | None:
        flags, key = int(fields["flags"]), f"{int(fields['ICAO_address']) & 0xFFFFFF:06X}"
        if not flags & _COORDINATES:
            return None
        place = _place(fields["lat"], fields["lon"])
        known = flags & _HEADING and flags & _VELOCITY
        heading, speed = (fields["heading"], fields["hor_velocity"]) if known else (0.0, 0.0)
        altitude_m = None
        if flags & _ALTITUDE and self._frame.origin is not None:
            altitude_m = fields["altitude"] * 1e-3 - self._frame.origin.altitude_m
        label = _text(fields["callsign"]) if flags & _CALLSIGN else ""
        return key, self._aircraft(label or key, place, altitude_m, heading, speed, float(fields["tslc"]))

    def _drone(self, fields: Fields) -> tuple[str, Aircraft] | None:
        if not (fields["latitude"] or fields["longitude"]):
            return None
        key, place = _address(fields), _place(fields["latitude"], fields["longitude"])
        direction, speed = fields["direction"], fields["speed_horizontal"]
        known = direction < _DIRECTION_UNKNOWN and speed < _SPEED_UNKNOWN
        height_m = float(fields["height"])
        altitude_m = height_m if height_m > _HEIGHT_UNKNOWN_M and fields["height_reference"] == _OVER_TAKE_OFF else None
        moves = (direction, speed) if known else (0.0, 0.0)
        return key, self._aircraft(self._labels.get(key) or f"drone {key[:6]}", place, altitude_m, *moves)

    def _name(self, fields: Fields) -> None:
        key, label = _address(fields), _text(fields["uas_id"])
        if label and (key in self._labels or len(self._labels) < KNOWN_MAX):
            self._labels[key] = label

    def _aircraft(
        self,
        label: str,
        place_deg: tuple[float, float],
        altitude_m: float | None,
        heading_cdeg: float,
        speed_cm_s: float,
        ago_s: float = 0.0,
    ) -> Aircraft:
        origin = self._frame.origin
        x, y, _ = self._frame.mission_from_geodetic(Geodetic(*place_deg, 0.0 if origin is None else origin.altitude_m))
        heading_rad, speed_m_s = radians(heading_cdeg / 100.0), speed_cm_s / 100.0
        velocity_ned = speed_m_s * cos(heading_rad), speed_m_s * sin(heading_rad), 0.0
        x_rate, y_rate, _ = self._frame.mission_from_ned(velocity_ned)
        return Aircraft(label, self._now_s() - ago_s, (x, y), (x_rate, y_rate), altitude_m)


def _place(latitude_e7: float, longitude_e7: float) -> tuple[float, float]:
    return latitude_e7 * 1e-7, longitude_e7 * 1e-7


def _address(fields: Fields) -> str:
    """Return the address that the reports of one drone share, all zeros where a receiver hears one alone."""
    return bytes(fields["id_or_mac"]).hex()


def _text(field: Any) -> str:
    """Return a text of a message: of its characters, or of their codes."""
    name = field if isinstance(field, str) else bytes(field).decode("ascii", "replace")
    return printable(name.partition("\0")[0]).strip()[:LABEL_MAX]
