"""The in-process simulation: the real cores with simulated time, plants and network; seeded and deterministic.

It uses only the inputs and outputs of a core, as a vehicle link and a peer bus do.
"""

from array import array
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import expm1, hypot, inf
from time import perf_counter
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from estimation.plant.model import Plant
from estimation.state import Sighting, Telemetry, Vector
from sitl.draws import normals, uniforms
from sitl.vehicle.body import VehicleBody
from sitl.vehicle.imperfections import IDEAL, EstimatorDrift, Imperfections, TelemetrySchedule
from sitl.vehicle.plant_step import Motion, Pair, StepFunction

LANDED_AFTER_S: Final = 15.0
"""The time in the air of a vehicle whose agent has ended: it hovers, and its autopilot lands it."""


@dataclass(frozen=True, slots=True)
class Absence:
    """The agent of `vehicle_id` is absent from `from_s` (0: it starts late) until `to_s` (inf: to the end).

    Then a new agent begins with the vehicle at rest at `at_m` (None: its present position).
    """

    vehicle_id: int
    from_s: float
    to_s: float = inf
    at_m: tuple[float, float] | None = None


def absence_at(absences: Sequence[Absence], now_s: float) -> Absence | None:
    """Return the absence at a time, None if the agent is present."""
    return next((absence for absence in absences if absence.from_s <= now_s < absence.to_s), None)


@dataclass(frozen=True, slots=True)
class TelemetryNoise:
    """White noise on the telemetry of a vehicle; standard deviations per axis."""

    position_m: float = 0.0
    velocity_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """A simulated vehicle, hovering at rest at `start_m` and `altitude_m` in the mission frame at time 0.

    `plant` is its true plant, which may differ from the one that its core assumes. `seed` seeds all its random
    generators. `disturbance_m_s2` is a constant acceleration (x, y). A vehicle that `climbs` follows the altitude of
    its setpoints; any other keeps `altitude_m`. During `absences` its agent is absent. `step` is a dynamics function in
    place of the plant's equation and the shaping limits; delay and feed-forward remain the plant's.
    """

    plant: Plant
    start_m: tuple[float, float]
    altitude_m: float
    seed: tuple[int, ...]
    noise: TelemetryNoise = TelemetryNoise()
    disturbance_m_s2: tuple[float, float] = (0.0, 0.0)
    imperfections: Imperfections = IDEAL
    absences: Sequence[Absence] = ()
    climbs: bool = False
    step: StepFunction | None = None


class Sensor(Protocol):
    """A target sensor on board one vehicle."""

    def sight(self, now_s: float, position_m: tuple[float, float]) -> tuple[Sighting, ...]:
        """Return the sightings that are due, of the targets in range."""


class WantedPosition(Protocol):
    """The parts of a setpoint that a simulated vehicle uses."""

    @property
    def position_m(self) -> tuple[float, float, float]:
        """The position in the mission frame."""

    @property
    def velocity_m_s(self) -> tuple[float, ...]:
        """The feed-forward velocity, empty if none is sent."""


class Packet(Protocol):
    """A message on the simulated network."""

    def received(self) -> object:
        """Return the message as its receivers decode it."""


class Output(Protocol):
    """The output of a core's tick."""

    @property
    def setpoint(self) -> WantedPosition | None:
        """The setpoint, if any."""

    @property
    def messages(self) -> Sequence[Packet]:
        """The messages to peers."""


OutputT = TypeVar("OutputT", bound=Output)
OutputT_co = TypeVar("OutputT_co", bound=Output, covariant=True)


class Core(Protocol[OutputT_co]):
    """The core of an agent: see `agents.core.VehicleCore`."""

    def take(self, item: Any) -> None:
        """Take a sample of the vehicle's motion, a sighting, or one of the inputs that `Inputs` makes."""

    def tick(self, now_s: float) -> OutputT_co:
        """Decide and plan."""


class Inputs(NamedTuple):
    """Makes the inputs of cores that are not samples and sightings: a message with the time of its arrival, decoded,
    and a peer's id with whether it is there.
    """

    message: Callable[[float, Any], object]
    presence: Callable[[int, bool], object]


@dataclass(frozen=True, slots=True)
class NetworkModel:
    """The peers' radio: its range, its delay, and the share of lost messages.

    Range and loss are those of all links, or of each: by sender and receiver (N, N).
    """

    range_m: float | Vector
    delay_s: float = 0.0
    loss: float | Vector = 0.0


class SimulatedVehicle(Generic[OutputT]):
    """One simulated vehicle: its true motion, its core, its sensor and its instruments."""

    def __init__(
        self,
        model: VehicleModel,
        core: Core[OutputT],
        sensor: Sensor,
        new_core: Callable[[], Core[OutputT]] | None = None,
    ) -> None:
        """Put the vehicle at its start; `new_core` makes the core of an agent that returns after an absence."""
        self.core = core
        self._model = model
        self._new_core = new_core
        self._away: Absence | None = None
        wind_random = np.random.default_rng([*model.seed, _WIND])
        push_m_s2, imperfections = model.disturbance_m_s2, model.imperfections
        self._body = VehicleBody(
            model.plant, model.start_m, model.altitude_m, push_m_s2, imperfections, wind_random, model.step
        )
        self.altitude_m = self._wanted_altitude_m = model.altitude_m
        self._sensor = sensor
        self._noisy = model.noise != TelemetryNoise()
        self._normals = normals(np.random.default_rng(model.seed))
        self._lead_s = model.plant.lead_s
        drift, timing = model.imperfections.estimator_drift, model.imperfections.telemetry_timing
        drift_random = np.random.default_rng([*model.seed, _DRIFT])
        self._estimator_drift = None if drift is None else EstimatorDrift(drift, drift_random)
        timing_random = np.random.default_rng([*model.seed, _TELEMETRY])
        self._telemetry_schedule = None if timing is None else TelemetrySchedule(timing, timing_random)
        self._samples: list[Telemetry] = []

    @property
    def motion(self) -> Motion:
        """The true motion."""
        return self._body.motion

    @property
    def is_intermittent(self) -> bool:
        """Whether its agent has absences."""
        return len(self._model.absences) > 0

    @property
    def present(self) -> bool:
        """Whether its agent is present."""
        return self._away is None

    def aloft(self, now_s: float) -> bool:
        """Return whether it is in the air: without an agent its autopilot lands it."""
        return self._away is None or 0.0 < self._away.from_s > now_s - LANDED_AFTER_S

    def attend(self, now_s: float) -> Absence | None:
        """Start or end an absence of its agent if it is due; return that absence, None if there is none."""
        before, self._away = self._away, absence_at(self._model.absences, now_s)
        if before is self._away:
            return None
        if self._away is not None:
            self._body.rest()
            return self._away
        assert before is not None
        self._body.rest(before.at_m)
        if before.from_s > 0.0 and self._new_core is not None:
            self.core = self._new_core()
        return before

    def push(self, acceleration_m_s2: Pair) -> None:
        """Set the constant acceleration (x, y) on the vehicle, beside that of its model."""
        (x, y), (own_x, own_y) = acceleration_m_s2, self._model.disturbance_m_s2
        self._body.disturbance_m_s2 = own_x + x, own_y + y

    def sense(self, now_s: float) -> tuple[list[Telemetry], Sequence[Sighting]]:
        """Return the samples of its instruments since the last call, and its sensor's sightings.

        The sensor measures relative to the true position; a sighting is relative to the estimated position at that
        time, so it includes the error of the vehicle's position.
        """
        samples, self._samples = self._samples, []
        if self._telemetry_schedule is None or now_s == 0.0:
            samples.append(self._sample(now_s))
        sightings = self._sensor.sight(now_s, self.motion[:2])
        return samples, [self._as_reported(sighting) for sighting in sightings] if sightings else ()

    def _as_reported(self, sighting: Sighting) -> Sighting:
        if self._estimator_drift is None:
            return sighting
        (x, y), (off_x, off_y) = sighting.position_m, self._estimator_drift.earlier_error_m(sighting.time_s)
        return msgspec.structs.replace(sighting, position_m=(x + off_x, y + off_y))

    def think(self, now_s: float, samples: Sequence[Telemetry], sightings: Sequence[Sighting]) -> OutputT:
        """Pass the samples and the sightings to the core, and tick it."""
        for telemetry in samples:
            self.core.take(telemetry)
        for sighting in sightings:
            self.core.take(sighting)
        return self.core.tick(now_s)

    def command(self, now_s: float, wanted: WantedPosition | None) -> None:
        """Send a setpoint, which acts one delay later."""
        if wanted is not None:
            self._body.command(now_s, self._aim_m(wanted))
            if self._model.climbs:
                fed_m_s = wanted.velocity_m_s[2] if wanted.velocity_m_s else 0.0
                self._wanted_altitude_m = wanted.position_m[2] + fed_m_s / CLIMB_PER_S

    def _aim_m(self, wanted: WantedPosition) -> Pair:
        """Return the same as `Plant.aim_m`, as numbers."""
        (x, y, _), velocity_m_s, (lead_x, lead_y) = wanted.position_m, wanted.velocity_m_s, self._lead_s
        return (x + lead_x * velocity_m_s[0], y + lead_y * velocity_m_s[1]) if velocity_m_s else (x, y)

    def advance(self, from_s: float, to_s: float) -> None:
        """Move the true vehicle, apply setpoints when they take effect, and take the samples that are due."""
        if self._telemetry_schedule is not None:
            for due_s in self._telemetry_schedule.due_s(to_s):
                if due_s > from_s:
                    self._move(from_s, due_s)
                    from_s = due_s
                    self._samples.append(self._sample(due_s))
        self._move(from_s, to_s)

    def _move(self, from_s: float, to_s: float) -> None:
        self._body.advance(from_s, to_s, self._off_m(from_s))
        if self._left_m != 0.0:
            self.altitude_m += self._left_m * -expm1(-CLIMB_PER_S * (to_s - from_s))

    @property
    def _left_m(self) -> float:
        return self._wanted_altitude_m - self.altitude_m

    def _off_m(self, at_s: float) -> Pair:
        return (0.0, 0.0) if self._estimator_drift is None else self._estimator_drift.error_m(at_s)

    def _sample(self, at_s: float) -> Telemetry:
        x, y, x_rate, y_rate = self.motion
        if self._noisy:
            noise, draw = self._model.noise, self._normals
            x, y = x + noise.position_m * next(draw), y + noise.position_m * next(draw)
            x_rate, y_rate = x_rate + noise.velocity_m_s * next(draw), y_rate + noise.velocity_m_s * next(draw)
        off_x, off_y = self._off_m(at_s)
        return Telemetry(at_s, (x + off_x, y + off_y, self.altitude_m), (x_rate, y_rate, CLIMB_PER_S * self._left_m))


CLIMB_PER_S: Final = 0.62
"""Climb rate per metre of altitude error, as for the stub vehicles (sitl/autopilot/airframe.py)."""
_WIND, _DRIFT, _TELEMETRY = range(3)
"""Each random process has its own generator, so that disabling one does not change the others."""
_ROUNDING_S: Final = 1e-9
"""A delay of whole ticks ends on a tick in spite of rounding."""


class _Flying(NamedTuple):
    """Messages of one sender in transit: arrival time and receivers."""

    arrive_s: float
    messages: Sequence[object]
    receivers: Sequence[int]


class _Network:
    """Packets between `count` vehicles. All have the same delay, so that they arrive in the order of sending.

    Another model may take the place of `model` at any time, with the same delay.
    """

    def __init__(self, model: NetworkModel, count: int, seed: int) -> None:
        self.model = model
        self._uniforms = uniforms(np.random.default_rng([seed, 0]))
        self._flying: deque[_Flying] = deque()
        self._others = [[each for each in range(count) if each != sender] for sender in range(count)]
        self._reached: Sequence[Sequence[int]] = self._others

    def place(self, positions_m: Sequence[Pair]) -> None:
        """Set the positions of the vehicles (count,), which determine who is in range of whom."""
        x, y, range_m = *zip(*positions_m, strict=True), self.model.range_m
        if not isinstance(range_m, np.ndarray) and hypot(max(x) - min(x), max(y) - min(y)) <= range_m:
            self._reached = self._others
            return
        at_m = np.array(positions_m)
        apart_m = np.hypot(*np.moveaxis(at_m[:, None] - at_m, 2, 0))
        np.fill_diagonal(apart_m, np.inf)
        self._reached = [np.flatnonzero(row).tolist() for row in apart_m <= range_m]

    def send(self, now_s: float, sender: int, packets: Sequence[Packet]) -> None:
        """Send to every other vehicle in range, decoded once for all; each copy is lost independently."""
        receivers, loss = self._reached[sender], self.model.loss
        if not packets or not receivers:
            return
        arrive_s, messages = now_s + self.model.delay_s, [packet.received() for packet in packets]
        each_loss = loss[sender].tolist() if isinstance(loss, np.ndarray) else [loss] * len(self._others)
        if not any(each_loss):
            self._flying.append(_Flying(arrive_s, messages, receivers))
            return
        for receiver in receivers:
            kept = [message for message in messages if next(self._uniforms) >= each_loss[receiver]]
            self._flying.append(_Flying(arrive_s, kept, (receiver,)))

    def arrived(self, now_s: float, taken: Callable[[float, Any], object]) -> list[list[object]]:
        """Return and remove the messages that have arrived, by receiver, each as `taken` makes it for all of them."""
        arrived: list[list[object]] = [[] for _ in self._others]
        while self._flying and self._flying[0].arrive_s <= now_s + _ROUNDING_S:
            _, messages, receivers = self._flying.popleft()
            items = [taken(now_s, message) for message in messages]
            for receiver in receivers:
                arrived[receiver] += items
        return arrived


@dataclass(frozen=True, slots=True)
class SimulatedFlight:
    """The truth of a simulated flight: `time_s` (T,), motions (T, N, 4), altitudes and tick times [us] (T, N).

    The computing time of a tick includes everything that a core does in one period: messages, sensors, decision and
    plan. `aloft` (T, N) is which vehicles are in the air.
    """

    time_s: Vector
    motion: Vector
    altitude_m: Vector
    tick_us: Vector
    aloft: NDArray[np.bool_]


class _Truth:
    """Records the true motions, tick by tick, and the computing time of each tick."""

    def __init__(self, ticks: int, vehicles: Sequence[SimulatedVehicle[OutputT]]) -> None:
        self._vehicles = vehicles
        self._intermittent = [(index, vehicle) for index, vehicle in enumerate(vehicles) if vehicle.is_intermittent]
        self._motion, self._altitude_m = array("d"), array("d")
        self._aloft = np.ones((ticks, len(vehicles)), dtype=np.bool_)
        self.tick_us = array("d")

    def note(self, tick: int, now_s: float) -> list[Motion]:
        """Record a tick's motions and return them."""
        motions = [vehicle.motion for vehicle in self._vehicles]
        for motion in motions:
            self._motion.extend(motion)
        self._altitude_m.extend([vehicle.altitude_m for vehicle in self._vehicles])
        for index, vehicle in self._intermittent:
            self._aloft[tick, index] = vehicle.aloft(now_s)
        return motions

    def flight(self, time_s: Vector) -> SimulatedFlight:
        """Return the recorded flight."""
        shape = self._aloft.shape
        motion, altitude_m, tick_us = map(np.frombuffer, (self._motion, self._altitude_m, self.tick_us))
        return SimulatedFlight(
            time_s, motion.reshape(*shape, 4), altitude_m.reshape(shape), tick_us.reshape(shape), self._aloft
        )


def _nothing(*_: object) -> None:
    """Do nothing: mypyc compiles no such lambda."""


def simulate(
    vehicles: Sequence[SimulatedVehicle[OutputT]],
    network: NetworkModel,
    *,
    rate_hz: float,
    duration_s: float,
    seed: int,
    inputs: Inputs,
    observe: Callable[[int, int, OutputT], None],
    progress: Callable[[float], None],
    move_target: Callable[[float, Sequence[Motion]], None] = _nothing,
    intervene: Callable[[int, float], NetworkModel | None] = _nothing,
) -> SimulatedFlight:
    """Fly all vehicles from time 0 for `duration_s`; `observe(tick, vehicle, output)` is called for every tick.

    `move_target` is called with the time and the true motions at every tick, before any vehicle senses. `intervene` is
    called before that with tick and time, once agents that are due are absent or back; it may change the vehicles, and
    returns the network from then on, of the same delay (None: as before).
    """
    time_s = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    truth, air = _Truth(time_s.size, vehicles), _Network(network, len(vehicles), seed)
    intermittent = [vehicle for vehicle in vehicles if vehicle.is_intermittent]
    for tick, now_s in enumerate(time_s.tolist()):
        for vehicle in intermittent:
            _attend(vehicle, vehicles, now_s, inputs)
        air.model = intervene(tick, now_s) or air.model
        motions = truth.note(tick, now_s)
        move_target(now_s, motions)
        air.place([motion[:2] for motion in motions])
        for index, (vehicle, messages) in enumerate(zip(vehicles, air.arrived(now_s, inputs.message), strict=True)):
            samples, sightings = vehicle.sense(now_s)
            if not vehicle.present:
                truth.tick_us.append(0.0)
                continue
            began = perf_counter()
            for message in messages:
                vehicle.core.take(message)
            output = vehicle.think(now_s, samples, sightings)
            truth.tick_us.append((perf_counter() - began) * 1e6)
            vehicle.command(now_s, output.setpoint)
            air.send(now_s, index, output.messages)
            observe(tick, index, output)
        for vehicle in vehicles:
            vehicle.advance(now_s, now_s + 1.0 / rate_hz)
        progress(now_s)
    return truth.flight(time_s)


def _attend(
    vehicle: SimulatedVehicle[OutputT], vehicles: Sequence[SimulatedVehicle[OutputT]], now_s: float, inputs: Inputs
) -> None:
    """Start or end an absence of a vehicle's agent if it is due, and notify all agents that are present."""
    changed = vehicle.attend(now_s)
    if changed is None:
        return
    for other in vehicles:
        if other is not vehicle and other.present:
            other.core.take(inputs.presence(changed.vehicle_id, vehicle.present))
