"""What positions refer to changes in flight: the link reads it again, and the vehicle stays where it is.

The truth is that of the stub. One autopilot sends an origin that has moved, the other does not.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import pairwise
from math import cos, dist, nan, sin, sqrt
from typing import Any

import pytest
from pymavlink.dialects.v20.common import MAVLink, MAVLink_odometry_message

from agents.ports import FlightMode, Reference, Setpoint, VehicleRefusedError
from agents.safety.failsafe import Condition, reported_faults
from agents.settings.sections import FailsafeSettings
from estimation.frames import Triple
from estimation.profile.autopilots import AutopilotName
from estimation.state import Telemetry
from gcs.link import mavsdk_link
from gcs.link.calls import find_origin
from gcs.link.feed import ORIGIN_STEP_M
from gcs.link.heights import BAROMETER, GPS, GPS_SIGMA_M, SIGMAS
from gcs.link.mavsdk_link import MavsdkLink
from sitl.server.governed_clock import GovernedClock
from sitl.server.server import Stub, StubConfig
from tests.support.wire import free_port, served, until
from tests.wire.link.test_link import BEARING_RAD, FRAME, PLANT, QUANTUM_M, SPEED, hold_setpoint, link_on, udp_in

pytestmark = pytest.mark.wire

PLACE_M = (3.0, -2.0, 8.0)
STAYS_M = 0.8
"""How far a vehicle may be moved by the one or two setpoints that are sent before the change is received."""
SAMPLED_S = 0.05
"""The period of the telemetry."""
NONE = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Flight:
    """A stub vehicle that hovers at PLACE_M in offboard, and its link."""

    stub: Stub
    link: MavsdkLink
    telemetry: list[Telemetry]
    clock: GovernedClock

    @property
    def true_m(self) -> Triple:
        return self.stub.autopilot.airframe.position_m

    @property
    def reference(self) -> Reference:
        return self.link.status.reference

    async def hold(self, duration_s: float = 6.0) -> float:
        """Hold the same place by setpoints, and return how far the vehicle was from it at most."""
        end_s, away_m = self.clock.now_s() + duration_s, 0.0
        while self.clock.now_s() < end_s:
            await hold_setpoint(self.link, Setpoint(PLACE_M), self.clock, 0.1)
            away_m = max(away_m, dist(self.true_m, PLACE_M))
        return away_m


@asynccontextmanager
async def in_flight(autopilot: AutopilotName = "px4") -> AsyncIterator[Flight]:
    config = StubConfig(1, free_port(), PLANT, FRAME, origin_offset_m=(0.4, -0.3, 0.2), autopilot=autopilot)
    async with (
        served([config], SPEED) as here,
        link_on(here.clock, udp_in(config), 1) as (link, telemetry),
    ):
        await link.take_off(PLACE_M[2])
        link.send(Setpoint(PLACE_M))
        await link.start_offboard()
        flight = Flight(here.stubs[1], link, telemetry, here.clock)
        await flight.hold(8.0)
        assert dist(flight.true_m, PLACE_M) < 0.05
        telemetry.clear()
        yield flight


def north_east(x: float, y: float) -> tuple[float, float]:
    """Return a horizontal vector of the mission frame, by its bearing."""
    return x * cos(BEARING_RAD) + y * sin(BEARING_RAD), x * sin(BEARING_RAD) - y * cos(BEARING_RAD)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
async def test_an_origin_that_moves_moves_neither_the_vehicle_nor_its_positions(autopilot: AutopilotName) -> None:
    async with in_flight(autopilot) as flight:
        flight.stub.faults.origin_moved_m = (8.0, 3.0, -2.0)
        assert await flight.hold() < STAYS_M
        off_m = max(dist(each.position_m, PLACE_M) for each in flight.telemetry)
        assert off_m < STAYS_M
        assert dist(flight.telemetry[-1].position_m, flight.true_m) < 2.0 * QUANTUM_M
        reference = flight.reference
        assert (reference.is_known, reference.moves, reference.jumps) == (True, 1, 0)
        assert reference.moved_m == pytest.approx((*north_east(8.0, 3.0), -2.0), abs=2.0 * QUANTUM_M)


async def test_a_move_too_small_for_a_jump_is_read_where_the_autopilot_sends_it() -> None:
    async with in_flight() as flight:
        flight.stub.faults.origin_moved_m = (0.6, 0.0, 0.0)
        await flight.hold()
        assert dist(flight.telemetry[-1].position_m, flight.true_m) < 2.0 * QUANTUM_M
        assert flight.reference.moves == 1
        flight.stub.faults.origin_moved_m = (0.6, 0.0, 0.9 * ORIGIN_STEP_M)
        await flight.hold()
        assert dist(flight.telemetry[-1].position_m, flight.true_m) < 2.0 * QUANTUM_M
        assert flight.reference.moves == 1, "corrections of a height are no event"


async def test_a_height_that_jumps_moves_neither_the_vehicle_nor_the_height_that_is_told() -> None:
    async with in_flight() as flight:
        flight.stub.faults.height_jump_m = 6.0
        assert await flight.hold() < STAYS_M
        assert max(abs(each.position_m[2] - PLACE_M[2]) for each in flight.telemetry) < STAYS_M
        reference = flight.reference
        assert (reference.moves, reference.jumps) == (0, 1)
        assert reference.jumped_m == pytest.approx((0.0, 0.0, 6.0), abs=0.05)
        # It lands on the ground, not 6 m above or below.
        await flight.link.land()
        assert not flight.link.status.armed
        assert flight.true_m[2] == pytest.approx(0.0, abs=0.05)


async def test_a_position_that_jumps_with_its_origin_where_it_was_is_told_as_it_is() -> None:
    async with in_flight() as flight:
        flight.stub.faults.estimate_offset_m = (7.0, 0.0, 0.0)
        await flight.clock.sleep(2.0)  # a core holds at the new place
        assert flight.telemetry[-1].position_m[0] == pytest.approx(flight.true_m[0] + 7.0, abs=0.05)
        reference = flight.reference
        assert (reference.is_known, reference.moves, reference.jumps) == (True, 0, 1)
        assert reference.jumped_m == pytest.approx((*north_east(7.0, 0.0), 0.0), abs=0.05)


async def test_one_wrong_sample_is_dropped() -> None:
    async with in_flight() as flight:
        count = len(flight.telemetry)
        await until(lambda: len(flight.telemetry) > count, waiting_for="a sample", clock=flight.clock)
        flight.stub.faults.estimate_offset_m = (7.0, 0.0, 3.0)
        await flight.clock.sleep(SAMPLED_S)  # begins and ends between samples: one is wrong
        flight.stub.faults.estimate_offset_m = NONE
        assert await flight.hold() < STAYS_M
        apart_s = [later.time_s - before.time_s for before, later in pairwise(flight.telemetry)]
        assert max(apart_s) > 1.5 * SAMPLED_S, "it was sent"
        assert max(dist(each.position_m, PLACE_M) for each in flight.telemetry) < STAYS_M
        assert flight.reference == Reference()


async def test_a_height_that_drifts_is_compared_with_the_barometer() -> None:
    async with in_flight() as flight:
        assert flight.link.status.height_off_m == 0.0
        for _ in range(20):
            flight.stub.faults.height_jump_m += 0.3
            await flight.hold(0.5)
        await flight.hold()
        status = flight.link.status
        # A slow drift is no jump: the vehicle has followed it down to 2 m, and the barometer tells.
        assert flight.reference == Reference()
        assert flight.true_m[2] == pytest.approx(2.0, abs=0.1)
        assert (status.height_off_m, status.height_sensor) == (6.0, BAROMETER)
        assert [*reported_faults(status, FailsafeSettings())] == [
            Condition.ESTIMATOR_FAILING,
            Condition.ESTIMATOR_DEGRADED,
        ]


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
async def test_a_height_that_follows_a_drifting_barometer_is_compared_with_the_gps(autopilot: AutopilotName) -> None:
    explained_m = SIGMAS * sqrt(2.0) * GPS_SIGMA_M  # the stub's GPS states no accuracy
    async with in_flight(autopilot) as flight:
        for off_m, conditions in (
            (explained_m + 1.0, []),
            (explained_m + 3.0, [Condition.ESTIMATOR_DEGRADED]),
            (explained_m + 5.0, [Condition.ESTIMATOR_FAILING, Condition.ESTIMATOR_DEGRADED]),
        ):
            # It climbs: below it is the ground.
            while flight.stub.faults.barometer_off_m > -off_m:
                flight.stub.faults.barometer_off_m -= 0.3
                await flight.hold(0.5)
            await flight.hold()
            status = flight.link.status
            assert flight.true_m[2] == pytest.approx(PLACE_M[2] + off_m, abs=0.5)
            assert status.height_off_m == pytest.approx(explained_m - off_m, abs=0.5)
            assert status.height_sensor == GPS
            assert [*reported_faults(status, FailsafeSettings())] == conditions
        assert flight.reference == Reference()


async def unreadable(*_: Any) -> Triple:
    raise VehicleRefusedError("has no position", "wait")


async def test_a_vehicle_stays_while_its_origin_cannot_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    async with in_flight("ardupilot") as flight:
        monkeypatch.setattr(mavsdk_link, "find_origin", unreadable)
        flight.stub.faults.origin_moved_m = (8.0, 0.0, 0.0)
        assert await flight.hold() < STAYS_M
        assert not flight.reference.is_known
        assert flight.link.status.mode is FlightMode.OFFBOARD
        monkeypatch.undo()
        assert await flight.hold() < STAYS_M
        assert (flight.reference.is_known, flight.reference.moves) == (True, 1)
        assert dist(flight.telemetry[-1].position_m, flight.true_m) < 2.0 * QUANTUM_M


async def test_an_origin_that_is_sent_unasked_is_as_good_as_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    async with in_flight() as flight:
        monkeypatch.setattr(mavsdk_link, "find_origin", unreadable)
        flight.stub.faults.estimate_offset_m = (5.0, 0.0, 0.0)
        await flight.clock.sleep(2.0)
        assert not flight.reference.is_known
        flight.stub.faults.estimate_offset_m = NONE
        flight.stub.faults.origin_moved_m = (8.0, 0.0, 0.0)
        assert await flight.hold() < STAYS_M
        assert (flight.reference.is_known, flight.reference.moves, flight.reference.jumps) == (True, 1, 0)


def odometry(resets: int) -> bytes:
    """Return a PX4's ODOMETRY with a count of its estimator's resets."""
    unknown = [nan] * 21
    still = (0.0,) * 3
    message = MAVLink_odometry_message(0, 1, 1, *still, (1.0, 0.0, 0.0, 0.0), *still, *still, unknown, unknown, resets)
    return bytes(message.pack(MAVLink(None, 1, 1)))


async def test_an_estimator_that_counts_a_reset_is_asked_for_its_origin(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[float]()
    find = find_origin

    async def noted(*arguments: Any) -> Triple:
        asked.append(flight.clock.now_s())
        return await find(*arguments)

    async with in_flight() as flight:
        monkeypatch.setattr(mavsdk_link, "find_origin", noted)
        for resets, readings in ((7, 0), (7, 0), (8, 1), (8, 1), (0, 2)):
            flight.stub.endpoint.send([odometry(resets)])
            assert await flight.hold(3.0) < STAYS_M
            assert len(asked) == readings, resets
        assert flight.reference == Reference()
