"""The joint assignment of one sensor's sightings to tracks, by the least sum of costs."""

from collections.abc import Callable, Sequence
from typing import Any


class Assignment:
    """The linear assignment problem with rows that may stay alone; of scipy, which it imports once, before a flight."""

    def __init__(self) -> None:
        # scipy.optimize takes half a second to import: more than a tick has, and a process with one target needs none.
        from scipy.optimize import linear_sum_assignment  # noqa: PLC0415

        self._solve: Callable[[Any], tuple[Any, Any]] = linear_sum_assignment

    def columns(self, costs: Sequence[Sequence[float]], alone: float) -> list[int]:
        """Return each row's column, -1 for a row that stays alone, of the assignment with the least sum of costs.

        `costs` (rows, columns) are finite, or infinite where a row cannot have a column; a row alone costs `alone`. No
        two rows have the same column.
        """
        rows, width = len(costs), len(costs[0]) if costs else 0
        # There are as many columns for staying alone as rows, so that a solution always exists.
        square = [[*row, *(alone for _ in range(rows))] for row in costs]
        if not square:
            return []
        _, chosen = self._solve(square)
        return [column if column < width else -1 for column in chosen.tolist()]
