"""The stub on real sockets: flown by MAVSDK as a PX4 would be, and its process kept on a lead."""

import asyncio
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from math import radians
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from agents.ports import Setpoint
from agents.shell.clock import WallClock
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Vector
from sitl.mavlink.reports import EstimatorNoise
from sitl.server import endpoint
from sitl.server.governed_clock import GovernedClock
from sitl.server.process import StubProcess, StubReady, run_in_process
from sitl.server.record import StubRecord
from sitl.server.server import StubConfig, serve
from sitl.server.shared_clock import ClockName, Rank
from tests.support.forger import Forger
from tests.support.wire import PATIENCE_S, free_port, served_by, stub_clock, stub_process, until
from tests.wire.link.test_link import hold_setpoint, link_on, udp_in

pytestmark = pytest.mark.wire

SPEED = 10.0
PLANT = Plant(PlantAxis(1.51, 1.90), PlantAxis(1.87, 2.40), delay_s=0.2)
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(30.0))


def config(vehicle_id: int = 1, **changes: Any) -> StubConfig:
    fields: dict[str, Any] = {"vehicle_id": vehicle_id, "client_port": free_port(), "plant": PLANT, "frame": FRAME}
    return StubConfig(**(fields | changes))


def flown(axis: PlantAxis, setpoint: float, times_s: Vector) -> Vector:
    """Return the positions after a step from rest, by a matrix exponential that shares no code with the stub."""
    matrix = np.array([[0.0, 1.0, 0.0], [-axis.a0_per_s2, -axis.a1_per_s, axis.a0_per_s2 * setpoint], [0.0, 0.0, 0.0]])
    return np.array([(expm(matrix * max(t, 0.0)) @ [0.0, 0.0, 1.0])[0] for t in times_s])


async def test_a_commanded_step_is_flown_as_the_plant_answers_it() -> None:
    wind_m_s2, x0, y0 = (0.3, -0.2), 3.0, 2.0
    noise = EstimatorNoise(position_m=0.01)
    stub = config(9, start_position_m=(x0, y0), wind_m_s2=wind_m_s2, noise=noise, battery_fraction=0.6)
    with stub_clock(SPEED) as clock, stub_process([stub], clock.name) as process:
        async with link_on(clock, udp_in(stub), 9, FRAME) as (link, telemetry):
            await until(lambda: len({each.position_m for each in telemetry}) > 1, waiting_for="noise", clock=clock)
            await link.take_off(3.0)
            rests, goal = Setpoint((x0, y0, 3.0)), Setpoint((x0 + 4.0, y0 - 2.0, 3.0))
            link.send(rests)
            await link.start_offboard()
            await hold_setpoint(link, rests, clock, 12.5)  # until it rests, leaning into the wind
            sent_s = clock.now_s()
            await hold_setpoint(link, goal, clock, 7.5)
            arrived = telemetry[-1].position_m
            assert link.status.battery is not None
            assert 0.5 < link.status.battery <= 0.6
        (track,) = process.stop().tracks
    leaning_m = (wind_m_s2[0] / PLANT.x.a0_per_s2, wind_m_s2[1] / PLANT.y.a0_per_s2)
    window = (track.time_s > sent_s - 1.0) & (track.time_s < sent_s + 7.0)
    since_s = track.time_s[window] - sent_s - PLANT.delay_s
    flown_m = track.position_m[window, :2] - (x0, y0) - np.array(leaning_m)

    answers = np.transpose([flown(PLANT.x, 4.0, since_s), flown(PLANT.y, -2.0, since_s)])
    assert np.abs(flown_m - answers).max() < 0.03
    assert arrived == pytest.approx((x0 + 4.0 + leaning_m[0], y0 - 2.0 + leaning_m[1], 3.0), abs=0.06)


# The process and the server


def spawned(speed: float = SPEED) -> tuple[Any, Any]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=run_in_process, args=([config()], partial(WallClock, speed), theirs), daemon=True)
    process.start()
    theirs.close()
    assert ours.poll(PATIENCE_S)
    return process, ours


def test_the_process_ends_with_its_parent_and_ignores_ctrl_c() -> None:
    process, ours = spawned()
    assert isinstance(ours.recv(), StubReady)
    os.kill(process.pid, signal.SIGINT)
    process.join(0.3)
    assert process.is_alive()
    ours.close()  # what the parent's death does
    process.join(PATIENCE_S)
    assert process.exitcode == 0


def test_a_stub_that_cannot_run_says_why() -> None:
    with pytest.raises(OSError, match="no clock"):
        StubProcess([config()], partial(GovernedClock, ClockName(0), Rank.STUBS)).start()


def test_a_stub_that_was_killed_leaves_no_record() -> None:
    stubs = StubProcess([config()], partial(WallClock, SPEED))
    stubs.start()
    assert stubs.pid is not None
    os.kill(stubs.pid, signal.SIGKILL)
    with pytest.raises(OSError, match="before it was stopped"):
        stubs.stop()


async def test_a_vehicle_obeys_its_client_only_until_that_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    stub = config(7, port=free_port())
    port = stub.port
    client, forger, next_client = Forger(245, port=stub.client_port), Forger(245), Forger(245)
    with stub_clock(SPEED) as clock:
        async with served_by(clock, [stub]) as stubs:
            vehicle, dropped = stubs[7].autopilot, stubs[7].dropped

            def arms() -> bool:
                client.arm(7, port)  # again and again: the vehicle has to know its position first
                return vehicle.armed

            await until(lambda: client.received() > 0, waiting_for="telemetry of a client that is still silent")
            forger.garbage(port)
            await until(lambda: dropped() == {"garbage": 1})
            assert forger.received() == 0, "garbage claims no vehicle"
            await until(arms, waiting_for="its client's command")
            forger.disarm(7, port)
            await until(lambda: dropped().get("not from its client") == 1)
            assert vehicle.armed
            assert forger.received() == 0
            monkeypatch.setattr(endpoint, "SILENCE_S", 0.0)  # the client has left
            next_client.disarm(7, port)
            await until(lambda: not vehicle.armed and next_client.received() > 0, waiting_for="its next client")
            monkeypatch.setattr(endpoint, "SILENCE_S", 1e9)
            await until(arms, waiting_for="the client that its mission names, which came back")
            next_client.disarm(7, port)
            await until(lambda: dropped().get("not from its client") == 2)
            assert vehicle.armed
    for each in (client, forger, next_client):
        each.close()


class SetClock:
    """A clock that the test sets; whoever waits for a time looks at every setting."""

    speed = SPEED

    def __init__(self) -> None:
        self._now_s, self._looked = 1000.0, asyncio.Event()
        self._set = asyncio.Event()

    def now_s(self) -> float:
        return self._now_s

    def call_at(self, time_s: float, call: Callable[[], object]) -> object:
        raise NotImplementedError

    async def sleep_until(self, _time_s: float) -> float:
        self._looked.set()
        await self._set.wait()
        self._set.clear()
        return self._now_s

    async def set(self, now_s: float) -> None:
        """Set the time, and return once it has been looked at."""
        await self._looked.wait()
        self._looked.clear()
        self._now_s = now_s
        self._set.set()
        await self._looked.wait()

    def close(self) -> None:
        pass


async def test_time_that_cannot_be_caught_up_is_given_up_and_told() -> None:
    clock, stop = SetClock(), asyncio.Event()
    serving = asyncio.create_task(serve([config()], clock, stop))
    for now_s in (1001.0, 1051.0, 1051.4, 1051.8):
        await clock.set(now_s)
    stop.set()
    record: StubRecord = await serving
    assert record.slipped_s == pytest.approx(0.5 + 49.5)
    (track,) = record.tracks
    assert track.time_s[-1] == pytest.approx(1051.8, abs=0.1)
    assert len(track.time_s) == pytest.approx(18, abs=1)


def test_a_process_that_starts_stubs_still_holds_signals_back() -> None:
    program = """
import signal
from functools import partial
from agents.shell.clock import WallClock
from cordon.lockstep import LockstepClient
from gcs.signals import ENDING, hold_back
from sitl.server.process import StubProcess
hold_back()
stubs = StubProcess([], partial(WallClock, 1.0))
stubs.start()
print(ENDING <= signal.pthread_sigmask(signal.SIG_BLOCK, ()))
stubs.stop()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n", "Ctrl-C would end the supervisor, or the flying process"
