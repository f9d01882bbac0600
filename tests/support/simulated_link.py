"""One connection over an emulated radio, without sockets and in simulated time: its rates, queue, counts and silences.

The vehicles only send what was requested of them, and note when setpoints arrive.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import inf

from agents.safety.failsafe import SILENCES_PER_HOUR_MAX
from gcs.link.rates import (
    ESTIMATOR_BYTES,
    HEARTBEAT_BYTES,
    HEARTBEAT_HZ,
    ROUND_TRIP_BYTES,
    ROUND_TRIP_HZ,
    SETPOINT_BYTES,
    SLOW_STATUS_BYTES,
    STATUS_BYTES,
    TELEMETRY_BYTES,
    RateController,
    Rates,
    Traffic,
)
from gcs.link.relay.frames import HEARTBEAT, MAGIC_V2, SETPOINT, TIMESYNC, target_system
from gcs.link.relay.gate import RoundTrips, Sequences
from gcs.link.relay.relay import TransmitQueue
from gcs.preflight.link_facts import are_known
from sitl.radio import Air, Channel, RadioSpec

STEP_S = 0.01
TICK_S = 0.05
PLACE = ("radio", 1)
SET_WITHIN_S = 1.0
"""How long it takes until the vehicles send at new rates."""
OFFBOARD_S, TELEMETRY_S = 1.0, 1.0
NOTICED_S = 0.1
"""PX4 checks the stream of setpoints ten times a second."""
FULL = Rates(telemetry_hz=20.0, status_hz=2.0, setpoint_hz=20.0)


def frame(message: int, length: int, number: int = 0, *, vehicle: int = 0) -> bytes:
    """Return a frame of this length with a number and, for setpoints, a target."""
    payload = bytearray(length - 12)
    payload[4:12] = number.to_bytes(8, "little")
    if message == SETPOINT:
        payload[50] = vehicle
    return bytes((MAGIC_V2, length - 12, 0, 0, 0, 245, 190, message, 0, 0)) + bytes(payload) + b"\0\0"


def number_of(sent: bytes) -> int:
    """Return the number in a frame."""
    return int.from_bytes(sent[14:22], "little")


@dataclass(slots=True)
class Stream:
    """Messages that are sent a number of times a second."""

    message: int
    length: int
    next_s: float = 0.0

    def due(self, now_s: float, rate_hz: float) -> bool:
        """Return whether one is due."""
        if now_s < self.next_s:
            return False
        self.next_s = max(self.next_s + 1.0 / rate_hz, now_s)
        return True


@dataclass(slots=True)
class SimulatedVehicle:
    """One vehicle: its streams, its sequence numbers, and when setpoints and motions arrived last."""

    number: int
    streams: list[tuple[str, Stream]]
    down: Channel
    sequence: int = 0
    sequences: Sequences = field(default_factory=Sequences)
    setpoint_s: float = 0.0
    motion_s: float = 0.0
    is_without_setpoints: bool = False
    is_without_motion: bool = False

    def send(self, message: int, length: int, number: int, now_s: float) -> None:
        """Send a message, with the next sequence number in the place of the MAVLink header."""
        sent = bytearray(frame(message, length, number))
        sent[4], sent[5] = self.sequence % 256, self.number
        self.sequence += 1
        self.down.send(bytes(sent), now_s)


@dataclass
class Silences:
    """When a vehicle left offboard, and when one held for want of motion [s since the start]."""

    offboard_s: list[float] = field(default_factory=list)
    motion_s: list[float] = field(default_factory=list)


class SimulatedLink:
    """A connection of `vehicles` over a radio: own channels of each direction, or with `shared` one air for all."""

    def __init__(self, spec: RadioSpec, vehicles: int) -> None:
        self.pace = RateController(
            FULL, vehicles, spec.bytes_s, automatic=True, telemetry_s=TELEMETRY_S, offboard_s=OFFBOARD_S
        )
        self.now_s = 0.0
        self.silences = Silences()
        self.faults: list[str] = []
        """The connection's faults, one for each time that it began."""
        shared = Air(spec.bytes_s)

        def channel(number: int) -> Channel:
            return Channel(spec, shared if spec.shared else Air(spec.bytes_s), (spec.seed, number))

        self._buffer_bytes = spec.buffer_bytes
        self._up = channel(0)
        self._vehicles = [
            SimulatedVehicle(number, list(_streams(number / 100.0)), channel(number))
            for number in range(1, vehicles + 1)
        ]
        self._queue = TransmitQueue()
        self._round_trips = RoundTrips()
        self._sent = FULL
        self._set_s = inf
        self._free = 1.0
        self._up_streams = [(HEARTBEAT_HZ, Stream(HEARTBEAT, HEARTBEAT_BYTES))]
        self._up_streams += [(ROUND_TRIP_HZ, Stream(TIMESYNC, ROUND_TRIP_BYTES))]
        self._tick_next_s = self._look_next_s = 0.0
        self._setpoints = 0
        self._flies = False
        self._set_rates()
        self._sent = self.pace.rates

    @property
    def traffic(self) -> Traffic:
        """The counts, as the relay has them."""
        every = [vehicle.sequences for vehicle in self._vehicles]
        return Traffic(
            received=sum(each.received for each in every),
            missed=sum(each.missed for each in every),
            bursts=sum(each.bursts for each in every),
            buffer_free=self._free,
            delay_grown_s=self._round_trips.grown_s,
        )

    def check(self) -> str:
        """Count losses on the ground as the preflight does; return why the link is refused, empty if it is not."""
        assert self.pace.capacity_bytes_s is not None
        if self.pace.load.bytes_s > self.pace.capacity_bytes_s:
            return "too slow"
        self._advance(2.0)
        before, since_s = self.traffic, self.now_s
        while not are_known(self.traffic.losses(before), self.pace, self.now_s - since_s):
            self._advance(self.now_s + 0.4)
        self.pace.adapt(self.traffic.losses(before))
        self._set_rates()
        silences = self.pace.silences_per_hour
        return f"{self.pace.losses}: {silences:.1g} silences an hour" if silences > SILENCES_PER_HOUR_MAX else ""

    def fly(self, duration_s: float) -> Silences:
        """Send setpoints for a time; return the silences."""
        self._flies = True
        for vehicle in self._vehicles:
            vehicle.setpoint_s = vehicle.motion_s = self.now_s
        self._advance(self.now_s + duration_s)
        return self.silences

    def _advance(self, to_s: float) -> None:
        while self.now_s < to_s:
            self.now_s += STEP_S
            self._station()
            self._at_vehicles()
            self._at_station()
            if self._flies:
                self._note_silences()

    def _station(self) -> None:
        now_s = self.now_s
        if self._flies and now_s >= self._tick_next_s:
            self._tick_next_s = max(self._tick_next_s + TICK_S, now_s)
            self._setpoints += 1
            for vehicle in self._vehicles:
                self._queue.put(frame(SETPOINT, SETPOINT_BYTES, self._setpoints, vehicle=vehicle.number), PLACE)
        for rate_hz, stream in self._up_streams:
            if stream.due(now_s, rate_hz):
                now_ns = round(now_s * 1e9)
                if stream.message == TIMESYNC:
                    self._round_trips.asked(now_ns)
                self._queue.put(frame(stream.message, stream.length, now_ns), PLACE)
        for sent, _ in self._queue.due(now_s):
            self._up.send(sent, now_s)
        if now_s >= self._look_next_s:
            self._look_next_s = now_s + 1.0
            self._free = 1.0 - self._up.waiting_bytes(now_s) / self._buffer_bytes
            before, rates = self.pace.fault, self.pace.rates
            self.pace.look(self.traffic, now_s)
            if self.pace.fault and not before:
                self.faults.append(self.pace.fault)
            if self.pace.rates != rates:
                self._set_rates()

    def _set_rates(self) -> None:
        self._queue.bytes_s = self.pace.up_bytes_s or inf
        self._queue.setpoint_hz, self._queue.copies = self.pace.rates.setpoint_hz, self.pace.copies
        self._set_s = self.now_s + SET_WITHIN_S

    def _at_vehicles(self) -> None:
        for arrived in self._up.arrived(self.now_s):
            for vehicle in self._vehicles:
                if arrived[7] == SETPOINT and target_system(arrived) == vehicle.number:
                    vehicle.setpoint_s = self.now_s
                elif arrived[7] == TIMESYNC:
                    vehicle.send(TIMESYNC, ROUND_TRIP_BYTES, number_of(arrived), self.now_s)
        if self.now_s >= self._set_s:
            self._set_s, self._sent = inf, self.pace.rates
        rates_hz = {
            "motion": self._sent.telemetry_hz,
            "status": self._sent.status_hz,
            "slow": self._sent.status_hz / 2.0,
            "heartbeat": HEARTBEAT_HZ,
        }
        for vehicle in self._vehicles:
            for name, stream in vehicle.streams:
                if stream.due(self.now_s, rates_hz[name]):
                    vehicle.send(stream.message, stream.length, 0, self.now_s)

    def _at_station(self) -> None:
        for vehicle in self._vehicles:
            for arrived in vehicle.down.arrived(self.now_s):
                vehicle.sequences.take(1, arrived[4])
                if arrived[7] == TIMESYNC:
                    self._round_trips.answered(number_of(arrived), round(self.now_s * 1e9))
                elif len(arrived) == TELEMETRY_BYTES and arrived[7] == _MOTION:
                    vehicle.motion_s = self.now_s

    def _note_silences(self) -> None:
        for vehicle in self._vehicles:
            silent = self.now_s - vehicle.setpoint_s > OFFBOARD_S + NOTICED_S
            if silent and not vehicle.is_without_setpoints:
                self.silences.offboard_s.append(self.now_s)
            vehicle.is_without_setpoints = silent
            silent = self.now_s - vehicle.motion_s > TELEMETRY_S
            if silent and not vehicle.is_without_motion:
                self.silences.motion_s.append(self.now_s)
            vehicle.is_without_motion = silent


_MOTION = 32


def _streams(phase_s: float) -> Iterator[tuple[str, Stream]]:
    yield "motion", Stream(_MOTION, TELEMETRY_BYTES, phase_s)
    yield "heartbeat", Stream(HEARTBEAT, HEARTBEAT_BYTES, phase_s)
    yield from (("status", Stream(1, length, phase_s)) for length in STATUS_BYTES.values())
    yield from (("slow", Stream(2, length, phase_s)) for length in (*SLOW_STATUS_BYTES.values(), *ESTIMATOR_BYTES))
