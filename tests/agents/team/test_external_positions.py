"""Positions of vehicles from outside: whose they are, and what is refused."""

import json
from typing import Any

import pytest

from agents.team.external_positions import ExternalPosition, ExternalPositions

NOW_S = 1.8e9
GOOD: dict[str, Any] = {
    "time_s": NOW_S - 0.05,
    "poses": [{"vehicle": 1, "position_m": [1.0, 2.0, 3.0], "yaw_rad": 0.5}, {"vehicle": 2, "position_m": [4, 5, 6]}],
}


def taken(message: object, vehicle_id: int = 2) -> tuple[ExternalPosition | None, ExternalPositions, list[str]]:
    reported: list[str] = []
    positions = ExternalPositions(vehicle_id, reported.append)
    payload = message if isinstance(message, bytes) else json.dumps(message).encode()
    return positions.take(payload, NOW_S), positions, reported


def test_each_vehicle_takes_its_own_position() -> None:
    assert taken(GOOD, 1)[0] == ExternalPosition(NOW_S - 0.05, (1.0, 2.0, 3.0), 0.5)
    assert taken(GOOD, 2)[0] == ExternalPosition(NOW_S - 0.05, (4.0, 5.0, 6.0), None)
    position, positions, reported = taken(GOOD, 3)
    assert (position, positions.refused, reported) == (None, 0, [])


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (b"\xff\x00", "malformed"),
        (b'{"poses": [{"vehicle": 2, "position_m": [NaN, 0, 0]}]}', "malformed"),
        (GOOD | {"speed": 3}, "speed"),
        (GOOD | {"poses": [{"vehicle": 2, "position_m": [1.0, 2.0]}]}, "length 3"),
        (GOOD | {"poses": [{"vehicle": 2, "position_m": [1e5, 2.0, 0.0]}]}, "10000"),
        (GOOD | {"poses": [{"vehicle": i, "position_m": [1.0, 2.0, 0.0]} for i in range(65)]}, "length <= 64"),
        (GOOD | {"time_s": NOW_S - 0.51}, "0.51 s old"),
        (GOOD | {"time_s": NOW_S + 0.2}, "-0.20 s old"),
    ],
)
def test_what_is_not_a_position_of_now_is_refused_and_reported_once(message: object, why: str) -> None:
    position, positions, reported = taken(message)
    assert position is None
    assert len(reported) == 1
    assert why in reported[0]
    positions.take(b"", NOW_S)
    assert (positions.refused, len(reported)) == (2, 1)
