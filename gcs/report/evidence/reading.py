"""Reads the logs of a flight: the record behind the metrics, and each vehicle's evidence."""

from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import msgspec
import numpy as np

from agents.drops import Drops
from agents.flight_end import FlightEnd, LastPosition
from agents.inputs import AutopilotStatus, Command, LateTicks, Start, VehicleJoins
from agents.team.messages import BusMessage, CameraView, CommandAnswer, MemberState, OperatorCommand
from estimation.state import MOTION, Telemetry, Vector
from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog, LogRecord
from gcs.flightlog.records import Cost, Decision, Run, Taken, Truth, Vehicle, notes_of, ring_of
from gcs.flightlog.run import mission_of, planner_text
from gcs.flightlog.schema import plain_message
from gcs.metrics.ending import Unaccounted, VehicleEnding
from gcs.metrics.journal import Journal, RunTotals
from gcs.metrics.record import injected_faults
from gcs.mission.file import joined_mission
from gcs.mission.mission import Mission
from gcs.report.evidence.flight import EstimateSeries, FlightEvidence, LoopTiming, Reception, VehicleEvidence
from sitl.server.record import TruthTrack

SAME_START_S = 1.0
"""Vehicles of one flight agree on its start: logs that differ by more [wall s] are of different flights."""


@dataclass(frozen=True, slots=True)
class LoggedFlight:
    """A flight from its logs: its mission and its evidence, and whether a log is damaged."""

    mission: Mission
    evidence: FlightEvidence
    is_damaged: bool = False


def read_flight(logs: Sequence[FlightLog]) -> LoggedFlight:
    """Merge the logs of a flight's processes; raises LogError when they are not of one flight."""
    _require_one_flight(logs)
    journal = Journal(mission_of(logs[0]))
    vehicles = [_VehicleReader(log, vehicle_id, journal) for log in logs for vehicle_id in log.run.vehicles]
    mission = _joined(mission_of(logs[0]), logs, journal.joined)
    journal.enlarge(mission)
    starts_s = [each.start_s for each in vehicles if each.start_s is not None]
    if not starts_s:
        raise LogError([f"{log.path}: the mission did not start: there is nothing to report" for log in logs])
    start_s, speed = min(starts_s), logs[0].run.speed
    if max(starts_s) - start_s > SAME_START_S * speed:
        apart_s = (max(starts_s) - start_s) / speed
        raise LogError([f"the logs are of several flights: they start {apart_s:.0f} s apart"])
    totals = RunTotals(
        logs[0].run.source,
        sum(each.ticks for each in vehicles),
        sum(each.missed for each in vehicles),
        max(_wall_time_s(log) for log in logs),
        tuple(track for each in vehicles if (track := each.truth(mission)) is not None),
        logs[0].run.seed,
        tuple(each.ending(start_s, mission) for each in vehicles),
        injected_faults(logs[0].run.faults),
        _kinds(logs),
        logs[0].target_path,
        {each.vehicle_id: each.views for each in vehicles},
    )
    record = journal.record(start_s, _flown_s(logs, vehicles, start_s), totals)
    order = [track.vehicle_id for track in record.vehicles]
    evidence = {each.vehicle_id: each.evidence(start_s, speed) for each in vehicles}
    known = tuple(evidence.get(vehicle_id, VehicleEvidence(vehicle_id)) for vehicle_id in order)
    is_damaged = any(log.is_damaged for log in logs)
    facts = _facts(logs, mission, vehicles)
    return LoggedFlight(mission, FlightEvidence(record, known, facts, _names(logs), speed=speed), is_damaged)


def _joined(mission: Mission, logs: Sequence[FlightLog], joined: Collection[int]) -> Mission:
    """Return a mission with the vehicle that is among those `joined`, by what the others recorded of it."""
    records = (each for log in logs for records in log.vehicles.values() for each in records)
    for added in [each.read(VehicleJoins) for each in records if each.kind is VehicleJoins]:
        if added.vehicle_id in joined:
            return joined_mission(mission, added.vehicle_id, added.vehicle)
    return mission


def _require_one_flight(logs: Sequence[FlightLog]) -> None:
    first, faults = logs[0], []
    log_of: dict[int, FlightLog] = {}
    for log in logs:
        if log.run.mission_text != first.run.mission_text or log.run.source != first.run.source:
            faults.append(f"{log.path}: its mission differs from {first.path}")
        for vehicle_id in log.run.vehicles:
            if vehicle_id in log_of:
                faults.append(f"{log.path}: vehicle {vehicle_id} is also in {log_of[vehicle_id].path}")
            log_of[vehicle_id] = log
    if faults:
        raise LogError([*faults, "the logs are not of one flight: give those of other flights behind --compare"])


def _flown_s(logs: Sequence[FlightLog], vehicles: Sequence["_VehicleReader"], start_s: float) -> float:
    """Return the duration of the mission: from the end record, or from the last tick without one."""
    flown = [log.end.flown_s for log in logs if log.end is not None]
    if len(flown) == len(logs):
        return max(flown)
    last_s = max((each.last_s for each in vehicles), default=start_s)
    return max(min(last_s - start_s, logs[0].run.duration_s), 0.0)


def _wall_time_s(log: FlightLog) -> float:
    if log.end is not None:
        return log.end.wall_time_s
    stamps = [record.time_ns for records in log.vehicles.values() for record in (records[0], records[-1])]
    return (max(stamps) - min(stamps)) / 1e9 if stamps else 0.0


def _names(logs: Sequence[FlightLog]) -> tuple[str, ...]:
    return tuple(log.path.name for log in logs)


def _facts(logs: Sequence[FlightLog], mission: Mission, vehicles: Sequence["_VehicleReader"]) -> dict[str, str]:
    run: Run = logs[0].run
    began = datetime.fromtimestamp(run.began_s, UTC)
    facts = {
        "date": f"{began:%Y-%m-%d %H:%M:%S} UTC",
        "place": _place(mission),
        "operators": _operators(logs, vehicles),
        "wind": _wind(vehicles),
        "weather": run.weather or "not noted",
        "battery at the end": _battery(vehicles),
        "log": ", ".join(_names(logs)),
        "versions": ", ".join(f"{each.name} {each.version}" for each in run.versions),
    }
    if kinds := _kinds(logs):
        facts["vehicles"] = "; ".join(f"{i}: {kind}" for i, kind in kinds.items())
    if run.planner is not None:
        facts["planner"] = planner_text(run.planner)
    if run.faults:
        facts["injected faults"] = ", ".join(run.faults)
    faults = [f"{log.path.name}: {fault}" for log in logs for fault in log.faults]
    return {**facts, "incomplete": "; ".join(faults)} if faults else facts


def _place(mission: Mission) -> str:
    origin = mission.mission_frame().origin
    if origin is None:
        return "a local frame"
    place = f"{origin.latitude_deg:.6f}, {origin.longitude_deg:.6f}, ground at {origin.altitude_m:g} m"
    return f"{place}; x points {mission.frame.x_bearing_deg:g}° from north"


def _operators(logs: Sequence[FlightLog], vehicles: Sequence["_VehicleReader"]) -> str:
    """Return who began the flight and who sent commands, as far as the logs hold it."""
    began = sorted({log.run.operator for log in logs} - {""})
    commanded = sorted({name for each in vehicles for name in each.operators})
    known = [f"begun by {', '.join(began)}"] * bool(began) + [f"commands by {', '.join(commanded)}"] * bool(commanded)
    return "; ".join(known) or "not recorded"


def _wind(vehicles: Sequence["_VehicleReader"]) -> str:
    """Return the wind as the autopilots estimated it."""
    known = {each.vehicle_id: each.wind_m_s for each in vehicles if each.wind_m_s}
    if not known:
        return "not reported"
    every = [speed_m_s for speeds_m_s in known.values() for speed_m_s in speeds_m_s]
    by = f"by the estimate of vehicle{'s' * (len(known) > 1)} {', '.join(map(str, known))}"
    return f"{float(np.median(every)):.1f} m/s, up to {max(every):.1f} m/s, {by}"


def _battery(vehicles: Sequence["_VehicleReader"]) -> str:
    known = [f"{each.vehicle_id}: {each.charge:.0%}" for each in vehicles if each.charge is not None]
    return ", ".join(known) or "not reported"


def _kinds(logs: Sequence[FlightLog]) -> dict[int, str]:
    """Return what the vehicles are, as far as the logs say it."""
    vehicles = ((i, each) for log in logs for i in log.run.vehicles for each in log.of_kind(i, Vehicle))
    return {i: each.kind for i, each in sorted(vehicles, key=lambda pair: pair[0]) if each.kind}


@dataclass(slots=True)
class _Columns:
    """The columns of a vehicle's data, a row per tick of its control loop."""

    time_s: list[float] = field(default_factory=list)
    own: list[list[float]] = field(default_factory=list)
    own_sigma: list[Vector] = field(default_factory=list)
    target_s: list[float] = field(default_factory=list)
    target: list[list[float]] = field(default_factory=list)
    target_sigma: list[Vector] = field(default_factory=list)
    own_s: list[float] = field(default_factory=list)
    tick_us: list[float] = field(default_factory=list)
    skipped: list[int] = field(default_factory=list)
    qp: list[str] = field(default_factory=list)
    guard: list[str] = field(default_factory=list)
    setpoint_m: list[tuple[float, ...]] = field(default_factory=list)
    velocity_m_s: list[tuple[float, ...]] = field(default_factory=list)
    yaw_rad: list[float] = field(default_factory=list)
    values: dict[int, dict[str, float]] = field(default_factory=dict)


class _VehicleReader:
    """Reads a vehicle's records once: feeds the journal and collects the evidence."""

    def __init__(self, log: FlightLog, vehicle_id: int, journal: Journal) -> None:
        self.vehicle_id = vehicle_id
        self.start_s: float | None = None
        self.last_s = -np.inf
        self._log = log
        self._journal = journal
        self._rows = _Columns()
        self._telemetry: list[tuple[float, float, float, float, float]] = []
        self._received: defaultdict[int, list[tuple[float, float]]] = defaultdict(list)
        self._peers: dict[int, MemberState] = {}
        self._battery: list[tuple[float, float]] = []
        self.wind_m_s: list[float] = []
        self.views: list[CameraView] = []
        self.operators: set[str] = set()
        self._round_trip_s: list[float] = []
        self._truth: dict[bool, list[tuple[float, ...]]] = {False: [], True: []}
        self._late = 0
        self._dropped = ""
        self._end = log.end_of(vehicle_id)
        records = log.vehicles.get(vehicle_id, [])
        self._costs_us = {cost.time_s: cost.tick_us for cost in log.of_kind(vehicle_id, Cost)}
        takers: dict[type[Any], Callable[[LogRecord], None]] = {
            Decision: self._decision,
            Telemetry: self._sample,
            Taken: self._message,
            Truth: self._position,
            AutopilotStatus: self._autopilot,
            Command: self._command,
        }
        for record in records:
            if record.kind in takers:
                takers[record.kind](record)
            elif record.kind is LateTicks:
                self._late = record.read(LateTicks).count
            elif record.kind is Start:
                self.start_s = record.read(Start).at_s

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return len(self._rows.time_s) if self._end is None else self._end.ticks

    @property
    def missed(self) -> int:
        """Number of missed ticks."""
        return sum(self._rows.skipped) if self._end is None else self._end.missed

    @property
    def charge(self) -> float | None:
        """The newest charge of the battery that it reported."""
        return self._battery[-1][1] if self._battery else None

    def ending(self, start_s: float, mission: Mission) -> VehicleEnding:
        """Return how its flight ended: where the log does not say so it ends before that."""
        if self._end is None:
            ends = f"the log ends in flight, {max(self.last_s - start_s, 0.0):.1f} s after the mission's start"
            how, reason, last = FlightEnd.IN_FLIGHT, ends, self._last_position
        else:
            how, reason, last = FlightEnd(self._end.how), self._end.reason, self._end.unaccounted
        unaccounted = None if last is None else Unaccounted.of(self.vehicle_id, last, mission.mission_frame())
        return VehicleEnding(self.vehicle_id, how, reason, unaccounted)

    @property
    def _last_position(self) -> LastPosition | None:
        """The newest position when the log ends, None without one."""
        if not self._telemetry:
            return None
        _, sampled_s, x, y, z = self._telemetry[-1]
        return LastPosition((x, y, z), max(self.last_s - sampled_s, 0.0) / self._log.run.speed)

    def truth(self, mission: Mission) -> TruthTrack | None:
        """Return the true motion of the vehicle, known afterwards or else received in flight; None if not known."""
        known = self._truth[False] or self._truth[True]
        if not known:
            return None
        return TruthTrack.of(mission.vehicle(self.vehicle_id).system_id, known)

    def evidence(self, start_s: float, speed: float) -> VehicleEvidence:
        """Return the evidence of the vehicle, with times since `start_s`; ages are in wall seconds."""
        rows, telemetry = self._rows, np.array(self._telemetry).reshape(-1, 5)
        own_s = np.array(rows.own_s)
        received_s, sampled_s = telemetry[:, 0], telemetry[:, 1]
        altitude_m = np.interp(own_s, sampled_s, telemetry[:, 4]) if len(telemetry) else np.full(own_s.size, np.nan)
        battery = np.array(self._battery).reshape(-1, 2) - [start_s, 0.0]
        return VehicleEvidence(
            self.vehicle_id,
            own=_estimates(own_s - start_s, rows.own, rows.own_sigma),
            target=_estimates(np.array(rows.target_s) - start_s, rows.target, rows.target_sigma),
            altitude_m=altitude_m,
            loop=LoopTiming(
                np.array(rows.time_s) - start_s,
                np.array(rows.tick_us),
                np.array(rows.skipped),
                np.array(rows.qp, dtype="<U16"),
                np.array(rows.guard, dtype="<U16"),
                np.array(rows.setpoint_m).reshape(-1, 3),
                np.array(rows.velocity_m_s).reshape(-1, 3),
                np.array(rows.yaw_rad),
                _value_columns(rows.values, len(rows.time_s)),
            ),
            samples=telemetry[:, 1:4] - [start_s, 0.0, 0.0],
            telemetry=Reception(received_s - start_s, (received_s - sampled_s) / speed),
            peers={peer: _reception(received, start_s, speed) for peer, received in sorted(self._received.items())},
            dropped=self._dropped,
            battery=battery,
            round_trip_s=np.array(self._round_trip_s),
        )

    def _decision(self, record: LogRecord) -> None:
        decision, journal = record.message(), self._journal
        journal.event_log.add_notes(self.vehicle_id, notes_of(decision))
        others = [each for each in decision.peers if each in self._peers and each not in self._log.run.vehicles]
        peers = [self._peers[each] for each in others]
        for peer in peers:
            journal.event_log.add_peer(peer)
        self._dropped = _drops_text(decision)
        tick_us = self._costs_us.get(decision.time_s)
        if tick_us is None:  # outside the control loop
            return
        self.last_s = decision.time_s
        journal.tick(tick_us, decision.guard.causes)
        journal.add_peers(peers, _target_of(decision), ring_of(decision))
        self._add(decision, tick_us)

    def _add(self, decision: Any, tick_us: float) -> None:
        rows = self._rows
        if values := getattr(decision, "values", ()):  # earlier logs have none
            rows.values[len(rows.time_s)] = {each.name: each.value for each in values}
        rows.time_s.append(decision.time_s)
        rows.tick_us.append(tick_us)
        rows.skipped.append(self._late)
        rows.qp.append(decision.qp)
        rows.guard.append(decision.guard.status)
        sent = decision.HasField("setpoint")
        rows.setpoint_m.append(tuple(decision.setpoint.position_m) if sent else (np.nan, np.nan, np.nan))
        rows.yaw_rad.append(decision.setpoint.yaw_rad if sent else np.nan)
        # Older logs have no velocity in the setpoint.
        rows.velocity_m_s.append(tuple(decision.setpoint.velocity_m_s) or (0.0, 0.0, 0.0))
        if decision.HasField("own"):
            mean = list(decision.own.mean)
            rows.own_s.append(decision.time_s)
            rows.own.append(mean[MOTION])
            rows.own_sigma.append(_sigma(decision.own.covariance, 6))
            height_m = self._telemetry[-1][4] if self._telemetry else np.nan
            of_tick = np.array(mean[MOTION]), height_m, decision.tactic, _target_of(decision), ring_of(decision)
            self._journal.add_sample(self.vehicle_id, decision.time_s, *of_tick)
        if decision.HasField("target"):
            rows.target_s.append(decision.time_s)
            rows.target.append(list(decision.target.mean))
            rows.target_sigma.append(_sigma(decision.target.covariance, 4))

    def _sample(self, record: LogRecord) -> None:
        sample = record.message()
        received_s = record.time_ns * 1e-9 * self._log.run.speed
        self._telemetry.append((received_s, sample.time_s, *sample.position_m))

    def _message(self, record: LogRecord) -> None:
        with suppress(LogError):  # a message is lost: the log's faults say so
            for received in self._log.messages(record):
                self._receive(received.message, received.now_s)

    def _command(self, record: LogRecord) -> None:
        self.operators.add(record.read(Command).command.origin)

    def _receive(self, message: BusMessage, now_s: float) -> None:
        if isinstance(message, OperatorCommand):
            self.operators.add(message.origin)
        if isinstance(message, MemberState):
            self._received[message.sender].append((now_s, message.time_s))
            newest = self._peers.get(message.sender)
            if newest is None or message.time_s > newest.time_s:
                self._peers[message.sender] = message
        if isinstance(message, CommandAnswer) and message.sender not in self._log.run.vehicles:
            self._journal.event_log.add_answer(message)

    def _position(self, record: LogRecord) -> None:
        truth = record.message()
        self._truth[truth.received].append((truth.time_s, *truth.position_m, *truth.velocity_m_s))

    def _autopilot(self, record: LogRecord) -> None:
        status = record.message().status
        if status.HasField("battery"):
            self._battery.append((record.time_ns * 1e-9 * self._log.run.speed, status.battery))
        if status.HasField("wind_m_s"):
            self.wind_m_s.append(status.wind_m_s)
        if status.HasField("round_trip_s"):
            self._round_trip_s.append(status.round_trip_s)
        if "camera" in status.DESCRIPTOR.fields_by_name and status.HasField("camera"):
            view = msgspec.convert(plain_message(status.camera), CameraView)
            if not self.views or view.time_s > self.views[-1].time_s:
                self.views.append(view)


def _value_columns(values: dict[int, dict[str, float]], ticks: int) -> dict[str, Vector]:
    """Return the planner's values of each name (T,), from those of single ticks."""
    columns: dict[str, Vector] = {}
    for tick, named in values.items():
        for name, value in named.items():
            columns.setdefault(name, np.full(ticks, np.nan))[tick] = value
    return columns


def _target_of(decision: Any) -> Vector | None:
    """Return the vehicle's estimate of the target's motion (4,), None without one."""
    return np.array(decision.target.mean) if decision.HasField("target") else None


def _estimates(time_s: Vector, motion: list[list[float]], sigma: list[Vector]) -> EstimateSeries:
    return EstimateSeries(time_s, np.array(motion).reshape(-1, 4), np.array(sigma).reshape(-1, 4))


def _drops_text(decision: Any) -> str:
    """Return how many messages were dropped so far, by reason; empty if none."""
    return Drops(**{field.name: value for field, value in decision.drops.ListFields()}).text()


def _sigma(covariance: Sequence[float], size: int) -> Vector:
    diagonal = np.array(covariance[:: size + 1])[MOTION]
    return np.asarray(np.sqrt(np.maximum(diagonal, 0.0)))


def _reception(received: list[tuple[float, float]], start_s: float, speed: float) -> Reception:
    received_s, sent_s = np.array(received).T
    return Reception(received_s - start_s, (received_s - sent_s) / speed)
