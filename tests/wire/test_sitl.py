"""The stub on real sockets: flown by MAVSDK as a PX4 would be, and its process kept on a lead."""

import asyncio
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import radians
from typing import Any

import numpy as np
import pytest
from mavsdk.mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.geofence import FenceType, Geofence, GeofenceData, Point, Polygon
from mavsdk.plugins.info import Info
from mavsdk.plugins.mission_raw import MissionRaw
from mavsdk.plugins.offboard import Offboard, PositionNedYaw
from mavsdk.plugins.telemetry import Telemetry
from scipy.linalg import expm

from agents.shell.clock import WallClock
from cordon.lockstep import LockstepClient
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Vector
from sitl.mavlink.reports import EstimatorNoise
from sitl.server import endpoint
from sitl.server.governed_clock import GovernedClock
from sitl.server.process import StubProcess, StubReady, run_in_process
from sitl.server.server import StubConfig, StubRecord, serve
from sitl.server.shared_clock import ClockName, Rank, new_clock
from tests.support.forger import Forger
from tests.support.wire import PATIENCE_S, free_port, served_by, stub_clock, stub_process, until

pytestmark = pytest.mark.wire

SPEED = 5.0
PLANT = Plant(PlantAxis(1.51, 1.90), PlantAxis(1.87, 2.40), delay_s=0.2)
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=radians(30.0))


def config(vehicle_id: int = 1, **changes: Any) -> StubConfig:
    fields: dict[str, Any] = {"vehicle_id": vehicle_id, "client_port": free_port(), "plant": PLANT, "frame": FRAME}
    return StubConfig(**(fields | changes))


def ports(configs: list[StubConfig]) -> list[int]:
    return [config.client_port for config in configs]


@dataclass
class Vehicle:
    """The MAVSDK plugins of one vehicle, and the clock of the stubs."""

    clock: LockstepClient
    system: Any
    telemetry: Any
    action: Any
    offboard: Any

    def mode(self) -> str:
        return str(self.telemetry.flight_mode().name)

    def ned(self) -> tuple[float, float, float]:
        position = self.telemetry.position_velocity_ned().position
        return position.north_m, position.east_m, position.down_m

    def go(self, north: float, east: float, down: float) -> None:
        self.offboard.set_position_ned(PositionNedYaw(north, east, down, 0.0))

    def take_off(self, height_m: float) -> None:
        self.launch(height_m)
        self.await_hover(height_m)

    def launch(self, height_m: float) -> None:
        self.action.set_takeoff_altitude(height_m)
        self.action.arm()
        self.action.takeoff()

    def await_hover(self, height_m: float) -> None:
        self.clock.until(lambda: abs(self.ned()[2] + height_m) < 0.05, "hovering")
        self.clock.until(lambda: self.mode() == "HOLD", "hold after take-off")


class Station:
    """One MAVSDK, connected to stubs, on their clock."""

    def __init__(self, configs: list[StubConfig]) -> None:
        self._clock = LockstepClient(*ports(configs))
        self.mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        for each in configs:
            assert self.mavsdk.add_any_connection(f"udpin://127.0.0.1:{each.client_port}").value == 0
        self._clock.until(lambda: self.mavsdk.system_count() == len(configs), "every vehicle found")
        systems = sorted(self.mavsdk.get_systems(), key=lambda system: system.get_system_id())
        self.vehicles = [self._vehicle(system) for system in systems]
        for vehicle in self.vehicles:
            self._clock.until(lambda vehicle=vehicle: vehicle.telemetry.health_all_ok(), "health all ok")  # type: ignore[misc]

    def _vehicle(self, system: Any) -> Vehicle:
        return Vehicle(self._clock, system, Telemetry(system), Action(system), Offboard(system))

    def close(self) -> None:
        self.mavsdk.destroy()
        self._clock.close()


def every_vehicle_is_found_healthy_where_it_stands(team: list[Vehicle]) -> None:
    assert [vehicle.system.get_system_id() for vehicle in team] == [1, 2, 3]
    for number, vehicle in enumerate(team, 1):
        assert vehicle.system.is_connected()
        health = vehicle.telemetry.health()
        assert health.is_armable
        assert health.is_local_position_ok
        assert health.is_global_position_ok
        assert health.is_home_position_ok
        truth = FRAME.geodetic_from_mission((4.0 * number, 1.0, 0.0))
        home, place = vehicle.telemetry.home(), vehicle.telemetry.position()
        for told in (home, place):
            assert told.latitude_deg == pytest.approx(truth.latitude_deg, abs=1e-7)
            assert told.longitude_deg == pytest.approx(truth.longitude_deg, abs=1e-7)
            assert told.absolute_altitude_m == pytest.approx(488.0, abs=0.01)
        origin = vehicle.telemetry.get_gps_global_origin()
        at = FRAME.mission_from_geodetic(Geodetic(origin.latitude_deg, origin.longitude_deg, origin.altitude_m))
        assert at == pytest.approx((4.0 * number + 0.3, 0.8, 0.0), abs=0.02)
        expected = FRAME.ned_from_mission((-0.3, 0.2, 0.0))
        assert vehicle.ned() == pytest.approx(expected, abs=1e-4)


def battery_gps_and_version_are_told(team: list[Vehicle]) -> None:
    battery = team[0].telemetry.battery()
    assert 90.0 < battery.remaining_percent <= 100.0
    assert 14.0 < battery.voltage_v < 17.0
    assert team[0].telemetry.gps_info().fix_type.name == "FIX_3D"
    info = Info(team[0].system)
    version = info.get_version()
    assert (version.flight_sw_major, version.flight_sw_minor) == (1, 17)
    assert info.get_identification().legacy_uid != Info(team[1].system).get_identification().legacy_uid


def fences_and_missions_are_uploaded_and_cleared(team: list[Vehicle]) -> None:
    geofence = Geofence(team[0].system)
    corners = [Point(47.397 + 0.001 * n, 8.545 + 0.001 * (n % 2)) for n in range(4)]
    geofence.upload_geofence(GeofenceData([Polygon(corners, FenceType.INCLUSION)], []))
    missions = MissionRaw(team[0].system)
    assert [item.x for item in missions.download_geofence()] == [round(c.latitude_deg * 1e7) for c in corners]
    geofence.clear_geofence()
    missions.clear_mission()
    assert list(missions.download_geofence()) == []


def three_vehicles_fly_at_once(team: list[Vehicle]) -> None:
    states: list[str] = []
    team[0].telemetry.subscribe_landed_state(lambda state, _: states.append(state.name))
    for vehicle in team:
        vehicle.launch(4.0)
    for vehicle in team:
        vehicle.await_hover(4.0)
    for vehicle in team:
        vehicle.go(2.0, -2.0, -4.0)
        vehicle.offboard.start()
    for vehicle in team:
        vehicle.clock.until(lambda vehicle=vehicle: np.allclose(vehicle.ned(), (2.0, -2.0, -4.0), atol=0.05), "there")  # type: ignore[misc]
    for vehicle in team:
        vehicle.action.hold()
        vehicle.action.land()
    for vehicle in team:
        vehicle.clock.until(lambda vehicle=vehicle: not vehicle.telemetry.armed(), "disarmed")  # type: ignore[misc]
    assert list(dict.fromkeys(states)) == ["ON_GROUND", "TAKING_OFF", "IN_AIR", "LANDING"]


@pytest.mark.long
def test_mavsdk_flies_a_team(subtests: pytest.Subtests) -> None:
    configs = [
        config(number, start_position_m=(4.0 * number, 1.0), origin_offset_m=(0.3, -0.2, 0.0)) for number in (1, 2, 3)
    ]
    with new_clock(SPEED, ports(configs)) as name, stub_process(configs, name) as stubs:
        station = Station(configs)
        for check in (
            every_vehicle_is_found_healthy_where_it_stands,
            battery_gps_and_version_are_told,
            fences_and_missions_are_uploaded_and_cleared,
            three_vehicles_fly_at_once,
        ):
            with subtests.test(check.__name__):
                check(station.vehicles)
        station.close()
        record = stubs.stop()
    assert record.slipped_s == 0.0
    assert [track.vehicle_id for track in record.tracks] == [1, 2, 3]
    assert np.diff(record.tracks[0].time_s) == pytest.approx(0.1, abs=1e-6)


def flown(axis: PlantAxis, setpoint: float, times_s: Vector) -> Vector:
    """Return the positions after a step from rest, by a matrix exponential that shares no code with the stub."""
    matrix = np.array([[0.0, 1.0, 0.0], [-axis.a0_per_s2, -axis.a1_per_s, axis.a0_per_s2 * setpoint], [0.0, 0.0, 0.0]])
    return np.array([(expm(matrix * max(t, 0.0)) @ [0.0, 0.0, 1.0])[0] for t in times_s])


def test_a_commanded_step_is_flown_as_the_plant_answers_it() -> None:
    wind_m_s2 = (0.3, -0.2)
    noise = EstimatorNoise(position_m=0.01)
    stub = config(9, start_position_m=(3.0, 2.0), wind_m_s2=wind_m_s2, noise=noise, battery_fraction=0.6)
    with new_clock(SPEED, ports([stub])) as name, stub_process([stub], name) as process:
        station = Station([stub])
        (vehicle,) = station.vehicles
        clock = vehicle.clock
        standing = vehicle.ned()
        clock.until(lambda: vehicle.ned() != standing, "noise on the telemetry")
        vehicle.take_off(3.0)
        vehicle.go(0.0, 0.0, -3.0)
        vehicle.offboard.start()
        clock.until(lambda: vehicle.mode() == "OFFBOARD", "offboard")
        clock.sleep(12.5)  # until it rests, leaning into the wind
        leaning_m = (wind_m_s2[0] / PLANT.x.a0_per_s2, wind_m_s2[1] / PLANT.y.a0_per_s2)
        x, y, z = FRAME.ned_from_mission((4.0, -2.0, 3.0))
        with clock.held_after():
            sent_s = clock.now_s
            clock.sends_setpoint(9, x, y, z)
        time.sleep(0.3)  # on its way the time stands still
        vehicle.go(x, y, z)
        clock.sleep(7.5)
        arrived = FRAME.mission_from_ned(vehicle.ned())
        assert 50.0 < vehicle.telemetry.battery().remaining_percent <= 60.0
        station.close()
        (track,) = process.stop().tracks
    window = (track.time_s > sent_s - 1.0) & (track.time_s < sent_s + 7.0)
    since_s = track.time_s[window] - sent_s - PLANT.delay_s
    flown_m = track.position_m[window, :2] - (3.0, 2.0) - np.array(leaning_m)

    answers = np.transpose([flown(PLANT.x, 4.0, since_s), flown(PLANT.y, -2.0, since_s)])
    assert np.abs(flown_m - answers).max() < 0.03
    assert arrived == pytest.approx((4.0 + leaning_m[0], -2.0 + leaning_m[1], 3.0), abs=0.06)


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
