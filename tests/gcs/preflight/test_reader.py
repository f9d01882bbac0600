"""What parameters and estimators' reports on the wire mean, by whose firmware sends them."""

import struct
from math import inf, nan

import pytest

from gcs.link.estimator_report import EstimatorReport, estimator_report
from gcs.preflight.estimator import DIALECTS
from gcs.preflight.findings import AutopilotKind
from gcs.preflight.reader import parameter_value

INT32, REAL32 = 6, 9
GPS_FLIGHT = 0b11_0011_1111  # attitude, velocities, positions and predicted positions


def in_a_floats_bytes(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def test_a_parameter_means(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[AutopilotKind, int, float | None, float | None], ...] = (
        (AutopilotKind.PX4, INT32, in_a_floats_bytes(4), 4.0),
        (AutopilotKind.PX4, INT32, in_a_floats_bytes(10040), 10040.0),
        (AutopilotKind.PX4, INT32, in_a_floats_bytes(-1), None),  # no number: JSON has lost it on the way
        (AutopilotKind.PX4, REAL32, 1.5, 1.5),
        (AutopilotKind.ARDUPILOT, INT32, 5.0, 5.0),
        (AutopilotKind.ARDUPILOT, 2, -1.0, -1.0),
        (AutopilotKind.ARDUPILOT, REAL32, 250.0, 250.0),
        (AutopilotKind.PX4, REAL32, nan, None),
        (AutopilotKind.PX4, REAL32, None, None),
    )
    for kind, wire_type, value, expected in rows:
        with subtests.test(kind=kind, wire_type=wire_type, value=value, expected=expected):
            assert parameter_value(kind, wire_type, value) == expected


PX4_FIELDS = {"vel_ratio": 0.1, "pos_horiz_ratio": 0.2, "pos_vert_ratio": 0.3, "mag_ratio": 0.4, "hagl_ratio": 9.0}
COPTER_FIELDS = {
    "velocity_variance": 0.1,
    "pos_horiz_variance": 0.2,
    "pos_vert_variance": 0.3,
    "compass_variance": 0.4,
    "terrain_alt_variance": 9.0,
}
RATIOS = {"velocity": 0.1, "horizontal position": 0.2, "height": 0.3, "compass": 0.4}
BOTH = pytest.mark.parametrize(
    ("kind", "fields"), [(AutopilotKind.PX4, PX4_FIELDS), (AutopilotKind.ARDUPILOT, COPTER_FIELDS)]
)


@BOTH
def test_an_estimators_report_means(kind: AutopilotKind, fields: dict[str, float]) -> None:
    report = estimator_report(DIALECTS[kind], fields | {"flags": GPS_FLIGHT})
    assert report == EstimatorReport(RATIOS, relative=True, absolute=True)
    blind = estimator_report(DIALECTS[kind], fields | {"flags": 0b1000_0000})
    assert blind is not None
    assert (blind.relative, blind.absolute, blind.wrong) == (
        False,
        False,
        ("no attitude", "no height"),
    )
    indoors = estimator_report(DIALECTS[kind], fields | {"flags": 0b10_1111})
    assert indoors == EstimatorReport(RATIOS, relative=True, absolute=False)


def test_the_upper_flags_mean_another_thing_to_each_autopilot() -> None:
    px4, copter = AutopilotKind.PX4, AutopilotKind.ARDUPILOT

    def told(kind: AutopilotKind, flags: int) -> tuple[tuple[str, ...], bool]:
        report = estimator_report(DIALECTS[kind], {"flags": GPS_FLIGHT | flags})
        assert report is not None
        return report.wrong, report.glitch

    assert told(px4, 1024) == ((), True)
    assert told(px4, 2048) == (("accelerometer error",), False)
    assert told(copter, 1024) == (("not initialized",), False)
    assert told(copter, 1 << 15) == ((), True)
    # On the ground ArduPilot may only predict a position; to PX4 that is none.
    predicted = {"flags": GPS_FLIGHT & ~(8 | 16)}
    assert [
        report and report.absolute for report in (estimator_report(DIALECTS[k], predicted) for k in (px4, copter))
    ] == [
        False,
        True,
    ]


@BOTH
def test_a_ratio_that_is_no_number_is_left_out(
    subtests: pytest.Subtests, kind: AutopilotKind, fields: dict[str, float]
) -> None:
    for spoilt in (nan, inf, None, "0.1", [1.0]):
        with subtests.test(spoilt=spoilt):
            first = next(iter(fields))
            report = estimator_report(DIALECTS[kind], {**fields, first: spoilt, "flags": GPS_FLIGHT})
            assert report is not None
            assert report.ratios == {name: ratio for name, ratio in RATIOS.items() if name != "velocity"}


def test_what_is_no_report_is_none(subtests: pytest.Subtests) -> None:
    rows: tuple[dict[str, float | None], ...] = ({}, {"flags": None}, {"flags": 1.5}, {"vel_ratio": 0.1})
    for fields in rows:
        with subtests.test(fields=fields):
            assert estimator_report(DIALECTS[AutopilotKind.PX4], fields) is None
