"""Links over emulated radios in simulated time: whether silences end offboard, and what is told of the links."""

import pytest

from sitl.radio import RadioSpec
from tests.support.simulated_link import SimulatedLink


def lossy(seed: int, **changes: float) -> RadioSpec:
    """Return a line of 38 400 baud with 100 ms, 30 ms of jitter, and 5 % lost in bursts of 3."""
    line = {"baud": 38400, "latency_ms": 100.0, "jitter_ms": 30.0, "loss": 0.05, "burst": 3.0, "seed": seed}
    return RadioSpec.model_validate({**line, **changes})


def test_a_lossy_line_flies_for_five_minutes_without_a_silent_second_and_with_few_warnings() -> None:
    for seed in (0, 1):
        link = SimulatedLink(lossy(seed), 1)
        silences = link.fly(300.0)
        assert (silences.offboard_s, silences.motion_s) == ([], [])
        assert len(link.faults) <= 3


@pytest.mark.parametrize(
    ("loss", "burst", "refused"),
    [(0.05, 3.0, {0}), (0.031, 3.8, {0, 1}), (0.1, 4.5, {7, 8}), (0.1, 8.0, {8})],
)
def test_few_lines_are_refused_that_are_fit_and_few_pass_that_are_not(
    loss: float, burst: float, refused: set[int]
) -> None:
    # The first three cause 0.01, 0.1 and 2 silences an hour; 0.3 are permitted.
    refusals = [SimulatedLink(lossy(seed, loss=loss, burst=burst), 1).check() for seed in range(8)]
    found = [each for each in refusals if each]
    assert len(found) in refused, found
    assert all("in a row" in each for each in found)


def test_a_line_that_loses_nothing_is_not_raised_and_one_that_is_too_slow_is_refused() -> None:
    link = SimulatedLink(lossy(1, loss=0.0), 1)
    assert link.check() == ""
    before = link.pace.rates
    assert not link.fly(60.0).offboard_s
    assert (link.pace.rates, link.faults) == (before, [])
    assert SimulatedLink(lossy(1, baud=4800, loss=0.0), 1).check()


@pytest.mark.parametrize("shared", [False, True])
def test_a_radio_that_is_slower_than_stated_is_found_by_what_waits(shared: bool) -> None:
    link = SimulatedLink(lossy(1, baud=57600, loss=0.0, shared=shared), 1)
    link.pace.capacity_bytes_s = None  # it is not known
    link.pace.adapt(link.pace.losses)
    slow = SimulatedLink(lossy(1, baud=9600, loss=0.0, shared=shared), 1)
    slow.pace.capacity_bytes_s = None
    slow.pace.adapt(slow.pace.losses)
    for each in (link, slow):
        each.fly(60.0)
    assert link.pace.rates.setpoint_hz == 20.0
    assert slow.pace.load.bytes_s < link.pace.load.bytes_s
