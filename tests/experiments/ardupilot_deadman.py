"""Kill cordon while it flies ardupilot-trio on three ArduCopter simulators, and time their failsafe (FS_GCS_ENABLE).

CORDON_ARDUCOPTER names the simulator. Each vehicle has another value of the parameter, by default land, return, and off
as the control. A relay between each autopilot and cordon records cordon's heartbeats and the vehicle's modes.
"""

import asyncio
import sys
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack

from agents.ports import VehicleRefusedError
from gcs.drill.faults import Roles
from gcs.drill.flight import DrillFlight
from gcs.drill.judge import OFFBOARD
from gcs.drill.run import drill_mission
from tests.experiments.arguments import parser
from tests.support.arducopter import OWN_DEFAULTS, ArduCopterMissing, ArduCopterSimulator
from tests.support.relay import HEARTBEAT, Message, Relay, flight_mode, is_armed
from tests.support.wire import free_port

MISSION = "ardupilot-trio"
READY_S, WATCHED_S = 45.0, 10.0
METRES_PER_DEGREE = 111_195.0
LAND, RETURN, OFF = 5, 1, 0
REACTIONS = {LAND: "land", RETURN: "return", OFF: OFFBOARD, 3: "SmartRTL", 4: "SmartRTL", 7: "brake"}
MODES = {4: OFFBOARD, 6: "return", 9: "land", 17: "brake", 21: "SmartRTL"}
TIMEOUT_S, CHECK_S = 5.0, 0.5
"""FS_GCS_TIMEOUT, and the tolerance of the reaction time."""


class CopterFlight(DrillFlight):
    """A flight of ArduCopter simulators behind relays."""

    def __init__(self, text: str, speed: float, enabled: Mapping[int, int]) -> None:
        super().__init__(text, speed)
        self.enabled = enabled
        self.heartbeat_s: dict[int, float] = {}

    async def serve(self, stack: AsyncExitStack) -> None:
        """Start relays and simulators, and wait until their estimators have a position."""
        frame = self.mission.frame
        assert frame.latitude_deg is not None
        assert frame.longitude_deg is not None
        assert frame.altitude_m is not None
        for instance, vehicle in enumerate(self.mission.vehicles):
            _, north_m = vehicle.section.start_m  # all starts are on the north axis
            place = (frame.latitude_deg + north_m / METRES_PER_DEGREE, frame.longitude_deg, frame.altitude_m)
            port = free_port()
            own = {**OWN_DEFAULTS, "FS_GCS_ENABLE": self.enabled[vehicle.id]}
            simulator = ArduCopterSimulator(
                port, free_port(), speed=self.speed, place=place, instance=instance, parameters=own
            )
            stack.callback(simulator.close)
            await self._relay(stack, vehicle.id, vehicle.system_id, port, vehicle.section.url)
            simulator.start()
        await asyncio.sleep(READY_S)

    async def _relay(self, stack: AsyncExitStack, vehicle: int, system_id: int, port: int, url: str) -> None:
        def take(message: Message) -> None:
            mode = flight_mode(message)
            if message.kind == HEARTBEAT and mode is not None:
                self.log.note_mode(self.now_s(), vehicle, MODES.get(mode, "other") if is_armed(message) else "disarmed")

        def hear() -> None:
            self.heartbeat_s[vehicle] = self.now_s()

        back_port = int(url.rpartition(":")[2])
        relay = Relay(system_id, port, back_port, on_message=take, on_setpoint=lambda: None, on_heartbeat=hear)
        await relay.open()
        stack.push_async_callback(relay.close)

    def observe(self, now_s: float) -> None:
        """Do nothing: the relays connect the vehicles."""


async def main(values: Sequence[int]) -> int:
    """Fly, kill cordon, and print each vehicle's reaction; return whether all are as expected."""
    text, faults, enabled_of = drill_mission(MISSION), 0, dict(enumerate(values, start=1))
    async with CopterFlight(text, 1.0, enabled_of) as flight:
        roles = Roles(flight.mission)
        await flight.reach_mission(roles.airborne, roles.tactic)
        flight.fail("killed agent", roles)
        killed_s = flight.now_s()
        await asyncio.sleep(WATCHED_S)
        for vehicle, enabled in enabled_of.items():
            expected, last_s = REACTIONS[enabled], flight.heartbeat_s[vehicle]
            at_s, mode = flight.log.modes[vehicle][-1]
            after_s = at_s - last_s
            on_time = mode == OFFBOARD or TIMEOUT_S <= after_s <= TIMEOUT_S + CHECK_S
            faults += not (mode == expected and on_time)
            when = (
                "" if mode == OFFBOARD else f" {after_s:.2f} s after the last heartbeat, {at_s - killed_s:.2f} s after"
            )
            print(f"FS_GCS_ENABLE = {enabled}: {mode}{when}{' the kill' if when else ''}")
    return 1 if faults else 0


if __name__ == "__main__":
    reader = parser("ardupilot_deadman", __doc__)
    reader.add_argument(
        "--enable",
        nargs=3,
        type=int,
        choices=list(REACTIONS),
        default=[LAND, RETURN, OFF],
        help="FS_GCS_ENABLE of vehicles 1, 2 and 3 (default: 5 1 0)",
    )
    chosen = reader.parse_args().enable
    try:
        sys.exit(asyncio.run(main(chosen)))
    except (ArduCopterMissing, VehicleRefusedError) as reason:
        sys.exit(str(reason))
