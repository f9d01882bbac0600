"""Values that an autopilot marks as unknown, and a second battery, over UDP and MAVSDK."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

import pytest
from pymavlink.dialects.v20 import common as mavlink

from agents.ports import FlightMode, ModeSource, Setpoint
from estimation.profile.autopilots import AutopilotName
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.preflight.link_facts import CheckedLink
from sitl.autopilot.modes import NavMode
from sitl.server.governed_clock import GovernedClock
from sitl.server.server import Stub, StubConfig
from tests.support.wire import free_port, served, until
from tests.wire.link.test_link import FRAME, PLANT, SPEED, link_on, udp_in

pytestmark = pytest.mark.wire


@asynccontextmanager
async def linked(
    autopilot: AutopilotName, *, unknown: bool = False
) -> AsyncIterator[tuple[Stub, MavsdkLink, GovernedClock]]:
    config = StubConfig(1, free_port(), PLANT, FRAME, autopilot=autopilot)
    async with served([config], SPEED) as stubs:
        stub = stubs.stubs[1]
        stub.faults.values_unknown = unknown
        async with link_on(stubs.clock, udp_in(config), 1) as (link, _):
            yield stub, link, stubs.clock


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
async def test_what_is_unknown_is_none_and_the_lower_of_two_batteries_counts(
    autopilot: AutopilotName, subtests: pytest.Subtests
) -> None:
    async with linked(autopilot, unknown=True) as (stub, link, clock):

        def told(fault: str) -> bool:
            return link.status.battery_fault == fault

        with subtests.test("what is unknown"):
            await until(lambda: link.status.gps_dimensions == 3, clock=clock)
            await clock.sleep(6.0)  # all messages have been received several times
            status = link.status
            assert (status.battery, status.endurance_s, status.satellites) == (None, None, None)
            assert (status.estimator_ratio, status.estimator_sensor) == (None, "")
            stub.faults.values_unknown, stub.faults.endurance_s = False, 500.0
            await until(lambda: (link.status.battery, link.status.endurance_s) == (1.0, 500.0), clock=clock)
            await until(lambda: link.status.satellites == 14 and link.status.estimator_ratio is not None, clock=clock)
            stub.faults.values_unknown = True
            await until(lambda: link.status.satellites is None and link.status.estimator_ratio is None, clock=clock)
            assert link.status.battery == 1.0, "it is kept for a while"
        stub.faults.values_unknown = False
        with subtests.test("what an autopilot says of a battery"):
            assert told("")
            stub.faults.second_battery = 0.9
            for state, fault in (
                (mavlink.MAV_BATTERY_CHARGE_STATE_LOW, "battery 0 low, battery 1 low"),
                (mavlink.MAV_BATTERY_CHARGE_STATE_UNHEALTHY, "battery 0 unhealthy, battery 1 unhealthy"),
                (mavlink.MAV_BATTERY_CHARGE_STATE_OK, ""),
            ):
                stub.faults.charge_state = state
                await until(partial(told, fault), clock=clock)
        with subtests.test("the lower counts, whichever is reported last"):
            stub.faults.second_battery = 0.08
            await until(lambda: link.status.battery == 0.08, clock=clock)
            stub.faults.second_battery, stub.autopilot.battery_fraction = 0.9, 0.06
            await until(lambda: link.status.battery == 0.06, clock=clock)
            seen = set()
            for _ in range(100):
                await clock.sleep(0.05)
                seen.add(link.status.battery)
            assert seen == {0.06}


async def test_check_lists_the_batteries_that_an_autopilot_reports() -> None:
    config = StubConfig(1, free_port(), PLANT, FRAME)
    async with served([config], SPEED) as stubs:
        stubs.stubs[1].faults.second_battery = 0.08
        hub = MavsdkHub(stubs.clock)
        link = CheckedLink(hub, LinkConfig(udp_in(config), 1, FRAME), stubs.clock)
        try:
            await link.connect(lambda _telemetry: None)
            facts = await link.facts(1, 5.0)
        finally:
            await link.close()
            await hub.close()
    assert [(each.number, each.charge, each.flies) for each in facts.batteries] == [(0, 1.0, True), (1, 0.08, True)]
    assert facts.status.battery == 0.08


async def test_a_failsafe_of_the_autopilot_is_told_from_a_selected_mode() -> None:
    async with linked("px4") as (stub, link, clock):
        assert stub.autopilot.parameters.set("COM_OBL_RC_ACT", 4)
        await link.take_off(8.0)
        setpoint = Setpoint((0.0, 0.0, 8.0))
        link.send(setpoint)
        await link.start_offboard()
        stub.autopilot.select(NavMode.HOLD)
        await until(lambda: link.status.mode is FlightMode.HOLD, clock=clock)
        await clock.sleep(3.0)
        assert link.status.mode_by is ModeSource.UNKNOWN
        link.send(setpoint)
        await link.start_offboard()
        link.hand_over()  # no setpoint arrives any more
        await until(lambda: link.status.mode is FlightMode.LAND, clock=clock)
        status = link.status
        assert status.mode_by is ModeSource.FAILSAFE
