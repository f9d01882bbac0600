"""What positions refer to changes in flight: the link reads it again, and the vehicle stays where it is.

The truth is that of the stub. One autopilot sends an origin that has moved, the other does not.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import pairwise
from math import copysign, cos, dist, nan, sin, sqrt
from typing import Any

import pytest
from pymavlink.dialects.v20.common import MAVLink, MAVLink_home_position_message, MAVLink_odometry_message

from agents.ports import FlightMode, Reference, Setpoint, VehicleRefusedError, VehicleStatus
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

    def changes_since(self, before: Reference) -> tuple[bool, int, int]:
        """Return whether the origin is known, and how many moves and jumps have been counted since then."""
        now = self.reference
        return now.is_known, now.moves - before.moves, now.jumps - before.jumps

    @asynccontextmanager
    async def judged(self, subtests: pytest.Subtests, what: str) -> AsyncIterator[Reference]:
        """Judge one thing, once the vehicle is where it is to stay; yields the reference before."""
        with subtests.test(what):
            await self.hold(8.0)
            assert dist(self.true_m, PLACE_M) < 0.05
            self.telemetry.clear()
            yield self.reference

    async def drift(self, name: str, to_m: float) -> None:
        """Let an error of the height grow by 0.3 m every half second."""
        faults = self.stub.faults
        while (left_m := to_m - getattr(faults, name)) != 0.0:
            setattr(faults, name, to_m if abs(left_m) < 0.3 else getattr(faults, name) + copysign(0.3, left_m))
            await self.hold(0.5)
        await self.hold()

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
        yield Flight(here.stubs[1], link, telemetry, here.clock)


def north_east(x: float, y: float) -> tuple[float, float]:
    """Return a horizontal vector of the mission frame, by its bearing."""
    return x * cos(BEARING_RAD) + y * sin(BEARING_RAD), x * sin(BEARING_RAD) - y * cos(BEARING_RAD)


def odometry(resets: int) -> bytes:
    """Return a PX4's ODOMETRY with a count of its estimator's resets."""
    unknown = [nan] * 21
    still = (0.0,) * 3
    message = MAVLink_odometry_message(0, 1, 1, *still, (1.0, 0.0, 0.0, 0.0), *still, *still, unknown, unknown, resets)
    return bytes(message.pack(MAVLink(None, 1, 1)))


def home(position_m: Triple) -> bytes:
    """Return a vehicle's HOME_POSITION."""
    place = FRAME.geodetic_from_mission(position_m)
    degrees = (round(place.latitude_deg * 1e7), round(place.longitude_deg * 1e7), round(place.altitude_m * 1e3))
    message = MAVLink_home_position_message(*degrees, 0.0, 0.0, 0.0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    return bytes(message.pack(MAVLink(None, 1, 1)))


def raised_by_vehicle(status: VehicleStatus) -> list[Condition]:
    """Return the conditions of a status but that of the link, which loses messages on a busy computer."""
    return [each for each in reported_faults(status, FailsafeSettings()) if each is not Condition.LINK_DEGRADED]


async def unreadable(*_: Any) -> Triple:
    raise VehicleRefusedError("has no position", "wait")


async def test_of_an_autopilot_that_sends_its_origin(
    monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    asked, find = list[float](), find_origin
    async with in_flight() as flight:
        faults = flight.stub.faults

        async def noted(*arguments: Any) -> Triple:
            asked.append(flight.clock.now_s())
            return await find(*arguments)

        async with flight.judged(subtests, "one wrong sample is dropped"):
            await until(lambda: bool(flight.telemetry), waiting_for="a sample", clock=flight.clock)
            faults.estimate_offset_m = (7.0, 0.0, 3.0)
            await flight.clock.sleep(SAMPLED_S)  # begins and ends between samples: one is wrong
            faults.estimate_offset_m = NONE
            assert await flight.hold() < STAYS_M
            apart_s = [later.time_s - before.time_s for before, later in pairwise(flight.telemetry)]
            assert max(apart_s) > 1.5 * SAMPLED_S, "it was sent"
            assert max(dist(each.position_m, PLACE_M) for each in flight.telemetry) < STAYS_M
            assert flight.reference == Reference()
        async with flight.judged(subtests, "one that counts a reset or has a new home is asked for its origin"):
            monkeypatch.setattr(mavsdk_link, "find_origin", noted)
            # Corrections of its home's height, which PX4 sends after a take-off, are no reason.
            for resets, readings in ((7, 0), (7, 0), (8, 1), (8, 1), (0, 2)):
                flight.stub.endpoint.send([odometry(resets)])
                assert await flight.hold(3.0) < STAYS_M
                assert len(asked) == readings, resets
            asked.clear()
            flight.stub.endpoint.send([home((0.0, 8.0, 0.0))])  # the stub sends its own, which differs, at 0.5 Hz
            assert await flight.hold(3.0) < STAYS_M
            assert len(asked) == 2
            assert flight.reference == Reference()
        monkeypatch.undo()
        async with flight.judged(subtests, "a height that drifts is compared with the barometer") as before:
            assert flight.link.status.height_off_m == 0.0
            await flight.drift("height_jump_m", 6.0)
            status = flight.link.status
            # A slow drift is no jump: the vehicle has followed it down to 2 m, and the barometer tells.
            assert flight.reference == before
            assert flight.true_m[2] == pytest.approx(2.0, abs=0.1)
            assert (status.height_off_m, status.height_sensor) == (6.0, BAROMETER)
            assert raised_by_vehicle(status) == [Condition.ESTIMATOR_FAILING, Condition.ESTIMATOR_DEGRADED]
            await flight.drift("height_jump_m", 0.0)
        async with flight.judged(subtests, "a move too small for a jump is read") as before:
            for moved_m in ((0.6, 0.0, 0.0), (0.6, 0.0, 0.9 * ORIGIN_STEP_M)):  # corrections of a height are no event
                faults.origin_moved_m = moved_m
                await flight.hold()
                assert dist(flight.telemetry[-1].position_m, flight.true_m) < 2.0 * QUANTUM_M
                assert flight.changes_since(before) == (True, 1, 0)
        async with flight.judged(subtests, "a position that jumps with its origin where it was is told") as before:
            faults.estimate_offset_m = (7.0, 0.0, 0.0)
            await flight.clock.sleep(2.0)  # a core holds at the new place
            assert flight.telemetry[-1].position_m[0] == pytest.approx(flight.true_m[0] + 7.0, abs=0.05)
            assert flight.changes_since(before) == (True, 0, 1)
            assert flight.reference.jumped_m == pytest.approx((*north_east(7.0, 0.0), 0.0), abs=0.05)
        faults.estimate_offset_m = NONE
        async with flight.judged(subtests, "an origin that is sent unasked is as good as an answer") as before:
            monkeypatch.setattr(mavsdk_link, "find_origin", unreadable)
            faults.estimate_offset_m = (5.0, 0.0, 0.0)
            await flight.clock.sleep(2.0)
            assert not flight.reference.is_known
            faults.estimate_offset_m, faults.origin_moved_m = NONE, (8.0, 0.0, 0.0)
            assert await flight.hold() < STAYS_M
            assert flight.changes_since(before) == (True, 1, 0)
        monkeypatch.undo()
        async with flight.judged(subtests, "a height that jumps moves neither vehicle nor height") as before:
            faults.height_jump_m = 6.0
            assert await flight.hold() < STAYS_M
            assert max(abs(each.position_m[2] - PLACE_M[2]) for each in flight.telemetry) < STAYS_M
            assert flight.changes_since(before) == (True, 0, 1)
            assert flight.reference.jumped_m == pytest.approx((0.0, 0.0, 6.0), abs=0.05)
            # It lands on the ground, not 6 m above or below.
            await flight.link.land()
            assert not flight.link.status.armed
            assert flight.true_m[2] == pytest.approx(0.0, abs=0.05)


async def test_of_one_that_does_not(monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests) -> None:
    explained_m = SIGMAS * sqrt(2.0) * GPS_SIGMA_M  # the stub's GPS states no accuracy
    async with in_flight("ardupilot") as flight:
        async with flight.judged(subtests, "an origin that moves moves neither vehicle nor positions") as before:
            flight.stub.faults.origin_moved_m = (8.0, 3.0, -2.0)
            assert await flight.hold() < STAYS_M
            assert max(dist(each.position_m, PLACE_M) for each in flight.telemetry) < STAYS_M
            assert dist(flight.telemetry[-1].position_m, flight.true_m) < 2.0 * QUANTUM_M
            assert flight.changes_since(before) == (True, 1, 0)
            assert flight.reference.moved_m == pytest.approx((*north_east(8.0, 3.0), -2.0), abs=2.0 * QUANTUM_M)
        async with flight.judged(subtests, "a vehicle stays while its origin cannot be read") as before:
            monkeypatch.setattr(mavsdk_link, "find_origin", unreadable)
            flight.stub.faults.origin_moved_m = NONE
            assert await flight.hold() < STAYS_M
            assert not flight.reference.is_known
            assert flight.link.status.mode is FlightMode.OFFBOARD
            monkeypatch.undo()
            assert await flight.hold() < STAYS_M
            assert flight.changes_since(before) == (True, 1, 0)
            assert dist(flight.telemetry[-1].position_m, flight.true_m) < 2.0 * QUANTUM_M
        async with flight.judged(subtests, "a height that follows a drifting barometer is compared with GPS") as before:
            for off_m, conditions in (
                (explained_m + 1.0, []),
                (explained_m + 3.0, [Condition.ESTIMATOR_DEGRADED]),
                (explained_m + 5.0, [Condition.ESTIMATOR_FAILING, Condition.ESTIMATOR_DEGRADED]),
            ):
                await flight.drift("barometer_off_m", -off_m)  # it climbs: below it is the ground
                status = flight.link.status
                assert flight.true_m[2] == pytest.approx(PLACE_M[2] + off_m, abs=0.5)
                assert status.height_off_m == pytest.approx(explained_m - off_m, abs=0.5)
                assert status.height_sensor == GPS
                assert raised_by_vehicle(status) == conditions
            assert flight.reference == before
