"""Command a flying team while adversaries act on it at random: an authorised hold or kill must arrive within a second.

Stubs fly with issued keys on a governed clock at the speed of the wall's. In each round one or two adversaries act,
each a process of its own, and an operator who has just joined sends hold to all vehicles, or kill to one. The audit
logs of the flights are the judge: every vehicle has to have received the command and not refused it within a second,
and to have obeyed nobody else. Adversaries are an outsider without keys, another user of this computer (only as root),
and insiders with valid keys of a vehicle, of an operator who may only hold, and of a sensor. With --apart (only as
root) each vehicle flies in a process of its own, and the operator and the adversaries, but for the other user, are each
on a computer of their own: in a network namespace. Exit code 1 if a round failed.
"""

import asyncio
import json
import os
import socket
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Any, Literal

import numpy as np
import pytest
import zenoh

from agents.ports import VehicleRefusedError
from agents.team.codec import decode, encode
from agents.team.messages import TIME_MAX_S, CommandAnswer, MemberState, MissionIdentity, OperatorCommand, StartProposal
from agents.team.perception import ExternalSighting, encode_sighting
from agents.team.verbs import Verb
from cordon.lockstep import LockstepClient
from gcs.console.command_client import CommandClient
from gcs.errors import InputError
from gcs.flight.stubs import url_ports
from gcs.flightlog.audit import AuditEntry
from gcs.flightlog.reader import read_log
from gcs.keys.authority_folder import AuthorityFolder
from gcs.keys.key_folder import KeyFolder
from gcs.link.ports import free_ports
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.experiments.arguments import parser
from tests.support.computers import Computer, computers
from tests.support.paths import ROOT, finds_tests
from tests.support.ring_mission import ring_mission

Kind = Literal["outsider", "other user", "vehicle", "operator", "sensor"]
KINDS: Sequence[Kind] = ("outsider", "other user", "vehicle", "operator", "sensor")
COMMANDER, HOLDER, SENSOR = "anna", "eve", "mast"
NOBODY = 65534
HOLDS = 24
"""The rounds of a flight with hold; a kill of each vehicle follows."""
WITHIN_S = 1.0
IN_FLIGHT_WITHIN_S, ENDS_WITHIN_S = 180.0, 120.0
CONNECTIONS = 400
Say = Callable[[str, bytes], None]


@dataclass(frozen=True)
class Round:
    """One command: who acted meanwhile, and when it was sent on the team's clock [s]."""

    kinds: Sequence[Kind]
    verb: Verb
    vehicles: Sequence[int]
    number: int
    sent_s: float


@dataclass(frozen=True)
class Site:
    """The computers of the vehicles, of the operator and of the adversaries; None is this one for all."""

    folder: Path
    vehicles: Computer | None = None
    operator: Computer | None = None
    adversaries: Computer | None = None

    def run(self, computer: Computer | None, *arguments: str, **options: Any) -> "subprocess.Popen[str]":
        """Start a Python program there; those of other computers do not find the runtime directory of the flight's."""
        line = [sys.executable, *arguments]
        environment = finds_tests()
        if computer is not None:
            runtime = self.folder / f"runtime-{computer.namespace}"
            runtime.mkdir(mode=0o700, exist_ok=True)
            environment["XDG_RUNTIME_DIR"] = str(runtime)
            line = computer.command(*line)
        return subprocess.Popen(line, cwd=ROOT, env=environment, text=True, **options)

    def child(self, computer: Computer | None, act: str, mission: Path, stack: ExitStack) -> "subprocess.Popen[str]":
        """Start this program there to act, until the end of a context."""
        line = ("-m", __spec__.name, "--act", act, str(mission))
        process = stack.enter_context(self.run(computer, *line, stdin=subprocess.PIPE, stdout=subprocess.PIPE))
        stack.callback(process.kill)
        assert process.stdout is not None
        process.stdout.readline()
        return process


# Adversaries


def endpoints(mission: Mission) -> list[tuple[str, int]]:
    """Return where the vehicles are reached on the bus."""
    found = (vehicle.section.endpoint.partition("/")[2].rpartition(":") for vehicle in mission.vehicles)
    return [(host, int(port)) for host, _, port in found]


def idle(mission: Mission, random: np.random.Generator, over: Event) -> None:
    """Open connections that say nothing, or nonsense, and keep them or open others."""
    nonsense, keeps = random.bytes(int(random.integers(0, 200))), random.random() < 0.5
    held = list[socket.socket]()
    while not over.wait(0.002):
        if len(held) >= CONNECTIONS:
            if keeps:
                continue
            held.pop(0).close()
        with suppress(OSError):
            held.append(socket.create_connection(endpoints(mission)[int(random.integers(len(mission.ids)))], 0.2))
            held[-1].sendall(nonsense)
    for each in held:
        each.close()


def impostor(mission: Mission, random: np.random.Generator, over: Event) -> None:
    """Send nonsense to the UDP ports where autopilots are received."""
    ports = list(url_ports(mission, mission.ids).values())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while not over.wait(0.002):
            with suppress(OSError):
                nonsense = b"\xfd" + random.bytes(int(random.integers(1, 280)))
                sender.sendto(nonsense, ("127.0.0.1", ports[int(random.integers(len(ports)))]))


def uninvited(mission: Mission, random: np.random.Generator, over: Event) -> None:
    """Join without keys, and command."""
    scheme = "tls" if random.random() < 0.5 else "tcp"
    session = joined(mission, {"connect/endpoints": [f"{scheme}/{host}:{port}" for host, port in endpoints(mission)]})
    while not over.wait(0.01):
        number = int(random.integers(2**32))
        session.put(*command_of(mission, "kill", COMMANDER, number, time.time()))
    session.close()  # type: ignore[no-untyped-call]


def joined(mission: Mission, settings: dict[str, object]) -> zenoh.Session:
    """Open a plain session without access control."""
    config = zenoh.Config()
    for path, value in {
        "mode": "peer",
        "listen/endpoints": [],
        "connect/endpoints": [f"tls/{host}:{port}" for host, port in endpoints(mission)],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 1},
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,
        **settings,
    }.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def command_of(mission: Mission, verb: Verb, name: str, number: int, now_s: float) -> tuple[str, bytes]:
    """Return the full key and the payload of a command to all."""
    command = OperatorCommand(now_s, verb, None, name, number)
    return f"cordon/{mission.network.team}/command/{verb}/{name}", encode(command)


class Insider:
    """Has the keys of a vehicle, of an operator who may hold, or of a sensor, and says what it may and what not."""

    def __init__(self, kind: Kind, mission: Mission, keys: KeyFolder) -> None:
        role, name = {
            "vehicle": ("vehicle", str(mission.ids[-1])),
            "operator": ("operator", HOLDER),
            "sensor": ("sensor", SENSOR),
        }[kind]
        self._kind, self._mission, self._name = kind, mission, name
        security = keys.identity(role, name).security  # type: ignore[arg-type]
        assert security is not None
        team = mission.network.team
        self._session = joined(mission, {"transport/link/tls": security.settings(team)["transport/link/tls"]})
        self._prefix = f"cordon/{team}"
        self._number, self._now_s = 0, time.time()
        self._session.declare_subscriber(f"{self._prefix}/**", self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        """Learn the team's time and the number of the newest command."""
        with suppress(ValueError):
            message = decode(sample.payload.to_bytes())
            if isinstance(message, MemberState) and message.sender == self._mission.ids[0]:
                self._now_s = message.time_s
            if isinstance(message, CommandAnswer | OperatorCommand):
                self._number = message.number

    def __call__(self, _mission: Mission, random: np.random.Generator, over: Event) -> None:
        """Act."""
        says = {"vehicle": self._as_vehicle, "operator": self._as_operator, "sensor": self._as_sensor}[self._kind]
        off_s = float(random.choice([0.0, -60.0, 60.0, 1e9, TIME_MAX_S]))
        period_s = 1.0 / float(random.choice([10.0, 50.0, 200.0]))
        aims = [int(each) for each in random.choice(4, 2)]
        while not over.wait(period_s):
            for aim in aims:
                key, payload = says(aim, random, min(self._now_s + off_s, TIME_MAX_S))
                self._session.put(f"{self._prefix}/{key}", payload)
            verb, name = str(random.choice(["kill", "land"])), str(random.choice([COMMANDER, HOLDER, self._name]))
            number = int(random.choice([self._number, self._number + 1])) % 2**32
            self._session.put(*command_of(self._mission, verb, name, number, self._now_s))  # type: ignore[arg-type]

    def _as_vehicle(self, aim: int, random: np.random.Generator, now_s: float) -> tuple[str, bytes]:
        own = int(self._name)
        match aim:
            case 0:
                other = MissionIdentity("another", "0" * 16)
                return f"start/{own}", encode(StartProposal(own, now_s, None, mission=other))
            case 1:
                place = (float(random.normal(0.0, 20.0)), float(random.normal(0.0, 20.0)))
                state = MemberState(own, now_s, "encircle", place, (0.0, 0.0), place, (0.0, 0.0), 8.0)
                return f"member/{own}", encode(state)
            case 2:
                lie = CommandAnswer(own, now_s, self._number, "motors cut", "kill", COMMANDER, "obeyed")
                return f"answer/{own}", encode(lie)
            case _:
                return f"member/{own}", random.bytes(64)

    def _as_operator(self, aim: int, random: np.random.Generator, now_s: float) -> tuple[str, bytes]:
        number = (self._number + 1 + aim) % 2**32 if aim < 3 else int(random.integers(2**32))
        return f"command/hold/{HOLDER}", encode(OperatorCommand(now_s, "hold", None, HOLDER, number))

    def _as_sensor(self, aim: int, random: np.random.Generator, _now_s: float) -> tuple[str, bytes]:
        if aim == 0:
            return f"perception/{SENSOR}", random.bytes(200)
        place = (float(random.normal(0.0, 3.0)), float(random.normal(0.0, 3.0)))
        sighting = ExternalSighting("mission", place, (0.5, 0.0, 0.5), 0.9, 0.1)
        return f"perception/{SENSOR}", encode_sighting(sighting)


def adversary(kind: Kind, mission_path: str) -> None:
    """Act from each line `begin SEED` on standard input until the next line `end`; answer each with a line."""
    mission = load_mission(mission_path)
    if kind in ("outsider", "other user"):
        if kind == "other user":
            "".encode("idna")  # the codec is imported here: another user may not read this user's Python
            os.environ.pop("XDG_RUNTIME_DIR", None)
            os.setuid(NOBODY)
        acts: Sequence[Callable[[Mission, np.random.Generator, Event], None]] = (idle, impostor, uninvited)
    else:
        acts = (Insider(kind, mission, KeyFolder(Path(mission_path).parent / "keys")),)
    over, acting = Event(), list[Thread]()
    print("ready", flush=True)
    for line in sys.stdin:
        word, _, seed = line.strip().partition(" ")
        if word == "begin":
            random = np.random.default_rng(int(seed))
            over.clear()
            act = acts[int(random.integers(len(acts)))]
            acting = [Thread(target=act, args=(mission, random, over), daemon=True)]
            acting[0].start()
        else:
            over.set()
            for each in acting:
                each.join()
        print(word, flush=True)
    os._exit(0)


# The operator


async def wait_for_flight(mission: Mission) -> str:
    """Wait until every vehicle has left the ground; return "done", or the tactics by the end of the time."""
    client = CommandClient(mission, KeyFolder(mission.folder / "keys").identity("operator", COMMANDER))
    end_s = time.monotonic() + IN_FLIGHT_WITHIN_S
    await client.open()
    try:
        while len(client.tactics) < len(mission.ids) or {*client.tactics.values()} - {"formation", "encircle"}:
            if time.monotonic() > end_s:
                return f"not in flight: {client.tactics}"
            await asyncio.sleep(0.1)
    finally:
        await client.close()
    return "done"


async def command(mission: Mission, verb: Verb, vehicle: int | None, number: int) -> str:
    """Let an operator join, command and leave; return "done", or why not."""
    operator = KeyFolder(mission.folder / "keys").identity("operator", COMMANDER)
    asked = mission.ids if vehicle is None else (vehicle,)
    try:
        await CommandClient(mission, operator).command(verb, asked, vehicle, number=number)
    except VehicleRefusedError as error:
        return str(error)
    return "done"


def operator(mission_path: str) -> None:
    """Wait for the flight at each line `wait`, and send the command of each line `VERB VEHICLE NUMBER` (0: all)."""
    mission = load_mission(mission_path)
    print("ready", flush=True)
    for line in sys.stdin:
        match line.split():
            case [verb, vehicle, number]:
                print(asyncio.run(command(mission, verb, int(vehicle) or None, int(number))), flush=True)  # type: ignore[arg-type]
            case _:
                print(asyncio.run(wait_for_flight(mission)), flush=True)
    os._exit(0)


# Flights


def told(process: "subprocess.Popen[str]", line: str) -> str:
    """Send a line to a process that acts, and return its answer."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{line}\n")
    process.stdin.flush()
    return process.stdout.readline().strip()


def started(site: Site, mission: Path, stack: ExitStack) -> dict[Kind, "subprocess.Popen[str]"]:
    """Start one process for each kind of adversary; another user of the vehicles' computer needs root."""
    kinds = [each for each in KINDS if each != "other user" or os.geteuid() == 0]
    where = {"other user": site.vehicles}
    return {kind: site.child(where.get(kind, site.adversaries), kind, mission, stack) for kind in kinds}


def write_mission(site: Site, vehicles: int) -> Path:
    """Write the mission of a team, and issue its keys."""
    ports, folder = free_ports(2 * vehicles), site.folder
    path = folder / "ring.toml"
    text = ring_mission(vehicles, 3600.0, ports[:vehicles], ports[vehicles:])
    if site.vehicles is not None:
        text = text.replace("tcp/127.0.0.1", f"tcp/{site.vehicles.address}")
    path.write_text(f'{text}\n[network.security]\nkeys = "keys"\n', encoding="utf-8")
    keys = AuthorityFolder(folder / "keys")
    keys.init(10.0)
    for number in range(vehicles):
        keys.issue("vehicle", str(number + 1), 1.0)
    keys.issue("operator", COMMANDER, 1.0, ("hold", "resume", "kill"))
    keys.issue("operator", HOLDER, 1.0, ("hold",))
    keys.issue("sensor", SENSOR, 1.0)
    return path


def flights(site: Site, mission: Path, ids: Sequence[int], stack: ExitStack) -> list["subprocess.Popen[str]"]:
    """Start the stubs and their flight, or one for each vehicle; each writes a log `flight-*.mcap`."""
    quiet: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    lines: list[tuple[str, ...]] = [("fly", str(mission), "--sitl")]
    if site.vehicles is not None:
        lines = [("fly", str(mission), "--only", str(each)) for each in ids]
        stubs = site.run(
            site.vehicles, "-m", "gcs", "sitl", str(mission), "--lockstep", stdout=subprocess.DEVNULL, **quiet
        )
        stack.callback(stubs.wait)
        stack.callback(stubs.terminate)
    flying = []
    for number, line in enumerate(lines):
        options = ("--json", "--log", str(site.folder / f"flight-{number}.mcap"))
        with (site.folder / f"result-{number}.json").open("wb") as result:
            flying.append(site.run(site.vehicles, "-m", "gcs", *line, *options, stdout=result, **quiet))
        stack.callback(flying[-1].kill)
    return flying


@dataclass(frozen=True)
class Flown:
    """A flight: its rounds, the commander's commands by number, and the entries of the audit logs."""

    rounds: Sequence[Round]
    sent: Mapping[int, Verb]
    entries: Sequence[AuditEntry]


def fly(site: Site, vehicles: int, seed: int, rounds: int, acting: Sequence[Kind]) -> Flown:
    """Fly a team for this many rounds at most."""
    random, flown, sent = np.random.default_rng(seed), list[Round](), dict[int, Verb]()
    with ExitStack() as stack:
        path = write_mission(site, vehicles)
        mission = load_mission(str(path))
        flying = flights(site, path, mission.ids, stack)
        clock = _clock(mission, flying, stack)
        commander = site.child(site.operator, "commander", path, stack)
        if (answer := told(commander, "wait")) != "done":
            raise RuntimeError(answer)
        enemies = started(site, path, stack)
        plan: list[tuple[Verb, int | None]] = [("hold", None)] * HOLDS
        plan += [("kill", int(each)) for each in random.permutation(mission.ids)]
        for verb, vehicle in plan[-rounds:]:
            if all(each.poll() is not None for each in flying):
                print(
                    f"the flight has ended by itself: {(site.folder / 'result-0.json').read_text()[-300:]}", flush=True
                )
                break
            present = [each for each in acting if each in enemies]
            kinds = [str(each) for each in random.choice(present, min(len(present), int(random.integers(1, 3))), False)]
            for kind in kinds:
                told(enemies[kind], f"begin {random.integers(2**31)}")  # type: ignore[index]
            time.sleep(float(random.uniform(0.2, 1.5)))
            number, sent_s = int(random.integers(2**32)), clock.now_s
            sent[number] = verb
            told(commander, f"{verb} {vehicle or 0} {number}")
            for kind in kinds:
                told(enemies[kind], "end")  # type: ignore[index]
            asked = mission.ids if vehicle is None else (vehicle,)
            flown.append(Round(kinds, verb, asked, number, sent_s))  # type: ignore[arg-type]
            if verb == "hold":
                sent[number := int(random.integers(2**32))] = "resume"
                told(commander, f"resume 0 {number}")
        for each in flying:
            with suppress(subprocess.TimeoutExpired):
                each.wait(ENDS_WITHIN_S)
            if each.poll() is None:
                each.terminate()
                each.wait(ENDS_WITHIN_S)
        logs = [read_log(each) for each in sorted(site.folder.glob("flight-*.mcap"))]
        entries = [each.read(AuditEntry) for log in logs for each in log.run_records if each.kind is AuditEntry]
    return Flown(flown, sent, entries)


def _clock(mission: Mission, flying: Sequence["subprocess.Popen[str]"], stack: ExitStack) -> LockstepClient:
    end_s = time.monotonic() + IN_FLIGHT_WITHIN_S
    while all(each.poll() is None for each in flying) and time.monotonic() < end_s:
        with suppress(InputError):
            return stack.enter_context(LockstepClient(*url_ports(mission, mission.ids).values()))
        time.sleep(0.2)
    raise RuntimeError("the flight did not begin")


def judged(flown: Flown) -> Iterator[tuple[Round, float, str]]:
    """Yield each round with its slowest answer [s], and what failed, empty if nothing did."""
    answered = defaultdict[int, dict[int, AuditEntry]](dict)
    own = [each for each in _answers(flown) if _is_own(each, flown)]
    ended_s = {each.vehicle: each.time_s for each in own if each.did == "motors cut"}
    for each in own:
        before = answered[each.command].setdefault(each.vehicle, each)
        if before.did.startswith("refused"):  # for its date, and carried out as it is repeated
            answered[each.command][each.vehicle] = each
    for one in flown.rounds:
        answers, slowest_s, faults = answered[one.number], 0.0, list[str]()
        for vehicle in one.vehicles:
            if ended_s.get(vehicle, np.inf) < one.sent_s:
                continue
            answer = answers.get(vehicle)
            slowest_s = max(slowest_s, np.inf if answer is None else answer.time_s - one.sent_s)
            if answer is None:
                faults.append(f"{vehicle} did not hear it")
            elif answer.did.startswith("refused"):
                faults.append(f"{vehicle} {answer.did}")
            elif answer.time_s - one.sent_s > WITHIN_S:
                faults.append(f"{vehicle} after {answer.time_s - one.sent_s:.1f} s")
        yield one, slowest_s, "; ".join(faults)


def usurped(flown: Flown) -> list[str]:
    """Return what vehicles did for one who may not command it, or in the commander's name without its command."""
    return [
        f"{each.operator}: {each.key}: {each.did}"
        for each in _answers(flown)
        if not (
            each.did.startswith("refused") or _is_own(each, flown) or (each.operator, _verb(each)) == (HOLDER, "hold")
        )
    ]


def _answers(flown: Flown) -> Iterator[AuditEntry]:
    return (each for each in flown.entries if each.event == "answered")


def _is_own(entry: AuditEntry, flown: Flown) -> bool:
    """Return whether an entry is of a command that the commander sent: the number and its verb."""
    return entry.operator == COMMANDER and flown.sent.get(entry.command) == _verb(entry)


def _verb(entry: AuditEntry) -> str:
    return entry.key.split("/")[1]


@contextmanager
def sites(*, apart: bool) -> Iterator[Site]:
    """Make a folder, and computers where the team is apart."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        if os.geteuid() == 0:
            folder.chmod(0o755)  # another user of the computer may read the mission
        yield Site(folder, *(stack.enter_context(computers(3)) if apart else ()))


def main(sizes: Sequence[int], rounds: int, seed: int, acting: Sequence[Kind], *, apart: bool) -> int:
    """Fly until each size has had this many rounds; print a table of the kinds of adversaries."""
    failed = 0
    for vehicles in sizes:
        left, teams = rounds, 0
        slowest_s, faults = defaultdict[str, list[float]](list), Counter[str]()
        usurpations = list[str]()
        while left > 0 and teams < rounds:
            with sites(apart=apart) as site:
                flown = fly(site, vehicles, seed + teams, left, acting)
            teams, left = teams + 1, left - len(flown.rounds)
            usurpations += usurped(flown)
            for one, after_s, fault in judged(flown):
                for kind in one.kinds:
                    slowest_s[f"{kind}, {one.verb}"].append(after_s)
                if fault:
                    faults["failed"] += 1
                    print(f"{vehicles} vehicles, seed {seed + teams - 1}: {one.verb}, {one.kinds}: {fault}", flush=True)
        print(f"\n{vehicles} vehicles, {rounds - left} rounds in {teams} flights: {faults['failed']} failed")
        print("| adversary, command | rounds | median, s | slowest, s |\n|---|---|---|---|")
        for what, times_s in sorted(slowest_s.items()):
            print(f"| {what} | {len(times_s)} | {np.median(times_s):.2f} | {max(times_s):.2f} |")
        print(f"obeyed others: {len(usurpations)} {usurpations[:5]}", flush=True)
        failed += faults["failed"] + len(usurpations) + max(left, 0)
    return int(failed > 0)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--act", "commander", path]:
            operator(path)
        case ["--act", kind, path]:
            adversary(kind, path)  # type: ignore[arg-type]
    reader = parser("adversaries", __doc__ or "")
    reader.add_argument("vehicles", nargs="*", type=int, default=[3, 8], help="team sizes (default: 3 8)")
    reader.add_argument("--rounds", type=int, default=500, help="rounds for each size (default: %(default)s)")
    reader.add_argument("--seed", type=int, default=0, help="first seed (default: %(default)s)")
    reader.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS, help="adversaries (default: all)")
    reader.add_argument("--apart", action="store_true", help="processes and computers of their own (as root)")
    given = reader.parse_args()
    try:
        sys.exit(main(given.vehicles, given.rounds, given.seed, given.kinds, apart=given.apart))
    except pytest.skip.Exception as reason:
        sys.exit(str(reason))
