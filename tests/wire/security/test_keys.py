"""Keys on the wire: a stranger gets no link, and who has keys is heard on its own keys only.

Peers are cordon's buses; strangers are plain Zenoh sessions, which try whatever their certificate does not grant.
"""

import asyncio
import base64
import json
import re
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest
import zenoh
from foxglove import Context
from rich.console import Console

from agents.shell.bus_security import BusSecurity
from agents.shell.clock import WallClock
from agents.shell.gate import FAILED_MAX
from agents.shell.zenoh_bus import ParticipantBus, Station, ZenohBus, single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.codec import encode
from agents.team.messages import (
    REPORT_TOPIC,
    ROSTER_TOPIC,
    BusMessage,
    CommandAnswer,
    MemberState,
    OperatorCommand,
    VehicleReport,
    key_of,
)
from agents.team.participant import vehicle
from gcs.cli.log import audit
from gcs.console.live import LiveView
from gcs.errors import Exit
from gcs.flight import audit_exchange
from gcs.flight.team import FlightTeam
from gcs.flightlog.audit import AuditEntry
from gcs.flightlog.flight import Recording
from gcs.flightlog.reader import read_log
from gcs.flightlog.run import run_of
from gcs.flightlog.writer import LogWriter
from gcs.keys.approval import APPROVAL_FILE, KILL_KEY_FILE, ApproverFolder, KillGrant
from gcs.keys.authority_folder import AuthorityFolder
from gcs.keys.key_folder import KeyFolder
from gcs.keys.run_keys import RunKeys
from gcs.keys.team_keys import NoKeys, TeamKeys
from gcs.link.ports import free_ports
from gcs.mission.file import load_mission
from tests.conftest import Ran, RunHere
from tests.gcs.keys.test_approval import authority_of
from tests.gcs.keys.test_key_folder import security_of
from tests.support.mission_text import LOW
from tests.support.paths import ROOT
from tests.support.wire import PATIENCE_S, until
from tests.support.wire import cordon as flown

pytestmark = pytest.mark.wire

TEAM = "keys"
TRIES = 8
"""Attempts of a stranger after all that is expected was heard: each sends all keys once."""
CLOSED_S = 2.0
"""How long before its certificate expires a link may end: certificates count whole seconds."""
LINK_S = 1.0
"""How long a stranger has that is to get no link: who has keys gets one in a fifth of that."""


def member(vehicle_id: int, tactic: str = "hold") -> bytes:
    return encode(MemberState(vehicle_id, time.time(), tactic, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)))


def command(verb: str, name: str) -> bytes:
    return encode(OperatorCommand(time.time(), verb, None, name, 1))  # type: ignore[arg-type]


SAID: Mapping[str, bytes] = {
    "member/1": member(1, "land"),
    "member/2": member(2, "land"),
    "member/3": member(3, "land"),
    "answer/1": encode(CommandAnswer(1, 1.0, 1, "forged")),
    "command/hold/anna": command("hold", "anna"),
    "command/kill/anna": command("kill", "anna"),
    "command/hold/bob": command("hold", "bob"),
    "perception/mast": b"mast",
    "position/mast": b"mast",
    "perception/cameras": b"cameras",
    "position/cameras": b"cameras",
}
"""What every stranger sends, by key."""


@pytest.fixture
def keys(tmp_path: Path) -> AuthorityFolder:
    """Return the keys of three vehicles, of operators and of others."""
    folder = AuthorityFolder(tmp_path / "keys")
    folder.init(10.0)
    folder.issue("vehicle", "1", 1.0)
    folder.issue("vehicle", "2", 1.0)
    folder.issue("vehicle", "3", 1.0)
    folder.issue("operator", "anna", 1.0, ("hold",))
    folder.issue("operator", "bob", 1.0)
    folder.issue("sensor", "mast", 1.0)
    folder.issue("positions", "cameras", 1.0)
    folder.issue("observer", "tower", 1.0)
    return folder


class Peers:
    """Vehicles 1 and 2 of a team: the keys that each hears of the other, those that a stranger is heard on, and who is
    present.
    """

    def __init__(self, endpoints: Sequence[str] = ()) -> None:
        self.endpoints = endpoints or [f"127.0.0.1:{port}" for port in free_ports(2)]
        self.heard: list[set[str]] = [set(), set()]
        self.forged: set[str] = set()
        self.present: list[set[int]] = [set(), set()]
        self.buses: list[ParticipantBus] = []

    def forget(self) -> None:
        for heard in (*self.heard, self.forged):
            heard.clear()

    def receive(self, own: int, message: BusMessage) -> None:
        key = key_of(message)
        (self.forged if SAID.get(key) == encode(message) else self.heard[own]).add(key)

    def perceive(self, topic: str, payload: bytes) -> None:
        self.forged.add(f"{topic}/{payload.decode()}")

    def note_presence(self, own: int, vehicle_id: int, present: bool) -> None:
        (self.present[own].add if present else self.present[own].discard)(vehicle_id)


@asynccontextmanager
async def peers(folder: AuthorityFolder | None, endpoints: Sequence[str] = ()) -> AsyncIterator[Peers]:
    team, keys = Peers(endpoints), NoKeys() if folder is None else KeyFolder(folder.path)
    async with AsyncExitStack() as stack:
        for k in (0, 1):
            identity = keys.identity("vehicle", str(k + 1))
            listen, other = (f"tcp/{team.endpoints[i]}" for i in (k, 1 - k))
            bus = single_bus(identity.participant, BusTeam(TEAM, (1, 2, 3)), listen, [other], identity.security)
            stack.push_async_callback(bus.close)
            await bus.open(partial(team.receive, k), team.perceive, partial(team.note_presence, k))
            team.buses.append(bus)
        await until(lambda: team.present == [{2}, {1}])
        yield team


@asynccontextmanager
async def process(keys: TeamKeys) -> AsyncIterator[Peers]:
    """Fly the vehicles 1 and 2 from one process: over one session, or one for each certificate."""
    team, others = Peers(), BusTeam(TEAM, (1, 2, 3))
    stations = [
        Station(tuple(map(vehicle, identity.vehicle_ids)), f"tcp/{endpoint}", identity.security)
        for identity, endpoint in zip(keys.flying((1, 2)), team.endpoints, strict=False)
    ]
    bus = ZenohBus(others, stations)
    team.buses = [bus.of(vehicle(each)) for each in (1, 2)]
    async with AsyncExitStack() as stack:
        for k, each in enumerate(team.buses):
            stack.push_async_callback(each.close)
            await each.open(partial(team.receive, k), team.perceive, partial(team.note_presence, k))
        await until(lambda: team.present == [{2}, {1}])
        yield team


def client_hello() -> bytes:
    """Return the first message of TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    sent = ssl.MemoryBIO()
    with suppress(ssl.SSLWantReadError):
        context.wrap_bio(ssl.MemoryBIO(), sent).do_handshake()
    return sent.read()


async def test_strangers_at_a_port_do_not_keep_a_program_of_the_same_user_out(keys: AuthorityFolder) -> None:
    """They have begun as many handshakes as one address may."""
    anna = KeyFolder(keys.path).identity("operator", "anna")
    assert anna.security is not None
    async with peers(keys) as team, AsyncExitStack() as stack:
        linked: dict[str, set[int]] = {"here": set(), "elsewhere": set()}
        securities = {"here": anna.security, "elsewhere": replace(anna.security, sockets=None)}
        for endpoint in FAILED_MAX * list(team.endpoints):
            host, port = endpoint.split(":")
            stranger = stack.enter_context(socket.create_connection((host, int(port))))
            stranger.sendall(client_hello())
            await asyncio.to_thread(stranger.recv, 1)
        for place in ("elsewhere", "here"):

            def note(vehicle_id: int, present: bool, known: set[int] = linked[place]) -> None:
                (known.add if present else known.discard)(vehicle_id)

            bus = single_bus(
                anna.participant,
                BusTeam(TEAM, (1, 2, 3)),
                None,
                [f"tls/{each}" for each in team.endpoints],
                securities[place],
            )
            stack.push_async_callback(bus.close)
            await bus.open(lambda *_: None, lambda *_: None, note)
        await until(lambda: linked["here"] == {1, 2})
        assert linked["elsewhere"] == set()
        assert team.buses[0].refusals["address 127.0.0.1", "too many handshakes"] > 0
        bus.publish("command/hold", encode(OperatorCommand(time.time(), "hold", None, "anna", 2)))
        await until(lambda: all("command/hold/anna" in heard for heard in team.heard))


class UnauthorisedClient:
    """A plain Zenoh session that connects to both vehicles, with some certificate or none, and no access control."""

    def __init__(self, endpoints: Sequence[str], settings: Mapping[str, object], scheme: str = "tls") -> None:
        config = zenoh.Config()
        all_settings: dict[str, object] = {
            "mode": "peer",
            "listen/endpoints": [],
            "connect/endpoints": [f"{scheme}/{each}" for each in endpoints],
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "connect/retry": {"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 1},
            "scouting/multicast/enabled": False,
            **settings,
        }
        for path, value in all_settings.items():
            config.insert_json5(path, json.dumps(value))
        self.heard: set[str] = set()
        self._session = zenoh.open(config)
        self._session.declare_subscriber(f"cordon/{TEAM}/**", self._hear, allowed_origin=zenoh.Locality.REMOTE)
        self._session.liveliness().declare_subscriber(f"cordon/{TEAM}/**", self._hear, history=True)
        self._token = self._session.liveliness().declare_token(f"cordon/{TEAM}/alive/3")

    def _hear(self, sample: zenoh.Sample) -> None:
        self.heard.add(str(sample.key_expr).removeprefix(f"cordon/{TEAM}/"))

    @property
    def linked(self) -> bool:
        return bool(list(self._session.info.peers_zid()))

    def say(self) -> None:
        for key, payload in SAID.items():
            self.put(key, payload)

    def put(self, key: str, payload: bytes) -> None:
        self._session.put(f"cordon/{TEAM}/{key}", payload)

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


def with_keys(security: BusSecurity) -> dict[str, object]:
    """Return the settings of a stranger that has somebody's keys."""
    return {"transport/link/tls": security.settings(TEAM)["transport/link/tls"]}


def without_keys(security: BusSecurity) -> dict[str, object]:
    """Return the settings of a stranger that knows the authority only."""
    authority = base64.b64encode(security.authority_pem).decode()
    tls = {"root_ca_certificate_base64": authority, "verify_name_on_connect": False}
    return {"transport/link/tls": tls}


@dataclass(frozen=True)
class Tried:
    """What a stranger reached: a link, the keys that vehicles heard of it, and those that it heard of vehicles."""

    linked: bool
    said: set[str]
    heard: set[str]


NOTHING = Tried(linked=False, said=set(), heard=set())
LISTENED = {"member/1", "member/2", "alive/1", "alive/2"}


async def tried(
    team: Peers, *settings: Mapping[str, object], scheme: str = "tls", expected: Tried = NOTHING
) -> list[Tried]:
    """Return what strangers reach side by side: what vehicles hear counts for each of them.

    What is `expected` they reach sooner or later; what else they reach, they reach at once.
    """
    strangers = [await asyncio.to_thread(UnauthorisedClient, team.endpoints, each, scheme) for each in settings]

    def say() -> bool:
        for stranger in strangers:
            stranger.say()
        for bus in team.buses:
            bus.publish("member", member(int(bus.participant.name), "hold"))
        return (
            team.heard == [{"member/2"}, {"member/1"}]
            and team.forged >= expected.said
            and all(each.heard >= expected.heard for each in strangers)
        )

    try:
        if expected.linked:
            await until(lambda: all(stranger.linked for stranger in strangers), waiting_for="a link")
        else:
            await asyncio.sleep(LINK_S)
        linked = [stranger.linked for stranger in strangers]
        team.forget()
        await until(say, waiting_for="what is to be heard")
        for _ in range(TRIES):
            say()
            await asyncio.sleep(0.03)
        said = set(team.forged)
        return [Tried(link, said, each.heard - {"alive/3"}) for link, each in zip(linked, strangers, strict=True)]
    finally:
        for stranger in strangers:
            await asyncio.to_thread(stranger.close)


async def reaches(team: Peers, settings: Mapping[str, object], *said: str, scheme: str = "tls") -> None:
    """Assert that a stranger is linked, hears all that vehicles say, and is heard on these keys only."""
    expected = Tried(linked=True, said=set(said), heard=LISTENED)
    assert await tried(team, settings, scheme=scheme, expected=expected) == [expected]


async def test_without_keys_everything_is_heard() -> None:
    # The control of all that follow: on a bus without keys the same attempts reach the vehicles.
    async with peers(None) as team:
        await reaches(team, {}, *SAID, scheme="tcp")


async def test_without_keys_that_count_there_is_no_link_or_nothing_is_heard(
    keys: AuthorityFolder, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    other = AuthorityFolder(tmp_path / "others")
    other.init(10.0)
    for role, name in (("vehicle", "2"), ("operator", "anna")):
        other.issue(role, name, 1.0)  # type: ignore[arg-type]
    forged, own = security_of(other, "operator", "anna"), security_of(keys, "vehicle", "1")
    revoked = security_of(keys, "operator", "bob")
    keys.revoke("operator-bob")
    replaced = security_of(keys, "operator", "anna")
    keys.issue("operator", "anna", 1.0, ("hold",))
    authority = authority_of(keys)
    expired, unlisted = (
        authority.issue("operator-anna", time.time() - 60.0),
        authority.issue("vehicle-9", time.time() + 60.0),
    )
    strangers = {
        "other authority": with_keys(forged),
        "other authority, trusting ours": with_keys(replace(forged, authority_pem=own.authority_pem)),
        "expired": with_keys(
            replace(own, certificate_pem=expired.certificate_pem, private_key_pem=expired.private_key_pem)
        ),
        "no certificate": without_keys(own),
    }
    silent = {
        "revoked": with_keys(revoked),
        "replaced": with_keys(replaced),
        "not on the roster": with_keys(
            replace(own, certificate_pem=unlisted.certificate_pem, private_key_pem=unlisted.private_key_pem)
        ),
    }
    async with peers(keys) as team:
        for name, found in zip(strangers, await tried(team, *strangers.values()), strict=True):
            with subtests.test(name=name):
                assert found == NOTHING
        with subtests.test(name="plain TCP"):
            assert await tried(team, {}, scheme="tcp") == [NOTHING]
        for name, found in zip(silent, await tried(team, *silent.values()), strict=True):
            with subtests.test(name=name):
                assert (found.said, found.heard) == (set(), set())
        assert team.present == [{2}, {1}]


async def test_what_comes_from_a_certificate_that_has_expired_is_dropped(keys: AuthorityFolder) -> None:
    own = security_of(keys, "operator", "anna")
    async with peers(keys) as team:
        for valid_s in (4.0, 20.0, 100.0):  # on a busy computer a link may take longer than the first is valid
            expires_s = time.time() + valid_s
            pair = authority_of(keys).issue("operator-anna", expires_s)
            settings = with_keys(
                replace(own, certificate_pem=pair.certificate_pem, private_key_pem=pair.private_key_pem)
            )
            stranger = await asyncio.to_thread(UnauthorisedClient, team.endpoints, settings)
            try:

                def heard(speaker: UnauthorisedClient = stranger, until_s: float = expires_s) -> bool:
                    speaker.say()
                    return bool(team.forged) or time.time() > until_s

                await until(heard)
                if not team.forged:
                    continue
                await until(lambda speaker=stranger: not speaker.linked, waiting_for="the end of its link")  # type: ignore[misc]
                assert time.time() > expires_s - CLOSED_S
                team.forget()
                for _ in range(TRIES):
                    stranger.say()
                    await asyncio.sleep(0.03)
                assert team.forged == set()
                assert not stranger.linked
                return
            finally:
                await asyncio.to_thread(stranger.close)
        pytest.fail("no link within the longest validity")


async def revoked_in_flight(keys: AuthorityFolder, team: Peers, *labels: str) -> None:
    """Send the roster without these holders as the operator bob does; return when both vehicles have taken it."""
    for label in labels:
        keys.revoke(label)
    bob, roster = KeyFolder(keys.path).identity("operator", "bob"), keys.roster
    bus = single_bus(
        bob.participant, BusTeam(TEAM, (1, 2, 3)), None, [f"tcp/{e}" for e in team.endpoints], bob.security
    )
    try:
        await bus.open(lambda *_: None, lambda *_: None, lambda *_: None)

        def taken() -> bool:
            bus.publish(ROSTER_TOPIC, roster.compact())
            return all(bus.rosters.get(name, 0) == roster.serial for name in "12")

        await until(taken, waiting_for="both vehicles' answers")
    finally:
        await bus.close()


async def test_what_comes_from_keys_revoked_in_flight_is_dropped(
    keys: AuthorityFolder, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    holders = ("operator", "anna"), ("sensor", "mast"), ("vehicle", "3")
    settings = {label: with_keys(security_of(keys, *label)) for label in holders}  # type: ignore[arg-type]
    said = {"command/hold/anna", "perception/mast", "member/3"}
    copied = AuthorityFolder(tmp_path / "there" / "keys")
    for name in ("vehicle-1", "vehicle-2"):
        shutil.copytree(keys.path / name, copied.path / name)
    async with peers(copied) as team:
        expected = Tried(linked=True, said=said, heard=LISTENED)
        assert await tried(team, *settings.values(), expected=expected) == [expected] * 3
        older = keys.roster.compact()
        await revoked_in_flight(keys, team, *(f"{role}-{name}" for role, name in holders))
        silent = replace(expected, said=set())
        with subtests.test("nothing is heard of them"):
            assert await tried(team, *settings.values(), expected=silent) == [silent] * 3
            assert team.buses[0].revoked == ("operator-anna", "sensor-mast", "vehicle-3")
            refused = team.buses[0].refusals
            assert refused["command/anna", "not a member"] > 0
            assert refused["operator-anna", "not on the roster"] > 0
            assert not {sender for sender, _ in refused} & {"member/2", "vehicle-2", "operator-bob"}
            assert team.present == [{2}, {1}]
        with subtests.test("others are heard"):
            bob = with_keys(security_of(keys, "operator", "bob"))
            await reaches(team, bob, "command/hold/bob")
        with subtests.test("rosters that are older, altered or of another authority change nothing"):
            other = AuthorityFolder(tmp_path / "others")
            other.init(10.0)
            newest = keys.roster
            altered = msgspec.structs.replace(newest, serial=newest.serial + 1)
            forged = [altered.compact(), other.roster.compact(), b"{}", b"["]
            speaker = await asyncio.to_thread(UnauthorisedClient, team.endpoints, bob)
            try:
                for payload in forged:
                    counted, end_s = team.buses[0].drops.malformed, time.monotonic() + PATIENCE_S
                    while team.buses[0].drops.malformed == counted:
                        assert time.monotonic() < end_s
                        speaker.put("roster/bob", payload)
                        await asyncio.sleep(0.25)  # a sender may send five rosters a second
                for _ in range(TRIES):
                    speaker.put("roster/bob", older)
                    await asyncio.sleep(0.25)
            finally:
                await asyncio.to_thread(speaker.close)
            assert await tried(team, *settings.values(), expected=silent) == [silent] * 3
    for name in "12":
        with subtests.test("the roster is kept for the next flight", vehicle=name):
            names = {grant.common_name for grant in security_of(copied, "vehicle", name).grants}
            assert names == {"vehicle-1", "vehicle-2", "operator-bob", "positions-cameras", "observer-tower"}


def cordon(*arguments: str) -> Ran:
    """Run a command in a process of its own."""
    command = [sys.executable, "-m", "gcs", *arguments]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=2 * PATIENCE_S, check=False)
    return Ran(ran.returncode, ran.stdout, ran.stderr)


def keyed_mission(mission_file: Callable[..., str]) -> str:
    """Return a mission beside the folder of keys."""
    first = "[[vehicles]]\nid = 1\n"
    return mission_file("case2", LOW, (first, f'[network]\nteam = "{TEAM}"\nsecurity = {{ keys = "keys" }}\n\n{first}'))


class Process:
    """A process that flies one of the vehicles: its bus, its audit log, and its exchange of heads."""

    def __init__(self, keys: AuthorityFolder, vehicle_id: int, bus: ParticipantBus, folder: Path) -> None:
        self.log = folder / f"vehicle{vehicle_id}.mcap"
        self.clock = WallClock(1.0)
        self.recorded = LogWriter(self.log, Context())
        self.recording = Recording(self.recorded, self.clock)
        self.keys, self.buses, self.view = KeyFolder(keys.path), {vehicle_id: bus}, LiveView(Console(quiet=True))
        self.plan = SimpleNamespace(mission=load_mission("case2"), log=self.recorded)
        self.members = [SimpleNamespace(vehicle=SimpleNamespace(id=vehicle_id))]
        run = run_of(
            load_mission("case2"), (vehicle_id,), seed=0, source="flight", speed=1.0, began_s=1.7e9, duration_s=10.0
        )
        self.recording.note_run(run)

    def obeys(self, name: str) -> None:
        entry = AuditEntry(time.time(), "answered", 1, "bus", name, f"command/land/{name}", 1, "lands", "", "")
        self.recording.note_run(entry)


async def test_a_log_rewritten_after_the_flight_contradicts_the_heads_in_the_log_of_its_peer(
    keys: AuthorityFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(audit_exchange, "HEAD_EVERY_S", 0.5)
    async with peers(keys) as team, AsyncExitStack() as stack:
        flights = [Process(keys, k + 1, bus, tmp_path) for k, bus in enumerate(team.buses)]
        for each in flights:
            stack.enter_context(each.recording)
        exchanges = [audit_exchange.AuditExchange(cast(FlightTeam, each)) for each in flights]
        running = [asyncio.create_task(each.run()) for each in exchanges]
        flights[0].obeys("anna")
        await until(lambda: "1" in team.buses[1].heads and "2" in team.buses[0].heads, waiting_for="heads of both")
        flights[0].obeys("bob")
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
        before = team.buses[1].heads["1"]
        await exchanges[0].end()
        await until(lambda: team.buses[1].heads["1"] != before, waiting_for="the last head")
        await exchanges[1].end()
    first, second = (flight.log for flight in flights)
    entries = [each.read(AuditEntry) for each in read_log(first).run_records if each.kind is AuditEntry]
    bob = next(k for k, each in enumerate(entries) if each.operator == "bob")
    assert audit([first, second]) == Exit.HOLDS
    forged = tmp_path / "forged.mcap"
    with Recording(LogWriter(forged, Context()), WallClock(1.0)) as recording:
        recording.note_run(read_log(first).run)
        for entry in (*entries[:bob], *entries[bob + 1 : -1]):
            recording.note_run(entry)
    assert audit([forged]) == Exit.HOLDS
    capsys.readouterr()
    assert audit([forged, second]) == Exit.VERDICT_FAILED
    told = capsys.readouterr().err
    assert f"{forged}: rewritten after its entry" in told
    assert f"{second} holds the head that vehicle 1 sent of" in told
    assert audit([first, second], keys=keys.path) == Exit.HOLDS
    accusing = tmp_path / "accusing.mcap"
    with Recording(LogWriter(accusing, Context()), WallClock(1.0)) as recording:
        recording.note_run(read_log(second).run)
        (*_, head) = (
            each.read(AuditEntry)
            for each in read_log(second).run_records
            if each.kind is AuditEntry and each.read(AuditEntry).event == "head"
        )
        recording.note_run(msgspec.structs.replace(head, did="ab" * 32))
    assert audit([first, accusing], keys=keys.path) == Exit.VERDICT_FAILED
    assert "heads of other logs that their vehicles have not signed: 1" in capsys.readouterr().err


def test_a_revocation_that_reaches_nobody_is_told(
    keys: AuthorityFolder, mission_file: Callable[..., str], run_here: RunHere
) -> None:
    unsent = run_here("keys", "revoke", "sensor-mast", "--keys", str(keys.path))
    assert unsent.code == Exit.HOLDS
    assert "not sent to a running team: no --mission is given" in unsent.err
    mission = keyed_mission(mission_file)
    refused = run_here("keys", "revoke", "observer-tower", "--keys", str(keys.path), "--mission", mission)
    assert refused.code == Exit.REFUSED
    assert "choose one" in refused.err
    assert [each.label for each in keys.roster.holders if each.revoked] == ["observer-tower", "sensor-mast"]


async def test_the_command_revokes_in_flight(keys: AuthorityFolder, mission_file: Callable[..., str]) -> None:
    mission = keyed_mission(mission_file)
    endpoints = re.findall(r'endpoint = "tcp/(.*?)"', Path(mission).read_text(encoding="utf-8"))[:2]

    async def revoke(*arguments: str) -> Ran:
        there = ("--keys", str(keys.path), "--mission", mission)
        return await asyncio.to_thread(cordon, "keys", "revoke", *arguments, *there)

    async with peers(keys, endpoints) as team:
        sent = await revoke("vehicle-2", "--key", "bob")
        assert sent.code == Exit.HOLDS, sent.err
        for words in ("vehicle 1: has taken the revocation", "not on the bus or revoked: 2, 3", "next: copy"):
            assert words in sent.err
        of_itself = await revoke("operator-anna", "--key", "anna")
        assert of_itself.code == Exit.HOLDS, of_itself.err
        assert [bus.revoked for bus in team.buses] == [("operator-anna", "vehicle-2")] * 2
        assert team.present == [set(), {1}]


def test_a_flight_records_the_revocation(
    keys: AuthorityFolder, mission_file: Callable[..., str], tmp_path: Path
) -> None:
    mission, log, office = keyed_mission(mission_file), str(tmp_path / "flight.mcap"), tmp_path / "office"
    shutil.copytree(keys.path, office)
    with flown("fly", mission, "--sitl", "--speed", "2", "--log", log) as flight:
        assert flight.stderr is not None
        while "standby -> formation" not in (line := flight.stderr.readline()):
            assert line, "it has ended"
        revoke = ("keys", "revoke", "operator-anna", "--keys", str(office), "--mission", mission, "--key", "bob")
        while "vehicle 3: has taken" not in cordon(*revoke).err:
            assert flight.poll() is None
        flight.send_signal(signal.SIGINT)
        flight.communicate(timeout=2 * PATIENCE_S)
    entries = cordon("log", "audit", log)
    assert entries.code == Exit.HOLDS
    noted = [line for line in entries.out.splitlines() if "accepts nothing from operator-anna" in line]
    assert sorted(line.split("vehicle ")[1][0] for line in noted) == ["1", "2", "3"]


async def test_who_has_keys_is_heard_on_its_own_keys_only(keys: AuthorityFolder, subtests: pytest.Subtests) -> None:
    expected = {
        ("operator", "anna"): {"command/hold/anna"},
        ("sensor", "mast"): {"perception/mast"},
        ("positions", "cameras"): {"position/cameras"},
        ("observer", "tower"): set(),
        ("vehicle", "3"): {"member/3"},
    }
    async with peers(keys) as team:
        for (role, name), said in expected.items():
            with subtests.test(role=role):
                assert team.present == [{2}, {1}]
                await reaches(team, with_keys(security_of(keys, role, name)), *said)  # type: ignore[arg-type]


async def test_a_kill_needs_an_approved_key(keys: AuthorityFolder, tmp_path: Path, subtests: pytest.Subtests) -> None:
    """The authority certifies another operator of the name whose kill was approved, as no command does."""
    carol = ApproverFolder(tmp_path / "approver-carol", lambda: b"secret")
    public_key = carol.make()
    shutil.rmtree(keys.path)
    keys.init(10.0, [public_key])
    for name in "12":
        keys.issue("vehicle", name, 1.0)
    keys.issue("operator", "anna", 1.0, ("hold", "kill"))
    folder = keys.path / "operator-anna"
    approved = carol.approve(KillGrant.read(folder / "kill-request.json"))
    (folder / KILL_KEY_FILE).write_bytes((approved / KILL_KEY_FILE).read_bytes())
    (folder / KILL_KEY_FILE).chmod(0o600)
    keys.admit(approved / APPROVAL_FILE)
    own = KeyFolder(keys.path).identity("operator", "anna")
    assert own.security is not None
    pair = authority_of(keys).issue("operator-anna", time.time() + 600.0)
    forged = replace(own.security, certificate_pem=pair.certificate_pem, private_key_pem=pair.private_key_pem)
    async with peers(keys) as team:
        with subtests.test("by the authority alone"):
            await reaches(team, with_keys(forged), "command/hold/anna")
            assert team.buses[0].drops.wrong_sender > 0
        with subtests.test("by the operator"):
            ends = [f"tcp/{each}" for each in team.endpoints]
            bus = single_bus(own.participant, BusTeam(TEAM, (1, 2, 3)), None, ends, own.security)
            try:
                await bus.open(lambda *_: None, lambda *_: None, lambda *_: None)
                kill = encode(OperatorCommand(time.time(), "kill", None, "anna", 2))

                def obeyed() -> bool:
                    bus.publish("command/kill", kill)
                    return all("command/kill/anna" in heard for heard in team.heard)

                await until(obeyed)
            finally:
                await bus.close()


async def test_a_session_that_vehicles_share_admits_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    run = RunKeys(TEAM, (1, 2, 3))
    with run.held():
        operator, own = run.identity("operator").security, run.identity("vehicle").security
        assert operator is not None
        assert own is not None
        async with process(run) as team:
            with subtests.test(holder="operator"):
                await reaches(team, with_keys(operator))  # in its own name it said nothing
            with subtests.test(holder="no certificate"):
                assert await tried(team, without_keys(own)) == [NOTHING]
            with subtests.test(holder="the vehicles' certificate, elsewhere"):
                await reaches(team, with_keys(own), "member/3")  # 1 and 2 are flown here


async def test_certificates_of_several_vehicles_in_one_process(
    keys: AuthorityFolder, subtests: pytest.Subtests
) -> None:
    folder = KeyFolder(keys.path)
    async with process(folder) as team:
        third = folder.identity("vehicle", "3")
        ends, heard, present = [f"tcp/{each}" for each in team.endpoints], set[str](), set[int]()
        bus = single_bus(third.participant, BusTeam(TEAM, (1, 2, 3)), None, ends, third.security)
        try:
            await bus.open(lambda each: heard.add(key_of(each)), lambda *_: None, lambda each, _: present.add(each))

            def said() -> bool:
                for each in (*team.buses, bus):
                    each.publish("member", member(int(each.participant.name), "hold"))
                is_heard = team.heard == [{"member/2", "member/3"}, {"member/1", "member/3"}]
                return is_heard and (heard, present) == ({"member/1", "member/2"}, {1, 2})

            with subtests.test("each hears the others, also over sessions of their own"):
                await until(said)
        finally:
            await bus.close()
        await until(lambda: team.present == [{2}, {1}])
        with subtests.test("a certificate is heard on its own keys only"):
            await reaches(team, with_keys(security_of(keys, "vehicle", "3")), "member/3")


async def test_reports_reach_who_looks_on_and_none_in_the_name_of_another(keys: AuthorityFolder) -> None:
    """The keys of vehicle 3 put on the key of vehicle 1, by a program without rules, straight to an observer."""
    folder, heard = KeyFolder(keys.path), {"tower": list[BusMessage](), "mast": list[BusMessage]()}
    observed = f"127.0.0.1:{free_ports(1)[0]}"
    async with peers(keys) as team, AsyncExitStack() as stack:
        for role, name, listen in (("observer", "tower", f"tcp/{observed}"), ("sensor", "mast", None)):
            identity = folder.identity(role, name)  # type: ignore[arg-type]
            ends = [f"tcp/{each}" for each in team.endpoints]
            bus = single_bus(identity.participant, BusTeam(TEAM, (1, 2, 3)), listen, ends, identity.security)
            stack.push_async_callback(bus.close)
            await bus.open(heard[name].append, lambda *_: None, lambda *_: None)
        settings = with_keys(security_of(keys, "vehicle", "3"))
        stranger = await asyncio.to_thread(UnauthorisedClient, [observed], settings)
        stack.push_async_callback(asyncio.to_thread, stranger.close)

        def said() -> bool:
            for own in (1, 2):
                team.buses[own - 1].publish(REPORT_TOPIC, encode(VehicleReport(own, 1.0, "offboard")))
                team.buses[own - 1].publish("member", member(own, "hold"))
            for sender in (1, 3):
                stranger.put(f"{REPORT_TOPIC}/{sender}", encode(VehicleReport(sender, 1.0, "forged")))
            reported = {each.sender for each in heard["tower"] if isinstance(each, VehicleReport)}
            return reported == {1, 2, 3} and bool(heard["mast"]) and team.heard == [{"member/2"}, {"member/1"}]

        await until(said)
        for _ in range(TRIES):
            assert said()
            await asyncio.sleep(0.03)
        forged = {each.sender for each in heard["tower"] if isinstance(each, VehicleReport) and each.mode == "forged"}
        assert forged == {3}
        assert {type(each) for each in heard["mast"]} == {MemberState}
