"""What a parameter on the wire means, by whose firmware sends it."""

import struct
from math import nan

import pytest

from gcs.findings import AutopilotKind
from gcs.preflight_reader import parameter_value

INT32, REAL32 = 6, 9


def in_a_floats_bytes(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


@pytest.mark.parametrize(
    ("kind", "wire_type", "value", "expected"),
    [
        (AutopilotKind.PX4, INT32, in_a_floats_bytes(4), 4.0),
        (AutopilotKind.PX4, INT32, in_a_floats_bytes(10040), 10040.0),
        (AutopilotKind.PX4, INT32, in_a_floats_bytes(-1), None),  # no number: JSON has lost it on the way
        (AutopilotKind.PX4, REAL32, 1.5, 1.5),
        (AutopilotKind.ARDUPILOT, INT32, 5.0, 5.0),
        (AutopilotKind.ARDUPILOT, 2, -1.0, -1.0),
        (AutopilotKind.ARDUPILOT, REAL32, 250.0, 250.0),
        (AutopilotKind.PX4, REAL32, nan, None),
        (AutopilotKind.PX4, REAL32, None, None),
    ],
)
def test_a_parameter_means(kind: AutopilotKind, wire_type: int, value: float | None, expected: float | None) -> None:
    assert parameter_value(kind, wire_type, value) == expected
