"""Cordon's own log read as everybody's, and one flight that is the same plant whichever log it is read from."""

from math import radians
from pathlib import Path

import numpy as np
import pytest
from foxglove import Context
from pymavlink.dialects.v20 import common as dialect

from agents.inputs import AutopilotStatus
from agents.ports import FlightMode, Setpoint, VehicleStatus
from estimation.frames import Geodetic, MissionFrame
from estimation.identification.identify import identify
from estimation.state import Telemetry, Vector
from gcs.flightlog.container import LogError
from gcs.flightlog.records import Decision, Parameter, Vehicle
from gcs.flightlog.run import run_of
from gcs.flightlog.writer import LogWriter
from gcs.identify.reading import recording_of
from gcs.vehicle_logs.foreign import is_foreign, read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import VehicleLog
from tests.experiments.identification_draws import intervals_of
from tests.support.flight_logs import engaging, record_simulation
from tests.support.mission_text import content, parsed, put
from tests.support.paths import MISSIONS
from tests.support.synthetic_flights import excitation_m
from tests.support.telemetry_log import PLANT, Flown, Station

BEARING_DEG = 30.0


def decision(time_s: float, setpoint: Setpoint | None) -> Decision:
    nothing = (None,) * 3
    return Decision(
        time_s, "formation", 0.0, setpoint, *nothing, None, None, None, None, "", (), (), (), (), 0
    )  # fmt: skip


def written(path: Path, flown: Flown, round_trip_s: float | None = None, jump_m: Vector | float = 0.0) -> Path:
    """Write what was flown as cordon's log of vehicle 1, whose mission's x axis points elsewhere than north.

    `jump_m` (T, 3) is added to the positions.
    """
    mission = content((MISSIONS / "case1.toml").read_text(encoding="utf-8"))
    turned = parsed(put(mission, ("frame", "x_bearing_deg"), BEARING_DEG))
    frame = MissionFrame(Geodetic(0.0, 0.0, 0.0), radians(BEARING_DEG))
    writer = LogWriter(path, Context())
    run = run_of(turned, (1,), seed=0, source="flight", speed=1.0, began_s=1.7e9, duration_s=flown.time_s[-1])
    writer.write(0, 0, 0, run)
    number = 0

    def note(time_s: float, record: object) -> None:
        nonlocal number
        number += 1
        writer.write(1, number, round(time_s * 1e9), record)

    def turn(place: tuple[float, ...]) -> tuple[float, float, float]:
        north, west, up = place
        return frame.mission_from_ned((north, -west, -up))

    note(0.0, Vehicle("px4", "1.17.0", (Parameter("MPC_XY_P", 0.95),)))
    events = [(time_s, 0, index) for index, time_s in enumerate(flown.time_s) if index % 5 == 0]
    events += [(time_s, 1, index) for index, time_s in enumerate(flown.asked_s)]
    places = np.array(flown.position_m)
    speeds = np.gradient(places, flown.time_s, axis=0)
    places = places + jump_m
    mode = FlightMode.HOLD
    note(0.0, AutopilotStatus(VehicleStatus(connected=True, mode=mode)))
    for time_s, kind, index in sorted(events):
        if kind == 0:
            note(time_s, Telemetry(time_s, turn(tuple(places[index].tolist())), turn(tuple(speeds[index].tolist()))))
            continue
        if mode is FlightMode.HOLD and time_s >= flown.offboard_s[0]:
            mode = FlightMode.OFFBOARD
            note(time_s, AutopilotStatus(VehicleStatus(connected=True, mode=mode, round_trip_s=round_trip_s)))
        note(time_s, decision(time_s, Setpoint(turn(flown.asked_m[index]))))
    writer.close()
    return path


@pytest.fixture(scope="module")
def station() -> Station:
    """Return a flight of a stub vehicle: take-off, then random steps in offboard for a minute."""
    wished_m = excitation_m(np.random.default_rng(3), 70.0, 0.0)
    station = Station((1,), 1.0)

    def ask(flown: Flown, time_s: float) -> None:
        north, west = wished_m[min(len(flown.asked_s) * 2, wished_m.shape[0] - 1)].tolist()
        fields = (0, flown.system_id, 1, 1, 0b100111111000, north, -west, -5.0, *(0.0,) * 8)
        station.send(flown.system_id, dialect.MAVLink_set_position_target_local_ned_message(*fields))
        flown.asked_s.append(time_s)
        flown.asked_m.append((north, west, 5.0))

    station.run(3.0)
    station.command(1, 400, 1)
    station.command(1, 22, 0, 0, 0, *(float("nan"),) * 4)
    station.run(20.0)
    station.run(0.4, ask)
    station.command(1, 176, 1, 6)
    station.run(60.0, ask)
    return station


@pytest.fixture(scope="module")
def own(station: Station, tmp_path_factory: pytest.TempPathFactory) -> VehicleLog:
    path = written(tmp_path_factory.mktemp("own") / "flight.mcap", station.flown[0])
    (log,) = read_vehicle_logs(path)
    return log


def test_motion_and_setpoints_are_north_and_west_whatever_the_missions_bearing(
    own: VehicleLog, station: Station
) -> None:
    flown = station.flown[0]
    begin_s = flown.time_s[0]
    truth = [
        np.interp(own.series()["position"].time_s + begin_s, flown.time_s, axis)
        for axis in np.array(flown.position_m).T
    ]
    assert own.series()["position"].values == pytest.approx(np.column_stack(truth), abs=1e-3)
    assert own.series()["setpoint"].values == pytest.approx(np.array(flown.asked_m), abs=1e-9)
    assert own.series()["setpoint"].time_s + begin_s == pytest.approx(np.array(flown.asked_s), abs=1e-5)
    steps_m = np.diff(own.series()["position"].values, axis=0) / np.diff(own.series()["position"].time_s)[:, None]
    assert (
        np.abs((own.series()["velocity"].values[1:] + own.series()["velocity"].values[:-1]) / 2.0 - steps_m).max() < 0.1
    )


def test_setpoints_count_as_sent_later_by_the_links_round_trip(
    own: VehicleLog, station: Station, tmp_path: Path
) -> None:
    """So what is identified is the vehicle without the link."""
    (late,) = read_vehicle_logs(written(tmp_path / "late.mcap", station.flown[0], round_trip_s=0.13))
    assert late.series()["setpoint"].time_s == pytest.approx(own.series()["setpoint"].time_s + 0.13, abs=2e-6)
    assert [mode.span.begin_s for mode in late.modes] == [mode.span.begin_s for mode in own.modes]


def test_who_flew_it_when_and_what_it_was(own: VehicleLog, station: Station) -> None:
    assert (own.autopilot, own.firmware, own.system_id) == ("px4", "1.17.0", 1)
    assert dict(own.parameters) == {"MPC_XY_P": 0.95}
    assert [(mode.name, mode.external) for mode in own.modes] == [("hold", False), ("cordon", True)]
    offboard_s = station.flown[0].offboard_s[0] - station.flown[0].time_s[0]
    assert own.modes[1].span.begin_s == pytest.approx(offboard_s, abs=0.25)


def test_one_flight_is_one_plant_whichever_log_it_is_read_from(
    own: VehicleLog, station: Station, tmp_path: Path
) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(bytes(station.log))
    (ground,) = read_vehicle_logs(path)
    times_s = np.array(station.flown[0].time_s)
    jump_m = np.outer(times_s >= times_s[-1] - 30.0, (25.0, 0.0, 0.0))
    (jumped,) = read_vehicle_logs(written(tmp_path / "jumped.mcap", station.flown[0], jump_m=jump_m))
    true = (PLANT.x.a0_per_s2, PLANT.x.a1_per_s, PLANT.y.a0_per_s2, PLANT.y.a1_per_s, PLANT.delay_s)
    for log in (own, ground, jumped):
        identified = identify([recording_of(log)])
        assert identified.found is not None, identified.reasons
        values = [interval.value for interval in intervals_of(identified.found)]
        assert values == pytest.approx(true, rel=0.06), log.format


def test_every_vehicle_of_a_simulated_flight_is_there_with_its_truth(tmp_path: Path) -> None:
    path = tmp_path / "team.mcap"
    record_simulation(engaging(), path, duration_s=10.0)
    logs = read_vehicle_logs(path)
    assert [log.system_id for log in logs] == [1, 2, 3]
    assert all(log.true_position is not None and log.duration_s == pytest.approx(10.0, abs=0.2) for log in logs)
    assert not is_foreign(path)


def test_a_flight_that_ended_before_it_began_is_refused(tmp_path: Path) -> None:
    mission = parsed(content((MISSIONS / "case1.toml").read_text(encoding="utf-8")))
    writer = LogWriter(tmp_path / "flight.mcap", Context())
    writer.write(0, 0, 0, run_of(mission, (1,), seed=0, source="flight", speed=1.0, began_s=1.7e9, duration_s=1.0))
    writer.close()
    with pytest.raises(LogError, match=r"flight\.mcap: it has no record of a vehicle"):
        read_vehicle_logs(tmp_path / "flight.mcap")
