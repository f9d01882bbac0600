"""Flights of drills on the firmware of autopilots in its own simulators, each vehicle behind a relay."""

import asyncio
import struct
from collections import defaultdict
from collections.abc import Mapping
from contextlib import AsyncExitStack
from pathlib import Path
from typing import ClassVar, Protocol

from agents.ports import VehicleRefusedError
from estimation.frames import Geodetic, Triple
from gcs.drill.flight import DrillFlight
from gcs.drill.judge import OFFBOARD
from gcs.mission.mission import MissionVehicle
from sitl.autopilot.modes import NavMode
from sitl.autopilot.px4 import custom_mode
from tests.support.arducopter import OWN_DEFAULTS, ArduCopterSimulator
from tests.support.px4 import FIRST_PORT, Px4Simulator
from tests.support.relay import CURRENT_MODE, GLOBAL_POSITION, HEARTBEAT, Message, Relay, flight_mode, is_armed
from tests.support.wire import free_port

HIL_STATE_QUATERNION, SIM_STATE = 115, 108
SET_MESSAGE_INTERVAL = 511
MODE_PERIOD_US, POSITION_PERIOD_US, TRUTH_PERIOD_US = 50_000.0, 200_000.0, 100_000.0
ASKED_AGAIN_S = 1.0
READY_WITHIN_S, SETTLES_S = 60.0, 15.0
METRES_PER_DEGREE = 111_195.0


class Simulator(Protocol):
    """A process of an autopilot's firmware."""

    def start(self) -> None:
        """Start it."""

    def close(self) -> None:
        """Stop it, and delete its files."""


class FirmwareFlight(DrillFlight):
    """A flight of simulators behind relays; a subclass makes those of one autopilot, and names its modes.

    `true_m` holds the vehicles' true positions in the mission frame, with their times.
    """

    modes: ClassVar[Mapping[int, str]]
    periods_us: ClassVar[Mapping[int, float]]
    """The messages that are requested, also after a restart."""
    mode_message: ClassVar[int]

    def __init__(self, text: str, speed: float, logs: Path | None = None) -> None:
        super().__init__(text, speed, logs)
        self.relays: dict[int, Relay] = {}
        self.true_m: defaultdict[int, list[tuple[float, Triple]]] = defaultdict(list)
        self._frame = self.mission.mission_frame()
        self._armed: dict[int, bool] = {}
        self._located: set[int] = set()
        self._asked_s = 0.0

    def make(self, vehicle: MissionVehicle, instance: int, place: Triple) -> tuple[Simulator, int]:
        """Return a vehicle's simulator at a place (deg, deg, m), and the port that it sends to."""
        raise NotImplementedError

    def true_place(self, message: Message) -> Geodetic | None:
        """Return the place in a simulator's message of its truth, None for other messages."""
        raise NotImplementedError

    async def serve(self, stack: AsyncExitStack) -> None:
        """Start relays and simulators, and wait until their estimators have settled."""
        frame, simulators = self.mission.frame, list[Simulator]()
        assert frame.x_bearing_deg == 90.0
        for instance, vehicle in enumerate(self.mission.vehicles):
            east_m, north_m = vehicle.section.start_m
            assert frame.latitude_deg is not None
            assert frame.longitude_deg is not None
            assert frame.altitude_m is not None
            assert east_m == 0.0
            place = (frame.latitude_deg + north_m / METRES_PER_DEGREE, frame.longitude_deg, frame.altitude_m)
            simulator, port = self.make(vehicle, instance, place)
            stack.callback(simulator.close)
            await self._relay(stack, vehicle, port)
            simulators.append(simulator)
        for simulator in simulators:
            simulator.start()
        if not await self.until(self._all_located, READY_WITHIN_S):
            raise VehicleRefusedError(f"vehicles {sorted(self._located)} alone know where they are", "see their logs")
        await asyncio.sleep(SETTLES_S)

    def _all_located(self) -> bool:
        self._request()
        return len(self._located) == len(self.relays)

    async def _relay(self, stack: AsyncExitStack, vehicle: MissionVehicle, port: int) -> None:
        relay = Relay(
            vehicle.system_id,
            port,
            int(vehicle.section.url.rpartition(":")[2]),
            on_message=lambda message: self.take(vehicle.id, message),
            on_setpoint=lambda: self.log.setpoint_s.update({vehicle.id: self.now_s()}),
            on_heartbeat=lambda: self.take_heartbeat(vehicle.id),
        )
        await relay.open()
        stack.push_async_callback(relay.close)
        self.relays[vehicle.id] = relay

    def take(self, vehicle: int, message: Message) -> None:
        """Take a message of an autopilot."""
        if message.kind == GLOBAL_POSITION and any(message.payload[4:12]):
            self._located.add(vehicle)
        if message.kind == HEARTBEAT:
            self._armed[vehicle] = is_armed(message)
        if message.kind == self.mode_message:
            self.log.note_mode(self.now_s(), vehicle, self.mode(message))
        if (place := self.true_place(message)) is not None:
            self.true_m[vehicle].append((self.now_s(), self._frame.mission_from_geodetic(place)))

    def take_heartbeat(self, vehicle: int) -> None:
        """Take a heartbeat of cordon to a vehicle."""

    def mode(self, message: Message) -> str:
        """Return the flight mode in a message."""
        return self.modes.get(flight_mode(message) or 0, "other")

    def is_armed(self, vehicle: int) -> bool:
        """Return whether its newest heartbeat reports it."""
        return self._armed.get(vehicle, False)

    def observe(self, now_s: float) -> None:
        """Record their position estimates, and request their messages, also after a restart."""
        self.log.note_places(now_s, {i: at_m for i, at_m in self.positions_m.items() if self.is_armed(i)})
        self._request()

    def _request(self) -> None:
        if self.now_s() - self._asked_s > ASKED_AGAIN_S:
            self._asked_s = self.now_s()
            for relay in self.relays.values():
                for number, period_us in self.periods_us.items():
                    relay.command(SET_MESSAGE_INTERVAL, number, period_us)


class Px4Flight(FirmwareFlight):
    """A flight of PX4 simulators. Modes are taken from CURRENT_MODE at 20 Hz."""

    modes: ClassVar[Mapping[int, str]] = {custom_mode(mode): mode.name.lower() for mode in NavMode}
    periods_us: ClassVar[Mapping[int, float]] = {CURRENT_MODE: MODE_PERIOD_US, HIL_STATE_QUATERNION: TRUTH_PERIOD_US}
    mode_message = CURRENT_MODE

    def __init__(self, text: str, speed: float, logs: Path | None = None) -> None:
        super().__init__(text, speed, logs)
        self.simulators: dict[int, Px4Simulator] = {}

    def make(self, vehicle: MissionVehicle, instance: int, place: Triple) -> tuple[Simulator, int]:
        """Return a vehicle's simulator at a place, and the port that it sends to."""
        simulator = Px4Simulator(instance, speed=self.speed, place=place, parameters={"COM_OBL_RC_ACT": 4.0})
        self.simulators[vehicle.id] = simulator
        return simulator, FIRST_PORT + instance

    def true_place(self, message: Message) -> Geodetic | None:
        """Return the place in HIL_STATE_QUATERNION."""
        if message.kind != HIL_STATE_QUATERNION:
            return None
        latitude, longitude, altitude_mm = struct.unpack_from("<3i", message.payload.ljust(48, b"\0"), 36)
        return Geodetic(latitude * 1e-7, longitude * 1e-7, altitude_mm * 1e-3)


class CopterFlight(FirmwareFlight):
    """A flight of ArduCopter simulators, which send nothing but heartbeats until they are asked."""

    modes: ClassVar[Mapping[int, str]] = {4: OFFBOARD, 5: "loiter", 6: "return", 9: "land", 17: "brake", 21: "SmartRTL"}
    periods_us: ClassVar[Mapping[int, float]] = {GLOBAL_POSITION: POSITION_PERIOD_US, SIM_STATE: TRUTH_PERIOD_US}
    mode_message = HEARTBEAT

    def parameters(self, _vehicle: int) -> Mapping[str, float]:
        """Return a vehicle's own default parameters."""
        return OWN_DEFAULTS

    def make(self, vehicle: MissionVehicle, instance: int, place: Triple) -> tuple[Simulator, int]:
        """Return a vehicle's simulator at a place, and the port that it sends to."""
        port, own = free_port(), self.parameters(vehicle.id)
        return ArduCopterSimulator(
            port, free_port(), speed=self.speed, place=place, instance=instance, parameters=own
        ), port

    def true_place(self, message: Message) -> Geodetic | None:
        """Return the place in SIM_STATE."""
        if message.kind != SIM_STATE:
            return None
        payload = message.payload.ljust(92, b"\0")
        latitude, longitude = struct.unpack_from("<2i", payload, 84)
        return Geodetic(latitude * 1e-7, longitude * 1e-7, struct.unpack_from("<f", payload, 60)[0])
