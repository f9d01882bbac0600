"""Telemetry logs against flights of stub vehicles, whose true motion is known to the last digit."""

from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from estimation.state import Vector
from gcs.flightlog.container import LogError
from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import Series, VehicleLog
from tests.support.telemetry_log import BATTERY_FRACTION, BEGIN_US, Flown, Station, flight

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(scope="module")
def team() -> Station:
    return flight((3, 7))


def written(path: Path, log: bytes) -> Path:
    file = path / "flight.tlog"
    file.write_bytes(log)
    return file


def read(path: Path, log: bytes) -> tuple[VehicleLog, ...]:
    return read_vehicle_logs(written(path, log))


def at(series: Series, times_s: Vector) -> Vector:
    return np.column_stack([np.interp(times_s, series.time_s, column) for column in series.values.T])


def boot_s(log: VehicleLog, flown: Flown) -> float:
    """The vehicle's time at the log's begin, from where its height first passes two metres."""
    true_s = float(np.interp(2.0, [place[2] for place in flown.position_m[:1000]], flown.time_s[:1000]))
    climb = log.series()["position"].values[:, 2] < 4.0
    return true_s - float(
        np.interp(2.0, log.series()["position"].values[climb, 2], log.series()["position"].time_s[climb])
    )


def setpoint_error_s(log: VehicleLog, flown: Flown) -> Vector:
    return np.asarray(log.series()["setpoint"].time_s + boot_s(log, flown) - np.array(flown.asked_s))


@pytest.mark.parametrize(("speed", "latency_s"), [(10.0, 0.0), (1.0, 0.1)])
def test_it_holds_what_was_flown_on_the_vehicles_clock(tmp_path: Path, speed: float, latency_s: float) -> None:
    """At ten times the wall's speed, and over a slow link: motion is where and when it was."""
    station = flight((3,), speed=speed, latency_s=latency_s)
    (log,), flown = read(tmp_path, bytes(station.log)), station.flown[0]
    times_s = log.series()["position"].time_s + boot_s(log, flown)
    truth = np.column_stack([np.interp(times_s, flown.time_s, axis) for axis in np.array(flown.position_m).T])
    assert np.abs(log.series()["position"].values - truth).max() < 0.03
    assert log.series()["setpoint"].values == pytest.approx(np.array(flown.asked_m), abs=1e-5)
    error_s = setpoint_error_s(log, flown)
    assert error_s == pytest.approx(np.full(error_s.size, -latency_s), abs=0.04)


def test_every_vehicle_has_its_own_log(tmp_path: Path, team: Station) -> None:
    logs = read(tmp_path, bytes(team.log))
    assert [log.system_id for log in logs] == [3, 7]
    for log, flown in zip(logs, team.flown, strict=True):
        assert log.autopilot == "px4"
        assert log.firmware == "v1.17.0"
        assert log.series()["setpoint"].values == pytest.approx(np.array(flown.asked_m), abs=1e-5)
        assert log.series()["setpoint"].rate_hz == pytest.approx(5.0, rel=0.01)


def test_velocity_and_attitude_are_those_of_the_motion(tmp_path: Path, team: Station) -> None:
    log = read(tmp_path, bytes(team.log))[0]
    moved = np.diff(log.series()["position"].values, axis=0) / np.diff(log.series()["position"].time_s)[:, np.newaxis]
    flying = log.series()["position"].time_s[1:] > 25.0
    assert np.abs(moved - log.series()["velocity"].values[1:])[flying].max() < 0.15
    # Accelerating north, it pitches nose down: positive in a frame of front, left and up.
    north = np.gradient(
        at(log.series()["velocity"], log.series()["attitude"].time_s)[:, 0], log.series()["attitude"].time_s
    )
    flying = log.series()["attitude"].time_s > 30.0
    assert np.corrcoef(north[flying], log.series()["attitude"].values[flying, 1])[0, 1] > 0.9


def test_modes_arming_texts_battery_and_parameters(tmp_path: Path, team: Station) -> None:
    log, flown = read(tmp_path, bytes(team.log))[1], team.flown[1]
    begin_s = boot_s(log, flown)
    assert [mode.name for mode in log.modes] == ["hold", "take-off", "hold", "offboard"]
    assert [mode.external for mode in log.modes] == [False, False, False, True]
    # Heartbeats come once a second, and so does what they tell.
    assert 0.0 <= log.modes[-1].span.begin_s + begin_s - flown.offboard_s[0] < 1.02
    assert len(log.armed) == 1
    assert 0.0 <= log.armed[0].begin_s + begin_s - 3.0 < 1.02
    assert log.armed[0].end_s == log.duration_s
    assert "Takeoff detected" in [text.text for text in log.texts]
    assert log.series()["battery"].values[0, 2] == pytest.approx(BATTERY_FRACTION, abs=0.01)
    assert 10.0 < log.series()["battery"].values[0, 0] < 20.0
    assert log.parameters["MAV_SYS_ID"] == 7
    assert log.parameters["MIS_TAKEOFF_ALT"] == 5.0
    assert log.missing == log.notes == ()


def packed(*messages: tuple[float, object], system_id: int = 9) -> bytes:
    writer = common.MAVLink(None, system_id, 1)
    return b"".join(
        round(BEGIN_US + at_s * 1e6).to_bytes(8, "big") + bytes(message.pack(writer))  # type: ignore[attr-defined]
        for at_s, message in messages
    )


def beat(custom_mode: int, autopilot: int = 12) -> object:
    return common.MAVLink_heartbeat_message(2, autopilot, 128, custom_mode, 4, 3)


def place(time_s: float, x: float, scale: float = 1.0) -> object:
    return common.MAVLink_local_position_ned_message(round(time_s * 1e3), x * scale, 0.0, -5.0, 1.0, 0.0, 0.0)


def test_bytewise_minus_one_numbers_and_chunked_texts(tmp_path: Path) -> None:
    long = "the quick brown fox jumps over the lazy dog, and then sleeps for a while"
    minus_one = np.frombuffer(b"\xff\xff\xff\xff", dtype="<f4")[0]
    messages = [
        (0.0, beat(6 << 16)),
        (0.1, common.MAVLink_param_value_message(b"COM_X", minus_one, 6, 2, 0)),
        (0.2, common.MAVLink_statustext_message(4, long[:50].encode(), 5, 0)),
        (0.3, common.MAVLink_statustext_message(4, long[50:].encode(), 5, 1)),
    ]
    (log,) = read(tmp_path, packed(*messages))
    assert log.parameters == {"COM_X": -1}
    assert [(text.severity, text.text) for text in log.texts] == [(4, long)]
    assert [mode.name for mode in log.modes] == ["offboard"]
    assert "LOCAL_POSITION_NED" in log.missing
    with pytest.raises(LogError, match=r"vehicle 9: the log has no position and setpoint; looked for LOCAL_POSITION"):
        log.require("position", "setpoint")


def test_arducopters_modes_and_the_axes_that_a_setpoint_leaves_out(tmp_path: Path) -> None:
    target = [10, 9, 1, 1, 0b100111111100, 1.0, 2.0, -3.0, *(0.0,) * 8]
    offset = [10, 9, 1, 7, 0b100111111000, 1.0, 2.0, -3.0, *(0.0,) * 8]
    messages = [
        (0.0, beat(4, autopilot=3)),
        (0.1, common.MAVLink_set_position_target_local_ned_message(*target)),
        (0.2, common.MAVLink_set_position_target_local_ned_message(*offset)),
    ]
    (log,) = read(tmp_path, packed(*messages))
    assert log.autopilot == "ardupilot"
    assert [(mode.name, mode.external) for mode in log.modes] == [("guided", True)]
    assert log.series()["setpoint"].values == pytest.approx(np.array([[1.0, -2.0, np.nan], [np.nan] * 3]), nan_ok=True)
    assert any("1 setpoints in other frames" in note for note in log.notes)


def test_velocities_beside_setpoints_are_those_that_were_sent(tmp_path: Path) -> None:
    """What an autopilot says that it aims at has the velocity that its position controller adds."""
    fields = (1.0, 2.0, -3.0, 0.5, -0.25, 0.125, *(0.0,) * 5)
    target = [[10, 9, 1, 1, mask, *fields] for mask in (0b100111000000, 0b100111111000)]
    sent = [common.MAVLink_set_position_target_local_ned_message(*each) for each in target]
    (log,) = read(tmp_path, packed((0.0, beat(4, autopilot=3)), (0.1, sent[0]), (0.2, sent[1])))
    assert log.series()["setpoint_velocity"].values == pytest.approx(np.array([[0.5, 0.25, -0.125]]))
    aimed = common.MAVLink_position_target_local_ned_message(10, 1, 0b100111000000, *fields)
    (log,) = read(tmp_path, packed((0.0, beat(4, autopilot=3)), (0.1, aimed)))
    assert log.setpoint_velocity is None


def test_a_log_of_the_first_mavlink_is_read_too(tmp_path: Path) -> None:
    writer = common.MAVLink(None, 4, 1)
    stamps = [round(BEGIN_US + step * 1e5).to_bytes(8, "big") for step in range(2)]
    messages = (beat(6 << 16), place(1.0, 2.0))
    log = b"".join(
        stamp + bytes(message.pack(writer, force_mavlink1=True))  # type: ignore[attr-defined]
        for stamp, message in zip(stamps, messages, strict=True)
    )
    (vehicle,) = read(tmp_path, log)
    assert log[8] == 0xFE
    assert vehicle.series()["position"].values.tolist() == [[2.0, 0.0, 5.0]]


def test_targets_in_latitude_and_longitude_end_the_setpoint_before_them(tmp_path: Path) -> None:
    """A vehicle that a station sends elsewhere does not fly by the last local setpoint any more."""
    target = [10, 9, 1, 1, 0b100111111000, 1.0, 2.0, -3.0, *(0.0,) * 8]
    degrees = (473977420, 85455940, 500.0)
    elsewhere = common.MAVLink_set_position_target_global_int_message(
        10, 9, 1, 6, 0b100111111000, *degrees, *(0.0,) * 8
    )
    fly_here = common.MAVLink_command_int_message(9, 1, 6, 192, 0, 0, 0.0, 0.0, 0.0, 0.0, *degrees)
    other = common.MAVLink_command_int_message(9, 1, 6, 195, 0, 0, 0.0, 0.0, 0.0, 0.0, *degrees)
    local = common.MAVLink_set_position_target_local_ned_message(*target)
    sent = [local, elsewhere, local, fly_here, local, other]
    (log,) = read(
        tmp_path, packed((0.0, beat(4, autopilot=3)), *((0.1 + step, each) for step, each in enumerate(sent)))
    )
    assert np.isfinite(log.series()["setpoint"].values[:, 0]).tolist() == [True, False, True, False, True]
    assert any("2 setpoints in other frames" in note for note in log.notes)


def test_of_an_autopilot_that_restarted_the_longest_boot_is_read(tmp_path: Path) -> None:
    boots = [(100.0, 40), (2.0, 90), (3.0, 20)]
    at_s, flown = 0.0, list[tuple[float, object]]()
    for begin_s, count in boots:
        flown += [(at_s + step * 0.1, place(begin_s + step * 0.1, step * 0.1)) for step in range(count)]
        at_s = flown[-1][0] + 0.1
    (log,) = read(tmp_path, packed((0.0, beat(0)), (6.0, beat(6 << 16)), *flown))
    assert log.series()["position"].values[:, 0] == pytest.approx(np.arange(90) * 0.1, abs=1e-6)
    assert log.duration_s == pytest.approx(8.9)
    assert [mode.name for mode in log.modes] == ["offboard"]
    assert any("restarted: of 3 boots (3.9, 8.9, 1.9 s) the longest was read, number 2" in note for note in log.notes)


def test_packets_that_overtook_one_another_are_put_in_order(tmp_path: Path) -> None:
    flown = [(step * 0.1, place(100.0 + step * 0.1, step * 0.1)) for step in range(40)]
    flown[10], flown[11] = flown[11], flown[10]
    (log,) = read(tmp_path, packed((0.0, beat(0)), *flown))
    assert log.series()["position"].values[:, 0] == pytest.approx(np.arange(40) * 0.1, abs=1e-6)
    assert any("out of order" in note for note in log.notes)


def test_a_position_in_millimetres_is_refused(tmp_path: Path) -> None:
    flown = [(step * 0.1, place(100.0 + step * 0.1, step * 0.1, scale=1000.0)) for step in range(100)]
    with pytest.raises(LogError, match=r"LOCAL_POSITION_NED: .* about 1000 times .* most of all at .* not in metres"):
        read(tmp_path, packed((0.0, beat(0)), *flown))
