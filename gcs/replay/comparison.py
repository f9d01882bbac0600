"""Comparison of two decisions: bit for bit, or within a tolerance where library versions differ."""

import re
from collections.abc import Callable, Iterator
from math import inf
from typing import Any, NamedTuple

import msgspec

from agents.team.codec import decode
from gcs.flightlog.records import Decision, Run
from gcs.flightlog.run import versions
from gcs.flightlog.schema import plain
from gcs.mission.planner import ChosenPlanner

TOLERANCE = 1e-3
"""Tolerance [m, m/s, rad]: solvers of other versions differ by less, and the effect on a flight is negligible."""
COVARIANCE_TOLERANCE = 1e-6
"""Tolerance of covariances, in their own units: they do not depend on a solver."""

Same = Callable[[str, Any, Any], bool]
"""Return whether a field, given by its path, has the same value in two decisions."""
_VALUES = ("tactic", "alert", "command", "guard")
_NUMBER = re.compile(r"-?\d+(?:\.(\d+))?")


class FieldDifference(NamedTuple):
    """A field of a decision, given by its path, with its recorded and its replayed value."""

    field: str
    recorded: Any
    replayed: Any


def versions_that_differ(run: Run, planner: ChosenPlanner | None = None) -> tuple[str, ...]:
    """Return the libraries and tools whose installed version differs from the one in a run, as text.

    The planner of the replay is one of them where it is not cordon's.
    """
    recorded = {each.name: each.version for each in run.versions}
    installed = {each.name: each.version for each in versions()}
    if run.planner is not None and planner is not None:
        name = f"planner {run.planner.name}"
        recorded[name] = _version(run.planner.distribution, run.planner.digest)
        installed[name] = _version(planner.distribution, planner.digest)
    return tuple(
        f"{name} {recorded.get(name, 'unknown')} in the flight, {installed.get(name, 'none')} now"
        for name in sorted({*recorded, *installed})
        if recorded.get(name) != installed.get(name)
    )


def _version(distribution: str, digest: str) -> str:
    return f"{distribution or 'no distribution'} (source {digest or 'unknown'})"


def differences(recorded: Decision, replayed: Decision, same: Same) -> list[FieldDifference]:
    """Return every field that differs between two decisions."""
    one, other = _readable(recorded), _readable(replayed)
    # Logs of 0.2.0 have neither the outcome of an answer, nor the values of a note, nor the outlook.
    for sent, again in zip(one["sent"], other["sent"], strict=False):
        if isinstance(sent["message"], dict) and sent["message"].get("outcome", "") is None and sent != again:
            again["message"]["outcome"] = None
    for note, again in zip(one["notes"], other["notes"], strict=False):
        if all(note[name] is None for name in _VALUES):
            again.update(dict.fromkeys(_VALUES))
            if note["kind"] == "guard":  # its text named the causes alone
                again["text"] = note["text"]
    if one["outlook"] is None:
        other["outlook"] = None
    return list(_compared("", one, other, same))


def identical(_: str, one: Any, other: Any) -> bool:
    """Return whether two values are equal to the last bit."""
    return repr(one) == repr(other)


def close(field: str, one: Any, other: Any) -> bool:
    """Return whether two values are equal within the tolerance; numbers in texts, within their last digit."""
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, int | float) and isinstance(other, int | float):
        tolerance = COVARIANCE_TOLERANCE if "covariance" in field else TOLERANCE
        return abs(one - other) <= tolerance or repr(one) == repr(other)
    if isinstance(one, str) and isinstance(other, str):
        return _close_texts(one, other)
    return bool(one == other)


def _close_texts(one: str, other: str) -> bool:
    if _NUMBER.sub("#", one) != _NUMBER.sub("#", other):
        return False
    pairs = zip(_NUMBER.finditer(one), _NUMBER.finditer(other), strict=True)
    return all(abs(float(a[0]) - float(b[0])) <= max(TOLERANCE, _last_digit(a), _last_digit(b)) for a, b in pairs)


def _last_digit(number: re.Match[str]) -> float:
    """Return the value of the last digit plus a rounding margin; whole numbers are counts and have to be equal."""
    return 1.001 * 10.0 ** -len(number[1] or "") if number[1] else -inf


def _readable(decision: Decision) -> dict[str, Any]:
    """Return a decision as plain data, with the messages that it sent and its answers decoded."""
    fields = plain(decision)
    fields["sent"] = [{"topic": sent.topic, "message": _decoded(sent.payload)} for sent in decision.sent]
    fields["answers"] = [_decoded(payload) for payload in decision.answers]
    return fields


def _decoded(payload: bytes) -> Any:
    try:
        message = decode(payload)
    except ValueError:
        return payload
    return {name: msgspec.to_builtins(value) for name, value in msgspec.structs.asdict(message).items()}


def _compared(path: str, one: Any, other: Any, same: Same) -> Iterator[FieldDifference]:
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        for name, value in one.items():
            yield from _compared(f"{path}.{name}" if path else name, value, other[name], same)
    elif isinstance(one, list | tuple) and isinstance(other, list | tuple) and len(one) == len(other):
        for index, (value, counterpart) in enumerate(zip(one, other, strict=True)):
            yield from _compared(f"{path}[{index}]", value, counterpart, same)
    elif not same(path, one, other):
        yield FieldDifference(path, one, other)
