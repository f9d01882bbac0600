"""The stub vehicles on UDP: one socket and one MAVLink stream per vehicle, in scaled time, and their true tracks."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from math import floor, isfinite
from typing import cast

import numpy as np

from estimation.frames import MissionFrame, Triple
from estimation.plant.model import Plant
from estimation.state import Telemetry, Vector
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.arducopter import ArduCopter
from sitl.autopilot.equipment import Battery, Positioning
from sitl.autopilot.modes import NavMode
from sitl.autopilot.parameters import Value
from sitl.autopilot.px4 import Autopilot
from sitl.faults import VehicleFaults, VehicleInjection
from sitl.mavlink.dialects import ARDUCOPTER, PX4, AutopilotKind, Dialect
from sitl.mavlink.protocol import MavlinkVehicle
from sitl.mavlink.reports import EstimatorNoise, MavlinkConfig
from sitl.mavlink.signing import SigningKey

WAKE_PERIOD_S = 0.004
"""The shortest wall time between two updates: at high speed an update takes several steps."""
CATCH_UP_MAX_S = 0.5
"""The largest simulated time of one update; time beyond it is dropped, which lowers the speed reached.

It is shorter than the offboard timeout: a stall of the stub must not trigger that timeout.
"""
TRUTH_STEPS = round(0.1 / STEP_S)
DATAGRAM_MAX = 1400
PEERS_MAX = 4
LOOPBACK = "127.0.0.1"

Address = tuple[str, int]


@dataclass(frozen=True, slots=True)
class StubConfig:
    """One stub vehicle: its identity, the address of its client, its start and its flight properties.

    The vehicle id is its MAVLink system id. Mission frame; `origin_offset_m` is the estimator's origin seen from the
    start position, `wind_m_s2` a constant disturbance acceleration. Raises ValueError for invalid values.

    Without `gps` it has a local position but no global one, no home and no geodetic origin, as a PX4 that is flown
    indoors by external position: neither hold nor return can be flown, and it arms in take-off or offboard only. If it
    is not `localised`, it has no position and cannot be armed; an `external` one has a position while it receives
    external positions. `port` is its own port for clients; 0 is any. `parameters` are values that differ from the
    firmware's defaults. With a `signing_key` it accepts signed messages only, and signs its own. A `uid` and SYS_HITL
    among its `parameters` make it look like a board.
    """

    vehicle_id: int
    client_port: int
    plant: Plant
    frame: MissionFrame
    start_position_m: tuple[float, float] = (0.0, 0.0)
    client_host: str = LOOPBACK
    origin_offset_m: Triple = (0.0, 0.0, 0.0)
    noise: EstimatorNoise = field(default_factory=EstimatorNoise)
    wind_m_s2: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    battery_fraction: float = 1.0
    autopilot: AutopilotKind = AutopilotKind.PX4
    gps: bool = True
    localised: bool = True
    external: bool = False
    port: int = 0
    parameters: Mapping[str, Value] = field(default_factory=dict)
    signing_key: SigningKey | None = None
    uid: int | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        if not 1 <= self.vehicle_id <= 254:
            raise ValueError(f"vehicle_id = {self.vehicle_id}: a MAVLink system id lies between 1 and 254")
        if not (1 <= self.client_port <= 65535 and 0 <= self.port <= 65535):
            raise ValueError(f"client_port = {self.client_port}, port = {self.port}: one is not a port")
        if not all(map(isfinite, (*self.start_position_m, *self.origin_offset_m, *self.wind_m_s2))):
            raise ValueError(f"vehicle {self.vehicle_id}: its start, origin and wind must be finite")
        if not (self.seed >= 0 and 0.0 <= self.battery_fraction <= 1.0):
            raise ValueError(f"vehicle {self.vehicle_id}: a negative seed, or no battery fraction")
        if self.gps and self.frame.is_local:
            raise ValueError(f"vehicle {self.vehicle_id}: in a local frame there is no GPS")


@dataclass(frozen=True, slots=True)
class TruthTrack:
    """The true track of one vehicle, ten times a second: `time_s` (T,) on the common clock, the rest (T, 3)."""

    vehicle_id: int
    time_s: Vector
    position_m: Vector
    velocity_m_s: Vector

    @classmethod
    def of(cls, vehicle_id: int, motions: Sequence[Telemetry]) -> "TruthTrack":
        """Return the track of at least one true motion."""
        time_s = np.array([each.time_s for each in motions])
        position_m = np.array([each.position_m for each in motions])
        return cls(vehicle_id, time_s, position_m, np.array([each.velocity_m_s for each in motions]))


@dataclass(frozen=True, slots=True)
class StubRecord:
    """The record of a run: tracks, the speed reached, the simulated time dropped, and messages dropped by vehicle."""

    tracks: tuple[TruthTrack, ...]
    speed_reached: float
    slipped_s: float
    dropped: dict[int, dict[str, int]]


class _Endpoint(asyncio.DatagramProtocol):
    """One vehicle's socket: sends to its client and to every other address that has sent to it."""

    def __init__(self, receive: Callable[[bytes], list[bytes]], client: Address, faults: VehicleFaults) -> None:
        self._receive = receive
        self._peers = [client]
        self._faults = faults
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        if addr not in self._peers and len(self._peers) < PEERS_MAX:
            self._peers.append(addr)
        self._carry(lambda: self.send(self._receive(data)))

    def send(self, packets: list[bytes]) -> None:
        if packets:
            self._carry(lambda: self._send(packets))

    def _carry(self, deliver: Callable[[], None]) -> None:
        """Deliver packets as the link's faults demand: at once, late, or not at all."""
        if self._faults.link_cut:
            return
        if self._faults.link_delay_s > 0.0:
            asyncio.get_running_loop().call_later(self._faults.link_delay_s, deliver)
        else:
            deliver()

    def _send(self, packets: list[bytes]) -> None:
        if self._transport is None or self._transport.is_closing():
            return
        for datagram in _bundled(packets):
            for peer in self._peers:
                self._transport.sendto(datagram, peer)


class _Pace:
    """The stubs' uptime: the common clock's time since the start, less the dropped time."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._start_s = now_s()
        self.slipped_s = 0.0
        self.step = 0

    @property
    def clock_offset_s(self) -> float:
        return self._start_s + self.slipped_s

    def uptime_s(self) -> float:
        return self._now_s() - self.clock_offset_s

    def steps_due(self) -> range:
        """Return the steps to take now; those beyond one update are dropped."""
        late_s = self.uptime_s() - self.step * STEP_S
        self.slipped_s += max(0.0, late_s - CATCH_UP_MAX_S)
        first = self.step + 1
        self.step = max(self.step, floor(self.uptime_s() / STEP_S))
        return range(first, self.step + 1)

    def share_kept(self) -> float:
        elapsed_s = self._now_s() - self._start_s
        return 1.0 - self.slipped_s / elapsed_s if elapsed_s > 0.0 else 1.0


_MANNERS: Mapping[AutopilotKind, tuple[type[Autopilot], Dialect]] = {
    AutopilotKind.PX4: (Autopilot, PX4),
    AutopilotKind.ARDUPILOT: (ArduCopter, ARDUCOPTER),
}


class Stub:
    """One served vehicle: its protocol, its socket, its track, and its faults."""

    def __init__(self, config: StubConfig, pace: _Pace) -> None:
        x, y = config.start_position_m
        dx, dy, dz = config.origin_offset_m
        self.config = config
        autopilot, dialect = _MANNERS[config.autopilot]
        self.faults = VehicleFaults()
        self.autopilot = autopilot(
            config.plant,
            (x, y, 0.0),
            battery=Battery(config.battery_fraction),
            positioning=Positioning(config.gps, config.localised, config.external),
        )
        for name, value in config.parameters.items():
            if not self.autopilot.parameters.set(name, value):
                raise ValueError(f"vehicle {config.vehicle_id}: {name} = {value!r} does not fit its type or range")
        origin_m, seed = (x + dx, y + dy, dz), (config.seed, config.vehicle_id)
        mavlink = MavlinkConfig(
            config.vehicle_id, config.frame, origin_m, config.noise, seed, config.signing_key, config.uid
        )
        self._vehicle = MavlinkVehicle(self.autopilot, mavlink, dialect, self.faults)
        self.endpoint = _Endpoint(
            lambda data: self._vehicle.receive(data, pace.uptime_s()),
            (config.client_host, config.client_port),
            self.faults,
        )
        self._pace = pace
        self._truth: list[tuple[float, ...]] = []

    def advance(self, steps: range) -> None:
        """Take the steps one by one, record the truth, and send the messages that are due."""
        packets: list[bytes] = []
        (wind_x, wind_y), (push_x, push_y) = self.config.wind_m_s2, self.faults.push_m_s2
        for step in steps:
            self.autopilot.step(step * STEP_S, (wind_x + push_x, wind_y + push_y))
            packets += self._vehicle.emit(self.autopilot.time_s)
            if step % TRUTH_STEPS == 0:
                airframe = self.autopilot.airframe
                clock_s = self.autopilot.time_s + self._pace.clock_offset_s
                self._truth.append((clock_s, *airframe.position_m, *airframe.velocity_m_s))
        self.endpoint.send(packets)

    def inject(self, injection: VehicleInjection) -> None:
        """Inject faults from now on."""
        self.faults.add(injection.faults)
        if injection.battery_fraction is not None:
            self.autopilot.battery_fraction = injection.battery_fraction
        if injection.selects_hold:
            self.autopilot.select(NavMode.HOLD)

    def track(self) -> TruthTrack:
        """Return the true track so far."""
        rows = np.array(self._truth).reshape(-1, 7)
        return TruthTrack(self.config.vehicle_id, rows[:, 0], rows[:, 1:4], rows[:, 4:7])

    def dropped(self) -> dict[str, int]:
        """Return the counts of messages dropped so far, by reason."""
        return {drop.value: count for drop, count in self._vehicle.dropped.items()}


async def serve(
    configs: Sequence[StubConfig],
    *,
    speed: float,
    now_s: Callable[[], float],
    stop: asyncio.Event,
    on_ready: Callable[[Sequence[Stub]], None] | None = None,
) -> StubRecord:
    """Run the stubs until `stop` is set, then return their record; `on_ready` receives them when all can be reached.

    `now_s` is the clock that all processes share: monotonic simulated seconds, `speed` times as fast as the wall's.
    Raises OSError when a socket cannot be bound, ValueError for a speed that is not positive.
    """
    if not (isfinite(speed) and speed > 0.0):
        raise ValueError(f"speed = {speed}: it must be positive")
    for config in configs:
        if not config.frame.is_local:
            config.frame.geodetic_from_mission((0.0, 0.0, 0.0))  # its first use loads a library
    pace = _Pace(now_s)
    stubs = [Stub(config, pace) for config in configs]
    async with AsyncExitStack() as stack:
        for stub in stubs:
            await stack.enter_async_context(_bound(stub.endpoint, stub.config.port))
        if on_ready is not None:
            on_ready(stubs)
        while not stop.is_set():
            steps = pace.steps_due()
            for stub in stubs:
                stub.advance(steps)
            due_in_s = ((pace.step + 1) * STEP_S - pace.uptime_s()) / speed
            await asyncio.sleep(max(due_in_s, WAKE_PERIOD_S))
    tracks = tuple(stub.track() for stub in stubs)
    dropped = {stub.config.vehicle_id: stub.dropped() for stub in stubs}
    return StubRecord(tracks, speed * pace.share_kept(), pace.slipped_s, dropped)


@asynccontextmanager
async def _bound(endpoint: _Endpoint, port: int) -> AsyncIterator[None]:
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: endpoint, local_addr=(LOOPBACK, port))
    try:
        yield
    finally:
        transport.close()


def _bundled(packets: list[bytes]) -> list[bytes]:
    """Join packets into datagrams that fit an Ethernet frame, as PX4 does."""
    datagrams: list[bytes] = []
    for packet in packets:
        if datagrams and len(datagrams[-1]) + len(packet) <= DATAGRAM_MAX:
            datagrams[-1] += packet
        else:
            datagrams.append(packet)
    return datagrams
