"""What parameters and estimators' reports on the wire mean, by whose firmware sends them."""

import struct
from math import inf, nan

import pytest

from gcs.autopilots import ardupilot, px4
from gcs.autopilots.autopilot import Autopilot
from gcs.link.self_reports import EstimatorReport, estimator_report
from gcs.preflight.link_facts import parameter_value

INT32, REAL32 = 6, 9
GPS_FLIGHT = 0b11_0011_1111  # attitude, velocities, positions and predicted positions


def in_a_floats_bytes(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def test_a_parameter_means(subtests: pytest.Subtests) -> None:
    for kind, wire_type, value, expected in (
        (px4.AUTOPILOT, INT32, in_a_floats_bytes(10040), 10040.0),
        (px4.AUTOPILOT, INT32, in_a_floats_bytes(-1), None),  # no number: JSON has lost it on the way
        (px4.AUTOPILOT, REAL32, 1.5, 1.5),
        (ardupilot.AUTOPILOT, INT32, 5.0, 5.0),
        (px4.AUTOPILOT, REAL32, nan, None),
        (px4.AUTOPILOT, REAL32, None, None),
    ):
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


@pytest.mark.parametrize(("kind", "fields"), [(px4.AUTOPILOT, PX4_FIELDS), (ardupilot.AUTOPILOT, COPTER_FIELDS)])
def test_an_estimators_report_means(kind: Autopilot, fields: dict[str, float]) -> None:
    report = estimator_report(kind.estimator, fields | {"flags": GPS_FLIGHT})
    assert report == EstimatorReport(RATIOS, relative=True, absolute=True)
    blind = estimator_report(kind.estimator, fields | {"flags": 0b1000_0000})
    assert blind is not None
    assert (blind.relative, blind.absolute, blind.wrong) == (False, False, ("no attitude", "no height"))
    indoors = estimator_report(kind.estimator, fields | {"flags": 0b10_1111})
    assert indoors == EstimatorReport(RATIOS, relative=True, absolute=False)


def test_the_upper_flags_mean_another_thing_to_each_autopilot() -> None:
    def told(kind: Autopilot, flags: int) -> tuple[tuple[str, ...], bool]:
        report = estimator_report(kind.estimator, {"flags": GPS_FLIGHT | flags})
        assert report is not None
        return report.wrong, report.glitch

    assert told(px4.AUTOPILOT, 1024) == ((), True)
    assert told(px4.AUTOPILOT, 2048) == (("accelerometer error",), False)
    assert told(ardupilot.AUTOPILOT, 1024) == (("not initialized",), False)
    assert told(ardupilot.AUTOPILOT, 1 << 15) == ((), True)
    # On the ground ArduPilot may only predict a position; to PX4 that is none.
    predicted = {"flags": GPS_FLIGHT & ~(8 | 16)}
    for autopilot, absolute in ((px4.AUTOPILOT, False), (ardupilot.AUTOPILOT, True)):
        report = estimator_report(autopilot.estimator, predicted)
        assert report is not None
        assert report.absolute is absolute


def test_a_ratio_that_is_no_number_is_left_out() -> None:
    for spoilt in (nan, inf, None, "0.1"):
        report = estimator_report(px4.AUTOPILOT.estimator, {**PX4_FIELDS, "vel_ratio": spoilt, "flags": GPS_FLIGHT})
        assert report is not None
        assert report.ratios == {name: ratio for name, ratio in RATIOS.items() if name != "velocity"}


def test_what_is_no_report_is_none(subtests: pytest.Subtests) -> None:
    for fields in ({}, {"flags": None}, {"flags": 1.5}, {"vel_ratio": 0.1}):
        with subtests.test(fields=fields):
            assert estimator_report(px4.AUTOPILOT.estimator, fields) is None
