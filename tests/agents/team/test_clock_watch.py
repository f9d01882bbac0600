"""Clocks that are set while their vehicles fly: who is off, since when, and by how much."""

import pytest

from agents.team.clock_watch import ClockWatch


def watched(age_s: float = 0.05, until_s: int = 10) -> ClockWatch:
    watch = ClockWatch()
    for tick in range(until_s * 10):
        watch.receive(1, age_s + 0.02 * (tick % 3), tick / 10.0)
    return watch


@pytest.mark.parametrize(("by_s", "off"), [(0.6, True), (-0.6, True), (0.4, False), (-0.4, False), (-40.0, True)])
def test_a_step_beyond_the_limit_either_way(by_s: float, off: bool) -> None:
    watch = watched()
    for tick in range(3):
        watch.receive(1, 0.07 - by_s, 10.0 + tick / 10.0)
    stepped = watch.stepped(10.3, 1.0)
    assert (1 in stepped) is off
    if off:
        assert stepped[1].since_s == 10.0
        assert stepped[1].by_s == pytest.approx(by_s, abs=0.03)


def test_a_single_late_message_is_ignored_after_the_next() -> None:
    watch = watched()
    watch.receive(1, 0.9, 10.0)
    watch.receive(1, 0.05, 10.1)
    assert watch.stepped(10.1, 1.0) == {}


def test_a_network_that_slows_down_is_no_clock() -> None:
    watch = watched()
    for tick in range(300):
        watch.receive(1, 0.05 + 0.9 * tick / 300.0, 10.0 + tick / 10.0)
        assert watch.stepped(10.0 + tick / 10.0, 1.0) == {}


def test_the_clocks_of_two_peers_are_distinguished_and_a_corrected_one_is_cleared() -> None:
    watch = watched()
    for tick in range(10):
        watch.receive(1, 3.0, 10.0 + tick / 10.0)
        watch.receive(2, -3.0, 10.0 + tick / 10.0)
    assert list(watch.stepped(11.0, 1.0)) == [1], "2 was never otherwise"
    watch.receive(1, 0.05, 11.0)
    assert watch.stepped(11.0, 1.0) == {}


@pytest.mark.parametrize(("time_scale", "after_s"), [(1.0, 1.05), (5.0, 5.05)])
def test_a_peer_without_messages_is_silent_and_its_clock_not_stepped(time_scale: float, after_s: float) -> None:
    watch = watched()
    watch.receive(1, 3.0, 10.0)
    assert list(watch.stepped(10.0 + after_s - 0.1, time_scale)) == [1]
    assert watch.stepped(10.0 + after_s, time_scale) == {}


def test_a_slow_drift_adds_up_and_is_found_past_the_limit() -> None:
    watch = ClockWatch()
    for tenth in range(1, 2000):  # 4 ms a second: no step, and 0.5 s after 125 s
        watch.receive(7, 0.05 - 0.0004 * tenth, tenth * 0.1)
        drifted_s = watch.drifted(tenth * 0.1)
        if tenth == 1200:
            assert not drifted_s
    assert not watch.off
    assert drifted_s[7] == pytest.approx(0.004 * 199.9, abs=0.03)


def test_a_network_that_varies_is_no_drift() -> None:
    watch = ClockWatch()
    for tenth in range(2000):
        watch.receive(7, 0.3 if tenth % 3 else 0.0, tenth * 0.1)
        assert not watch.drifted(tenth * 0.1)
