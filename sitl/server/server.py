"""The stub vehicles on UDP: one socket and one MAVLink stream per vehicle, in scaled time, and their true tracks."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from math import ceil, floor, inf

from estimation.frames import MissionFrame, Triple
from estimation.plant.model import Plant
from estimation.profile.autopilots import DEFAULT, AutopilotName
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.autopilot import Battery, MavResult, Positioning, autopilot_named
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.modes import NavMode
from sitl.autopilot.parameters import Value
from sitl.faults import VehicleFaults, VehicleInjection, shifted
from sitl.mavlink.protocol import MavlinkVehicle
from sitl.mavlink.reports import EstimatorNoise, MavlinkConfig
from sitl.mavlink.signing import SigningKey
from sitl.mavlink_constants import Outgoing
from sitl.server.endpoint import LOOPBACK, Endpoint, StubClock, bound
from sitl.server.governed_clock import GovernedClock, MotionTransit, SetpointTransit
from sitl.server.record import StubRecord, TruthTrack
from sitl.server.setpoint_stream import SetpointStream
from sitl.server.true_state import TrueState
from sitl.vehicle.mount import Mount

WAKE_PERIOD_S = 0.004
"""The shortest wall time between two updates by the wall's clock: at high speed an update takes several steps."""
SHOWN_ALIVE_S = 0.5
"""Wall time after which a stub sends a heartbeat if less has passed on its own clock: MAVSDK takes it as lost after 3 s
of the wall.
"""
CATCH_UP_MAX_S = 0.5
"""The largest simulated time of one update; time beyond it is dropped, which lowers the speed reached.

It is shorter than the offboard timeout: a stall of the stub must not trigger that timeout.
"""
TRUTH_STEPS = round(0.1 / STEP_S)
_ROUNDING = 1e-4
"""Of a step: clocks count microseconds."""


@dataclass(frozen=True, slots=True)
class StubConfig:
    """One stub vehicle: its identity, the address of its client, its start and its flight properties.

    The vehicle id is its MAVLink system id. Mission frame; `origin_offset_m` is the estimator's origin seen from the
    start position, `wind_m_s2` a constant disturbance acceleration.

    Without `gps` it has a local position but no global one, no home and no geodetic origin, as a PX4 that is flown
    indoors by external position: neither hold nor return can be flown, and it arms in take-off or offboard only. If it
    is not `localised`, it has no position and cannot be armed; an `external` one has a position while it receives
    external positions. `port` is its own port for clients; 0 is any. `parameters` are values that differ from the
    firmware's defaults. With a `signing_key` it accepts signed messages only, and signs its own. A `uid` and SYS_HITL
    among its `parameters` make it look like a board. With a `height_error_m` its heights are off from the start, as the
    altitudes of GPS receivers are; clearing its faults ends that. If it `awaits_stream`, a governed
    time waits for the setpoints of a client that is no participant: a busy computer does not end its offboard flight.
    With a `gimbal` it has a camera on a simulated mount.
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
    height_error_m: float = 0.0
    autopilot: AutopilotName = DEFAULT
    gps: bool = True
    localised: bool = True
    external: bool = False
    port: int = 0
    parameters: Mapping[str, Value] = field(default_factory=dict)
    signing_key: SigningKey | None = None
    uid: int | None = None
    awaits_stream: bool = False
    gimbal: bool = False


class _Pace:
    """The stubs' uptime: the common clock's time since the start, less the dropped time."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        # A whole second, so that a mission's events coincide with the steps and messages in the same way each time.
        self._start_s = float(ceil(now_s()))
        self.slipped_s = 0.0
        self.step = 0

    @property
    def clock_offset_s(self) -> float:
        return self._start_s + self.slipped_s

    @property
    def next_s(self) -> float:
        """When the next step is due, on the common clock."""
        return self.clock_offset_s + (self.step + 1) * STEP_S

    def uptime_s(self) -> float:
        return self._now_s() - self.clock_offset_s

    def steps_due(self) -> range:
        """Return the steps to take now; those beyond one update are dropped."""
        late_s = self.uptime_s() - self.step * STEP_S
        self.slipped_s += max(0.0, late_s - CATCH_UP_MAX_S)
        first = self.step + 1
        self.step = max(self.step, floor(self.uptime_s() / STEP_S + _ROUNDING))
        return range(first, self.step + 1)


class Stub:
    """One served vehicle: its protocol, its socket, its track, and its faults."""

    def __init__(self, config: StubConfig, pace: _Pace, clock: StubClock) -> None:
        x, y = config.start_position_m
        dx, dy, dz = config.origin_offset_m
        self.config = config
        self.faults = VehicleFaults(height_jump_m=config.height_error_m)
        self._origin_m = (x + dx, y + dy, dz)
        self._booted_steps = 0
        self._boot((x, y), config.battery_fraction)
        self.endpoint = Endpoint(
            lambda data: self._vehicle.receive(data, pace.uptime_s() - self._booted_steps * STEP_S),
            (config.client_host, config.client_port),
            self.faults,
            clock,
            self._vehicle.count_stranger if config.signing_key is None else None,
        )
        self.setpoints = 0
        """How many setpoints have arrived."""
        self.setpoint_s = -inf
        """When the newest arrived, on the common clock."""
        self._goal_m: Triple | None = None
        self._was_in_offboard = False
        self._pace = pace
        self._clock = clock
        self._truth: list[tuple[float, ...]] = []
        self._motion: tuple[float, ...] | None = None
        self._motions: MotionTransit | None = None
        self._setpoints: SetpointTransit | None = None
        if isinstance(clock, GovernedClock):
            self._motions, self._setpoints = clock.motions(config.vehicle_id), clock.setpoints(config.vehicle_id)
            clock.expect(self)
            if config.awaits_stream:
                clock.expect(SetpointStream(self._stream_age_s))

    def _boot(self, place_m: tuple[float, float], battery_fraction: float) -> None:
        """Boot an autopilot on the ground at a place in the mission frame."""
        config = self.config
        self.autopilot = autopilot_named(config.autopilot)(
            config.plant,
            (*place_m, 0.0),
            battery=Battery(battery_fraction),
            positioning=Positioning(config.gps, config.localised, config.external),
            mount=Mount() if config.gimbal else None,
        )
        for name, value in config.parameters.items():
            if not self.autopilot.parameters.set(name, value):
                raise ValueError(f"vehicle {config.vehicle_id}: {name} = {value!r} does not fit its type or range")
        mavlink = MavlinkConfig(
            config.vehicle_id,
            config.frame,
            self._origin_m,
            config.noise,
            (config.seed, config.vehicle_id),
            config.signing_key,
            config.uid,
        )
        self._vehicle = MavlinkVehicle(self.autopilot, mavlink, self.faults, observer=self)

    def restart(self, battery_fraction: float) -> None:
        """Boot its autopilot anew where it stands, disarmed, with a battery of this charge: its clock begins at 0."""
        x, y, _ = self.autopilot.airframe.position_m
        self._booted_steps = self._pace.step
        self._boot((float(x), float(y)), battery_fraction)
        self._was_in_offboard = False

    def advance(self, steps: range) -> None:
        """Take the steps one by one, record the truth, and send the messages that are due."""
        packets: list[bytes] = []
        (wind_x, wind_y), (push_x, push_y) = self.config.wind_m_s2, self.faults.push_m_s2
        for step in steps:
            if self._goal_m is not None and step % TRUTH_STEPS == 0:
                self._fly_on(self._goal_m)
            self.autopilot.step((step - self._booted_steps) * STEP_S, (wind_x + push_x, wind_y + push_y))
            packets += self._vehicle.emit(self.autopilot.time_s)
            if step % TRUTH_STEPS == 0:
                airframe = self.autopilot.airframe
                clock_s = self.autopilot.time_s + self._booted_steps * STEP_S + self._pace.clock_offset_s
                self._truth.append((clock_s, *airframe.position_m, *airframe.velocity_m_s))
        self._was_in_offboard = self._was_in_offboard or self._in_offboard
        motion, self._motion = self._motion, None
        self.endpoint.send(packets, lambda: self._note_sent(motion))

    def begin_mission(self) -> None:
        """Draw the noise of the mission from its seed."""
        self._vehicle.begin_mission()

    def send_heartbeat(self) -> None:
        """Send a heartbeat beside those that are due."""
        self.endpoint.send(self._vehicle.heartbeat())

    def hear(self, report: Outgoing) -> None:
        """Pass on a message that a receiver on board hears: its id and its fields, such as those of ADSB_VEHICLE."""
        self.endpoint.send(self._vehicle.pass_on(report))

    def on_motion(self, ned: tuple[float, ...]) -> None:
        """Take position and velocity in NED that are about to be sent; implements the protocol's `Observer`."""
        self._motion = ned

    def on_setpoint(self, ned: tuple[float, float, float]) -> None:
        """Take the position in NED of a setpoint that has arrived."""
        self.setpoints, self.setpoint_s, self._goal_m = self.setpoints + 1, self._clock.now_s(), None
        if self._setpoints is not None:
            self._setpoints.take(*ned)

    def arrived(self) -> bool:
        """Return whether the newest setpoint has arrived; with a cut or late link none is waited for."""
        faulty = self.faults.link_cut or self.faults.link_delay_s > 0.0
        return self._setpoints is None or faulty or self._setpoints.arrived()

    def forget(self) -> None:
        """Take a setpoint under way as lost."""
        if self._setpoints is not None:
            self._setpoints.forget()

    def _note_sent(self, motion: tuple[float, ...] | None) -> None:
        if motion is not None and self._motions is not None:
            self._motions.send(motion)

    def inject(self, injection: VehicleInjection) -> None:
        """Inject faults from now on."""
        self.faults.add(injection.faults)
        if injection.battery_fraction is not None:
            self.autopilot.battery_fraction = injection.battery_fraction
        if injection.selects_hold:
            self.autopilot.select(NavMode.HOLD)

    def arm(self) -> str:
        """Arm as by a command of its client; return why it refused, empty if it is armed."""
        if self.autopilot.arm() is MavResult.ACCEPTED:
            return ""
        return f"it does not arm in mode {self.autopilot.mode.value}"

    def go_to(self, position_m: Triple) -> str:
        """Fly to a mission position in offboard, until a client sends a setpoint or selects another mode.

        Return why it refused, empty if it flies.
        """
        if not self.autopilot.armed:
            return "it is not armed"
        if self.autopilot.go_to(self._aim_m(position_m)) is not MavResult.ACCEPTED:
            return f"it does not leave mode {self.autopilot.mode.value}"
        self._goal_m = position_m
        return ""

    def clear(self) -> str:
        """Clear all of its faults; it has none to refuse that."""
        self.faults.clear()
        return ""

    def state(self) -> TrueState:
        """Return the true state now."""
        autopilot, frame = self.autopilot, self.config.frame
        x, y, z = self._origin_m
        position_m, velocity_m_s = autopilot.airframe.position_m, autopilot.airframe.velocity_m_s
        return TrueState(
            autopilot.time_s,
            position_m,
            velocity_m_s,
            frame.ned_from_mission(shifted(position_m, (-x, -y, -z))),
            frame.ned_from_mission(velocity_m_s),
            autopilot.armed,
            autopilot.mode.value,
        )

    def _fly_on(self, goal_m: Triple) -> None:
        """Send the setpoint to the goal again, unless its mode was changed."""
        if self.autopilot.mode is NavMode.OFFBOARD:
            self.autopilot.receive_setpoint(self.autopilot.time_s, PositionTarget(self._aim_m(goal_m)))
        else:
            self._goal_m = None

    def _aim_m(self, goal_m: Triple) -> Triple:
        """Return the goal in its own estimate, to which it flies."""
        x, y, z = self.faults.offset_m
        return shifted(goal_m, (-x, -y, -z))

    def _stream_age_s(self) -> float:
        """Return the age of its client's newest setpoint while offboard needs these or is about to, else 0."""
        by_client = self._goal_m is None and self.setpoints > 0 and not self.faults.link_cut
        needed = self.autopilot.NEEDS_STREAM and (self._in_offboard or not self._was_in_offboard)
        return self._clock.now_s() - self.setpoint_s if by_client and needed else 0.0

    @property
    def _in_offboard(self) -> bool:
        return self.autopilot.armed and self.autopilot.mode is NavMode.OFFBOARD

    def track(self) -> TruthTrack:
        """Return the true track so far."""
        return TruthTrack.of(self.config.vehicle_id, self._truth)

    def dropped(self) -> dict[str, int]:
        """Return the counts of messages dropped so far, by reason."""
        return {drop.value: count for drop, count in self._vehicle.dropped.items()}


async def serve(
    configs: Sequence[StubConfig],
    clock: StubClock,
    stop: asyncio.Event,
    on_ready: Callable[[Sequence[Stub]], None] | None = None,
) -> StubRecord:
    """Run the stubs until `stop` is set, then return their record; `on_ready` receives them when all can be reached.

    `clock` is the clock that all processes share. Raises OSError when a socket cannot be bound.
    """
    for config in configs:
        if not config.frame.is_local:
            config.frame.geodetic_from_mission((0.0, 0.0, 0.0))  # its first use loads a library
    pace = _Pace(clock.now_s)
    stubs = [Stub(config, pace, clock) for config in configs]
    async with AsyncExitStack() as stack:
        for stub in stubs:
            await stack.enter_async_context(bound(stub.endpoint, stub.config.port))
        if on_ready is not None:
            on_ready(stubs)
        stepping = asyncio.create_task(_step(stubs, pace, clock))
        heartbeats = asyncio.create_task(_send_heartbeats(stubs, pace))
        stopping = asyncio.create_task(stop.wait())
        try:
            done, _ = await asyncio.wait((stepping, heartbeats, stopping), return_when=asyncio.FIRST_COMPLETED)
            for each in done:
                each.result()
        finally:
            for each in (stepping, heartbeats, stopping):
                each.cancel()
            await asyncio.gather(stepping, heartbeats, stopping, return_exceptions=True)
    tracks = tuple(stub.track() for stub in stubs)
    dropped = {stub.config.vehicle_id: stub.dropped() for stub in stubs}
    return StubRecord(tracks, pace.slipped_s, dropped)


async def _step(stubs: Sequence[Stub], pace: _Pace, clock: StubClock) -> None:
    wake_period_s = 0.0 if isinstance(clock, GovernedClock) else WAKE_PERIOD_S * clock.speed
    governed = clock if isinstance(clock, GovernedClock) else None
    began_s = None
    while True:
        steps = pace.steps_due()
        if governed is not None and governed.mission_began_s != began_s:
            began_s = governed.mission_began_s
            for stub in stubs:
                stub.begin_mission()
        for stub in stubs:
            stub.advance(steps)
        await clock.sleep_until(max(pace.next_s, clock.now_s() + wake_period_s))


async def _send_heartbeats(stubs: Sequence[Stub], pace: _Pace) -> None:
    """Send heartbeats by the wall where the simulated time stands still or creeps, as that of a busy computer does."""
    uptime_s = -inf
    while True:
        await asyncio.sleep(SHOWN_ALIVE_S)
        before_s, uptime_s = uptime_s, pace.uptime_s()
        if uptime_s - before_s < SHOWN_ALIVE_S:
            for stub in stubs:
                stub.send_heartbeat()
