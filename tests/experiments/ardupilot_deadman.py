"""Kill cordon while it flies ardupilot-trio on three ArduCopter simulators, and time their failsafe (FS_GCS_ENABLE).

CORDON_ARDUCOPTER names the simulator. Each vehicle has another value of the parameter, by default land, return, and off
as the control. A relay between each autopilot and cordon records cordon's heartbeats and the vehicle's modes.
"""

import asyncio
import sys
from collections.abc import Mapping, Sequence

from agents.ports import VehicleRefusedError
from gcs.drill.faults import Roles
from gcs.drill.judge import OFFBOARD
from gcs.drill.run import drill_mission
from tests.experiments.arguments import parser
from tests.support.arducopter import ArduCopterMissing
from tests.support.firmware_flight import CopterFlight

MISSION = "ardupilot-trio"
WATCHED_S = 10.0
LAND, RETURN, OFF = 5, 1, 0
REACTIONS = {LAND: "land", RETURN: "return", OFF: OFFBOARD, 3: "SmartRTL", 4: "SmartRTL", 7: "brake"}
TIMEOUT_S, CHECK_S = 5.0, 0.5
"""FS_GCS_TIMEOUT, and the tolerance of the reaction time."""


class DeadmanFlight(CopterFlight):
    """A flight of ArduCopter simulators, each with its own FS_GCS_ENABLE."""

    def __init__(self, text: str, speed: float, enabled: Mapping[int, int]) -> None:
        super().__init__(text, speed)
        self.enabled = enabled
        self.heartbeat_s: dict[int, float] = {}

    def parameters(self, vehicle: int) -> Mapping[str, float]:
        """Return a vehicle's own default parameters."""
        return {**super().parameters(vehicle), "FS_GCS_ENABLE": self.enabled[vehicle]}

    def take_heartbeat(self, vehicle: int) -> None:
        """Note when cordon's heartbeat arrives."""
        self.heartbeat_s[vehicle] = self.now_s()


async def main(values: Sequence[int]) -> int:
    """Fly, kill cordon, and print each vehicle's reaction; return whether all are as expected."""
    text, faults, enabled_of = drill_mission(MISSION), 0, dict(enumerate(values, start=1))
    async with DeadmanFlight(text, 1.0, enabled_of) as flight:
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
