"""A router with issued keys: all is heard through it, each sender on its own keys only, and operators are seen."""

import asyncio
import resource
import socket
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import psutil
import pytest
import tomli_w

from agents.ports import VehicleRefusedError
from agents.shell import zenoh_session
from agents.shell.bus_security import BusSecurity
from agents.shell.computer import allow_descriptors
from agents.shell.zenoh_bus import ParticipantBus, single_bus
from agents.shell.zenoh_session import BusTeam, ZenohSession
from agents.team.codec import encode
from agents.team.messages import (
    OPERATORS_TOPIC,
    ROSTER_TOPIC,
    BusMessage,
    OperatorCommand,
    VehicleReport,
    key_of,
)
from agents.team.participant import Participant, Role, vehicle
from gcs.keys.authority_folder import AuthorityFolder
from tests.gcs.keys.test_key_folder import security_of
from tests.support.mission_text import CASE2
from tests.support.paths import ROOT
from tests.support.wire import free_port, until
from tests.wire.security.test_keys import UnauthorisedClient, client_hello, member, with_keys

pytestmark = pytest.mark.wire

FORGED, FORGED_NUMBER = "pilot override", 99


class RoutedTeam:
    """A team of three vehicles with its keys; `heard` are the keys that each participant has received on.

    `forged` are the messages that somebody else has sent in a sender's name.
    """

    def __init__(self, folder: Path) -> None:
        self.keys = AuthorityFolder(folder / "keys")
        self.keys.init(10.0)
        for name in "123":
            self.keys.issue("vehicle", name, 1.0)
        self.keys.issue("operator", "anna", 1.0)
        self.keys.issue("router", "hill", 1.0)
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.team = BusTeam("routed", (1, 2, 3), self.endpoint)
        self.heard: dict[str, set[str]] = {}
        self.forged: list[BusMessage] = []

    def security(self, role: Role, name: str) -> BusSecurity:
        return replace(security_of(self.keys, role, name), sockets=None)  # as on a computer of its own

    @property
    def port(self) -> int:
        """The router's port."""
        return int(self.endpoint.rpartition(":")[2])

    def start_router(self, stack: AsyncExitStack, descriptors: int) -> "subprocess.Popen[str]":
        """Run the router in a process of its own, with that many descriptors."""

        def limit() -> None:
            resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors, descriptors))

        folder = self.keys.path.parent
        mission = tomllib.loads(CASE2)
        mission["network"] = {"team": "routed", "router": self.endpoint, "security": {"keys": "keys"}}
        (folder / "mission.toml").write_text(tomli_w.dumps(mission), encoding="utf-8")
        command = [sys.executable, "-m", "gcs", "router", str(folder / "mission.toml")]
        process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, preexec_fn=limit)  # noqa: PLW1509
        stack.callback(process.wait)
        stack.callback(process.kill)
        assert process.stderr is not None
        stack.callback(process.stderr.close)
        assert "Ctrl-C" in process.stderr.readline()
        return process

    async def router(self, stack: AsyncExitStack) -> None:
        session = ZenohSession(self.team, self.endpoint, (), self.security("router", "hill"))
        await asyncio.to_thread(partial(session.open, None, own=False, reports=False))
        stack.push_async_callback(asyncio.to_thread, session.close)

    async def bus(self, participant: Participant, stack: AsyncExitStack) -> ParticipantBus:
        heard = self.heard[participant.name] = set()
        security = self.security(participant.role, participant.name)
        bus = single_bus(participant, self.team, None, (), security)
        stack.push_async_callback(bus.close)

        def hear(message: BusMessage) -> None:
            heard.add(key_of(message))
            if getattr(message, "tactic", "") == FORGED or getattr(message, "number", 0) == FORGED_NUMBER:
                self.forged.append(message)

        await bus.open(hear, lambda *_: None, lambda *_: None)
        return bus


async def test_all_is_heard_through_it_and_nobody_speaks_for_another(tmp_path: Path) -> None:
    team = RoutedTeam(tmp_path)
    async with AsyncExitStack() as stack:
        await team.router(stack)
        one, two = [await team.bus(vehicle(each), stack) for each in (1, 2)]
        assert not one.operated
        anna = await team.bus(Participant("operator", "anna"), stack)
        await until(lambda: one.operated and two.operated, waiting_for="the operator's presence")

        def said() -> bool:
            one.publish("member", member(1))
            one.publish("@report", encode(VehicleReport(1, time.time(), "hold")))
            anna.publish("command/start", encode(OperatorCommand(time.time(), "start", None, "anna", 1)))
            return "member/1" in team.heard["2"] and {"@report/1", "member/1"} <= team.heard["anna"]

        await until(said, waiting_for="vehicle 1 everywhere")
        await until(lambda: "command/start/anna" in team.heard["1"] & team.heard["2"], waiting_for="the start")
        assert "@report/1" not in team.heard["2"]

        liar = ZenohSession(team.team, None, (), team.security("vehicle", "3"))
        await asyncio.to_thread(partial(liar.open, None, own=False, reports=False))
        stack.push_async_callback(asyncio.to_thread, liar.close)
        await asyncio.to_thread(liar.appear, "bob", OPERATORS_TOPIC)

        def lied() -> bool:
            liar.publish("member/1", member(1, FORGED))
            liar.publish("command/land/anna", encode(OperatorCommand(time.time(), "land", None, "anna", FORGED_NUMBER)))
            liar.publish("member/3", member(3))
            return "member/3" in team.heard["1"] & team.heard["2"]

        await until(lied, waiting_for="vehicle 3 as itself")
        assert team.forged == []
        await anna.close()
        await until(lambda: not (one.operated or two.operated), waiting_for="the operator's end")


async def test_keys_revoked_in_flight_are_dropped_behind_it(tmp_path: Path) -> None:
    team = RoutedTeam(tmp_path)
    team.keys.issue("operator", "bob", 1.0)
    async with AsyncExitStack() as stack:
        await team.router(stack)
        one, two = [await team.bus(vehicle(each), stack) for each in (1, 2)]
        bob, lost = await team.bus(Participant("operator", "bob"), stack), await team.bus(vehicle(3), stack)

        def said() -> bool:
            lost.publish("member", member(3))
            return "member/3" in team.heard["1"] & team.heard["2"]

        await until(said, waiting_for="vehicle 3")
        team.keys.revoke("vehicle-3")
        roster = team.keys.roster

        def taken() -> bool:
            bob.publish(ROSTER_TOPIC, roster.compact())
            return one.revoked == two.revoked == ("vehicle-3",)

        await until(taken, waiting_for="the revocation")
        for heard in team.heard.values():
            heard.clear()

        def others_said() -> bool:
            lost.publish("member", member(3))
            one.publish("member", member(1))
            two.publish("member", member(2))
            return "member/1" in team.heard["2"] and "member/2" in team.heard["1"]

        dropped = one.drops.not_a_member
        await until(lambda: others_said() and one.drops.not_a_member > dropped, waiting_for="the others")
        assert "member/3" not in team.heard["1"] | team.heard["2"]


async def test_without_it_a_participant_is_refused_with_the_next_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zenoh_session, "_ROUTER_TIMEOUT_MS", 300)
    team = RoutedTeam(tmp_path)
    async with AsyncExitStack() as stack:
        with pytest.raises(VehicleRefusedError, match=r"router .* does not answer") as refused:
            await team.bus(vehicle(1), stack)
        assert "cordon router" in refused.value.next_step


SILENT, FAILING, SESSIONS = 1000, 40, 45


def listening(process: int) -> set[int]:
    """Return the ports at which a process listens, as every user of the computer can find them."""
    opened = psutil.Process(process).net_connections()
    return {each.laddr.port for each in opened if each.status == psutil.CONN_LISTEN}


@contextmanager
def calling(port: int, count: int, says: bytes = b"", host: str = "127.0.0.1") -> Iterator[None]:
    """Hold connections of a stranger, which come again when they are dropped, until the end."""
    ended = threading.Event()

    def call() -> None:
        held = list[socket.socket]()
        while not ended.is_set():
            with suppress(OSError):
                held.append(socket.create_connection(("127.0.0.1", port), 0.1, (host, 0)))
                held[-1].sendall(says)
            if len(held) > count:
                held.pop(0).close()
            time.sleep(0.001)
        for each in held:
            each.close()

    thread = threading.Thread(target=call)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


ATTACKS = {
    "silent": (b"", SILENT, "127.0.0.1"),
    "begins": (b"\x16", SILENT, "127.0.0.1"),
    "no TLS": (b"GET / HTTP/1.1\r\n\r\n", FAILING, "127.0.0.1"),
    "no certificate": (client_hello(), FAILING, "127.0.0.2"),
}
if sys.platform == "linux":  # others have no filter
    ATTACKS["behind the gate"] = (b"GET / HTTP/1.1\r\n\r\n", FAILING, "127.0.0.1")


async def test_strangers_shut_no_operator_out(tmp_path: Path, subtests: pytest.Subtests) -> None:
    team = RoutedTeam(tmp_path)

    async def joins_within_s(when: str) -> float:
        async with AsyncExitStack() as stack:
            began_s = time.monotonic()
            anna = await team.bus(Participant("operator", "anna"), stack)

            def heard() -> bool:
                one.publish("member", member(1))
                anna.publish("command/hold", encode(OperatorCommand(time.time(), "hold", None, "anna", 1)))
                return "member/1" in team.heard["anna"] and "command/hold/anna" in team.heard["1"]

            team.heard["1"].clear()
            await until(heard, waiting_for=f"the operator {when}")
            return time.monotonic() - began_s

    allow_descriptors()  # this process is the strangers' as well
    async with AsyncExitStack() as stack:
        router = team.start_router(stack, descriptors=512)
        (inner,) = listening(router.pid) - {team.port}
        one = await team.bus(vehicle(1), stack)
        for name, (says, count, host) in ATTACKS.items():
            with subtests.test(name):
                spent_s = [await joins_within_s("before the attack")]
                with calling(inner if name == "behind the gate" else team.port, count, says, host):
                    for _ in range(3):
                        await asyncio.sleep(1.0)
                        spent_s.append(await joins_within_s("during the attack"))
                spent_s.append(await joins_within_s("after the attack"))
                print(f"{name}: {', '.join(f'{each:.2f} s' for each in spent_s)}")
                assert max(spent_s) < 6.0
        with subtests.test("the router prints the refused addresses, few times"):
            router.kill()
            _, told = await asyncio.to_thread(router.communicate)
            for refused in ("127.0.0.1 is refused: too many silent", "127.0.0.2 is refused: too many handshakes"):
                assert 2 <= told.count(refused) <= 6, told


@asynccontextmanager
async def seen_as(host: str, port: int) -> AsyncIterator[int]:
    """Pass connections on to a port of this computer from another of its addresses; yield the port to call."""

    async def copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(65_536):
                writer.write(data)
                await writer.drain()
        writer.close()

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            there = await asyncio.open_connection("127.0.0.1", port, local_addr=(host, 0))
            await asyncio.gather(copy(reader, there[1]), copy(there[0], writer))
        writer.close()

    async with await asyncio.start_server(pass_on, "127.0.0.1", 0) as server:
        yield int(server.sockets[0].getsockname()[1])


async def test_one_computer_with_keys_takes_no_operators_place(tmp_path: Path) -> None:
    """An observer opens sessions without end."""
    team = RoutedTeam(tmp_path)
    team.keys.issue("observer", "tower", 1.0)
    async with AsyncExitStack() as stack:
        await team.router(stack)
        one = await team.bus(vehicle(1), stack)
        port = await stack.enter_async_context(seen_as("127.0.0.2", team.port))
        settings = with_keys(team.security("observer", "tower"))
        opening = [asyncio.to_thread(UnauthorisedClient, [f"127.0.0.1:{port}"], settings) for _ in range(SESSIONS)]
        for stranger in await asyncio.gather(*opening):
            stack.push_async_callback(asyncio.to_thread, stranger.close)
        anna = await team.bus(Participant("operator", "anna"), stack)

        def heard() -> bool:
            anna.publish("command/hold", encode(OperatorCommand(time.time(), "hold", None, "anna", 1)))
            return "command/hold/anna" in team.heard["1"] and one.operated

        await until(heard, waiting_for="the operator and her presence")
