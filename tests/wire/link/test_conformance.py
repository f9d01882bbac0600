"""Stub and PX4 fly the same list of exercises: see `tests.experiments.conformance`."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
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
    table,
)
from tests.support.conformance_client import Client
from tests.support.px4 import VARIABLE, Px4Missing, Px4Simulator, px4_build
from tests.support.wire import free_port, repeated_now

NAMES = [exercise.name for exercise in EXERCISES]


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


def test_the_table_marks_what_fails_and_what_differs() -> None:
    stub = {"stream lost hold": observed(failsafe_s=1.5, mode="LAND", resumes_unasked_s=0.1)}
    px4 = {"stream lost hold": observed(failsafe_s=0.8, mode="HOLD", resumes_unasked_s=0.2)}
    lines = [line for line in table(stub, px4) if line.startswith("stream lost hold")]
    marks = ["DIFFERS: unexplained", "FAILS (stub) DIFFERS: unexplained", "0.2"]
    assert [line.rstrip().endswith(mark) for line, mark in zip(lines, marks, strict=True)] == [True] * 3
    assert [line.split()[3] for line in table(stub, {}) if "FAILS" in line] == ["mode"]


def test_every_exercise_says_what_it_does() -> None:
    assert len({*NAMES}) == len(NAMES)
    assert all(exercise.run.__doc__ and exercise.expected for exercise in EXERCISES)


def test_a_px4_that_is_not_there_says_what_to_set(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    with pytest.raises(Px4Missing, match=r"CORDON_PX4 is not set: .*bin/px4"):
        px4_build()
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    (tmp_path / "etc").mkdir()
    with pytest.raises(Px4Missing, match="holds no bin/px4: it is no"):
        px4_build()
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "px4").touch()
    assert px4_build() == tmp_path


@pytest.mark.parametrize("name", get_args(AutopilotName))
def test_the_stubs_know_every_parameter_that_preflight_reads(name: AutopilotName) -> None:
    known = autopilot_named(name).TABLE.defaults.keys()
    assert [names for names in autopilot_of(name).parameters_wanted if not {*names} & known] == []
