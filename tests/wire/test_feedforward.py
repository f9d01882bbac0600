"""Setpoints with velocities from the link over MAVSDK to a stub vehicle: it keeps up with them, and turned rightly."""

from math import radians

import numpy as np
import pytest

from agents.ports import Setpoint
from agents.shell.ticker import Ticker
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Telemetry
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from sitl.server.server import StubConfig
from tests.support.wire import free_port, stub_clock, stub_process

pytestmark = pytest.mark.wire

SPEED, TICK_S = 10.0, 0.05
AXIS = PlantAxis(0.8, 0.87)
PLANT = Plant(AXIS, AXIS, 0.0, 1.0)
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(35.0))
VELOCITY = (0.9, -0.6, 0.0)
LAG_S = AXIS.a1_per_s / AXIS.a0_per_s2


async def test_a_velocity_beside_the_setpoint_reaches_the_vehicle() -> None:
    config, telemetry = StubConfig(1, free_port(), PLANT, FRAME), list[Telemetry]()
    with stub_clock(SPEED) as clock, stub_process([config], clock.name):
        hub = MavsdkHub(clock)
        link = MavsdkLink(hub, LinkConfig(f"udpin://127.0.0.1:{config.client_port}", 1, FRAME), clock)

        async def trail_s(velocity: tuple[float, ...], from_m: tuple[float, float]) -> float:
            """Move the setpoint steadily for a while; return how long after it the vehicle is where it was."""
            start_s, lags_s = clock.now_s(), []
            async for tick in Ticker(TICK_S, clock):
                x, y = (p + rate * (clock.now_s() - start_s) for p, rate in zip(from_m, VELOCITY[:2], strict=True))
                link.send(Setpoint((x, y, 5.0), velocity_m_s=velocity))
                behind = np.array([x, y]) - telemetry[-1].position_m[:2]
                lags_s.append(float(behind @ VELOCITY[:2]) / float(np.dot(VELOCITY, VELOCITY)))
                if tick.deadline_s > start_s + 10.0:
                    break
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
    assert fed_s == pytest.approx(0.0, abs=0.1), "a tick, and the age of the telemetry"
    assert unfed_s - fed_s == pytest.approx(LAG_S, abs=0.05)
