"""Yaw and altitude on the wire: what a stub vehicle says of its own, while it encircles a target over MAVLink."""

import struct
from collections.abc import Callable
from dataclasses import replace
from math import atan2, degrees, hypot
from statistics import median

import pytest

from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from tests.support.flights import flying, in_flight
from tests.support.mission_text import with_first_vehicles
from tests.support.relay import Message, Relay
from tests.support.wire import free_port, served

pytestmark = pytest.mark.wire

SPEED, ATTITUDE, LOCAL_POSITION = 5.0, 30, 32
SETTLES_DEG, SEEN_DEG = 30.0, 70.0
"""How far around the ring it flies before it is looked at, and while it is."""
START_M, TARGET_M, TARGET_ALTITUDE_M = (0.0, 4.0), (13.5, 2.0), 1.5
"""In the mission frame, whose x is east and y north; the vehicle's own frame begins where it starts."""
ALONE = (
    ("leader = 2", "leader = 1"),
    ("altitude_m = 8.0", "altitude_m = 4.0"),
    ("start_m = [20.0, 0.0]\nvelocity_m_s = [0.1, 0.0]", f"start_m = [{TARGET_M[0]}, {TARGET_M[1]}]"),
    ("separation_m = 2.0", "separation_m = 2.0\naltitude_min_m = 3.0\naltitude_max_m = 20.0"),
    ("speed_max_m_s = 3.0", 'speed_max_m_s = 3.0\nyaw = "target"\naltitude = "target"\naltitude_offset_m = 4.5'),
    ("[target]\n", f"[target]\naltitude_m = {TARGET_ALTITUDE_M}\n"),
)


class Witness:
    """What a vehicle on the ring said: its heading off the target's direction, and that direction [degrees], unwrapped.

    Those from `settled` on count.
    """

    def __init__(self) -> None:
        self.off_deg: list[float] = []
        self.direction_deg: list[float] = []
        self.settled = 0
        self.height_m = 0.0
        self._away_m: tuple[float, float] | None = None

    @property
    def turned_deg(self) -> float:
        """How far around it has flown since it came to the ring."""
        return abs(self.direction_deg[-1] - self.direction_deg[0]) if self.direction_deg else 0.0

    def hear(self, message: Message) -> None:
        payload = message.payload.ljust(40, b"\0")
        if message.kind == LOCAL_POSITION:
            north_m, east_m, down_m = struct.unpack_from("<fff", payload, 4)
            self.height_m = -down_m
            self._away_m = TARGET_M[1] - (START_M[1] + north_m), TARGET_M[0] - (START_M[0] + east_m)
        if message.kind == ATTITUDE and self._away_m is not None and 9.0 < hypot(*self._away_m) < 11.0:
            north_m, east_m = self._away_m
            direction_rad = atan2(east_m, north_m)
            yaw_rad = struct.unpack_from("<f", payload, 12)[0]
            self.off_deg.append((degrees(yaw_rad - direction_rad) + 180.0) % 360.0 - 180.0)
            if self.turned_deg < SETTLES_DEG:
                self.settled = len(self.off_deg)
            before_deg = self.direction_deg[-1] if self.direction_deg else 0.0
            self.direction_deg.append(before_deg + (degrees(direction_rad) - before_deg + 180.0) % 360.0 - 180.0)


async def test_a_vehicle_on_the_ring_says_that_it_looks_at_the_target_and_flies_above_it(
    mission_file: Callable[..., str],
) -> None:
    mission = load_mission(with_first_vehicles(mission_file("px4-trio", *ALONE), 1))
    (stub,) = stub_configs(mission)
    witness, front_port = Witness(), free_port()
    relay = Relay(1, front_port, stub.client_port, on_message=witness.hear, on_setpoint=lambda: None)
    await relay.open()
    async with served([replace(stub, client_port=front_port)], SPEED) as stubs:
        plan = FlightPlan(mission, 300.0, mission.vehicles, speed=SPEED, clock=stubs.clock.name)
        async with flying(plan) as flight:
            await in_flight(
                flight, lambda: witness.turned_deg > SETTLES_DEG + SEEN_DEG, "a part of the ring", stubs.clock
            )
            off_deg, height_m = witness.off_deg[witness.settled :], witness.height_m
    await relay.close()
    assert len(off_deg) > 5
    assert max(map(abs, off_deg)) < 5.0
    assert median(map(abs, off_deg)) < 3.0
    assert height_m == pytest.approx(TARGET_ALTITUDE_M + 4.5, abs=0.2)
