"""Setpoints with velocities from the link over MAVSDK to a stub vehicle: it keeps up with them, and turned rightly."""

import asyncio
import time
from functools import partial
from math import radians

import numpy as np
import pytest

from agents.ports import Setpoint
from agents.shell.clock import WallClock
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Telemetry
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from sitl.server.process import StubProcess
from sitl.server.server import StubConfig
from tests.support.wire import free_port

pytestmark = pytest.mark.wire

SPEED = 10.0
AXIS = PlantAxis(0.8, 0.87)
PLANT = Plant(AXIS, AXIS, 0.0, 1.0)
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(35.0))
VELOCITY = (0.9, -0.6, 0.0)
LAG_S = AXIS.a1_per_s / AXIS.a0_per_s2


async def test_a_velocity_beside_the_setpoint_reaches_the_vehicle() -> None:
    config = StubConfig(1, free_port(), PLANT, FRAME)
    process, hub, telemetry = StubProcess([config], partial(WallClock, SPEED)), MavsdkHub(), list[Telemetry]()
    process.start()
    began_s = time.monotonic()
    link_config = LinkConfig(f"udpin://127.0.0.1:{config.client_port}", 1, FRAME)
    link = MavsdkLink(hub, link_config, lambda: SPEED * (time.monotonic() - began_s), SPEED)

    async def trail_s(velocity: tuple[float, ...], from_m: tuple[float, float]) -> float:
        """Move the setpoint steadily for a while; return how long after it the vehicle is where it was."""
        start_s = now_s = SPEED * (time.monotonic() - began_s)
        lags_s = []
        while now_s < start_s + 10.0:
            now_s = SPEED * (time.monotonic() - began_s)
            x, y = (place + rate * (now_s - start_s) for place, rate in zip(from_m, VELOCITY[:2], strict=True))
            link.send(Setpoint((x, y, 5.0), velocity_m_s=velocity))
            behind = np.array([x, y]) - telemetry[-1].position_m[:2]
            lags_s.append(float(behind @ VELOCITY[:2]) / float(np.dot(VELOCITY, VELOCITY)))
            await asyncio.sleep(0.01)
        return float(np.mean(lags_s[-30:]))

    try:
        await link.connect(telemetry.append)
        await link.take_off(5.0)
        link.send(Setpoint((0.0, 0.0, 5.0), velocity_m_s=(0.0, 0.0, 0.0)))
        await link.start_offboard()
        fed_s = await trail_s(VELOCITY, (0.0, 0.0))
        x, y, _ = telemetry[-1].position_m
        unfed_s = await trail_s((), (x, y))
        await link.land()
    finally:
        await link.close()
        await hub.close()
        process.stop()
    assert fed_s == pytest.approx(0.0, abs=0.7), "only the wire's own delay, ten times as long here"
    assert unfed_s - fed_s == pytest.approx(LAG_S, abs=0.35)
