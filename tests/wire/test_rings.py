"""A team on two rings over MAVLink and Zenoh: an operator assigns a vehicle to the other ring, and changes one ring."""

from collections.abc import Callable
from math import hypot

import pytest

from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from tests.support.flights import flying, in_flight, unseen_view
from tests.support.mission_text import LOW
from tests.support.wire import hurried, running, served

pytestmark = pytest.mark.wire
SPEED = 5.0
NORTH_M = (45.0, 20.0)
"""Where the target of the ring "north" rests."""


async def test_a_vehicle_is_assigned_to_the_other_ring_and_one_ring_is_changed(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mission_file("two-targets", LOW)
    mission, rings, view = load_mission(path), dict[int, str](), unseen_view()
    monkeypatch.setattr(
        view, "update", lambda rows, *_: rings.update({each.vehicle_id: f"{each.tactic} {each.ring}" for each in rows})
    )

    async def told(*command: str) -> str:
        async with running("command", *command, "--mission", path) as process:
            _, said = await process.communicate()
            assert process.returncode == 0, said.decode()
            return said.decode()

    async with served(stub_configs(mission), SPEED) as stubs:
        plan = FlightPlan(mission, 600.0, mission.vehicles, speed=None, clock=stubs.clock.name)
        async with flying(plan, view) as flight:

            def around_north_m(radius_m: float) -> set[int]:
                """Return the vehicles whose true distance from the northern target is a radius."""
                places = {i: stub.airframe.position_m for i, stub in stubs.vehicles.items()}
                return {
                    i for i, (x, y, _) in places.items() if abs(hypot(x - NORTH_M[0], y - NORTH_M[1]) - radius_m) < 0.3
                }

            def flown() -> list[str]:
                return sorted(rings.values())

            wanted = ["encircle north"] * 2 + ["encircle south"] * 3
            with hurried(stubs.clock):
                await in_flight(flight, lambda: flown() == wanted, "the rings", stubs.clock)
                await in_flight(flight, lambda: len(around_north_m(8.0)) == 2, "the ring north", stubs.clock)
            assigned = next(i for i, ring in rings.items() if ring.endswith("south"))
            assert "goes to the ring 'north'" in await told("assign", str(assigned), "north")
            with hurried(stubs.clock):
                await in_flight(
                    flight,
                    lambda: flown() == wanted and assigned in around_north_m(8.0) and len(around_north_m(8.0)) == 2,
                    "the exchange",
                    stubs.clock,
                )
            assert "changes the ring 'north' to 11 m" in await told("ring", "north", "radius=11")
            with hurried(stubs.clock):
                await in_flight(flight, lambda: len(around_north_m(11.0)) == 2, "the ring of 11 m", stubs.clock)
            assert assigned in around_north_m(11.0)
