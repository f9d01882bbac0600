"""`cordon recover`: a team whose flight was killed comes home by another process, apart, and nobody else is touched.

The vehicles are stubs of this process, on a governed clock, with plants that differ from their profiles.
"""

import asyncio
import json
import os
import shutil
import signal
import sys
from asyncio.subprocess import Process
from collections.abc import Callable
from math import dist
from pathlib import Path

import pytest

from gcs.keys.authority_folder import AuthorityFolder
from sitl.autopilot.modes import NavMode
from tests.support.recoveries import HOME_M, in_mid_ring, kill_whole, recovered, take_off
from tests.support.served_team import FAST, UNLIKE, Team, team_of
from tests.support.terminals import take_terminal, terminal
from tests.support.wire import PATIENCE_S, at_speed, hurried, running, until

pytestmark = pytest.mark.wire

ON_RING = (
    *UNLIKE,
    ("start_m = [35.0, -5.0]", "start_m = [14.0, 0.0]"),
    ("distance_max_m = 12.0", "distance_max_m = 30.0"),
    ("start_m = [0.0, -4.0]", 'start_m = [0.0, -4.0]\nautopilot = "ardupilot"'),
)
"""The same, with its target at hand, at which its vehicles engage at once; one is an ArduCopter."""


async def killed(team: Team, flight: Process) -> None:
    """Kill the supervisor and the flying process, and wait for an autopilot's failsafe."""
    kill_whole(flight.pid)
    await until(lambda: team.vehicles[1].mode is NavMode.HOLD, 30.0, "the autopilots' failsafe", clock=team.clock)


@pytest.mark.long
async def test_a_team_whose_flight_was_killed_in_mid_ring_comes_home(mission_file: Callable[..., str]) -> None:
    """Until its flight is killed, its vehicles are not taken from it."""
    async with team_of(mission_file("case2", *ON_RING)) as team:
        async with in_mid_ring(team) as flight:
            with at_speed(team.clock, 1.0):
                code, said, _ = await recovered(team)
            assert code == 3, said
            assert "still runs" in said
            assert "cordon command" in said
            assert all(each.mode is NavMode.OFFBOARD for each in team.vehicles.values())
            await killed(team, flight)
        assert team.aloft == {1, 2, 3}
        assert min(map(team.off_start_m, (1, 2, 3))) > 2.0, "they are on the ring"
        began_s = team.clock.now_s()
        async with team.watched():
            code, said, _ = await recovered(team)
        took_s = team.clock.now_s() - began_s
        distances = f"least distance {team.least_m:.2f} m, at like heights {team.least_level_m:.2f} m"
        print(f"MEASURED ring: {distances}, {took_s:.0f} s from the command to the end")
        assert code == 0, said
        assert not team.aloft
        assert max(map(team.off_start_m, (1, 2, 3))) < HOME_M
        assert team.least_level_m >= team.mission.safety.separation_m


def setpoints(team: Team) -> dict[int, int]:
    """Return how many setpoints each vehicle has received."""
    return {i: stub.setpoints for i, stub in team.stubs.stubs.items()}


async def test_a_pilot_keeps_his_vehicle_and_one_that_fell_is_reported(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pilot hovers on the way home of the one that is brought home, at the height at which it flies."""
    monkeypatch.setattr("sitl.autopilot.guidance.NEEDS_STICKS", frozenset())  # its pilot holds it where it is
    path, places_m = mission_file("case2", *UNLIKE), {1: (10.0, -3.4), 2: (60.0, 20.0), 3: (20.0, -4.0)}
    async with team_of(path, starts_m=places_m) as team:
        await take_off(team, {1: 15.5, 3: 8.0})
        team.vehicles[1]._intention.mode = NavMode.POSITION
        place_m = team.place_m(1)
        began_s = team.clock.now_s()
        async with team.watched():
            code, said, result = await recovered(team)
            took_s = team.clock.now_s() - began_s
        print(f"MEASURED pilot: least distance at like heights {team.least_level_m:.2f} m")
        assert code == 4, said
        assert team.aloft == {1}
        assert team.vehicles[1].mode is NavMode.POSITION
        assert dist(team.place_m(1), place_m) < 0.3
        assert setpoints(team)[1] == setpoints(team)[2] == 0
        assert not team.vehicles[3].armed
        assert team.off_start_m(3) < HOME_M
        assert team.least_level_m >= team.mission.safety.separation_m
        found = {each["id"]: each for each in result["vehicles"]}
        assert {i: (each["treatment"], each["how"]) for i, each in found.items()} == {
            1: ("leave to its pilot", "pilot"),
            2: ("leave alone", None),
            3: ("bring home", "landed"),
        }
        assert found[3]["from_start_m"] == pytest.approx(20.0, abs=0.5)
        assert found[3]["landed_from_start_m"] == pytest.approx(team.off_start_m(3), abs=0.2)
        assert 10.0 < found[3]["landed_at_s"] <= result["duration_s"] < took_s
        assert result["distance_min_m"] == pytest.approx(team.least_m, abs=0.3)
        assert result["ended"]["vehicles"] == [1]
    words = " ".join(said.split())
    assert "warning vehicle 1 it is in the air in mode other" in words
    assert "--take-from-pilot 1" in words
    assert "warning vehicle 2 it is disarmed, 63.2 m from its start" in words
    assert "Handed over, not landed by cordon: vehicle 1" in words


async def test_a_vehicle_is_taken_from_its_pilot_at_the_word_and_a_silent_one_is_left(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The log of it is replayed bit for bit."""
    monkeypatch.setattr("sitl.autopilot.guidance.NEEDS_STICKS", frozenset())
    path, places_m = mission_file("case2", *UNLIKE), {1: (10.0, 6.0), 2: (20.0, 0.0)}
    async with team_of(path, starts_m=places_m) as team:
        await take_off(team, {1: 8.0, 2: 8.0})
        team.vehicles[2]._intention.mode = NavMode.POSITION
        team.stubs.stubs[3].faults.link_cut = True
        code, said, _ = await recovered(team, "--take-from-pilot", "2", "--land", log=str(tmp_path / "home.mcap"))
        assert code == 0, said
        assert not team.aloft
        assert {i: dist(team.place_m(i)[:2], place_m) < 1.0 for i, place_m in places_m.items()} == {1: True, 2: True}
    words = " ".join(said.split())
    assert "warning vehicle 3 it is not received: no heartbeat" in words
    assert "Landed and disarmed" in words
    async with running("replay", str(tmp_path / "home.mcap")) as replay:
        out, err = await replay.communicate()
        assert replay.returncode == 0, err.decode()
        assert b"compared bit for bit" in out + err


async def test_nothing_is_sent_while_one_must_not_be_taken_and_the_others_come_home_without_it(
    mission_file: Callable[..., str], subtests: pytest.Subtests
) -> None:
    """One is armed on the ground, and a vehicle with another system id is at the url of one of the team's."""
    path, places_m = mission_file("case2", *UNLIKE), {1: (15.0, 3.0)}
    async with team_of(path, starts_m=places_m, system_ids={3: 7}) as team:
        assert team.vehicles[2].parameters.set("COM_DISARM_PRFLT", 600.0)
        await take_off(team, {1: 8.0, 7: 9.0})
        team.vehicles[2].arm()
        modes = {i: each.mode for i, each in team.vehicles.items()}
        with subtests.test("refused, and nothing was sent"):
            code, said, result = await recovered(team)
            words = " ".join(said.split())
            assert code == 3, said
            assert [result[key] for key in ("ended", "duration_s", "distance_min_m")] == [None] * 3
            assert [each["grade"] for each in result["vehicles"]] == ["pass", "refuse", "refuse"]
            assert "refuse vehicle 2 it is armed on the ground" in words
            assert "carries system id 7, not 3" in words
            assert "nothing was sent to the vehicles: vehicles 2 and 3 must not be taken" in words
            assert {i: each.mode for i, each in team.vehicles.items()} == modes
            assert set(setpoints(team).values()) == {0}
        with subtests.test("the other one comes home without them"):
            code, said, _ = await recovered(team, "--leave", "2", "--leave", "3")
            assert code == 0, said
            assert team.aloft == {7}
            assert team.off_start_m(1) < HOME_M
            assert team.vehicles[2].armed
            assert setpoints(team)[2] == setpoints(team)[7] == 0


async def test_two_interrupts_land_the_vehicles_where_they_are(mission_file: Callable[..., str]) -> None:
    path, places_m = mission_file("case2", *UNLIKE), {1: (25.0, 6.0), 2: (25.0, 0.0), 3: (25.0, -6.0)}
    async with team_of(path, starts_m=places_m) as team:
        heights_m = {1: 8.0, 2: 11.0, 3: 9.5}
        await take_off(team, heights_m)
        team.clock.set_speed(1.0)
        async with asyncio.timeout(PATIENCE_S), running("recover", path, "--yes", "--no-log") as process:
            flown = team.vehicles.values()
            await until(lambda: all(each.mode is NavMode.OFFBOARD for each in flown), waiting_for="offboard")
            process.send_signal(signal.SIGINT)
            await team.clock.sleep(0.5)
            assert all(each.mode is NavMode.OFFBOARD for each in flown), "they hold first"
            assert all(abs(team.place_m(i)[2] - height_m) < 0.3 for i, height_m in heights_m.items())
            process.send_signal(signal.SIGINT)
            team.clock.set_speed(FAST)
            _, err = await process.communicate()
        assert process.returncode == 4, err.decode()
        assert not team.aloft
        assert {i: dist(team.place_m(i)[:2], place_m) < 1.0 for i, place_m in places_m.items()} == dict.fromkeys(
            places_m, True
        )


async def test_another_computer_with_the_teams_keys_brings_them_home_once_no_flight_runs(
    mission_file: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other computer is a process with files, keys and a runtime directory of its own."""
    first = "[target]\n"
    secured = mission_file("case2", *UNLIKE, (first, f'[network]\nsecurity = {{ keys = "keys" }}\n\n{first}'))
    keys = AuthorityFolder(tmp_path / "keys")
    keys.init(10.0)
    for each in "123":
        keys.issue("vehicle", each, 1.0)
    keys.issue("operator", "anna", 1.0)
    laptop = tmp_path / "laptop"
    (laptop / "run").mkdir(parents=True, mode=0o700)
    shutil.copytree(keys.path, laptop / "keys")
    path = str(shutil.copy(secured, laptop))
    async with team_of(secured) as team:
        async with in_mid_ring(team, 30.0) as flight:
            monkeypatch.setenv("XDG_RUNTIME_DIR", str(laptop / "run"))
            with at_speed(team.clock, 1.0):
                code, said, _ = await recovered(team, path=path)
            assert code == 3, said
            assert "still runs: it flies vehicles 1, 2 and 3, as its bus shows" in said
            assert all(each.mode is NavMode.OFFBOARD for each in team.vehicles.values())
            await killed(team, flight)
        assert min(map(team.off_start_m, (1, 2, 3))) > 5.0
        async with team.watched():
            code, said, _ = await recovered(team, path=path)
        assert code == 0, said
        assert max(map(team.off_start_m, (1, 2, 3))) < HOME_M
        assert team.least_level_m >= team.mission.safety.separation_m


async def test_on_a_terminal_it_asks_once_and_does_nothing_without_a_yes(mission_file: Callable[..., str]) -> None:
    path, places_m = mission_file("case2", *UNLIKE), {1: (15.0, 3.0)}
    async with team_of(path, starts_m=places_m) as team:
        await take_off(team, {1: 8.0})
        for answer, code in ((b"n\n", 3), (b"\x03", 3), (b"y\n", 0)):
            with terminal() as (here, there, shown):
                process = await asyncio.create_subprocess_exec(
                    *(sys.executable, "-m", "gcs", "recover", path, "--no-log", "--land"),
                    stdin=there,
                    stdout=there,
                    stderr=there,
                    env={**os.environ, "TERM": "xterm", "COLUMNS": "200"},
                    start_new_session=True,
                    preexec_fn=take_terminal,
                )
                await until(lambda: b"[y/N]" in shown, waiting_for="the question")
                assert team.vehicles[1].mode is NavMode.HOLD
                os.write(here, answer)
                async with asyncio.timeout(PATIENCE_S):
                    assert await process.wait() == code, shown.decode()
            assert "Take vehicle 1 of case2, hold, and land where they are?" in " ".join(shown.decode().split())
            assert (setpoints(team)[1] > 0) == (code == 0)
        assert not team.vehicles[1].armed
        assert dist(team.place_m(1)[:2], places_m[1]) < 1.0


@pytest.mark.long
async def test_a_team_whose_flight_was_killed_flies_on_with_its_mission(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    """Its vehicles are taken on the ring; they hold together, and are on the ring again when the mission ends."""
    log = tmp_path / "on.mcap"
    async with team_of(mission_file("case2", *ON_RING)) as team:
        async with in_mid_ring(team) as flight:
            await killed(team, flight)
        options = ("--adopt", "--yes", "--duration", "60", "--json", "--log", str(log))
        async with team.watched(), asyncio.timeout(PATIENCE_S), running("fly", team.path, *options) as flight:
            with hurried(team.clock):
                out, err = await flight.communicate()
        assert flight.returncode is not None, err.decode()
        result = json.loads(out)
        print(f"MEASURED on: least distance {team.least_m:.2f} m, {result['ring']}")
        assert result["ended"]["how"] == "landed", err.decode()
        assert result["verdicts"]["C1"]
        assert result["verdicts"]["C3"]
        assert result["departures"] == []
        assert not team.aloft
        assert team.least_level_m >= team.mission.safety.separation_m
    async with running("replay", str(log)) as replay:
        out, err = await replay.communicate()
        assert replay.returncode == 0, err.decode() + out.decode()
