"""Helpers for tests of the replay in a report: flights that are hard to embed, and a report's embedded files."""

import gzip
import re
from base64 import b64decode

import msgspec
import numpy as np
from msgspec.structs import replace

from gcs.console.vehicle_view import VehicleView
from gcs.station.picture import FlightPicture, TeamPicture
from tests.support.page.station_pictures import ring_flight, ring_mission, ring_team


def nasty_flight(text: str) -> FlightPicture:
    """Return a recorded flight whose mission and events are named by a text."""
    flight = ring_flight()
    events = tuple(replace(event, text=text) for event in flight.events)
    return replace(flight, mission=replace(flight.mission, mission=text), events=events)


def noisy_flight(vehicles: int, pictures: int = 16_000) -> FlightPicture:
    """Return a recorded flight with this many pictures of vehicles, whose numbers hardly repeat."""
    random = np.random.default_rng(vehicles)
    mission = replace(ring_mission(vehicles), source="log")
    teams = (ring_team(mission, float(second)) for second in range(pictures // vehicles))
    return FlightPicture(mission, tuple(_noisy(team, random) for team in teams), ring_flight().events)


def _noisy(team: TeamPicture, random: np.random.Generator) -> TeamPicture:
    return replace(team, vehicles=tuple(_noisy_vehicle(each, random) for each in team.vehicles))


def _noisy_vehicle(vehicle: VehicleView, random: np.random.Generator) -> VehicleView:
    x, y, z, vx, vy, ahead_x, ahead_y = (round(float(each), 2) for each in random.uniform(-100.0, 100.0, 7))
    yaw, rate, lead = (round(float(each), 4) for each in random.uniform(-3.0, 3.0, 3))
    battery, endurance_s, radius_m, nearest_m, margin_m = (round(float(e), 2) for e in random.uniform(0.0, 99.0, 5))
    return replace(
        vehicle,
        position_m=(x, y, z),
        velocity_m_s=(vx, vy),
        setpoint_m=(ahead_x, ahead_y),
        yaw_rad=yaw,
        angular_rate_rad_s=rate,
        lead_rad=lead,
        autopilot=replace(vehicle.autopilot, battery=battery, endurance_s=endurance_s),
        radius_m=radius_m,
        nearest_m=nearest_m,
        fence_margin_m=margin_m,
    )


def held_files(html: str) -> dict[str, str]:
    """Return the texts of the files that a report holds for its replay, by name."""
    found = re.search(r'<script type="text/plain" id="replay-files">([^<]*)</script>', html)
    assert found
    files: dict[str, str] = msgspec.json.decode(
        gzip.decompress(b64decode(found[1], validate=True)), type=dict[str, str]
    )
    return files
