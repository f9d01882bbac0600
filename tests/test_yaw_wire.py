"""The nose on the wire: what a stub vehicle says of its own heading, while it encircles a target over MAVLink."""

import asyncio
import struct
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from math import atan2, cos, degrees, hypot, radians
from pathlib import Path

import pytest
from rich.console import Console

from gcs.flight import fly
from gcs.flight_plan import FlightPlan
from gcs.live import LiveView
from gcs.mission_file import load_mission
from gcs.stubs import stub_configs
from tests.relay import GLOBAL_POSITION, Message, Relay
from tests.wire import free_port, served, until

pytestmark = pytest.mark.wire

SPEED, ATTITUDE = 5.0, 30
SETTLES_DEG, SEEN_DEG = 30.0, 70.0
"""How far around the ring it flies before it is looked at, and while it is."""
TARGET_M = (13.5, 2.0)
METRES_PER_DEGREE = 111_170.0
"""Of latitude, at 47.4 degrees north: the meridian's radius of curvature there is 6 370 km."""
ALONE = (
    ("leader = 2", "leader = 1"),
    ("altitude_m = 8.0", "altitude_m = 4.0"),
    ("start_m = [20.0, 0.0]\nvelocity_m_s = [0.1, 0.0]", f"start_m = [{TARGET_M[0]}, {TARGET_M[1]}]"),
    ("speed_max_m_s = 3.0", 'speed_max_m_s = 3.0\nyaw = "target"'),
)
"""x is east, and y north."""


class Witness:
    """What a vehicle on the ring said: its heading off the target's direction, and that direction [degrees], unwrapped.

    Those from `settled` on count.
    """

    def __init__(self) -> None:
        self.off_deg: list[float] = []
        self.direction_deg: list[float] = []
        self.settled = 0
        self._away_m: tuple[float, float] | None = None

    @property
    def turned_deg(self) -> float:
        """How far around it has flown since it came to the ring."""
        return abs(self.direction_deg[-1] - self.direction_deg[0]) if self.direction_deg else 0.0

    def hear(self, message: Message) -> None:
        payload = message.payload.ljust(40, b"\0")
        if message.kind == GLOBAL_POSITION:
            latitude, longitude = (each * 1e-7 for each in struct.unpack_from("<ii", payload, 4))
            north_m = (latitude - 47.397742) * METRES_PER_DEGREE
            east_m = (longitude - 8.545594) * METRES_PER_DEGREE * 1.0045 * cos(radians(latitude))
            self._away_m = TARGET_M[1] - north_m, TARGET_M[0] - east_m
        if message.kind == ATTITUDE and self._away_m is not None and 9.0 < hypot(*self._away_m) < 11.0:
            north_m, east_m = self._away_m
            direction_rad = atan2(east_m, north_m)
            yaw_rad = struct.unpack_from("<f", payload, 12)[0]
            self.off_deg.append((degrees(yaw_rad - direction_rad) + 180.0) % 360.0 - 180.0)
            if self.turned_deg < SETTLES_DEG:
                self.settled = len(self.off_deg)
            before_deg = self.direction_deg[-1] if self.direction_deg else 0.0
            self.direction_deg.append(before_deg + (degrees(direction_rad) - before_deg + 180.0) % 360.0 - 180.0)


async def test_a_vehicle_on_the_ring_says_that_it_looks_at_the_target(mission_file: Callable[..., str]) -> None:
    path = Path(mission_file("px4-trio", *ALONE))
    text = path.read_text(encoding="utf-8")
    path.write_text("[[vehicles]]".join(text.split("[[vehicles]]")[:2]), encoding="utf-8")
    mission = load_mission(str(path))
    (stub,) = stub_configs(mission)
    witness, front_port = Witness(), free_port()
    relay = Relay(1, front_port, stub.client_port, on_message=witness.hear, on_setpoint=lambda: None)
    await relay.open()
    plan = FlightPlan(mission, 300.0, mission.vehicles, stubs=False, speed=SPEED)
    async with served([replace(stub, client_port=front_port)], SPEED):
        flight = asyncio.create_task(fly(plan, LiveView(Console(file=StringIO()))))
        try:
            await until(lambda: flight.done() or witness.turned_deg > SETTLES_DEG + SEEN_DEG, 60.0)
            assert not flight.done(), flight.result()
            off_deg = witness.off_deg[witness.settled :]
        finally:
            flight.cancel()
            await asyncio.gather(flight, return_exceptions=True)
            await relay.close()
    assert len(off_deg) > 5
    assert max(map(abs, off_deg)) < 8.0
