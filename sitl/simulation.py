"""The in-process simulation: the cores that fly, with simulated time, plants and network; seeded, deterministic.

It knows a core only by what goes in and out of it, as a vehicle link and a peer bus would.
"""

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import hypot
from time import perf_counter
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from estimation.plant import Plant, exact_step
from estimation.state import MOTION, POSITION, Sighting, Telemetry, Vector
from sitl.absence import LANDED_AFTER_S, Absence, absence_at


class Sensor(Protocol):
    """A sensor of the target that travels with one vehicle."""

    def sight(self, now_s: float, position_m: tuple[float, float]) -> Sighting | None:
        """Return a sighting when one is due and in range."""
        ...


class WantedPosition(Protocol):
    """A setpoint as far as a simulated vehicle obeys it."""

    @property
    def position_m(self) -> tuple[float, float, float]:
        """Mission frame."""
        ...

    @property
    def velocity_m_s(self) -> tuple[float, ...]:
        """The velocity beside it, empty if there is none."""
        ...


class Packet(Protocol):
    """A message on the simulated network."""

    @property
    def payload(self) -> bytes:
        """The bytes that go over the air."""
        ...


class Output(Protocol):
    """What a core asks for in a tick."""

    @property
    def setpoint(self) -> WantedPosition | None:
        """The position wanted."""
        ...

    @property
    def messages(self) -> Sequence[Packet]:
        """What peers shall hear."""
        ...


OutputT = TypeVar("OutputT", bound=Output)
OutputT_co = TypeVar("OutputT_co", bound=Output, covariant=True)


class Core(Protocol[OutputT_co]):
    """A vehicle's decision making: see `agents.core.VehicleCore`."""

    def on_telemetry(self, telemetry: Telemetry) -> None:
        """Take a sample of the vehicle's own motion."""
        ...

    def on_sighting(self, sighting: Sighting) -> None:
        """Take a sighting of the target."""
        ...

    def on_message(self, payload: bytes, now_s: float) -> None:
        """Take a peer's message."""
        ...

    def on_presence(self, vehicle_id: int, present: bool) -> None:
        """Take the news that a peer has come or gone."""
        ...

    def tick(self, now_s: float) -> OutputT_co:
        """Decide and plan."""
        ...


@dataclass(frozen=True, slots=True)
class NetworkModel:
    """The peers' radio: how far it reaches, how late a message comes, and the share that never comes."""

    range_m: float
    delay_s: float = 0.0
    loss: float = 0.0


@dataclass(frozen=True, slots=True)
class TelemetryNoise:
    """White noise on what a vehicle reports of itself; standard deviations per axis."""

    position_m: float = 0.0
    velocity_m_s: float = 0.0


class SimulatedVehicle(Generic[OutputT]):
    """One simulated vehicle: its true plant and motion, what it carries, and the setpoints on their way to it."""

    def __init__(
        self,
        core: Core[OutputT],
        plant: Plant,
        start_m: tuple[float, float],
        altitude_m: float,
        sensor: Sensor,
        noise: TelemetryNoise,
        disturbance_m_s2: tuple[float, float],
        seed: Sequence[int],
        absences: Sequence[Absence] = (),
        new_core: Callable[[], Core[OutputT]] | None = None,
    ) -> None:
        """Put a vehicle at rest, hovering at `start_m`; `plant` is the truth, which its core need not know.

        `new_core` makes the core of an agent that comes back after one of the `absences`.
        """
        self.core = core
        self._absences = absences
        self._new_core = new_core
        self._away: Absence | None = None
        self.motion: Vector = np.array([*start_m, 0.0, 0.0])
        self._plant = plant
        self._altitude_m = altitude_m
        self._sensor = sensor
        self._noise = np.array([noise.position_m] * 2 + [noise.velocity_m_s] * 2)
        self._disturbance = np.array(disturbance_m_s2)
        self._random = np.random.default_rng(seed)
        self._aim_m: Vector = np.array(start_m)
        self._pending: list[tuple[float, Vector]] = []

    @property
    def present(self) -> bool:
        """Whether its agent is there."""
        return self._away is None

    def aloft(self, now_s: float) -> bool:
        """Return whether it is in the air: one whose agent has died is landed by its autopilot."""
        return self._away is None or 0.0 < self._away.from_s > now_s - LANDED_AFTER_S

    def attend(self, now_s: float) -> Absence | None:
        """Let its agent come or go, if it is time; return the absence that begins or ends now, None if none does."""
        before, self._away = self._away, absence_at(self._absences, now_s)
        if before is self._away:
            return None
        if self._away is not None:
            self._rest(self.motion[POSITION])
            return self._away
        assert before is not None
        if before.at_m is not None:
            self.motion = np.array([*before.at_m, 0.0, 0.0])
        self._rest(self.motion[POSITION])
        if before.from_s > 0.0 and self._new_core is not None:
            self.core = self._new_core()
        return before

    def sense(self, now_s: float) -> tuple[Telemetry, Sighting | None]:
        """Return what its instruments say, and its sensor if it sees the target now."""
        x, y, x_rate, y_rate = (self.motion + self._noise * self._random.standard_normal(4)).tolist()
        true_x, true_y = self.motion[POSITION].tolist()
        telemetry = Telemetry(now_s, (x, y, self._altitude_m), (x_rate, y_rate, 0.0))
        return telemetry, self._sensor.sight(now_s, (true_x, true_y))

    def think(self, now_s: float, telemetry: Telemetry, sighting: Sighting | None) -> OutputT:
        """Let the core take in what was sensed, and decide."""
        self.core.on_telemetry(telemetry)
        if sighting is not None:
            self.core.on_sighting(sighting)
        return self.core.tick(now_s)

    def command(self, now_s: float, wanted: WantedPosition | None) -> None:
        """Send a setpoint on its way; it acts one delay later."""
        if wanted is not None:
            self._pending.append(
                (now_s + self._plant.delay_s, self._plant.aim_m(wanted.position_m, wanted.velocity_m_s))
            )

    def advance(self, from_s: float, to_s: float) -> None:
        """Move the true vehicle, changing setpoints exactly when they take effect."""
        while self._pending and self._pending[0][0] <= to_s:
            acts_s, aim_m = self._pending.pop(0)
            self._fly(max(acts_s, from_s) - from_s)
            from_s = max(acts_s, from_s)
            self._aim_m = aim_m
        self._fly(to_s - from_s)

    def _rest(self, place_m: Vector) -> None:
        """Let the autopilot hold the vehicle at (2,), whatever setpoints are still on their way."""
        self._pending.clear()
        self._setpoint_m = place_m.copy()

    def _fly(self, step_s: float) -> None:
        step_s = round(step_s, 9)
        if step_s > 0.0:
            step = exact_step(self._plant, step_s)
            self.motion = step.advance(self.motion, self._aim_m, self._disturbance)


_ROUNDING_S = 1e-9
"""A delay of whole ticks arrives on a tick, whatever its last binary digit says."""


class _Network:
    """Packets in flight between vehicles, by the time they arrive."""

    def __init__(self, model: NetworkModel, seed: int) -> None:
        self._model = model
        self._random = np.random.default_rng([seed, 0])
        self._flying: list[tuple[float, int, int, bytes]] = []
        self._count = 0

    def send(self, now_s: float, sender: int, packets: Sequence[Packet], positions: Vector) -> None:
        """Send to every other vehicle in range; each copy is lost or late on its own."""
        x, y = positions[sender].tolist()
        for receiver, (other_x, other_y) in enumerate(positions.tolist()):
            if receiver == sender or hypot(other_x - x, other_y - y) > self._model.range_m:
                continue
            for packet in packets:
                if self._model.loss == 0.0 or self._random.random() >= self._model.loss:
                    arrival = (now_s + self._model.delay_s, self._count, receiver, packet.payload)
                    heapq.heappush(self._flying, arrival)
                    self._count += 1

    def arrived(self, now_s: float) -> list[tuple[int, bytes]]:
        """Take out what has arrived: receivers and payloads."""
        arrived = []
        while self._flying and self._flying[0][0] <= now_s + _ROUNDING_S:
            _, _, receiver, payload = heapq.heappop(self._flying)
            arrived.append((receiver, payload))
        return arrived


@dataclass(frozen=True, slots=True)
class SimulatedFlight:
    """The truth of a simulated flight: `time_s` (T,), motions (T, N, 4), and what each tick cost [us] (T, N).

    A tick's cost is all a vehicle's core does in one period: what peers say, its own sensors, decision and plan.
    `aloft` (T, N) says who is in the air.
    """

    time_s: Vector
    motion: Vector
    tick_us: Vector
    aloft: NDArray[np.bool_]


def simulate(
    vehicles: Sequence[SimulatedVehicle[OutputT]],
    network: NetworkModel,
    *,
    rate_hz: float,
    duration_s: float,
    seed: int,
    observe: Callable[[int, int, OutputT], None],
    progress: Callable[[float], None],
) -> SimulatedFlight:
    """Fly all vehicles from time 0 for `duration_s`; `observe(tick, vehicle, output)` sees every decision."""
    ticks = round(duration_s * rate_hz) + 1
    time_s = np.arange(ticks) / rate_hz
    motion = np.empty((ticks, len(vehicles), 4))
    tick_us = np.zeros((ticks, len(vehicles)))
    aloft = np.ones((ticks, len(vehicles)), dtype=np.bool_)
    air = _Network(network, seed)
    for tick, now_s in enumerate(time_s.tolist()):
        _attend(vehicles, now_s)
        for index, vehicle in enumerate(vehicles):
            motion[tick, index, MOTION] = vehicle.motion
            aloft[tick, index] = vehicle.aloft(now_s)
        for receiver, payload in air.arrived(now_s):
            if not vehicles[receiver].present:
                continue
            began = perf_counter()
            vehicles[receiver].core.on_message(payload, now_s)
            tick_us[tick, receiver] += (perf_counter() - began) * 1e6
        for index, vehicle in enumerate(vehicles):
            sensed = vehicle.sense(now_s)
            if not vehicle.present:
                continue
            began = perf_counter()
            output = vehicle.think(now_s, *sensed)
            tick_us[tick, index] += (perf_counter() - began) * 1e6
            vehicle.command(now_s, output.setpoint)
            air.send(now_s, index, output.messages, motion[tick, :, POSITION])
            observe(tick, index, output)
        for vehicle in vehicles:
            vehicle.advance(now_s, now_s + 1.0 / rate_hz)
        progress(now_s)
    return SimulatedFlight(time_s, motion, tick_us, aloft)


def _attend(vehicles: Sequence[SimulatedVehicle[OutputT]], now_s: float) -> None:
    """Let agents come and go, and tell all that are there."""
    for vehicle in vehicles:
        changed = vehicle.attend(now_s)
        if changed is None:
            continue
        for other in vehicles:
            if other is not vehicle and other.present:
                other.core.on_presence(changed.vehicle_id, vehicle.present)
