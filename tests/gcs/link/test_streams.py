"""Messages that arrive at other rates than requested."""

from collections import Counter

import pytest

from gcs.link.streams import ATTEMPTS_MISSING, Streams

MESSAGE = 30


class Vehicle:
    """Sends messages at a rate on a clock of the test."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.received: Counter[int] = Counter({MESSAGE: 1000})
        self.streams = Streams(lambda: self.received, lambda: self.now_s)

    def fly(self, duration_s: float, rate_hz: float) -> list[dict[int, float]]:
        """Return what is wrong at each second."""
        looks = []
        for _ in range(round(duration_s)):
            self.now_s += 1.0
            self.received[MESSAGE] += round(rate_hz * self.now_s) - round(rate_hz * (self.now_s - 1.0))
            looks.append(self.streams.wrong())
        return looks


@pytest.mark.parametrize("rate_hz", [0.25, 50.0])
@pytest.mark.parametrize("share", [0.5, 1.5])
def test_messages_about_as_often_as_requested_are_right(rate_hz: float, share: float) -> None:
    vehicle = Vehicle()
    vehicle.streams.expect(MESSAGE, rate_hz)
    assert not any(vehicle.fly(200.0, share * rate_hz))


@pytest.mark.parametrize(("rate_hz", "default_hz"), [(0.5, 10.0), (1.0, 8.0)])
def test_a_default_rate_is_noticed_within_a_second_until_it_is_corrected(rate_hz: float, default_hz: float) -> None:
    vehicle = Vehicle()
    vehicle.streams.expect(MESSAGE, rate_hz)
    assert vehicle.fly(3.0, default_hz)[0] == {MESSAGE: rate_hz}
    vehicle.streams.expect(MESSAGE, rate_hz)
    assert not any(vehicle.fly(60.0, rate_hz))


def test_what_waited_on_the_link_and_arrives_at_once_is_right() -> None:
    vehicle = Vehicle()
    vehicle.streams.expect(MESSAGE, 1.0)
    vehicle.received[MESSAGE] += 4
    assert not any(vehicle.fly(60.0, 1.0))


def test_a_message_that_does_not_arrive_is_requested_again_a_few_times() -> None:
    vehicle = Vehicle()
    vehicle.streams.expect(MESSAGE, 0.5)
    looks = vehicle.fly(100.0, 0.0)
    assert [at for at, wrong in enumerate(looks, start=1) if wrong] == [10 * n for n in range(1, ATTEMPTS_MISSING + 1)]


def test_nothing_is_expected_of_a_refused_message() -> None:
    vehicle = Vehicle()
    vehicle.streams.expect(MESSAGE, 0.5)
    vehicle.streams.forget(MESSAGE)
    assert not any(vehicle.fly(100.0, 50.0))
