"""How a flight ended, from the endings of its vehicles: the gravest is the headline, the others are in the sentence."""

import json
from itertools import pairwise

import pytest

from agents.flight_end import FlightEnd
from agents.shell.outcome import Outcome
from gcs.flight.team import ending_of
from gcs.metrics.ending import HEADLINES, TeamEnding, VehicleEnding

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
ORDER = (F.KILLED, F.WATCHDOG, F.PILOT, F.BATTERY, F.FAILSAFE, F.ABORTED, F.OPERATOR, F.LANDED)


@pytest.mark.parametrize(("graver", "other"), [*pairwise(ORDER), (F.ERROR, F.REFUSED)])
def test_which_is_the_graver(graver: FlightEnd, other: FlightEnd) -> None:
    assert flight((1, other, "x"), (2, graver, "y")).how is graver


def test_a_team_that_landed_ended_as_it_should_and_without_vehicles_nothing_is_known() -> None:
    ended = flight((3, FlightEnd.LANDED, DOWN), (1, FlightEnd.LANDED, DOWN), (2, FlightEnd.LANDED, DOWN))
    assert ended == TeamEnding(FlightEnd.LANDED, "Vehicles 1, 2 and 3: landed and disarmed.", (1, 2, 3))
    assert ended.headline == "Landed and disarmed"
    assert {how for how in FlightEnd if not flight((1, how, "x")).is_early} == {FlightEnd.LANDED, FlightEnd.SIMULATED}
    assert TeamEnding.of([]) is None


def test_every_ending_has_a_headline_and_an_outcome_a_reason() -> None:
    assert set(HEADLINES) == set(FlightEnd)
    assert ending_of(1, Outcome(FlightEnd.LANDED, flew=True)) == VehicleEnding(1, FlightEnd.LANDED, DOWN)


def test_a_word_of_a_newer_version_is_unknown_and_words_are_json() -> None:
    assert FlightEnd("swallowed") is FlightEnd.UNKNOWN
    assert json.dumps(FlightEnd.IN_FLIGHT) == '"in flight"'
