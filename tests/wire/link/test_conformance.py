"""Stub and PX4 fly the same list of exercises: see `tests.experiments.conformance`."""

from collections.abc import Iterator
from functools import partial
from typing import get_args

import pytest

from estimation.profile.autopilots import AutopilotName
from gcs.autopilots.registry import autopilot_of
from sitl.autopilot.autopilot import autopilot_named
from tests.experiments.conformance import (
    EXERCISES,
    PLACE,
    PX4_SPEED,
    SYSTEM_ID,
    Exercise,
    Is,
    Observation,
    StubSimulator,
    Value,
    Within,
    client_of,
    observed,
)
from tests.support.conformance_client import Client
from tests.support.px4 import Px4Missing, Px4Simulator
from tests.support.wire import free_port, repeated_now


@pytest.fixture(scope="module")
def stub() -> Iterator[Client]:
    with client_of(StubSimulator(free_port())) as client:
        yield client


@pytest.fixture(scope="module")
def px4() -> Iterator[Client]:
    try:
        simulator = Px4Simulator(SYSTEM_ID - 1, speed=PX4_SPEED, place=PLACE)
    except Px4Missing as missing:
        pytest.skip(str(missing))
    with client_of(simulator) as client:
        yield client


@pytest.mark.long
@pytest.mark.wire
def test_the_stub_conforms(subtests: pytest.Subtests, stub: Client) -> None:
    for exercise in EXERCISES:
        with subtests.test(exercise=exercise):
            repeated_now(partial(conforms, exercise, stub))


def conforms(exercise: Exercise, stub: Client) -> None:
    assert exercise.faults(exercise.run(stub)) == []


@pytest.mark.px4
def test_px4_conforms(subtests: pytest.Subtests, px4: Client) -> None:
    for exercise in EXERCISES:
        with subtests.test(exercise=exercise):
            assert exercise.faults(exercise.run(px4)) == []


# The list itself


def test_an_expectation_judges(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[Is | Within, Value, bool], ...] = (
        (Is("HOLD"), "HOLD", True),
        (Is("HOLD"), "LAND", False),
        (Is(True), False, False),
        (Within(1.0, 2.0), 1.0, True),
        (Within(1.0, 2.0), 2.01, False),
        (Within(1.0, 2.0), float("nan"), False),
        (Within(1.0, 2.0), "silence", False),
    )
    for expected, value, holds in rows:
        with subtests.test(expected=expected, value=value, holds=holds):
            assert expected.holds(value) is holds


def look(client: Client) -> Observation:
    return observed(mode="LAND", after_s=3.0, extra=True)


def test_faults_name_what_is_wrong_missing_and_too_much() -> None:
    exercise = Exercise(look, {"mode": Is("HOLD"), "after_s": Within(0.0, 4.0), "height_m": Within(3.0, 5.0)})
    assert exercise.faults(observed(mode="LAND", after_s=3.0, extra=True)) == [
        "mode is LAND, expected HOLD",
        "height_m was not observed",
        "extra is not expected",
    ]
    assert exercise.faults(observed(mode="HOLD", after_s=3.0, height_m=4.0)) == []


@pytest.mark.parametrize("name", get_args(AutopilotName))
def test_the_stubs_know_every_parameter_that_preflight_reads(name: AutopilotName) -> None:
    known = autopilot_named(name).TABLE.defaults.keys()
    assert [names for names in autopilot_of(name).parameters_wanted if not {*names} & known] == []
