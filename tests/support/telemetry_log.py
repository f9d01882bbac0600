"""A ground station's telemetry log of stub vehicles flown without sockets, with pymavlink as the station."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import cos, sin
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from estimation.frames import Geodetic, MissionFrame, Triple
from estimation.plant.model import Plant, PlantAxis
from sitl.autopilot.airframe import STEP_S
from sitl.autopilot.autopilot import Battery
from sitl.autopilot.px4 import Px4
from sitl.mavlink.protocol import MavlinkVehicle
from sitl.mavlink.reports import MavlinkConfig

PLANT = Plant(PlantAxis(1.51, 1.90), PlantAxis(1.87, 2.40), delay_s=0.2)
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0))
BEGIN_US = 1_763_700_000_000_000
SETPOINT_EVERY = 10
BATTERY_FRACTION = 0.83


@dataclass
class Flown:
    """The log and the truth: times on the vehicle's clock, positions x north, y west, z up from its origin."""

    system_id: int
    origin_m: Triple
    time_s: list[float] = field(default_factory=list)
    position_m: list[tuple[float, ...]] = field(default_factory=list)
    asked_s: list[float] = field(default_factory=list)
    asked_m: list[Triple] = field(default_factory=list)
    offboard_s: list[float] = field(default_factory=list)


class Station:
    """Flies stub vehicles step by step, and logs every packet with its time stamp."""

    def __init__(self, system_ids: Sequence[int], speed: float, latency_s: float = 0.0) -> None:
        self.log = bytearray()
        self.flown = [Flown(system_id, (4.0 * system_id, -3.0, 0.5)) for system_id in system_ids]
        self._speed, self._latency_s, self._step = speed, latency_s, 0
        self._writer = dialect.MAVLink(None, 245, 190)
        self._autopilots = [
            Px4(PLANT, (4.0 * system_id, -3.0, 0.5), battery=Battery(BATTERY_FRACTION)) for system_id in system_ids
        ]
        self._vehicles = [
            MavlinkVehicle(autopilot, MavlinkConfig(flown.system_id, FRAME, flown.origin_m))
            for autopilot, flown in zip(self._autopilots, self.flown, strict=True)
        ]

    def run(self, seconds: float, ask: Callable[[Flown, float], None] | None = None) -> None:
        for _ in range(round(seconds / STEP_S)):
            self._step += 1
            for autopilot, vehicle, flown in zip(self._autopilots, self._vehicles, self.flown, strict=True):
                autopilot.step(self._step * STEP_S)
                if ask and self._step % SETPOINT_EVERY == 0:
                    ask(flown, autopilot.time_s)
                for packet in vehicle.emit(autopilot.time_s):
                    self._keep(packet, autopilot.time_s + self._latency_s * self._speed)
                place = np.subtract(autopilot.airframe.position_m, flown.origin_m)
                flown.time_s.append(autopilot.time_s)
                flown.position_m.append(tuple(place.tolist()))
                if autopilot.mode.name == "OFFBOARD":
                    flown.offboard_s.append(autopilot.time_s)

    def send(self, system_id: int, message: Any) -> None:
        index = [flown.system_id for flown in self.flown].index(system_id)
        packet = bytes(message.pack(self._writer))
        self._keep(packet, self._autopilots[index].time_s)
        for answer in self._vehicles[index].receive(packet, self._autopilots[index].time_s):
            self._keep(answer, self._autopilots[index].time_s + self._latency_s * self._speed)

    def command(self, system_id: int, command: int, *params: float) -> None:
        padded = (*params, *(0.0,) * 7)[:7]
        self.send(system_id, dialect.MAVLink_command_long_message(system_id, 1, command, 0, *padded))

    def ask(self, flown: Flown, time_s: float) -> None:
        """Send a setpoint on a circle around the vehicle's origin, 5 m up."""
        x, y, z = 3.0 * cos(0.4 * time_s), 3.0 * sin(0.4 * time_s), 5.0
        fields = (0, flown.system_id, 1, 1, 0b100111111000, x, -y, -z, *(0.0,) * 8)
        self.send(flown.system_id, dialect.MAVLink_set_position_target_local_ned_message(*fields))
        flown.asked_s.append(time_s)
        flown.asked_m.append((x, y, z))

    def _keep(self, packet: bytes, time_s: float) -> None:
        self.log += round(BEGIN_US + time_s / self._speed * 1e6).to_bytes(8, "big") + packet


def flight(system_ids: Sequence[int], *, speed: float = 1.0, latency_s: float = 0.0, seconds: float = 20.0) -> Station:
    """Boot, list the parameters, take off to 5 m, and circle in offboard for `seconds`."""
    station = Station(system_ids, speed, latency_s)
    station.run(3.0)
    for system_id in system_ids:
        station.send(system_id, dialect.MAVLink_param_request_list_message(system_id, 1))
        station.send(system_id, dialect.MAVLink_param_set_message(system_id, 1, b"MIS_TAKEOFF_ALT", 5.0, 9))
        station.command(system_id, 512, 148)
        station.command(system_id, 400, 1)
        station.command(system_id, 22, 0, 0, 0, *(float("nan"),) * 4)
    station.run(20.0)
    station.run(0.4, station.ask)
    for system_id in system_ids:
        station.command(system_id, 176, 1, 6)
    station.run(seconds, station.ask)
    return station
