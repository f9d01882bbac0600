"""Reads cordon's own log: each vehicle's setpoints at the times of sending, and its motion from telemetry.

Setpoints are delayed by the round trip of the vehicle's link, so that the identified plant does not contain it.
"""

from collections.abc import Sequence
from statistics import median

import numpy as np

from agents.inputs import AutopilotStatus
from agents.ports import FlightMode
from estimation.frames import MissionFrame, Triple, up_from_ned
from estimation.state import Telemetry, Vector
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Decision, Truth, Vehicle
from gcs.flightlog.run import mission_of
from gcs.mission.mission import Mission, MissionVehicle
from gcs.vehicle_logs.log_file import LogFile
from gcs.vehicle_logs.raw_log import CORDON, US, RawLog, Samples, Stamps, vehicle_log
from gcs.vehicle_logs.vehicle_log import VehicleLog

FORMAT = "log of cordon (.mcap)"
DECISION, TELEMETRY, TRUTH, AUTOPILOT = "decision", "telemetry", "truth", "autopilot"


def read(log: LogFile) -> tuple[VehicleLog, ...]:
    """Return the log of each vehicle that this process flew; raises LogError when it cannot be read or has none."""
    flight = read_log(log.path)
    mission = mission_of(flight)
    flown = [vehicle for vehicle in mission.vehicles if vehicle.id in flight.vehicles]
    if not flown:
        raise LogError([f"{log.name}: it has no record of a vehicle: its flight ended before it began"])
    logs = [_vehicle(log, flight, mission, vehicle) for vehicle in flown]
    return tuple(sorted(logs, key=lambda each: each.system_id))


def _vehicle(log: LogFile, flight: FlightLog, mission: Mission, vehicle: MissionVehicle) -> VehicleLog:
    facts = next(flight.of_kind(vehicle.id, Vehicle), None)
    raw = RawLog(
        path=log.name,
        format=FORMAT,
        sha256=log.sha256,
        autopilot=facts.autopilot if facts is not None else flight.run.source,
        firmware=facts.firmware if facts is not None else "",
        system_id=vehicle.system_id,
        mode_topic=DECISION,
        notes=list(flight.faults),
        is_damaged=flight.is_damaged,
    )
    if facts is not None:
        raw.parameters.update({parameter.name: parameter.value for parameter in facts.parameters})
    _add_setpoints(raw, flight, vehicle.id, mission.mission_frame())
    _add_motion(raw, flight, vehicle.id, mission.mission_frame())
    return vehicle_log(raw)


def _add_setpoints(raw: RawLog, flight: FlightLog, vehicle_id: int, frame: MissionFrame) -> None:
    """Add the setpoints sent, and when they controlled the vehicle: by the autopilot's mode, if it is logged."""
    sent: list[tuple[float, Triple]] = []
    fed: list[tuple[float, Triple]] = []
    mode, link_s = FlightMode.UNKNOWN, _round_trip_s(flight, vehicle_id)
    for record in flight.vehicles[vehicle_id]:
        if record.kind is AutopilotStatus:
            mode = record.read(AutopilotStatus).status.mode
        elif record.kind is Decision:
            decision = record.read(Decision)
            flown = decision.setpoint is not None and mode in (FlightMode.OFFBOARD, FlightMode.UNKNOWN)
            raw.modes.append((_stamp(decision.time_s), CORDON if flown else mode.value))
            if decision.setpoint is not None:
                sent_s = decision.time_s + link_s
                sent.append((sent_s, decision.setpoint.position_m))
                if decision.setpoint.velocity_m_s:
                    x, y, z = decision.setpoint.velocity_m_s
                    fed.append((sent_s, (x, y, z)))
    _add(raw, "setpoint", DECISION, sent, frame)
    if fed:
        _add(raw, "setpoint_velocity", DECISION, fed, frame)


def _round_trip_s(flight: FlightLog, vehicle_id: int) -> float:
    """Return the median round trip of a vehicle's link, 0 if none was measured."""
    statuses = (each.status for each in flight.of_kind(vehicle_id, AutopilotStatus))
    return median([each.round_trip_s for each in statuses if each.round_trip_s is not None] or [0.0])


def _add_motion(raw: RawLog, flight: FlightLog, vehicle_id: int, frame: MissionFrame) -> None:
    samples = list(flight.of_kind(vehicle_id, Telemetry))
    _add(raw, "position", TELEMETRY, [(each.time_s, each.position_m) for each in samples], frame)
    _add(raw, "velocity", TELEMETRY, [(each.time_s, each.velocity_m_s) for each in samples], frame)
    true = list(flight.of_kind(vehicle_id, Truth))
    if true:
        _add(raw, "true_position", TRUTH, [(each.time_s, each.position_m) for each in true], frame)
        _add(raw, "true_velocity", TRUTH, [(each.time_s, each.velocity_m_s) for each in true], frame)


def _add(raw: RawLog, name: str, topic: str, rows: Sequence[tuple[float, Triple]], frame: MissionFrame) -> None:
    if not rows:
        raw.missing.append(topic)
        return
    stamps: Stamps = np.array([_stamp(time_s) for time_s, _ in rows], dtype=np.int64)
    values: Vector = up_from_ned(np.array([frame.ned_from_mission(row) for _, row in rows]))
    raw.samples[name] = Samples(topic, stamps, values)


def _stamp(time_s: float) -> int:
    return round(time_s * US)
