"""The messages that were requested of a vehicle, and those that arrive at other rates than requested."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

EXPECTED = 5.0
"""How many messages have to be expected before none of them shows a lost request: losses come in bursts."""
TOO_MANY, TOO_MANY_SHARE = 4.0, 2.0
"""More than this share of the expected messages, and this many besides, arrive at a default rate: after a delay some
arrive at once.
"""
ATTEMPTS_MISSING = 3
"""How often a message that does not arrive is requested again: a vehicle may have nothing to send."""


@dataclass(slots=True)
class _Stream:
    rate_hz: float
    since_s: float
    count: int
    attempts: int


class Streams:
    """Compares the rates of one vehicle's messages with those requested of it.

    COMMAND_ACK names no message. Where answers are late, MAVSDK repeats a request, and takes the second answer for
    that to its next request, which may have been lost: the message would keep its default rate for the whole flight,
    and on a slow radio the others would wait.

    `received` returns how many messages of each number have arrived. `now_s` is a clock as fast as the vehicle's.
    """

    def __init__(self, received: Callable[[], Mapping[int, int]], now_s: Callable[[], float]) -> None:
        self._received = received
        self._now_s = now_s
        self._streams: dict[int, _Stream] = {}

    def expect(self, message: int, rate_hz: float, *, attempts: int = ATTEMPTS_MISSING) -> None:
        """Expect a message at a rate [Hz] from now on; request it so often again if it does not arrive."""
        self._streams[message] = _Stream(rate_hz, self._now_s(), self._received().get(message, 0), attempts)

    def forget(self, message: int) -> None:
        """Expect nothing of a message that the vehicle refuses to send."""
        self._streams.pop(message, None)

    def wrong(self) -> dict[int, float]:
        """Return the messages that have to be requested again, with their rates [Hz].

        A message is expected anew then, and once enough of them have been expected.
        """
        now_s, received = self._now_s(), self._received()
        wrong: dict[int, float] = {}
        for message, stream in self._streams.items():
            expected = (now_s - stream.since_s) * stream.rate_hz
            arrived = received.get(message, 0) - stream.count
            too_many = arrived > TOO_MANY_SHARE * expected + TOO_MANY
            missing = arrived == 0 and expected >= EXPECTED and stream.attempts > 0
            if too_many or missing:
                wrong[message] = stream.rate_hz
                stream.attempts -= missing
            if too_many or expected >= EXPECTED:
                stream.since_s, stream.count = now_s, received.get(message, 0)
        return wrong
