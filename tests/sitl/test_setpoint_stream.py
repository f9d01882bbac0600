"""A stream of setpoints: the time waits for the next one, until the stream has ended."""

import time

import pytest

from sitl.server import setpoint_stream
from sitl.server.setpoint_stream import SetpointStream
from tests.support.wire import until_now


def test_the_time_waits_for_a_setpoint_that_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setpoint_stream, "LOST_AFTER_S", 1e9)
    age_s = 0.4
    stream = SetpointStream(lambda: age_s)
    assert stream.arrived()
    age_s = 0.6
    assert not stream.arrived()
    stream.forget()
    assert not stream.arrived()
    age_s = 0.0
    assert stream.arrived()


def test_a_stream_that_has_ended_is_not_waited_for_until_it_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setpoint_stream, "LOST_AFTER_S", 0.2)
    age_s = 0.6
    stream = SetpointStream(lambda: age_s)
    began_s = time.monotonic()
    until_now(stream.arrived, "its end")
    assert time.monotonic() - began_s > 0.1
    age_s = 5.0
    assert stream.arrived()
    age_s = 0.0
    assert stream.arrived()
    age_s = 0.6
    assert not stream.arrived()
