"""Fuzzing of external inputs: readers refuse any bytes with their stated errors, within limits of time and memory.

`tests/support/fuzz_targets.py` has the readers. Inputs are valid ones, which the project's own writers make, those in
`tests/corpus`, which fuzzing has found, and changes of both.
"""

import re
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from random import Random
from types import FrameType, ModuleType
from typing import Any

import msgspec

from tests.support.paths import ROOT

CORPUS = ROOT / "tests" / "corpus"
"""A folder for each target. What once was a finding is named `found-...`; the other inputs reached new code."""
SECONDS_MAX = 5
"""Limit of processor time per input."""
WALL_SECONDS_MAX = 60.0
"""Limit of wall time per input: a busy computer stalls for seconds."""
MEMORY_MAX_BYTES = 400_000_000
"""Limit of the memory beyond that of the valid inputs."""
INPUT_MAX_BYTES = 16_384

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
_EXTREMES = (b"0", b"-1", b"1e308", b"-1e308", b"nan", b"inf", b"9" * 400, b"1e-320", b"255", b"true", b'""', b"[]")
_BYTES = (
    b"\x00",
    b"\xff",
    b"\xff" * 8,
    b"\x00" * 8,
    b"\x7f\xff\xff\xff",
    b'{"":' + b"[" * 1200,
    b"\xc1",
    b"\xdf\xff\xff\xff\xff",
)
_VALUES: tuple[object, ...] = (None, True, -1, 0, 255, 2**63, 1e308, 1e-320, "", "\x00", "a" * 200, (), {})


class HangError(BaseException):
    """An input exceeded its time limit; readers must not catch this as their own error."""


@dataclass(frozen=True)
class Target:
    """A reader: its name, valid inputs, the errors that it states, and how many changed inputs a test reads."""

    name: str
    valid: Sequence[bytes]
    read: Callable[[bytes], object]
    errors: tuple[type[Exception], ...]
    count: int

    @cached_property
    def inputs(self) -> list[bytes]:
        """All inputs that are kept."""
        return [*self.valid, *(path.read_bytes() for path in sorted((CORPUS / self.name).glob("*")))]


def faults_of(target: Target) -> list[str]:
    """Return the faults of a target on its kept inputs and on changed ones, with memory beyond the limit."""
    for valid in target.valid:
        target.read(valid)
    before_bytes = _peak_bytes()
    changed = (mutated(target, number) for number in range(target.count))
    faults = [f"{fault}input: {data!r}" for data in (*target.inputs, *changed) if (fault := fault_of(target, data))]
    if (grown_bytes := _peak_bytes() - before_bytes) > MEMORY_MAX_BYTES:
        faults.append(f"memory grew by {grown_bytes / 1e6:.0f} MB")
    return faults


def mutated(target: Target, number: int) -> bytes:
    """Return a kept input after one to four changes, the same each time for a number."""
    random = Random(f"{target.name}/{number}")
    data = random.choice(target.inputs)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        data = changed(data, random, target)
    return data


def changed(data: bytes, random: Random, target: Target) -> bytes:
    """Return an input after one change."""
    return random.choice(_MUTATIONS)(data, random, target)[:INPUT_MAX_BYTES]


def fault_of(target: Target, data: bytes) -> str:
    """Read an input; return the fault in its handling, empty if none."""
    try:
        with _limited():
            target.read(data)
    except target.errors:
        return ""
    except HangError:
        limits = f"{SECONDS_MAX} s of the processor, or {WALL_SECONDS_MAX:g} s in all"
        return f"took longer than {limits}:\n{traceback.format_exc(limit=-3)}"
    except Exception:
        return f"undeclared error:\n{traceback.format_exc(limit=-4)}"
    return ""


@contextmanager
def _limited() -> Iterator[None]:
    def end(_number: int, _frame: FrameType | None) -> None:
        raise HangError

    timers = ((signal.SIGALRM, signal.ITIMER_REAL, WALL_SECONDS_MAX), (signal.SIGPROF, signal.ITIMER_PROF, SECONDS_MAX))
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
    other = random.choice(target.inputs)
    return data[: random.randrange(len(data) + 1)] + other[random.randrange(len(other) + 1) :]


def _value(data: bytes, random: Random, _: Target) -> bytes:
    """Replace, leave out or repeat a value within a message that is encoded as msgpack or JSON."""
    for coding in (msgspec.msgpack, msgspec.json):
        with suppress(ValueError, RecursionError):
            return _encoded(coding, _with_a_value_changed(coding.decode(data), random))
    return data


def _encoded(coding: ModuleType, value: object) -> bytes:
    encoded: bytes = coding.encode(value)
    return encoded


def _with_a_value_changed(value: Any, random: Random) -> Any:
    if not isinstance(value, list | dict) or not value or random.random() < 0.1:
        return random.choice(_VALUES)
    places = range(len(value)) if isinstance(value, list) else list(value)
    place = random.choice(places)
    match random.randrange(8):
        case 0:
            del value[place]
        case 1 if isinstance(value, list):
            value.insert(place, value[place])
        case _:
            value[place] = _with_a_value_changed(value[place], random)
    return value


_MUTATIONS = (
    _flip,
    _flip,
    _overwrite,
    _insert,
    _cut,
    _leave_out,
    _repeat,
    _number,
    _number,
    _line,
    _cross,
    _value,
    _value,
)
