"""Checks of the values that a user's functions return."""

from math import isfinite

from gcs.errors import InputError


def finite_numbers(returned: object, names: tuple[str, ...], of: str) -> tuple[float, ...]:
    """Return a function's result as finite numbers, one for each name; raises InputError for anything else."""
    try:
        numbers = tuple(map(float, returned))  # type: ignore[call-overload]  # anything, until here
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != len(names) or not all(map(isfinite, numbers)):
        raise InputError([f"{of} returned {returned!r}: return ({', '.join(names)}), finite numbers"])
    return numbers
