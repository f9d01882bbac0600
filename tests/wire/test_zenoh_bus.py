"""The peer bus: names without a network, then real Zenoh sessions on loopback."""

import asyncio
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from statistics import median

import pytest

from agents.drops import NO_DROPS, Drops
from agents.ports import PeerBus, VehicleRefusedError
from agents.shell.mailbox import PAYLOAD_LIMIT_BYTES
from agents.shell.zenoh_bus import ZenohBus
from agents.team.participant import vehicle
from tests.support.paths import ROOT
from tests.support.wire import free_ports

PEER_PROCESS = """
import asyncio, sys
from agents.shell.zenoh_bus import ZenohBus
from agents.team.participant import vehicle

async def main():
    bus = ZenohBus(vehicle(9), "wire", (1, 9), sys.argv[1], sys.argv[2:])
    print("opening", flush=True)
    await bus.open(lambda key, payload: bus.publish("answer", payload), lambda peer_id, present: None)
    await asyncio.Event().wait()

asyncio.run(main())
"""


MEMBERS = (1, 2, 3, 9)


class Heard:
    """What one peer heard, in order."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []
        self.keys: list[str] = []
        self.presence: list[tuple[int, bool]] = []

    def on_message(self, key: str, payload: bytes) -> None:
        self.keys.append(key)
        self.messages.append(payload)

    def on_presence(self, peer_id: int, present: bool) -> None:
        self.presence.append((peer_id, present))


async def until(condition: Callable[[], bool], timeout_s: float) -> float:
    """Return the seconds until the condition held."""
    start_s = time.monotonic()
    while not condition():
        assert time.monotonic() - start_s < timeout_s, "waited in vain"
        await asyncio.sleep(0.005)
    return time.monotonic() - start_s


async def acquainted(buses: dict[int, ZenohBus], heard: dict[int, Heard]) -> None:
    """Wait until everybody is heard by everybody: that a peer is there is known before what it listens to."""
    greetings = {own: f"{own}:hello".encode() for own in buses}

    def greeted() -> bool:
        for own, bus in buses.items():
            bus.publish("answer", greetings[own])
        return all(set(greetings.values()) - {greetings[own]} <= set(each.messages) for own, each in heard.items())

    await until(greeted, 2.0)
    await asyncio.sleep(0.2)  # until the last greetings have arrived
    for each in heard.values():
        each.messages.clear()


def free_endpoints(count: int) -> list[str]:
    return [f"tcp/127.0.0.1:{port}" for port in free_ports(count)]


@asynccontextmanager
async def opened(vehicle_id: int, listen: str, connect: list[str]) -> AsyncIterator[tuple[ZenohBus, Heard]]:
    bus, heard = ZenohBus(vehicle(vehicle_id), "wire", MEMBERS, listen, connect), Heard()
    await bus.open(heard.on_message, heard.on_presence)
    try:
        yield bus, heard
    finally:
        await bus.close()


def peer_process(listen: str, connect: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", PEER_PROCESS, listen, connect], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "opening\n"
    return process


def test_names_that_are_patterns_are_refused(subtests: pytest.Subtests) -> None:
    for name in ["", "a/", "*", "a b", "$", "a#"]:
        with subtests.test(name=name):
            with pytest.raises(ValueError, match="team"):
                ZenohBus(vehicle(1), name, MEMBERS)
            with pytest.raises(ValueError, match="topic"):
                ZenohBus(vehicle(1), "team", MEMBERS).publish(name, b"")


async def test_an_unopened_bus_drops_and_closes() -> None:
    bus: PeerBus = ZenohBus(vehicle(1), "team", MEMBERS)
    bus.publish("answer", b"not received")
    await bus.close()


@pytest.mark.wire
async def test_three_peers_hear_each_other_and_not_themselves() -> None:
    ends = free_endpoints(3)
    async with (
        opened(1, ends[0], ends[1:]) as (first, heard_first),
        opened(2, ends[1], [ends[0], ends[2]]) as (second, heard_second),
    ):
        # The third starts when the other two have long given up on their first attempt.
        await asyncio.sleep(0.7)
        started_s = time.monotonic()
        async with opened(3, ends[2], ends[:2]) as (third, heard_third):
            buses = {1: first, 2: second, 3: third}
            heard = {1: heard_first, 2: heard_second, 3: heard_third}
            await until(lambda: all(len(each.presence) == 2 for each in heard.values()), 2.0)
            assert time.monotonic() - started_s < 1.5
            await acquainted(buses, heard)
            for number in range(20):
                for own, bus in buses.items():
                    bus.publish("answer", f"{own}:{number}".encode())
                await asyncio.sleep(0.01)  # the bus may drop what comes faster than it can carry on a busy machine
            await until(lambda: all(len(each.messages) >= 40 for each in heard.values()), 2.0)
            for own, each in heard.items():
                assert sorted(each.presence) == [(peer, True) for peer in buses if peer != own]
                for peer in buses:
                    mine = [text for text in each.messages if text.startswith(b"%d:" % peer)]
                    expected = [] if peer == own else [b"%d:%d" % (peer, number) for number in range(20)]
                    assert mine == expected
        lost_s = await until(lambda: (3, False) in heard_first.presence and (3, False) in heard_second.presence, 1.0)
        assert lost_s < 0.3
        first.publish("answer", b"after")
        await until(lambda: b"after" in heard_second.messages, 1.0)


@pytest.mark.wire
async def test_a_peer_started_late_is_found_and_a_killed_one_missed() -> None:
    ends = free_endpoints(2)
    async with opened(1, ends[0], [ends[1]]) as (bus, heard):
        # The late starter knows nobody: it is the waiting peer's retries that find it, also after many in vain.
        await asyncio.sleep(0.7)
        with peer_process(ends[1], "tcp/127.0.0.1:1") as process:
            found_s = await until(lambda: heard.presence == [(9, True)], 2.0)
            round_trip_s = await measure_round_trip(bus, heard)
            process.kill()
            lost_s = await until(lambda: heard.presence[1:] == [(9, False)], 2.0)
    print(f"found after {found_s:.3f} s, lost {lost_s:.3f} s after SIGKILL, round trip {round_trip_s:.5f} s")
    assert found_s < 1.0
    assert lost_s < 0.5
    assert round_trip_s < 0.02


@pytest.mark.wire
async def test_a_frozen_peer_is_missed_after_its_lease_and_found_again() -> None:
    ends = free_endpoints(2)
    async with opened(1, ends[0], [ends[1]]) as (bus, heard):
        with peer_process(ends[1], ends[0]) as process:
            try:
                await until(lambda: heard.presence == [(9, True)], 2.0)
                process.send_signal(signal.SIGSTOP)
                lost_s = await until(lambda: heard.presence[1:] == [(9, False)], 3.0)
                process.send_signal(signal.SIGCONT)
                await until(lambda: heard.presence[2:] == [(9, True)], 3.0)
                assert await measure_round_trip(bus, heard) < 0.02
            finally:
                process.kill()
    print(f"lost {lost_s:.3f} s after SIGSTOP")
    assert 0.5 < lost_s < 2.0


async def measure_round_trip(bus: ZenohBus, heard: Heard) -> float:
    """Return the median round trip of 50 messages to the other process and back [s]."""
    times_s = []
    for number in range(50):
        payload = b"ping %d" % number
        start_s = time.perf_counter()
        bus.publish("answer", payload)
        while payload not in heard.messages:
            assert time.perf_counter() - start_s < 1.0
            await asyncio.sleep(0)
        times_s.append(time.perf_counter() - start_s)
    return median(times_s)


@pytest.mark.wire
async def test_a_payload_too_long_is_counted_and_dropped() -> None:
    ends = free_endpoints(2)
    async with opened(1, ends[0], []) as (first, _), opened(2, ends[1], [ends[0]]) as (second, heard):
        await until(lambda: heard.presence == [(1, True)], 2.0)
        first.publish("answer", bytes(PAYLOAD_LIMIT_BYTES + 1))
        first.publish("answer", bytes(PAYLOAD_LIMIT_BYTES))
        await until(lambda: len(heard.messages) == 1, 1.0)
        assert len(heard.messages[0]) == PAYLOAD_LIMIT_BYTES
        assert (second.drops, first.drops) == (Drops(too_long=1), NO_DROPS)


@pytest.mark.wire
async def test_a_raising_callback_does_not_stop_the_bus() -> None:
    ends = free_endpoints(2)
    failures: list[object] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: failures.append(context["exception"]))
    second, present, received = ZenohBus(vehicle(2), "wire", MEMBERS, ends[1], [ends[0]]), [], []

    def on_message(_key: str, payload: bytes) -> None:
        received.append(payload)
        raise RuntimeError("a bug in the core")

    async with opened(1, ends[0], []) as (first, _):
        await second.open(on_message, lambda peer_id, alive: present.append((peer_id, alive)))
        await until(lambda: present == [(1, True)], 2.0)
        first.publish("answer", b"one")
        first.publish("answer", b"two")
        await until(lambda: len(failures) == 2, 1.0)
        assert received == [b"one", b"two"]
        await second.close()
        first.publish("answer", b"three")
        await asyncio.sleep(0.1)
        assert len(received) == 2


@pytest.mark.wire
async def test_a_taken_port_is_refused_with_a_next_step() -> None:
    ends = free_endpoints(1)
    async with opened(1, ends[0], []):
        late = ZenohBus(vehicle(2), "wire", MEMBERS, ends[0])
        with pytest.raises(VehicleRefusedError, match="is taken") as refusal:
            await late.open(lambda key, payload: None, lambda peer_id, present: None)
        assert ends[0] in refusal.value.reason
        assert "another port" in refusal.value.next_step
        await late.close()


@pytest.mark.wire
async def test_opening_never_blocks_the_loop_and_can_be_cancelled() -> None:
    ends = free_endpoints(2)
    bus = ZenohBus(vehicle(1), "wire", MEMBERS, ends[0], [ends[1]])
    longest_s, opening = (
        0.0,
        asyncio.create_task(bus.open(lambda key, payload: None, lambda peer_id, present: None)),
    )
    for _ in range(20):
        start_s = time.monotonic()
        await asyncio.sleep(0.005)
        longest_s = max(longest_s, time.monotonic() - start_s)
    assert longest_s < 0.25
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    # The cancelled session lets go of its port by itself.
    await asyncio.sleep(0.8)
    async with opened(2, ends[0], []):
        pass
