"""A team of stubs as a test of a user's own has it: true states, commands, faults, waits, and its end."""

import asyncio
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import dist, inf
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

import cordon
from gcs.link.ports import bind_fault
from sitl.autopilot.airframe import STEP_S
from tests.support.wire import until_now
from tests.wire.test_sitl import flown

pytestmark = pytest.mark.wire


@contextmanager
def client(vehicle: cordon.StubVehicle) -> Iterator[Any]:
    """Connect pymavlink."""
    link = mavutil.mavlink_connection(vehicle.pymavlink_url)
    try:
        yield link
    finally:
        link.close()


def raised(team: cordon.StubTeam, vehicle_id: int, height_m: float = 6.0) -> None:
    """Let cordon arm a vehicle and take off at its start, to rest there."""
    x, y, _ = team[vehicle_id].truth().position_m
    team[vehicle_id].arm()
    team[vehicle_id].goto(x, y, height_m)
    team.wait_until(lambda: abs(team[vehicle_id].truth().position_m[2] - height_m) < 0.01)


def test_a_step_is_flown_as_the_plant_answers_it_and_the_saved_track_shows_it(tmp_path: Path) -> None:
    mission, begun_s = cordon.load("case2", {"frame.x_bearing_deg": 30.0}), []
    with cordon.stubs(mission, 1, speed=50.0) as team:
        raised(team, 1)

        def begin() -> bool:
            team[1].goto(3.0, 2.0, 6.0)
            begun_s.append(team[1].truth().time_s)
            return True

        team.wait_until(begin)  # the time stands still in a condition
        team.wait_until(lambda: team[1].truth().time_s > begun_s[0] + 12.0)
        state = team[1].truth()
    team.save_tracks(tmp_path / "tracks.csv")
    heads = (tmp_path / "tracks.csv").read_text().partition("\n")[0]
    vehicle, time_s, x, y, z, vx, _, _ = np.loadtxt(tmp_path / "tracks.csv", delimiter=",", skiprows=1).T
    assert heads == "vehicle,time_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s"
    assert {*vehicle} == {1.0}
    after = time_s > begun_s[0]
    plant = mission.vehicle(1).true_plant
    since_s = time_s[after] - begun_s[0] - plant.delay_s
    assert np.abs(x[after] - flown(plant.x, 3.0, since_s)).max() < 0.02
    assert np.abs(y[after] - 4.0 - flown(plant.y, -2.0, since_s)).max() < 0.02
    assert np.abs(np.gradient(x[after], time_s[after]) - vx[after])[1:-1].max() < 0.05
    assert np.abs(z[after] - 6.0).max() < 0.02
    assert state.position_m == pytest.approx((3.0, 2.0, 6.0), abs=0.02)
    assert state.mode == "Offboard"


def test_what_pymavlink_receives_is_the_true_state_in_the_vehicles_own_frame() -> None:
    mission = cordon.load("case2", {"frame.x_bearing_deg": 30.0})
    with cordon.stubs(mission, 2) as team, client(team[1]) as link:
        raised(team, 1)
        # A message each step: at the default rate, the times of all states may lie between those of the messages.
        link.recv_match()  # pymavlink knows whom to send to
        interval = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, STEP_S * 1e6
        command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        link.mav.command_long_send(team[1].system_id, 1, command, 0, *interval, *[0] * 5)
        team[1].goto(8.0, 3.0, 6.0)
        states: list[cordon.TrueState] = []
        received: dict[float, Any] = {}

        def near() -> bool:
            while (message := link.recv_match()) is not None:
                if message.get_type() == "LOCAL_POSITION_NED":
                    received[message.time_boot_ms / 1e3] = message
            states.append(team[1].truth())
            return states[-1].position_m[0] > 6.0

        team.wait_until(near)
        compared = 0
        for state in states:
            if (message := received.get(round(state.time_s, 3))) is not None:
                assert (message.x, message.y, message.z) == pytest.approx(state.ned_m, abs=1e-3)
                assert (message.vx, message.vy, message.vz) == pytest.approx(state.ned_m_s, abs=1e-3)
                compared += 1
        assert compared > 5
        assert link.target_system == team[1].system_id


def test_ardupilot_takes_off_and_flies_on() -> None:
    with cordon.stubs("ardupilot-trio", 1) as team:
        raised(team, 1)
        team[1].goto(5.0, 4.0, 8.0)
        team.wait_until(lambda: dist(team[1].truth().position_m, (5.0, 4.0, 8.0)) < 0.2)
        assert team[1].truth().mode == "Offboard", "GUIDED"


def test_refusals_and_bad_input_name_the_vehicle(subtests: pytest.Subtests) -> None:
    with cordon.stubs("case2", 2) as team:
        with pytest.raises(cordon.VehicleRefusedError, match="vehicle 1: it is not armed"):
            team[1].goto(0.0, 0.0, 6.0)
        with pytest.raises(cordon.InputError, match=r"y_m: .*inf(.|\n)*z_m: .*'6'"):
            team[1].goto(0.0, inf, "6")  # type: ignore[arg-type]
        with pytest.raises(cordon.InputError, match=r"vehicle 3: .*: 1, 2"):
            team.inject(3, "link-cut")
        for fault in ("link-cutt", "latency", "killed-agent", "liar", 3):
            with subtests.test(fault=fault), pytest.raises(cordon.InputError, match=f"fault = {fault!r}: .*link-cut"):
                team.inject(1, fault)  # type: ignore[arg-type]


def test_a_fault_affects_one_vehicle_until_it_is_cleared() -> None:
    with cordon.stubs("case2", 2) as team, client(team[1]) as first, client(team[2]) as second:

        def heard(link: Any) -> bool:
            """Return whether anything arrives in two seconds of simulated time."""
            while link.recv_match() is not None:
                pass
            end_s = team[1].truth().time_s + 2.0
            team.wait_until(lambda: team[1].truth().time_s > end_s)
            return link.recv_match() is not None

        team.inject(2, "link-cut")
        assert heard(first)
        assert not heard(second)
        team.clear(2)
        assert heard(second)
        team.inject(1, "link-cut")
        assert not heard(first)
        team.clear()
        assert heard(first)


async def test_until_waits_in_simulated_time_which_waits_for_other_tasks() -> None:
    async with cordon.stubs("case2", 1, speed=inf) as team:
        began_s = team[1].truth().time_s
        with pytest.raises(
            TimeoutError, match=r"within 100 s: vehicle 1 disarmed, mode Hold, at \(0\.00, 4\.00, 0\.00\)"
        ):
            await team.until(lambda: False, within_s=100.0)
        assert team[1].truth().time_s - began_s == pytest.approx(100.0, abs=2.0)
        times_s: list[float] = []

        async def computing() -> None:
            for _ in range(3):
                before_s = team[1].truth().time_s
                time.sleep(0.2)
                times_s.append(team[1].truth().time_s - before_s)
                await asyncio.sleep(0.05)

        task = asyncio.create_task(computing())
        await team.until(task.done, within_s=1e6)
        assert max(times_s) < 0.08, "a poll, and a step of the stubs"


def test_a_program_of_its_own_joins_the_clock() -> None:
    with cordon.stubs("case2", 1) as team, cordon.LockstepClient(team[1].port, speed=inf) as clock:
        began_s = team[1].truth().time_s
        with clock.held_after(50.0):
            assert team[1].truth().time_s - began_s == pytest.approx(50.0, abs=1.0)


def stream(link: Any) -> None:
    link.mav.set_position_target_local_ned_send(0, 1, 1, 1, 0b1101_1111_1000, 0, 0, -6.0, 0, 0, 0, 0, 0, 0, 0, 0)


def test_the_time_waits_for_a_slow_stream_of_setpoints_and_no_longer_once_it_ends() -> None:
    with cordon.stubs("case2", 1) as team, client(team[1]) as link:
        link.wait_heartbeat()
        with cordon.LockstepClient(team[1].port, speed=inf):
            stream(link)
            time.sleep(0.3)  # by then offboard would no longer be possible
            link.mav.command_long_send(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)
            link.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
            until_now(lambda: team[1].truth().armed, "the command")
            modes, end_s = set(), time.monotonic() + 3.0
            while time.monotonic() < end_s:  # five setpoints a second, by the wall
                stream(link)
                time.sleep(0.2)
                modes.add(team[1].truth().mode)
            assert modes == {"Offboard"}
            stopped_s, before_s = team[1].truth().time_s, -inf
            while stopped_s > before_s:  # until the time waits for the next setpoint, for 3 s, not for the processor
                time.sleep(0.2)
                stopped_s, before_s = team[1].truth().time_s, stopped_s
            returned_s = team.wait_until(lambda: team[1].truth().mode == "Return", within_s=5.0)
        assert returned_s - stopped_s == pytest.approx(1.1 - 0.5, abs=0.2), (
            "the failsafe of PX4, of which half has passed"
        )


def stub_of(process_id: int) -> psutil.Process | None:
    """Return the stubs' process that a program has started."""
    children = psutil.Process(process_id).children()
    return next((each for each in children if "sitl.server.program" in each.cmdline()), None)


def test_at_the_end_no_process_and_no_port_is_left() -> None:
    with cordon.stubs("case2", 1) as team:
        stub, vehicle = stub_of(os.getpid()), team[1]
        assert stub is not None
        assert stub.is_running()
    assert not stub.is_running()
    assert bind_fault(socket.SOCK_DGRAM, "127.0.0.1", vehicle.port) is None
    with pytest.raises(cordon.VehicleRefusedError, match="vehicle 1: its stub has ended"):
        vehicle.truth()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_stubs_end_with_a_program_that_is_killed(number: signal.Signals) -> None:
    program = "import cordon, time\nwith cordon.stubs('case2'):\n    print('runs', flush=True)\n    time.sleep(1e3)\n"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", program], stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "runs\n"
        stub = stub_of(process.pid)
        assert stub is not None
        process.send_signal(number)
        process.wait()
        until_now(lambda: not stub.is_running(), "the end of the stubs")
