"""Logs of real firmware, against the same flights as the client recorded them on its own."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from estimation.state import Vector
from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import Series, Span, VehicleLog, describe
from tests.support.paths import DATA

pytestmark = pytest.mark.filterwarnings("error")


@dataclass(frozen=True)
class Client:
    """What the client recorded, in x north, y west: setpoint, position and velocity, by its own clock."""

    time_s: Vector
    setpoint_m: Vector
    position_m: Vector
    velocity_m_s: Vector


def client(name: str) -> Client:
    rows = np.genfromtxt(DATA / f"{name}.csv", delimiter=",", skip_header=1)
    west = np.array((1.0, -1.0))
    return Client(rows[:, 0], rows[:, 1:3] * west, rows[:, 3:5] * west, rows[:, 5:7] * west)


@pytest.fixture(scope="module")
def px4() -> VehicleLog:
    return read_vehicle_logs(DATA / "px4-quad.ulg")[0]


@pytest.fixture(scope="module")
def copter() -> VehicleLog:
    return read_vehicle_logs(DATA / "arducopter.bin")[0]


def plane(series: Series, times_s: Vector) -> Vector:
    """The horizontal part of a series at given times."""
    return np.column_stack([np.interp(times_s, series.time_s, column) for column in series.values.T[:2]])


@cache
def shift_s(log: VehicleLog, name: str) -> float:
    """The log's time at the client's zero: where the cross-correlation of the velocities is greatest."""
    seen = client(name)

    def likeness(shift: float) -> float:
        flown = plane(log.series()["velocity"], seen.time_s + shift)
        return float((flown * seen.velocity_m_s).sum() / np.sqrt((flown**2).sum() * (seen.velocity_m_s**2).sum()))

    coarse = max(np.arange(0.0, log.duration_s - seen.time_s[-1], 0.05), key=likeness)
    return float(max(np.arange(coarse - 0.06, coarse + 0.06, 0.005), key=likeness))


@pytest.mark.parametrize(("name", "position_m", "velocity_m_s"), [("px4-quad", 0.04, 0.06), ("arducopter", 0.01, 0.01)])
def test_motion_is_what_the_client_saw(
    name: str, position_m: float, velocity_m_s: float, px4: VehicleLog, copter: VehicleLog
) -> None:
    """RMS of the difference over 18 s: 0.028 m and 0.041 m/s for PX4, 0.006 m and 0.007 m/s for ArduCopter.

    PX4's is the client's clock, which gained 0.2 s meanwhile; ArduCopter's the log's 10 Hz. Axes exchanged, or of the
    other sign, are metres away.
    """
    log, seen = {"px4-quad": px4, "arducopter": copter}[name], client(name)
    shift = shift_s(log, name)
    differs_m = plane(log.series()["position"], seen.time_s + shift) - seen.position_m
    differs_m_s = plane(log.series()["velocity"], seen.time_s + shift) - seen.velocity_m_s
    assert np.sqrt((differs_m**2).sum(axis=1).mean()) < position_m
    assert np.sqrt((differs_m_s**2).sum(axis=1).mean()) < velocity_m_s


@pytest.mark.parametrize("name", ["px4-quad", "arducopter"])
def test_setpoints_are_what_the_client_sent(name: str, px4: VehicleLog, copter: VehicleLog) -> None:
    """Every one, to the last digit of the record, not more than 0.2 s apart, and 8 m up as the client asked."""
    log, seen = {"px4-quad": px4, "arducopter": copter}[name], client(name)
    shift = shift_s(log, name)
    inside = (log.series()["setpoint"].time_s > shift + 0.5) & (
        log.series()["setpoint"].time_s < shift + seen.time_s[-1] - 0.5
    )
    assert inside.sum() > 75
    for time_s, setpoint in zip(
        log.series()["setpoint"].time_s[inside] - shift, log.series()["setpoint"].values[inside], strict=True
    ):
        near = np.abs(seen.time_s - time_s) < 0.2
        assert np.abs(seen.setpoint_m[near] - setpoint[:2]).max(axis=1).min() < 6e-5
        assert setpoint[2] == pytest.approx(8.0)


@pytest.mark.parametrize(("name", "within_m"), [("px4-quad", 0.55), ("arducopter", 0.1)])
def test_the_simulators_truth_is_in_the_estimates_frame(
    name: str, within_m: float, px4: VehicleLog, copter: VehicleLog
) -> None:
    """PX4's estimator wanders by half a metre, ArduCopter's by some centimetres; origins and axes are the same."""
    log = {"px4-quad": px4, "arducopter": copter}[name]
    inside = log.series()["position"].time_s <= log.series()["true_position"].time_s[-1]
    times_s = log.series()["position"].time_s[inside]
    truth = np.column_stack(
        [
            np.interp(times_s, log.series()["true_position"].time_s, axis)
            for axis in log.series()["true_position"].values.T
        ]
    )
    assert np.abs(log.series()["position"].values[inside] - truth).max() < within_m
    assert np.ptp(truth, axis=0).min() > 1.5, "it flew on every axis"


def test_true_velocity_is_that_of_the_true_position(px4: VehicleLog) -> None:
    steps_s = np.diff(px4.series()["true_position"].time_s)[:, np.newaxis]
    moved = np.diff(px4.series()["true_position"].values, axis=0) / steps_s
    means = 0.5 * (px4.series()["true_velocity"].values[1:] + px4.series()["true_velocity"].values[:-1])
    assert np.abs(moved - means).max() < 0.05


def test_roll_to_the_left_accelerates_to_the_west(copter: VehicleLog) -> None:
    """In a frame of front, left, up, roll is positive with the right side down: west is left of a nose to the north."""
    flying = copter.series()["attitude"].time_s > 14.0
    push = np.gradient(copter.series()["velocity"].values, copter.series()["velocity"].time_s, axis=0)[flying, :2]
    roll, pitch, yaw = copter.series()["attitude"].values[flying].T
    front = np.column_stack((np.cos(yaw), np.sin(yaw)))
    left = np.column_stack((-np.sin(yaw), np.cos(yaw)))
    assert np.corrcoef(pitch, (push * front).sum(axis=1))[0, 1] > 0.8
    assert np.corrcoef(-roll, (push * left).sum(axis=1))[0, 1] > 0.8


def test_who_flew_what_and_when(px4: VehicleLog, copter: VehicleLog) -> None:
    assert (px4.autopilot, px4.firmware, px4.system_id) == ("px4", "v1.17.0 (alpha) b52a9e7e", 1)
    assert (copter.autopilot, copter.firmware) == ("ardupilot", "ArduCopter V4.7.0-dev (15376a49)")
    assert copter.system_id == 1
    assert [mode.name for mode in px4.modes] == ["take-off", "hold", "offboard"]
    assert [mode.name for mode in copter.modes] == ["stabilize", "guided"]
    assert [mode.external for mode in (*px4.modes, *copter.modes)] == [False, False, True, False, True]
    assert px4.modes[-1].span == Span(23.88, px4.duration_s)
    assert px4.armed == (Span(px4.modes[0].span.begin_s, px4.duration_s),), "the cut begins after the take-off"
    assert copter.armed == (Span(0.0, copter.duration_s),)
    assert [text.severity for text in px4.texts if text.text == "[commander] Takeoff detected"] == [6]
    assert "Arming motors" in [text.text for text in copter.texts]
    assert px4.parameters["COM_OBL_RC_ACT"] == 0
    assert copter.parameters["GUID_OPTIONS"] == 0.0


def test_what_it_holds_is_told_in_plain_words(px4: VehicleLog, copter: VehicleLog) -> None:
    told = "\n".join(map(": ".join, describe(px4)))
    assert "PX4 log (.ulg) of vehicle 1: px4, firmware v1.17.0 (alpha) b52a9e7e, 42.8 s" in told
    assert "samples from trajectory_setpoint, 5 Hz" in told
    assert "take-off -> hold -> offboard; 18.9 s under external position control" in told
    assert describe(copter)[0][0] == "ArduPilot log (.bin) of vehicle 1"
