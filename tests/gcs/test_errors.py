"""Errors of the input reach another process as they were raised."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from gcs.errors import InputError
from gcs.mission.file import MissionError, parse_mission
from tests.support.mission_text import CASE2


def raised_by(text: str) -> MissionError:
    with pytest.raises(MissionError) as raised:
        parse_mission(text, None)
    return raised.value


def test_an_error_of_a_worker_process_has_the_faults_of_one_raised_here() -> None:
    text = CASE2.replace("radius_m = 10.0", "radius_m = -1.0", 1).replace("spacing_m", "spacin_m", 1)
    here = raised_by(text)
    assert len(here.faults) > 1
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        error = pool.submit(parse_mission, text, None).exception()
    assert isinstance(error, MissionError)
    assert (error.faults, error.placed, str(error)) == (here.faults, here.placed, str(here))


def test_a_fault_without_a_place_and_of_several_lines_is_the_same_in_another_process() -> None:
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        error = pool.submit(refused).exception()
    assert isinstance(error, InputError)
    assert error.faults == ("two lines", "and one")
    assert str(error) == "two lines\nand one"


def refused() -> None:
    raise InputError(["two\nlines", "and one"])
