"""Flights that a program operates: what it sees, what it commands, and how they end whatever becomes of the program."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from math import dist
from pathlib import Path

import numpy as np
import psutil
import pytest

import cordon
from agents.flight_end import FlightEnd
from cordon.live_flight import on_own_ports
from tests.support.wire import PATIENCE_S, until_now

pytestmark = pytest.mark.wire

NEAR = {"target.start_m": [10.0, 0.0], "target.velocity_m_s": [0.0, 0.0], "encirclement.radius_m": 8.0}


def ring_mission() -> cordon.Mission:
    """Return a mission of three vehicles that begin near their ring, with plants unlike their profiles'."""
    return on_own_ports(cordon.load("case2-field", NEAR))


def flight_of(mission: cordon.Mission, folder: Path, duration_s: float = 90.0, **named: object) -> cordon.LiveFlight:
    settings = {"speed": 20.0, "log": folder / "flight.mcap", **named}
    return cordon.fly(mission, stubs=True, duration_s=duration_s, **settings)  # type: ignore[arg-type]


async def test_a_program_sees_and_commands_a_flight_to_its_end(tmp_path: Path) -> None:
    async with flight_of(ring_mission(), tmp_path) as flight:
        await flight.until("encircle", within_s=60.0)
        held_s = flight.time_s
        held = await flight.command("hold", 2)
        await flight.until(lambda: flight.vehicles[2].tactic == "hold", within_s=5.0)
        resumed = await flight.command("resume", 2)
        await flight.until("encircle", within_s=30.0)
        widened = await flight.command("ring", radius=np.float64(11.0))
        with pytest.raises(cordon.InputError, match="speed_max_m_s"):
            await flight.command("ring", radius=80.0)
        result = await flight.complete()
        seen = [event async for event in flight.events()]
    assert {i: answer and answer.did for i, answer in held.items()} == {2: "holds"}
    assert [answer is not None and answer.obeyed for answer in (*resumed.values(), *widened.values())] == 4 * [True]
    flown = cordon.read(flight.log or "")
    assert result.untimed().to_dict() == flown.metrics.untimed().to_dict()
    assert {event.ring.radius_m for event in seen if event.ring is not None} == {11.0}
    at_end_m = [dist(track.position_m[-10], (10.0, 0.0)) for track in flown.record.vehicles]  # by truth
    assert at_end_m == pytest.approx(3 * [11.0], abs=0.4)
    logged = [(event.vehicle, event.text) for event in flown.record.events if event.kind in ("tactic", "command")]
    assert sorted(logged) == sorted((e.vehicle, e.text) for e in seen if e.kind in ("tactic", "command"))
    (holds,) = (event for event in seen if event.tactic is not None and event.tactic.after == "hold")
    assert 0.0 <= holds.time_s - (held_s or 0.0) < 5.0


async def test_leaving_the_block_lands_the_vehicles(tmp_path: Path) -> None:
    async with flight_of(ring_mission(), tmp_path, 600.0) as flight:
        await flight.until("encircle", within_s=60.0)
    assert flight.is_over
    with pytest.raises(cordon.VehicleRefusedError, match="this flight was begun before"):
        await flight.__aenter__()
    assert {vehicle.ended for vehicle in flight.vehicles.values()} == {"disarmed"}
    assert flight.result.ended is not None
    assert flight.result.ended.how is FlightEnd.OPERATOR


async def test_what_a_program_raises_lands_the_vehicles_and_is_raised(tmp_path: Path) -> None:
    flight = flight_of(ring_mission(), tmp_path, 600.0)

    async def failing() -> None:
        async with flight:
            await flight.until("encircle", within_s=60.0)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await failing()
    assert {vehicle.ended for vehicle in flight.vehicles.values()} == {"disarmed"}


async def test_a_wait_ends_with_the_states_where_it_is_in_vain(tmp_path: Path) -> None:
    async with flight_of(ring_mission(), tmp_path, 30.0) as flight:
        with pytest.raises(TimeoutError, match="vehicle 3: "):
            await flight.until("return and land", within_s=3.0)
        with pytest.raises(cordon.VehicleRefusedError, match="the flight ended before 'aside': vehicle 1: disarmed"):
            await flight.until("aside")
        with pytest.raises(cordon.VehicleRefusedError, match="the flight ended before hold"):
            await flight.command("hold")


async def test_vehicles_that_are_not_there_refuse_the_flight(tmp_path: Path) -> None:
    flight = cordon.fly(ring_mission(), wait_s=0.0, log=tmp_path / "flight.mcap")
    with pytest.raises(cordon.VehicleRefusedError, match="vehicle 1: "):
        async with flight:
            pass
    with pytest.raises(cordon.VehicleRefusedError):
        _ = flight.result


async def test_a_flight_whose_process_is_killed_is_lost(tmp_path: Path) -> None:
    before = processes()

    async def killed() -> None:
        async with flight_of(ring_mission(), tmp_path, 600.0) as flight:
            await flight.until("encircle", within_s=60.0)
            _, flying = processes(after=before)
            flying.kill()
            await flight.until("hold")

    with pytest.raises(cordon.VehicleRefusedError, match="ended by signal 9 before its vehicles had landed"):
        await killed()


async def test_a_flight_whose_process_and_supervisor_are_killed_is_lost(tmp_path: Path) -> None:
    flight, before = flight_of(ring_mission(), tmp_path, 600.0), processes()

    async def killed() -> None:
        async with flight:
            await flight.until("encircle", within_s=60.0)
            for each in processes(after=before):
                each.kill()
            await flight.complete()

    with pytest.raises(
        cordon.VehicleRefusedError, match="the flying process and its supervisor ended in flight"
    ) as lost:
        await killed()
    assert "cordon recover" in lost.value.next_step


async def test_a_process_that_is_killed_before_take_off_begins_no_flight(tmp_path: Path) -> None:
    before = processes()

    async def kill() -> None:
        while len(processes(after=before)) < 2:
            await asyncio.sleep(0.01)
        processes(after=before)[-1].kill()

    killing = asyncio.create_task(kill())
    with pytest.raises(cordon.VehicleRefusedError, match="ended before the vehicles took off"):
        async with flight_of(ring_mission(), tmp_path):
            pass
    await killing


def processes(after: Collection[psutil.Process] = ()) -> list[psutil.Process]:
    """Return the supervisors and flying processes of this program's flights that run, but those of `after`.

    A flight is over for its program before its processes have ended.
    """
    children = psutil.Process().children(recursive=True)
    return [each for each in children if "gcs.flight.live_program" in _arguments(each) and each not in after]


PROGRAM = """
import asyncio, os, sys, time
import cordon
from cordon.live_flight import on_own_ports

async def main():
    mission = on_own_ports(cordon.load("case2-field", {near}))
    async with cordon.fly(mission, stubs=True, speed=20.0, duration_s=600.0, log=sys.argv[1]) as flight:
        await flight.until("encircle", within_s=60.0)
        {in_flight}
        await flight.until("hold")

asyncio.run(main())
"""
READY = "print('ready', flush=True)"


@contextmanager
def program(folder: Path, in_flight: str = READY) -> Iterator["subprocess.Popen[str]"]:
    """Run a program that waits in flight, from the time that it is ready."""
    command = [sys.executable, "-c", PROGRAM.format(near=NEAR, in_flight=in_flight), str(folder / "flight.mcap")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n", process.communicate()
        yield process


def flown(folder: Path) -> cordon.Flight:
    """Return the flight once its log is complete, which its process does last."""
    log = folder / "flight.mcap"
    until_now(lambda: not _open_by_any(log), "the complete log")
    return cordon.read(log)


def _arguments(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def _open_by_any(path: Path) -> bool:
    for process in psutil.process_iter():
        try:
            if any(Path(each.path) == path for each in process.open_files()):
                return True
        except psutil.Error:
            continue
    return False


def returning_s(flight: cordon.Flight) -> list[float]:
    """Return how long each vehicle flew home before it landed, after its hold."""
    began_s = {each.vehicle: each.time_s for each in flight.record.events if each.text.startswith("hold -> return")}
    return [
        each.time_s - began_s[each.vehicle]
        for each in flight.record.events
        if each.text.startswith("return and land -> land")
    ]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_the_vehicles_of_a_program_that_is_killed_land(how: signal.Signals, tmp_path: Path) -> None:
    with program(tmp_path) as process:
        process.send_signal(how)
        process.wait(PATIENCE_S)
    flight = flown(tmp_path)
    assert {(ending.how, ending.reason) for ending in flight.record.endings} == {
        (FlightEnd.WATCHDOG, "the program that operated the flight had ended")
    }
    assert flight.record.time_s[-1] < 300.0


def test_a_copy_of_the_program_that_outlives_it_does_not_keep_the_vehicles_in_the_air(tmp_path: Path) -> None:
    fork = "if os.fork() == 0: time.sleep(600.0)\n        " + READY
    with program(tmp_path, fork) as process:
        (copy,) = (each for each in psutil.Process(process.pid).children() if each.cmdline()[1] == "-c")
        process.kill()
        try:
            assert {ending.how for ending in flown(tmp_path).record.endings} == {FlightEnd.WATCHDOG}
        finally:
            copy.kill()


def test_ctrl_c_lets_the_vehicles_hold_and_land_before_the_program_ends(tmp_path: Path) -> None:
    with program(tmp_path) as process:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130 or "KeyboardInterrupt" in errors
    flight = flown(tmp_path)
    assert {ending.how for ending in flight.record.endings} == {FlightEnd.OPERATOR}
    assert min(returning_s(flight)) > 1.0


def test_a_second_ctrl_c_lands_them_at_once(tmp_path: Path) -> None:
    with program(tmp_path) as process:
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE_S)
    assert returning_s(flown(tmp_path)) == pytest.approx([0.0, 0.0, 0.0], abs=0.2)


def test_a_program_that_computes_keeps_no_vehicle_waiting(tmp_path: Path) -> None:
    with program(
        tmp_path, "end = time.time() + 3.0\n        while time.time() < end: pass\n        " + READY
    ) as process:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    assert flown(tmp_path).metrics.loop.missed == 0


@pytest.mark.parametrize(
    ("named", "fault"),
    [
        ({"stubs": (1, 9)}, "stubs: give True, or ids of the mission's vehicles, 1, 2, 3 (given: (1, 9))"),
        ({"speed": 0.0}, "speed: it must be a number from 0.1 to inf (given: 0.0)"),
        ({"speed": float("inf")}, "speed max: it needs stubs, or `cordon sitl --lockstep`"),
        ({"duration_s": "60"}, "duration_s: it must be a number from 0.001 to 1e+06 (given: '60')"),
        ({"wait_s": -1.0}, "wait_s: it must be a number from 0 to 3600 (given: -1.0)"),
        ({"faults": ["link-cut@10"]}, "faults: it needs stubs: faults are injected into stub vehicles only"),
        (
            {"faults": "link-cut@10"},
            "faults: give a list of texts, such as [\"link-cut@120:2\"] (given: 'link-cut@10')",
        ),
        ({"faults": None}, "faults: give a list of texts"),
        ({"stubs": [[1]]}, "stubs: give True, or ids of the mission's vehicles"),
        ({"log": "/nowhere/x.mcap"}, "log: '/nowhere/x.mcap': there is no folder '/nowhere'"),
        ({"log": 1}, "log: give the path of a new file (given: 1)"),
        ({"wait_s": None}, "wait_s: it must be a number from 0 to 3600 (given: None)"),
        ({"speed": 10**400}, "speed: it must be a number from 0.1 to inf (given: 1000"),
        ({"stubs": True, "faults": ["link-cut"]}, "faults: 'link-cut' is not NAME@SECONDS or NAME@SECONDS:VEHICLE"),
    ],
)
def test_bad_arguments_are_named(named: dict[str, object], fault: str) -> None:
    with pytest.raises(cordon.InputError) as raised:
        cordon.fly("case2", **named)  # type: ignore[arg-type]
    assert raised.value.faults[0].startswith(fault)


def test_faults_may_come_from_a_generator() -> None:
    with pytest.raises(cordon.InputError, match="nothing"):
        cordon.fly("case2", stubs=True, faults=(each for each in ["nothing@5"]))  # type: ignore[arg-type]


def test_a_log_that_exists_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "flight.mcap").write_text("precious")
    with pytest.raises(cordon.InputError, match=r"log: .*exists already"):
        flight_of(ring_mission(), tmp_path)
    assert (tmp_path / "flight.mcap").read_text() == "precious"


async def _never() -> bool:
    return False


async def test_bad_orders_are_named_and_change_nothing() -> None:
    flight = cordon.fly("case2", stubs=True)
    for wrong, fault in (
        (flight.until("encirlce"), "condition: there is no tactic 'encirlce'"),
        (flight.until("encircle", vehicles=4), "vehicles: it must be from 1 to 3"),
        (flight.until("encircle", within_s=-1.0), "within_s: it must be a number"),
        (flight.until(_never), "condition: <function _never"),  # type: ignore[arg-type]
        (flight.command("fly"), "verb: there is no 'fly'"),
        (flight.command("hold", 7), "vehicle: the mission has no vehicle 7"),
        (flight.command("ring"), "ring: give radius=METRES"),
        (flight.command("formation", "star"), "shape: there is no 'star'"),
    ):
        with pytest.raises(cordon.InputError, match=fault):
            await wrong
    for early in (flight.command("hold"), flight.complete(), anext(flight.events())):
        with pytest.raises(cordon.VehicleRefusedError, match="the flight has not begun"):
            await early


def test_environment_names_no_program() -> None:
    assert "CORDON_PROGRAM" not in os.environ


async def test_two_flights_of_a_program_at_once(tmp_path: Path) -> None:
    async def ended(name: str) -> set[str]:
        (tmp_path / name).mkdir()
        mission = ring_mission().replace(network={"team": name})
        async with flight_of(mission, tmp_path / name, 20.0) as flight:
            await flight.complete()
        return {vehicle.ended for vehicle in flight.vehicles.values()}

    first, second = await asyncio.gather(ended("first"), ended("second"))
    assert first == second == {"disarmed"}
