"""Checks of arguments of public functions, whose callers may pass anything."""

from contextlib import suppress
from numbers import Integral, Real

_LONG = 60


def is_whole(value: object) -> bool:
    """Return whether it is a whole number, numpy's included; a bool is none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def range_faults(name: str, value: object, least: float, most: float) -> list[str]:
    """Return why an argument is no number of a range, its ends included; none for one that is."""
    with suppress(OverflowError):  # a whole number beyond all floating-point ones
        if not isinstance(value, bool) and isinstance(value, Real) and least <= float(value) <= most:
            return []
    return [f"{name}: it must be a number from {least:g} to {most:g} (given: {shortened(value)})"]


def shortened(value: object) -> str:
    """Return a value as text for an error."""
    text = repr(value)
    return text if len(text) <= _LONG else f"{text[:_LONG]}..."
