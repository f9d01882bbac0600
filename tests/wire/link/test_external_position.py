"""Positions from outside on their way from the bus to an autopilot without GPS, over sockets."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from math import degrees, radians

import pytest
from pymavlink.dialects.v20 import common as dialect

from agents.shell.clock import WallClock
from agents.team.external_positions import OLD_S, ExternalPosition
from estimation.frames import MissionFrame
from gcs.link.config import LinkConfig
from gcs.link.external_position import NO_EXTERNAL_POSITION
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.link.ports import free_ports
from gcs.link.relay.relay import Relay
from sitl.server.process import StubProcess
from sitl.server.server import StubConfig
from tests.support.telemetry_log import PLANT
from tests.support.wire import until

pytestmark = pytest.mark.wire

INDOORS = MissionFrame(None, radians(90.0))
"""x points east, y north."""
ORIGIN_M = (2.0, 1.0, 0.5)


@asynccontextmanager
async def located(*, fed: bool) -> AsyncIterator[tuple[MavsdkLink, asyncio.Task[None], list[float]]]:
    """Connect to a stub that knows its place only while it is sent it, 60 times a second; yield when it was measured.

    These times are the wall's, as of sensors: what is asserted holds on a busy computer as well.
    """
    (port,) = free_ports(1)
    stubs = StubProcess([StubConfig(1, port, PLANT, INDOORS, gps=False, external=True)], partial(WallClock, 1.0))
    await asyncio.to_thread(stubs.start)
    hub = MavsdkHub()
    config = LinkConfig(f"udpin://127.0.0.1:{port}", 1, INDOORS, origin_m=ORIGIN_M, external_positions=True)
    link = MavsdkLink(hub, config, WallClock())

    measured_s: list[float] = []

    async def feed() -> None:
        while fed:
            measured_s.append(time.time() - 0.02)
            link.locate(ExternalPosition(measured_s[-1], (5.0, 3.0, 1.5), 0.3))
            await asyncio.sleep(1.0 / 60.0)

    feeding = asyncio.create_task(feed())
    try:
        await link.connect(lambda _: None)
        yield link, feeding, measured_s
    finally:
        feeding.cancel()
        await link.close()
        await hub.close()
        await asyncio.to_thread(stubs.stop)


async def test_a_vehicle_that_is_sent_where_it_is_gets_a_position(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[bytes] = []
    outbound = Relay._outbound

    def noted(relay: Relay, data: bytes) -> list[tuple[bytes, tuple[object, ...]]]:
        frames = outbound(relay, data)
        sent.extend(frame for frame, _ in frames)
        return frames

    monkeypatch.setattr(Relay, "_outbound", noted)
    async with located(fed=True) as (link, feeding, measured_s):
        await until(lambda: link.status.local_position_ok and link.status.estimator_fault == "")
        sent.clear()
        measured_s.clear()
        began_s = time.monotonic()
        await asyncio.sleep(2.0)
        duration_s, fed = time.monotonic() - began_s, len(measured_s)
        messages = [each for frame in sent for each in dialect.MAVLink(None).parse_buffer(frame) or []]
        estimates = [each for each in messages if each.get_type() == "VISION_POSITION_ESTIMATE"]
        assert len(estimates) <= 30.0 * duration_s + 2, "30 a second"
        assert len(estimates) >= 0.45 * fed, "of 60"
        newest = estimates[-1]
        # 3 m east, 2 m north and 1 m above its origin; x points east, so a yaw of 0.3 is a heading of 90 degrees less.
        assert (newest.x, newest.y, newest.z) == pytest.approx((2.0, 3.0, -1.0), abs=1e-6)
        assert degrees(newest.yaw) == pytest.approx(90.0 - degrees(0.3), abs=1e-4)
        assert min(abs(newest.usec * 1e-6 - each) for each in measured_s) < 1e-3
        feeding.cancel()
        await until(lambda: link.status.estimator_fault == NO_EXTERNAL_POSITION)
        assert time.time() - measured_s[-1] > OLD_S
