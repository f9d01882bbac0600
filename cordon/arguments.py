"""Checks of arguments of public functions, whose callers may pass anything."""

from numbers import Integral, Real


def is_whole(value: object) -> bool:
    """Return whether it is a whole number, numpy's included; a bool is none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def range_faults(name: str, value: object, least: float, most: float) -> list[str]:
    """Return why an argument is no number of a range, its ends included; none for one that is, and for None."""
    if not isinstance(value, bool) and isinstance(value, Real) and least <= float(value) <= most:
        return []
    return [] if value is None else [f"{name}: it must be a number from {least:g} to {most:g} (given: {value!r})"]
