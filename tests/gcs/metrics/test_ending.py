"""How a flight ended, from the endings of its vehicles: the gravest is the headline, the others are in the sentence."""

import json
from itertools import pairwise
from math import cos, degrees, radians, sin, sqrt

import pytest

from agents.flight_end import FlightEnd, LastPosition
from agents.shell.outcome import Outcome
from estimation.frames import Geodetic, MissionFrame
from gcs.flight.team import ending_of
from gcs.metrics.ending import UNACCOUNTED, TeamEnding, Unaccounted, VehicleEnding

DOWN = "landed and disarmed"


def flight(*endings: tuple[int, FlightEnd, str]) -> TeamEnding:
    ending = TeamEnding.of([VehicleEnding(*each) for each in endings])
    assert ending is not None
    return ending


def test_the_gravest_ending_of_a_vehicle_is_that_of_the_flight() -> None:
    ended = flight(
        (1, FlightEnd.LANDED, DOWN), (2, FlightEnd.KILLED, "its motors were cut"), (3, FlightEnd.LANDED, DOWN)
    )
    assert ended == TeamEnding(
        FlightEnd.KILLED, "Vehicle 2: its motors were cut; vehicles 1 and 3: landed and disarmed.", (2,)
    )
    assert ended.headline == "Killed by the operator: vehicle 2"
    assert ended.is_early


F = FlightEnd
ORDER = (F.LOST, F.KILLED, F.WATCHDOG, F.PILOT, F.BATTERY, F.FAILSAFE, F.ABORTED, F.OPERATOR, F.LANDED)


@pytest.mark.parametrize(("graver", "other"), [*pairwise(ORDER), (F.ERROR, F.REFUSED)])
def test_which_is_the_graver(graver: FlightEnd, other: FlightEnd) -> None:
    assert flight((1, other, "x"), (2, graver, "y")).how is graver


def test_a_team_that_landed_ended_as_it_should_and_without_vehicles_nothing_is_known() -> None:
    ended = flight((3, FlightEnd.LANDED, DOWN), (1, FlightEnd.LANDED, DOWN), (2, FlightEnd.LANDED, DOWN))
    assert ended == TeamEnding(FlightEnd.LANDED, "Vehicles 1, 2 and 3: landed and disarmed.", (1, 2, 3))
    assert ended.headline == "Landed and disarmed"
    as_planned = {FlightEnd.LANDED, FlightEnd.SIMULATED, FlightEnd.FLIES_ON}
    assert {how for how in FlightEnd if not flight((1, how, "x")).is_early} == as_planned
    assert TeamEnding.of([]) is None


def test_a_team_that_landed_names_one_that_joined_and_still_flies() -> None:
    ended = flight((1, FlightEnd.LANDED, DOWN), (4, FlightEnd.FLIES_ON, "joined this flight and still flies"))
    assert (ended.how, ended.vehicles, ended.still_flying) == (FlightEnd.LANDED, (1,), (4,))
    assert ended.reason == "Vehicle 1: landed and disarmed; vehicle 4: joined this flight and still flies."


def test_a_vehicle_that_is_unaccounted_for_has_its_last_place_in_degrees_or_in_metres_of_a_local_frame() -> None:
    """By the radii of the ellipsoid at the origin: 100 m north and 50 m east of it, with x to the east."""
    latitude_deg, longitude_deg, equator_m, eccentricity2 = 47.4, 8.5, 6378137.0, 6.69437999014e-3
    flat = 1.0 - eccentricity2 * sin(radians(latitude_deg)) ** 2
    north_deg = degrees(100.0 / (equator_m * (1.0 - eccentricity2) / flat**1.5))
    east_deg = degrees(50.0 / (equator_m / sqrt(flat) * cos(radians(latitude_deg))))
    lost = Outcome(FlightEnd.LOST, "its link was lost", unaccounted=LastPosition((50.0, 100.0, 8.04), 35.4))
    there = ending_of(3, lost, MissionFrame(Geodetic(latitude_deg, longitude_deg, 0.0), radians(90.0))).unaccounted
    assert there is not None
    assert there.latitude_deg == pytest.approx(latitude_deg + north_deg, abs=1e-6)
    assert there.longitude_deg == pytest.approx(longitude_deg + east_deg, abs=1e-6)
    assert f"{latitude_deg + north_deg:.6f}, {longitude_deg + east_deg:.6f}" in there.line
    local = ending_of(3, lost, MissionFrame(None))
    assert local.unaccounted == Unaccounted(3, None, None, (50.0, 100.0, 8.04), 35.4)
    ended = TeamEnding.of([VehicleEnding(1, FlightEnd.LANDED, DOWN), local])
    assert ended is not None
    assert (ended.how, ended.unaccounted) == (FlightEnd.LOST, (local.unaccounted,))
    line = ended.unaccounted[0].line
    assert all(part in line for part in ("Vehicle 3", UNACCOUNTED, "x 50.0 m", "y 100.0 m", "8.0 m", "35 s")), line


def test_a_word_of_a_newer_version_is_unknown_and_words_are_json() -> None:
    assert FlightEnd("swallowed") is FlightEnd.UNKNOWN
    assert json.dumps(FlightEnd.IN_FLIGHT) == '"in flight"'
