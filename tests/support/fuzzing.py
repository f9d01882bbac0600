"""Fuzzing of external inputs: readers refuse mutated inputs with declared errors, within time and memory limits.

Input number i of a target and a seed is always the same, so that findings can be reproduced.
"""

import re
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from random import Random
from time import process_time
from types import FrameType

import numpy as np

from agents.team.codec import decode, encode
from agents.team.messages import (
    CommandAnswer,
    MemberState,
    MissionIdentity,
    NeighbourAngle,
    OperatorCommand,
    StartProposal,
    TargetPackage,
    TargetReport,
    VehicleReport,
)
from agents.team.perception import ExternalSighting, Perception, encode_sighting
from estimation.profile.profile import ProfileError, ProfileLibrary
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import read_log
from gcs.flightlog.run import mission_of
from gcs.mission.file import MissionError, parse_mission
from gcs.mission.sections import SECTIONS
from gcs.vehicle_logs.foreign import read_vehicle_logs
from tests.support.cut_logs import BIN_KEPT, ULOG_EVERY, cut_bin, cut_ulog
from tests.support.flight_logs import engaging, record_simulation
from tests.support.paths import DATA, MISSIONS, PROFILES
from tests.support.telemetry_log import Station

LIMIT_S = 5.0
"""Limit of processor time per input."""
WALL_LIMIT_S = 60.0
"""Limit of wall time per input: a busy computer stalls for seconds."""
MEMORY_MAX_BYTES = 400_000_000
"""Limit of the memory of a run beyond that of the valid inputs."""

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
_EXTREMES = (b"0", b"-1", b"1e308", b"-1e308", b"nan", b"inf", b"9" * 400, b"1e-320", b"255", b"true", b'""', b"[]")
_BYTES = (b"\x00", b"\xff", b"\xff" * 8, b"\x00" * 8, b"\x7f\xff\xff\xff", b"[" * 400, b"\xc1", b"\xdf\xff\xff\xff\xff")

Read = Callable[[bytes], object]


class HangError(BaseException):
    """An input exceeded its time limit; readers must not catch this as their own error."""


@dataclass(frozen=True)
class Target:
    """A reader of inputs: its name, valid inputs, share of a run, and the errors that it may raise."""

    name: str
    valid: Sequence[bytes]
    read: Read
    share: float
    errors: tuple[type[Exception], ...]


@dataclass
class Findings:
    """The findings of a run: a line for each input that was handled wrongly, and the slowest inputs."""

    counts: dict[str, int] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    slowest_s: dict[str, float] = field(default_factory=dict)
    memory_bytes: int = 0


def targets(folder: Path) -> list[Target]:
    """Return all readers of external inputs; logs are written to `folder` for reading."""
    file = folder / "fuzzed.log"

    def written(read: Callable[[Path], object]) -> Read:
        def read_file(data: bytes) -> object:
            file.write_bytes(data)
            return read(file)

        return read_file

    logs = {
        "ulog": _small_ulog(),
        "dataflash": cut_bin((DATA / "arducopter.bin").read_bytes(), 60_000_000, BIN_KEPT),
        "tlog": _small_tlog(),
    }
    record_simulation(engaging(), folder / "valid.mcap", duration_s=2.0, flush_s=0.5)
    own = (folder / "valid.mcap").read_bytes()
    refusing = (LogError,)
    return [
        Target("bus", _messages(), _read_bus, 0.55, (ValueError,)),
        Target("sighting", _sightings(), _Sightings().read, 0.15, ()),
        Target("profile", [path.read_bytes() for path in sorted(PROFILES.glob("*.toml"))], _read_profile, 0.15, ()),
        Target("mission", [path.read_bytes() for path in sorted(MISSIONS.glob("*.toml"))], _read_mission, 0.06, ()),
        Target("mcap", [own], written(_read_own), 0.02, refusing),
        Target("mcap as a vehicle's log", [own], written(_read_vehicles), 0.01, refusing),
        *(Target(name, [log], written(_read_vehicles), 0.02, refusing) for name, log in logs.items()),
    ]


def run(
    fuzzed: Sequence[Target], count: int, seed: int, note: Callable[[str, int], None] = lambda *_: None
) -> Findings:
    """Read `count` inputs in all; `note` receives the target and the number of each input."""
    findings = Findings()
    for target in fuzzed:
        for valid in target.valid:
            target.read(valid)
    before_bytes = _peak_bytes()
    for target in fuzzed:
        findings.counts[target.name] = round(count * target.share)
        for number in range(findings.counts[target.name]):
            note(target.name, number)
            began_s = process_time()
            if fault := fault_of(target, mutated(target, seed, number)):
                findings.faults.append(f"{target.name}, seed {seed}, input {number}: {fault}")
            took_s = process_time() - began_s
            findings.slowest_s[target.name] = max(took_s, findings.slowest_s.get(target.name, 0.0))
    findings.memory_bytes = _peak_bytes() - before_bytes
    return findings


def mutated(target: Target, seed: int, number: int) -> bytes:
    """Return one of a target's inputs: a valid one after one to four changes."""
    random = Random(f"{seed}/{target.name}/{number}")
    data = random.choice(target.valid)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        data = random.choice(_MUTATIONS)(data, random, target)
    return data


def fault_of(target: Target, data: bytes) -> str:
    """Read an input; return the fault in its handling, empty if none."""
    try:
        with _limited():
            target.read(data)
    except target.errors:
        return ""
    except HangError:
        limits = f"{LIMIT_S:g} s of the processor, or {WALL_LIMIT_S:g} s in all"
        return f"took longer than {limits}:\n{traceback.format_exc(limit=-3)}"
    except Exception:
        return f"undeclared error:\n{traceback.format_exc(limit=-4)}"
    return ""


@contextmanager
def _limited() -> Iterator[None]:
    def end(_number: int, _frame: FrameType | None) -> None:
        raise HangError

    timers = ((signal.SIGALRM, signal.ITIMER_REAL, WALL_LIMIT_S), (signal.SIGPROF, signal.ITIMER_PROF, LIMIT_S))
    before = [signal.signal(number, end) for number, _, _ in timers]
    for _, timer, limit_s in timers:
        signal.setitimer(timer, limit_s)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(number, handler)


def _peak_bytes() -> int:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


# Mutations.


def _flip(data: bytes, random: Random, _: Target) -> bytes:
    at = random.randrange(len(data) or 1)
    return data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :] if data else data


def _overwrite(data: bytes, random: Random, _: Target) -> bytes:
    at, piece = random.randrange(len(data) or 1), random.choice((*_BYTES, random.randbytes(random.randrange(1, 16))))
    return data[:at] + piece + data[at + len(piece) :]


def _insert(data: bytes, random: Random, _: Target) -> bytes:
    at, piece = random.randrange(len(data) + 1), random.choice((*_BYTES, random.randbytes(random.randrange(1, 64))))
    return data[:at] + piece + data[at:]


def _cut(data: bytes, random: Random, _: Target) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _leave_out(data: bytes, random: Random, _: Target) -> bytes:
    at = random.randrange(len(data) + 1)
    return data[:at] + data[at + random.randrange(1, 64) :]


def _repeat(data: bytes, random: Random, _: Target) -> bytes:
    at, length = random.randrange(len(data) + 1), random.randrange(1, 200)
    return data[:at] + data[at : at + length] * random.choice((2, 2, 50)) + data[at + length :]


def _number(data: bytes, random: Random, _: Target) -> bytes:
    """Replace a number in a text."""
    places = list(_NUMBER.finditer(data[:20_000]))
    if not places:
        return data
    place = random.choice(places)
    return data[: place.start()] + random.choice(_EXTREMES) + data[place.end() :]


def _line(data: bytes, random: Random, _: Target) -> bytes:
    """Move or duplicate a line of a text."""
    lines = data.split(b"\n")
    line = random.choice(lines)
    if random.random() < 0.5:
        lines.remove(line)
    lines.insert(random.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


def _cross(data: bytes, random: Random, target: Target) -> bytes:
    other = random.choice(target.valid)
    return data[: random.randrange(len(data) + 1)] + other[random.randrange(len(other) + 1) :]


_MUTATIONS = (_flip, _flip, _overwrite, _insert, _cut, _leave_out, _repeat, _number, _number, _line, _cross)


# Targets.


def _messages() -> list[bytes]:
    two = (1.0, -2.0)
    angle = NeighbourAngle(2, 1e9, 1.0, 0.05, 10.0)
    package = TargetPackage(2, 1e9, two, (1.0, 0.0, 1.0), 0.8, 0.2, (1, 2))
    messages = (
        MemberState(1, 1e9, "formation", two, two, two, two, 8.0, 0.1, "battery low", "wedge", 1e9),
        MemberState(2, 1e9, "encircle", two, two, two, two, angle=angle, sightings=(package,)),
        StartProposal(1, 1e9, 1e9 + 2.0, mission=MissionIdentity("case2", "0123456789abcdef")),
        OperatorCommand(1e9, "formation", None, "somebody@somewhere", 7, "line"),
        CommandAnswer(2, 1e9, 7, "holds"),
        VehicleReport(1, 1e9, "offboard", ended="landed", target=TargetReport(two, two, (1.0, 0.0, 1.0), 0.5)),
    )
    return [encode(message) for message in messages]


def _read_bus(data: bytes) -> object:
    return decode(data)


def _sightings() -> list[bytes]:
    covariance = (1.0, 0.1, 1.0)
    return [
        encode_sighting(ExternalSighting("mission", (35.0, -5.0), covariance, 0.8, 0.2, time_s=1e9, source=3)),
        encode_sighting(ExternalSighting("geodetic", (47.3977, 8.5456), covariance, 0.8, 0.2, altitude_m=3.0)),
    ]


class _Sightings:
    """A vehicle's reader of external sightings, which refuses by returning None."""

    def __init__(self) -> None:
        self._perception = Perception(engaging("case2").mission_frame(), lambda _: None)

    def read(self, data: bytes) -> object:
        return self._perception.take(data, 1e9, 1.0)


def _read_profile(data: bytes) -> object:
    with suppress(ProfileError):
        return ProfileLibrary(None, {"own": data.decode(errors="replace")}).load("own")
    return None


def _read_mission(data: bytes) -> object:
    """Read a sound mission, or faults of which each is a line."""
    try:
        mission = parse_mission(data.decode(errors="replace"), None)
    except MissionError as error:
        if not error.faults or any(len(fault.splitlines()) != 1 for fault in error.faults):
            raise AssertionError(error.faults) from error
        return None
    assert len(set(mission.ids)) == len({each.system_id for each in mission.vehicles}) == len(mission.vehicles) > 0
    assert mission.formation.leader in mission.ids
    for name in SECTIONS.keys() - {"decision"}:
        assert all(map(isfinite, _numbers(getattr(mission, name).model_dump())))
    for vehicle in mission.vehicles:
        assert all(map(isfinite, _numbers(vehicle.section.model_dump(exclude_unset=True))))
        assert all(map(isfinite, _numbers(vehicle.own_filter.model_dump())))
        assert mission.agent_config(vehicle).vehicle_id == vehicle.id
    return mission


def _numbers(value: object) -> Iterator[float]:
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
        yield from _numbers(part)
    if isinstance(value, float):
        yield value


def _read_own(path: Path) -> object:
    log = read_log(path)
    for records in (log.run_records, *log.vehicles.values()):
        for record in records[::7]:
            record.read(record.kind)
    return mission_of(log)


def _read_vehicles(path: Path) -> object:
    """Read logs that keep their promises, or a fault that names the file."""
    try:
        logs = read_vehicle_logs(path)
    except LogError as error:
        if not all(path.name in fault for fault in error.faults):
            raise AssertionError(error.faults) from error
        raise
    assert logs
    for log in logs:
        assert log.duration_s >= 0.0
        for name, series in log.series().items():
            assert (np.diff(series.time_s) > 0.0).all()
            assert np.isfinite(series.values).all() or name in ("setpoint", "battery")
            assert series.time_s[0] >= 0.0
    return logs


def _small_ulog() -> bytes:
    every: Mapping[str, int] = {name: 8 * each for name, each in ULOG_EVERY.items()}
    return cut_ulog((DATA / "px4-quad.ulg").read_bytes(), (20_500_000, 24_000_000), dict(every))


def _small_tlog() -> bytes:
    station = Station([1], 1.0)
    station.run(3.0)
    return bytes(station.log)
