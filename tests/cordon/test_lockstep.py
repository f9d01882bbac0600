"""A user's program on the clock of stubs: what it waits for, what waits for it, and bad input."""

import threading
import time
from collections.abc import Iterator
from math import inf, nan

import pytest

import cordon
from sitl.server.shared_clock import new_clock
from tests.support.wire import PATIENCE_S

PORT = 40_123


@pytest.fixture
def client() -> Iterator[cordon.LockstepClient]:
    with new_clock(inf, [PORT, PORT + 1]), cordon.LockstepClient(PORT) as client:
        yield client


def test_a_time_passes_exactly_and_at_once(client: cordon.LockstepClient) -> None:
    began_s, began_wall_s = client.now_s, time.monotonic()
    for _ in range(1000):
        client.sleep(0.1)
    assert client.now_s - began_s == pytest.approx(100.0, abs=1e-6)
    assert time.monotonic() - began_wall_s < PATIENCE_S


def test_others_wait_while_it_holds_the_time(client: cordon.LockstepClient) -> None:
    times_s: list[float] = []

    def observe() -> None:
        with cordon.LockstepClient(PORT + 1) as other:
            while len(times_s) < 20:
                other.sleep(0.01)
                times_s.append(other.now_s)

    observer = threading.Thread(target=observe)
    with client.held_after(1.0):
        held_s = client.now_s
        observer.start()
        time.sleep(0.3)
        assert times_s == []
        assert client.now_s == held_s
    observer.join(PATIENCE_S)
    assert times_s == pytest.approx([held_s + 0.01 * (n + 1) for n in range(20)], abs=1e-6)


def test_a_speed_is_the_highest_until_the_client_leaves(client: cordon.LockstepClient) -> None:
    with cordon.LockstepClient(PORT, speed=2.0):
        began_wall_s = time.monotonic()
        client.sleep(1.0)
        assert time.monotonic() - began_wall_s > 0.45
    began_wall_s = time.monotonic()
    client.sleep(600.0)
    assert time.monotonic() - began_wall_s < PATIENCE_S


def test_a_condition_is_waited_for_and_named_if_it_never_holds(client: cordon.LockstepClient) -> None:
    began_s = client.now_s
    client.until(lambda: client.now_s >= began_s + 1.0, "a second has passed")
    began_s = client.now_s
    with pytest.raises(TimeoutError, match=r"not within 5 s: it flies"):
        client.until(lambda: False, "it flies", 5.0)
    assert client.now_s - began_s == pytest.approx(5.0, abs=0.03)


@pytest.mark.parametrize("ports", [(), (PORT,), (PORT, 1)])
def test_without_such_stubs_the_ports_are_named(ports: tuple[int, ...]) -> None:
    with pytest.raises(cordon.InputError, match=rf"ports = {', '.join(map(str, ports)) or 'none'}: .*--lockstep"):
        cordon.LockstepClient(*ports)


def test_bad_input_names_the_value(client: cordon.LockstepClient) -> None:
    for duration_s in (nan, inf, -0.1):
        with pytest.raises(cordon.InputError, match=f"duration_s = {duration_s}"):
            client.sleep(duration_s)
    for speed in (0.0, -1.0, nan):
        with pytest.raises(cordon.InputError, match=f"speed = {speed}"):
            cordon.LockstepClient(PORT, speed=speed)
    for system_id in (0, -1, 256):
        with pytest.raises(cordon.InputError, match=f"system_id = {system_id}"):
            client.sends_setpoint(system_id, 0.0, 0.0, 0.0)
    client.sleep(0.1)
