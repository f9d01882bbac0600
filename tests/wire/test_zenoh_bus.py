"""The peer bus: names without a network, then real Zenoh sessions on loopback."""

import asyncio
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import ExitStack, asynccontextmanager
from dataclasses import replace
from functools import partial

import pytest

from agents.drops import NO_DROPS, Drops
from agents.flight_end import FlightEnd
from agents.ports import PeerBus, VehicleRefusedError
from agents.shell.computer import allow_descriptors
from agents.shell.mailbox import PAYLOAD_LIMIT_BYTES
from agents.shell.outcome import Outcome
from agents.shell.reporter import Reporter
from agents.shell.zenoh_bus import ParticipantBus, Station, ZenohBus, single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team import codec
from agents.team.codec import decode, encode
from agents.team.messages import REPORT_TOPIC, BusMessage, CommandAnswer, StartProposal, VehicleReport
from agents.team.participant import Participant, vehicle
from gcs.link.ports import free_ports
from tests.support.fake_flight import FakeFlight
from tests.support.paths import ROOT
from tests.support.wire import PATIENCE_S, repeated, until

PEER_PROCESS = """
import asyncio, sys
from agents.shell.zenoh_bus import single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.codec import decode, encode
from agents.team.messages import CommandAnswer
from agents.team.participant import vehicle

async def main():
    bus = single_bus(vehicle(9), BusTeam("wire", (1, 2, 3, 9)), sys.argv[1], sys.argv[2:])

    def answer(message):
        bus.publish("answer", encode(CommandAnswer(9, 1.0, 1, message.did)))

    print("opening", flush=True)
    await bus.open(answer, lambda payload: None, lambda peer_id, present: None)
    await asyncio.Event().wait()

asyncio.run(main())
"""


TEAM = BusTeam("wire", (1, 2, 3, 9))


GREETING = "hello"


class Heard:
    """What one peer heard, in order: who greeted, the other texts of answers, sightings, and who came and went."""

    def __init__(self) -> None:
        self.greeted_by: set[int] = set()
        self.messages: list[str] = []
        self.sightings: list[bytes] = []
        self.presence: list[tuple[int, bool]] = []

    def on_message(self, message: BusMessage) -> None:
        assert isinstance(message, CommandAnswer)
        if message.did == GREETING:
            self.greeted_by.add(message.sender)
        else:
            self.messages.append(message.did)

    def on_sensor(self, topic: str, payload: bytes) -> None:
        assert topic == "perception"
        self.sightings.append(payload)

    def on_presence(self, peer_id: int, present: bool) -> None:
        self.presence.append((peer_id, present))


def answer(bus: ParticipantBus, text: str) -> None:
    """Send a message with a text."""
    bus.publish("answer", encode(CommandAnswer(int(bus.participant.name), 1.0, 1, text)))


async def sending(send: Callable[[], None], condition: Callable[[], bool]) -> None:
    """Send again and again until a condition holds."""

    def sent() -> bool:
        send()
        return condition()

    await until(sent)


async def acquainted(buses: dict[int, ParticipantBus], heard: dict[int, Heard]) -> None:
    """Wait until everybody is heard by everybody: that a peer is there is known before what it listens to."""

    def greeted() -> bool:
        for bus in buses.values():
            answer(bus, GREETING)
        return all(each.greeted_by == buses.keys() - {own} for own, each in heard.items())

    await until(greeted)


def free_endpoints(count: int) -> list[str]:
    return [f"tcp/127.0.0.1:{port}" for port in free_ports(count)]


@asynccontextmanager
async def opened(vehicle_id: int, listen: str, connect: list[str]) -> AsyncIterator[tuple[ParticipantBus, Heard]]:
    bus, heard = single_bus(vehicle(vehicle_id), TEAM, listen, connect), Heard()
    await bus.open(heard.on_message, heard.on_sensor, heard.on_presence)
    try:
        yield bus, heard
    finally:
        await bus.close()


@asynccontextmanager
async def shared(
    vehicle_ids: Sequence[int], listen: str, connect: Sequence[str] = ()
) -> AsyncIterator[tuple[dict[int, ParticipantBus], dict[int, Heard]]]:
    """Open one session for several vehicles."""
    participants = {each: vehicle(each) for each in vehicle_ids}
    bus = ZenohBus(TEAM, [Station(tuple(participants.values()), listen)], connect)
    buses = {each: bus.of(participant) for each, participant in participants.items()}
    heard = {each: Heard() for each in vehicle_ids}
    try:
        await asyncio.gather(
            *(each.open(heard[i].on_message, heard[i].on_sensor, heard[i].on_presence) for i, each in buses.items())
        )
        yield buses, heard
    finally:
        for each in buses.values():
            await each.close()


def peer_process(listen: str, connect: str, descriptors: int | None = None) -> subprocess.Popen[str]:
    """Start another vehicle's process, as a shell would that limits its `descriptors`."""

    def limit() -> None:
        if descriptors is not None:
            resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))

    process = subprocess.Popen(
        [sys.executable, "-c", PEER_PROCESS, listen, connect],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=limit,  # noqa: PLW1509  # the test's other threads hold no lock that it takes
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "opening\n"
    return process


def test_names_that_are_patterns_are_refused(subtests: pytest.Subtests) -> None:
    for name in ["", "a/", "*", "a b", "$", "a#"]:
        with subtests.test(name=name):
            with pytest.raises(ValueError, match="team"):
                BusTeam(name, (1,))
            with pytest.raises(ValueError, match="topic"):
                single_bus(vehicle(1), TEAM, None).publish(name, b"")


async def test_an_unopened_bus_drops_and_closes() -> None:
    bus: PeerBus = single_bus(vehicle(1), TEAM, None)
    bus.publish("answer", b"not received")
    assert not bus.alive
    await bus.close()


async def after_s(condition: Callable[[], bool]) -> float:
    """Return the seconds until a condition held."""
    began_s = time.monotonic()
    await until(condition)
    return time.monotonic() - began_s


@pytest.mark.wire
async def test_a_peer_is_found_late_missed_while_frozen_and_lost_when_killed() -> None:
    async def attempt() -> None:
        ends = free_endpoints(2)
        async with opened(1, ends[0], [ends[1]]) as (bus, heard):
            # The late starter knows nobody: it is the waiting peer's retries that find it, also after many in vain.
            await asyncio.sleep(0.7)
            with peer_process(ends[1], "tcp/127.0.0.1:1") as process:
                try:
                    found_s = await after_s(lambda: heard.presence == [(9, True)])
                    process.send_signal(signal.SIGSTOP)
                    frozen_s = await after_s(lambda: heard.presence[1:] == [(9, False)])
                    process.send_signal(signal.SIGCONT)
                    # It may be missed once more: its own lease of this peer has ended as well.
                    await until(lambda: len(heard.presence) > 2 and heard.presence[-1] == (9, True))
                    await answered(bus, heard)
                    process.kill()
                    lost_s = await after_s(lambda: heard.presence[-1] == (9, False))
                finally:
                    process.kill()
        print(f"found after {found_s:.3f} s, lost {frozen_s:.3f} s after SIGSTOP and {lost_s:.3f} s after SIGKILL")
        assert found_s < 1.0
        assert 0.5 < frozen_s < 2.0
        assert lost_s < 0.5

    await repeated(attempt)


async def answered(bus: ParticipantBus, heard: Heard) -> None:
    """Send 50 messages, each once the other process has answered the one before; the first until it listens."""
    await sending(partial(answer, bus, "ping"), lambda: "ping" in heard.messages)
    for number in range(49):
        text = f"ping {number}"
        answer(bus, text)
        await until(lambda text=text: text in heard.messages)  # type: ignore[misc]


@pytest.mark.wire
async def test_what_is_not_admitted_is_counted_and_dropped() -> None:
    ends = free_endpoints(2)
    async with opened(1, ends[0], []) as (first, heard_first), opened(2, ends[1], [ends[0]]) as (second, heard):
        await acquainted({1: first, 2: second}, {1: heard_first, 2: heard})
        first.publish("answer", bytes(PAYLOAD_LIMIT_BYTES + 1))
        first.publish("answer", bytes(PAYLOAD_LIMIT_BYTES))
        first.publish("answer", encode(CommandAnswer(2, 1.0, 1, "in another's name")))
        first.publish("answer", encode(StartProposal(1, 1.0, None)))
        answer(first, "heard")
        await until(lambda: bool(heard.messages))
        assert heard.messages == ["heard"]
        assert second.drops == Drops(too_long=1, malformed=1, wrong_sender=1, wrong_topic=1)
        assert first.drops == NO_DROPS


@pytest.mark.wire
async def test_a_raising_callback_does_not_stop_the_bus() -> None:
    ends = free_endpoints(2)
    failures: list[object] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: failures.append(context["exception"]))
    second, present, received = single_bus(vehicle(2), TEAM, ends[1], [ends[0]]), [], []

    def on_message(message: BusMessage) -> None:
        received.append(message.did)  # type: ignore[union-attr]
        raise RuntimeError("a bug in the core")

    async with opened(1, ends[0], []) as (first, _):
        await second.open(on_message, lambda *_: None, lambda peer_id, alive: present.append((peer_id, alive)))
        await until(lambda: present == [(1, True)])
        for text in ("one", "two"):
            await sending(partial(answer, first, text), lambda text=text: text in received)  # type: ignore[misc]
        await until(lambda: len(failures) == len(received))
        await second.close()
        answer(first, "three")
        await asyncio.sleep(0.1)
        assert "three" not in received


@pytest.mark.wire
async def test_a_program_that_accepts_and_stays_silent_at_endpoints_delays_no_guest() -> None:
    own, *taken = free_endpoints(4)
    with ExitStack() as stack:
        for endpoint in taken:
            stack.enter_context(socket.create_server(("127.0.0.1", int(endpoint.rpartition(":")[2]))))
        async with opened(1, own, []) as (first, _):
            began_s = time.monotonic()
            guest, heard = single_bus(Participant("operator", "anna"), TEAM, None, [*taken, own]), Heard()
            await guest.open(heard.on_message, heard.on_sensor, heard.on_presence)
            await sending(partial(answer, first, "here"), lambda: "here" in heard.messages)
            heard_s = time.monotonic()
            await guest.close()
            spent_s, left_s = time.monotonic() - began_s, time.monotonic() - heard_s
    print(f"joined, heard and left within {spent_s:.1f} s, left within {left_s:.2f} s")
    assert spent_s < 6.0  # the default of Zenoh waits for 10 s
    assert left_s < 1.0  # it does not wait for the handshakes under way, of 2 s


@pytest.mark.wire
async def test_strangers_who_connect_and_stay_silent_keep_nobody_out() -> None:
    silent, (end, *guests) = 400, free_endpoints(4)
    allow_descriptors()  # this process is the strangers' as well
    with peer_process(end, "tcp/127.0.0.1:1", descriptors=256) as process:
        try:
            for number, guest in enumerate(guests):
                with ExitStack() as strangers:  # they leave, and come again
                    for _ in range(silent if number else 0):
                        address = "127.0.0.1", int(end.rpartition(":")[2])
                        strangers.enter_context(socket.create_connection(address))
                    began_s = time.monotonic()
                    async with opened(1, guest, [end]) as (bus, heard):
                        await sending(partial(answer, bus, "ping"), lambda heard=heard: "ping" in heard.messages)  # type: ignore[misc]
                        spent_s = time.monotonic() - began_s
                print(f"joined and answered within {spent_s:.1f} s")
                assert spent_s < 6.0
        finally:
            process.kill()


@pytest.mark.wire
async def test_opening_never_blocks_the_loop_and_can_be_cancelled() -> None:
    ends: list[str] = []

    def begin() -> tuple[ParticipantBus, "asyncio.Task[None]"]:
        ends[:] = free_endpoints(2)
        bus = single_bus(vehicle(1), TEAM, ends[0], [ends[1]])
        return bus, asyncio.create_task(bus.open(lambda *_: None, lambda *_: None, lambda *_: None))

    async def attempt() -> None:
        bus, opening = begin()
        longest_s = 0.0
        while not opening.done():
            start_s = time.monotonic()
            await asyncio.sleep(0.001)
            longest_s = max(longest_s, time.monotonic() - start_s)
        await opening
        await bus.close()
        assert longest_s < 0.25

    await repeated(attempt)
    _, opening = begin()
    await asyncio.sleep(0)
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening

    async def port_is_free() -> None:
        try:
            async with opened(2, ends[0], []):
                pass
        except VehicleRefusedError as refusal:
            raise AssertionError from refusal

    await repeated(port_is_free)  # the cancelled session lets go of it by itself


@pytest.mark.wire
async def test_a_message_is_decoded_once_for_all_vehicles_of_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = free_endpoints(2)
    decoded: list[bytes] = []

    def counted(payload: bytes) -> BusMessage:
        decoded.append(payload)
        return decode(payload)

    monkeypatch.setattr(codec, "decode", counted)
    with peer_process(ends[1], ends[0]) as process:
        try:
            async with shared((1, 2, 3), ends[0], [ends[1]]) as (buses, heard):
                await until(lambda: all((9, True) in each.presence for each in heard.values()))
                await sending(lambda: answer(buses[1], GREETING), lambda: heard[2].greeted_by == {1, 9})
                for number in range(1, 11):  # one after the other: the bus drops what it cannot send at once
                    answer(buses[1], f"{number}")
                    due = [number, 2 * number, 2 * number]
                    await until(lambda due=due: [len(heard[i].messages) for i in (1, 2, 3)] == due)  # type: ignore[misc]
                await asyncio.sleep(0.05)
                texts = sorted(f"{number}" for number in range(1, 11))
                assert sorted(heard[1].messages) == texts, "of vehicle 9, which repeats what vehicle 1 sends"
                assert sorted(heard[2].messages) == sorted(heard[3].messages) == sorted(2 * texts)
                assert sum(decode(each).did != GREETING for each in decoded) == 20  # type: ignore[union-attr]
        finally:
            process.kill()


@pytest.mark.wire
async def test_vehicles_of_one_session_hear_each_other_once_and_leave_alone() -> None:
    ends = free_endpoints(2)
    async with (
        opened(9, ends[1], [ends[0]]) as (peer, heard_peer),
        shared((1, 2, 3), ends[0], [ends[1]]) as (buses, heard),
    ):
        everybody, all_heard = {**buses, 9: peer}, {**heard, 9: heard_peer}
        for own, each in all_heard.items():
            others = [(other, True) for other in sorted(all_heard) if other != own]
            await until(partial(lambda each, others: sorted(each.presence) == others, each, others))
        await acquainted(everybody, all_heard)
        for number in range(10):  # one after the other: the bus drops what it cannot send at once
            for own, bus in everybody.items():
                answer(bus, f"{own}:{number}")
            due = 3 * (number + 1)
            await until(lambda due=due: all(len(each.messages) >= due for each in all_heard.values()))  # type: ignore[misc]
        for own, each in all_heard.items():
            expected = sorted(f"{other}:{number}" for other in all_heard if other != own for number in range(10))
            assert sorted(each.messages) == expected

        for each in all_heard.values():
            each.presence.clear()
        await buses[2].close()
        await until(lambda: all(all_heard[i].presence for i in (1, 3, 9)))
        assert [buses[i].alive for i in (1, 2, 3)] == [True, False, True]
        answer(buses[2], "from a closed one")
        answer(buses[1], "from an open one")
        answer(peer, "from outside")
        await until(lambda: "from an open one" in heard_peer.messages and "from outside" in heard[3].messages)
        assert not any("from a closed one" in each.messages for each in all_heard.values())
        assert len(heard[2].messages) == 30
        assert [all_heard[i].presence for i in (1, 2, 3, 9)] == [[(2, False)], [], [(2, False)], [(2, False)]]
        assert all(bus.drops == NO_DROPS for bus in everybody.values())


@pytest.mark.wire
async def test_nobody_else_speaks_for_the_vehicles_of_a_session_and_sightings_go_to_each() -> None:
    ends = free_endpoints(1)
    sensor, impostor = (
        single_bus(Participant("sensor", "mast"), TEAM, None, ends),
        single_bus(vehicle(2), TEAM, None, ends),
    )
    async with shared((1, 2), ends[0]) as (buses, heard):
        present: set[int] = set()
        try:
            for bus in (sensor, impostor):
                await bus.open(lambda *_: None, lambda *_: None, lambda peer_id, _: present.add(peer_id))
            await until(lambda: present >= {1, 2})
            seen = partial(sensor.publish, "perception", b"seen")
            await sending(seen, lambda: all(heard[i].sightings for i in (1, 2)))
            await sending(lambda: answer(impostor, "forged"), lambda: buses[1].drops.own_id > 0)
            await asyncio.sleep(0.05)
            assert heard[1].messages == heard[2].messages == []
        finally:
            await sensor.close()
            await impostor.close()


OBSERVER_PROCESS = """
import asyncio, sys
from agents.shell.zenoh_bus import single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.participant import Participant

async def main():
    bus = single_bus(Participant("observer", "anna"), BusTeam("wire", (1,)), None, sys.argv[1:])
    await bus.open(lambda report: print(report.ended, flush=True), lambda *_: None, lambda *_: None)
    await asyncio.Event().wait()

asyncio.run(main())
"""


@pytest.mark.wire
async def test_the_last_report_of_a_flight_reaches_an_observer_that_lacks_the_processor() -> None:
    """It reads at once what has come meanwhile: of such messages Zenoh drops the newest where it limits their rate."""
    (end,) = free_endpoints(1)
    flown_bus = single_bus(vehicle(1), BusTeam("wire", (1,)), end)
    reporter = Reporter(replace(FakeFlight().parts, bus=flown_bus), lambda: None, dict)
    await flown_bus.open(lambda _message: None, lambda *_: None, lambda *_: None)
    command = (sys.executable, "-c", OBSERVER_PROCESS, end)
    observer = await asyncio.create_subprocess_exec(*command, cwd=ROOT, stdout=subprocess.PIPE)
    try:
        assert observer.stdout is not None
        async with asyncio.timeout(PATIENCE_S):
            reporter.begin()
            assert await observer.stdout.readline() == b"\n"
            observer.send_signal(signal.SIGSTOP)
            flown_bus.publish(REPORT_TOPIC, encode(VehicleReport(1, 1.0, "land")))
            reporter.end(Outcome(FlightEnd.LANDED))
            await reporter.close()
            await flown_bus.close()
            observer.send_signal(signal.SIGCONT)
            while (line := await observer.stdout.readline()) != b"landed\n":
                assert line == b"\n"
    finally:
        observer.kill()
        await observer.communicate()
