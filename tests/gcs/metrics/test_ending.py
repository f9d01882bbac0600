"""How a flight ended, from the endings of its vehicles: the gravest is the headline, the others are in the sentence."""

import json

import pytest

from agents.shell.outcome import Ending, Outcome
from gcs.flight.team import ending_of
from gcs.metrics.ending import HEADLINES, FlightEnding, How, VehicleEnding

DOWN = "landed and disarmed"


def flight(*endings: tuple[int, How, str]) -> FlightEnding:
    ending = FlightEnding.of([VehicleEnding(*each) for each in endings])
    assert ending is not None
    return ending


def test_the_gravest_ending_of_a_vehicle_is_that_of_the_flight() -> None:
    ended = flight((1, How.LANDED, DOWN), (2, How.KILLED, "its motors were cut"), (3, How.LANDED, DOWN))
    assert ended == FlightEnding(
        How.KILLED, "Vehicle 2: its motors were cut; vehicles 1 and 3: landed and disarmed.", (2,)
    )
    assert ended.headline == "Killed by the operator: vehicle 2"
    assert ended.is_early


GRAVER = (
    (How.KILLED, How.WATCHDOG), (How.WATCHDOG, How.PILOT), (How.PILOT, How.BATTERY), (How.BATTERY, How.FAILSAFE),
    (How.FAILSAFE, How.ABORTED), (How.ABORTED, How.OPERATOR), (How.OPERATOR, How.LANDED), (How.ERROR, How.REFUSED),
)  # fmt: skip


@pytest.mark.parametrize(("graver", "other"), GRAVER)
def test_which_is_the_graver(graver: How, other: How) -> None:
    assert flight((1, other, "x"), (2, graver, "y")).how is graver


def test_a_team_that_landed_ended_as_it_should_and_without_vehicles_nothing_is_known() -> None:
    ended = flight((3, How.LANDED, DOWN), (1, How.LANDED, DOWN), (2, How.LANDED, DOWN))
    assert ended == FlightEnding(How.LANDED, "Vehicles 1, 2 and 3: landed and disarmed.", (1, 2, 3))
    assert ended.headline == "Landed and disarmed"
    assert {how for how in How if not flight((1, how, "x")).is_early} == {How.LANDED, How.SIMULATED}
    assert FlightEnding.of([]) is None


def test_every_ending_has_a_headline_and_every_outcome_an_ending() -> None:
    assert set(HEADLINES) == set(How)
    hows = {ending_of(1, Outcome(ending, "why")).how for ending in Ending}
    assert hows == set(How) - {How.IN_FLIGHT, How.UNKNOWN, How.SIMULATED}
    assert ending_of(1, Outcome(Ending.COMPLETED, flew=True)) == VehicleEnding(1, How.LANDED, DOWN)


def test_a_word_of_a_newer_version_is_unknown_and_words_are_json() -> None:
    assert How("swallowed") is How.UNKNOWN
    assert json.dumps(How.IN_FLIGHT) == '"in flight"'
