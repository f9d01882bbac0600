"""The joint assignment against the least sum over all assignments."""

from collections.abc import Iterator, Sequence
from math import inf, isinf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimation.filters.assignment import Assignment

ASSIGNMENT = Assignment()
COST = st.one_of(st.floats(-50.0, 50.0), st.just(inf))


@st.composite
def tables(draw: st.DrawFn) -> list[list[float]]:
    rows, columns = draw(st.integers(0, 4)), draw(st.integers(0, 4))
    return [[draw(COST) for _ in range(columns)] for _ in range(rows)]


def every_sum(costs: Sequence[Sequence[float]], alone: float, used: frozenset[int] = frozenset()) -> Iterator[float]:
    """The sums of all assignments of the rows to columns that are not used."""
    if not costs:
        yield 0.0
        return
    first, *others = costs
    yield from (alone + rest for rest in every_sum(others, alone, used))
    for column, cost in enumerate(first):
        if column not in used and not isinf(cost):
            yield from (cost + rest for rest in every_sum(others, alone, used | {column}))


@given(tables(), st.floats(-60.0, 60.0))
def test_no_assignment_has_a_smaller_sum(costs: list[list[float]], alone: float) -> None:
    chosen = ASSIGNMENT.columns(costs, alone)
    taken = [column for column in chosen if column >= 0]
    assert len(chosen) == len(costs)
    assert len(taken) == len(set(taken))
    found = sum(alone if column < 0 else row[column] for row, column in zip(costs, chosen, strict=True))
    assert found == pytest.approx(min(every_sum(costs, alone)), abs=1e-9)


def test_a_row_gives_way_to_one_that_has_no_other_column() -> None:
    """By hand: 2 + 5 is less than 1 + 20, and 1 + 30 less than 5 + 30."""
    assert ASSIGNMENT.columns([[1.0, 2.0], [5.0, 20.0]], 30.0) == [1, 0]
    assert ASSIGNMENT.columns([[1.0, inf], [5.0, inf]], 30.0) == [0, -1]
