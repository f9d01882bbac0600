"""The thread that runs the relays, with sockets in their place."""

import socket
import threading
import time
from collections.abc import Container, Iterator
from math import inf

import pytest

from gcs.link.relay import relay_thread
from gcs.link.relay.relay_thread import RelayThread
from tests.support.wire import PATIENCE_S

LOOPBACK = "127.0.0.1"


class Echo:
    """Receives datagrams on a socket; a "bug" raises."""

    def __init__(self, port: int = 0) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((LOOPBACK, port))
        self.socket.setblocking(False)
        self.port = int(self.socket.getsockname()[1])
        self.received: list[bytes] = []
        self.arrived = threading.Event()
        self.due_at_s = inf
        self.turned = threading.Event()

    def watched(self) -> tuple[int, ...]:
        return (self.socket.fileno(),)

    def due_s(self) -> float:
        return self.due_at_s

    def turn(self, readable: Container[int]) -> None:
        if self.due_at_s <= time.monotonic():
            self.due_at_s = inf
            self.turned.set()
        if self.socket.fileno() in readable:
            try:
                self.received.append(self.socket.recv(100))
            except BlockingIOError:
                return
            self.arrived.set()
            if self.received[-1] == b"bug":
                raise ValueError("bug")

    def told(self, data: bytes) -> bool:
        """Send to it; return whether that arrives."""
        self.arrived.clear()
        self.tell(data)
        return self.arrived.wait(PATIENCE_S)

    def tell(self, data: bytes) -> None:
        """Send to it."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(data, (LOOPBACK, self.port))


@pytest.fixture
def thread(monkeypatch: pytest.MonkeyPatch) -> Iterator[RelayThread]:
    monkeypatch.setattr(relay_thread, "REMOVED_WITHIN_S", PATIENCE_S)
    thread = RelayThread("relays")
    yield thread
    thread.close()


def test_a_port_is_free_as_soon_as_its_relay_is_removed_and_closed(thread: RelayThread) -> None:
    others = [Echo() for _ in range(2)]
    for other in others:
        thread.add(other)
    port = 0
    for _ in range(5):
        each = Echo(port)
        port = each.port
        thread.add(each)
        assert each.told(b"here")
        thread.remove(each)
        each.socket.close()
    assert all(other.told(b"still here") for other in others)
    for other in others:
        thread.remove(other)
        other.socket.close()


def test_the_last_relay_is_removed_at_once_between_two_turns(
    thread: RelayThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    each, between, take_next = Echo(), threading.Event(), thread._next

    def next_one() -> object:
        between.set()
        while each in thread._relays:
            time.sleep(0.001)
        return take_next()

    monkeypatch.setattr(thread, "_next", next_one)
    thread.add(each)
    assert between.wait(PATIENCE_S)
    began_s = time.monotonic()
    thread.remove(each)
    assert time.monotonic() - began_s < PATIENCE_S / 2.0
    each.socket.close()


def test_a_turn_comes_when_it_is_due_although_nothing_arrives(
    thread: RelayThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(relay_thread, "WAKE_PERIOD_S", 3.0 * PATIENCE_S)  # no other turn comes by itself
    each = Echo()
    thread.add(each)
    for _ in range(2):
        each.turned.clear()
        each.due_at_s = time.monotonic() + 0.02
        thread.wake()
        assert each.turned.wait(PATIENCE_S)
    thread.remove(each)
    each.socket.close()


def test_a_bug_in_one_relay_leaves_the_others_running(thread: RelayThread, capsys: pytest.CaptureFixture[str]) -> None:
    broken, sound = Echo(), Echo()
    for each in (broken, sound):
        thread.add(each)
    assert broken.told(b"bug")
    broken.tell(b"two")
    assert sound.told(b"one")
    assert broken.received == [b"bug"]
    assert "ValueError: bug" in capsys.readouterr().err
    for each in (broken, sound):
        thread.remove(each)
        each.socket.close()
