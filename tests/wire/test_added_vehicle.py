"""A vehicle that is not in the mission file joins a team in flight: `cordon rejoin --add`.

The vehicles are stubs of this process, on a governed clock, with plants that differ from their profiles.
"""

import asyncio
import json
import os
import re
import shlex
import signal
from asyncio.subprocess import Process
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

from gcs.flightlog.reader import read_log
from gcs.flightlog.records import VehicleEnd
from gcs.report.evidence.reading import read_flight
from sitl.autopilot.modes import NavMode
from tests.support.recoveries import HOME_M, kill_whole, recovered, take_off
from tests.support.served_team import UNLIKE, Team, team_of
from tests.support.swaps import NEAR_TARGET, SETTLING_S, RingTruth, Tracks
from tests.support.wire import PATIENCE_S, at_speed, hurried, running, until

pytestmark = pytest.mark.wire
THREE, FOUR = (1, 2, 3), (1, 2, 3, 4)
FOURTH = """

[[vehicles]]
id = 4
url = "udpin://127.0.0.1:14543"
endpoint = "tcp/127.0.0.1:7464"
start_m = [0.0, -8.0]
true_scale = { a0 = 0.9, a1 = 1.12 }
reserve = true
"""
"""What the test serves, and the team's mission file does not have."""
_LAST = "start_m = [0.0, -4.0]\n"
WITH_FOURTH = (_LAST, f"{_LAST}{FOURTH}")
LASTS_S = 260.0
"""The time of the mission passes while programs start: half of it is left for them on a busy computer."""
LASTING = ("duration_s = 600.0", f"duration_s = {LASTS_S}")


def of_three(path_of_four: str) -> str:
    """Write the mission of the team, without the vehicle that joins it; return its path."""
    text = Path(path_of_four).read_text(encoding="utf-8")
    path = Path(path_of_four).with_name("three.toml")
    path.write_text(text.partition("[[vehicles]]\nid = 4")[0], encoding="utf-8")
    return str(path)


def addition(team: Team) -> tuple[str, ...]:
    """Return the command that adds vehicle 4 to a team, without the mission."""
    section = team.mission.vehicle(4).section
    return ("rejoin", "4", "--add", "--start", "0,-8", "--url", section.url, "--endpoint", section.endpoint)


async def commanded(team: Team, mission: str, *command: str) -> tuple[int | None, str]:
    """Return exit code and words of a command while the time of the team is the wall's."""
    with at_speed(team.clock, 1.0):
        return await told(*command, "--mission", mission)


async def told(*command: str) -> tuple[int | None, str]:
    """Return exit code and words of a command."""
    async with running(*command) as process:
        _, err = await process.communicate()
    assert "Traceback" not in err.decode(), err.decode()
    return process.returncode, " ".join(err.decode().split())


@pytest.mark.long
async def test_a_vehicle_that_is_not_in_the_file_joins_the_ring(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    """All four end evenly spaced, and land where they started; the logs of both processes are replayed bit for bit."""
    path = mission_file("case2", WITH_FOURTH, *UNLIKE, *NEAR_TARGET, LASTING)
    mission, log, its_log = of_three(path), tmp_path / "team.mcap", tmp_path / "joined.mcap"
    async with team_of(path) as team:
        code, said = await commanded(team, mission, *addition(team))
        assert (code, "no flight of team" in said) == (3, True), said
    async with (
        team_of(path) as team,
        asyncio.timeout(3.0 * PATIENCE_S),
        team.watched(),
        running("fly", mission, "--log", str(log), "--json") as flight,
    ):
        tracks = Tracks(team)
        recording = asyncio.create_task(tracks.record())
        await until(lambda: any(each.armed for each in team.vehicles.values()), waiting_for="a take-off")
        with hurried(team.clock):
            await team.clock.sleep(20.0 + SETTLING_S)
        code, said = await commanded(team, mission, *addition(team), "--set", "encirclement.radius_m=8")
        assert (code, "flies another mission" in said) == (3, True), said
        with at_speed(team.clock, 1.0):
            async with running(*addition(team), "--mission", mission, "--log", str(its_log)) as joined:
                flies = lambda: team.vehicles[4].armed or joined.returncode is not None  # noqa: E731
                armed_s = await until(flies, 60.0, "its take-off", clock=team.clock)
                if joined.returncode is not None:
                    raise AssertionError((await joined.communicate())[1].decode())
                code, said = await commanded(team, mission, "command", "hold", "--vehicle", "4")
                assert (code, "vehicle 4" in said) == (0, True), said
                code, said = await commanded(team, mission, "command", "resume", "--vehicle", "4")
                assert code == 0, said
                with hurried(team.clock):
                    await until(lambda: not team.aloft, 400.0, "all landings", clock=team.clock)
                _, its_err = (each.decode() for each in await joined.communicate())
        out, err = (each.decode() for each in await flight.communicate())
        recording.cancel()
    codes = [process.returncode for process in (joined, flight)]
    assert codes == [0, 0], f"{its_err}\n{err}"
    ring = RingTruth(team, log, tracks.samples)
    ends_s = ring.start_s + LASTS_S
    before, after = ring.figures(THREE, armed_s - 5.0, armed_s), ring.figures(FOUR, ends_s - 10.0, ends_s)
    even_s = ring.even_after_s(FOUR, armed_s, ends_s)
    print(f"MEASURED before: {before}\nafter: {after}\neven {even_s:.1f} s after its take-off")
    print(f"it took off {ends_s - armed_s:.0f} s before the end")
    print(f"least distance {team.least_m:.2f} m, level {team.least_level_m:.2f} m")
    for each in (before, after):
        assert each.radius_off_m < 0.3
        assert each.spacing_off_deg < 3.0
    assert team.least_level_m >= team.mission.safety.separation_m
    assert tracks.least_m(until_s=ends_s) >= team.mission.safety.separation_m
    off_m = {i: team.off_start_m(i) for i in FOUR}
    assert max(off_m.values()) < HOME_M, off_m
    assert "vehicle 4, which is not in the mission file, is added" in err
    verdicts = json.loads(out)["verdicts"]
    assert (verdicts["C3"], verdicts["separation"]) == (True, True), "the spacing of four is judged, not of three"
    assert (verdicts["kept"], json.loads(out)["ended"]["still_flying"]) == (True, [4]), "it lands after the others"
    reported = read_flight([read_log(log)])
    assert [each.vehicle_id for each in reported.evidence.record.vehicles] == [*FOUR]
    for each_log in (log, its_log):
        async with running("replay", str(each_log)) as replay:
            replayed = b"".join(await replay.communicate()).decode()
            assert replay.returncode == 0, replayed
            assert "compared bit for bit" in replayed


def flying_child(supervisor: Process) -> int:
    """Return the id of the process that flies the added vehicle, whose supervisor this is."""
    [child] = [each for each in psutil.Process(supervisor.pid).children() if "rejoin" in each.cmdline()]
    return child.pid


@pytest.mark.long
async def test_one_whose_program_was_killed_comes_home_beside_the_flight_and_is_added_anew_only_then(
    mission_file: Callable[..., str],
) -> None:
    """It hovers meanwhile, the others fly on, and all keep apart. The command is the one that its supervisor names."""
    path = mission_file("case2", WITH_FOURTH, *UNLIKE, *NEAR_TARGET)
    mission = of_three(path)
    async with team_of(path) as team, asyncio.timeout(3.0 * PATIENCE_S), team.watched():
        fourth = team.vehicles[4]
        async with running("fly", mission, "--no-log", "--json") as flight:
            await until(lambda: any(each.armed for each in team.vehicles.values()), waiting_for="a take-off")
            with hurried(team.clock):
                flown = [team.vehicles[i] for i in THREE]
                await until(lambda: all(each.mode is NavMode.OFFBOARD for each in flown), 90.0, clock=team.clock)
            async with running(*addition(team), "--mission", mission, "--no-log") as joined:
                await until(lambda: fourth.armed, waiting_for="its take-off")
                with hurried(team.clock):
                    await until(lambda: team.off_start_m(4) > 10.0, 90.0, "its way to the ring", clock=team.clock)
                plain = ("recover", mission, "--yes", "--add", "4", *addition(team)[3:])
                with at_speed(team.clock, 1.0):
                    code, said = await told(*plain)
                    assert (code, "still runs" in said, "--only ID" in said) == (3, True, True), said
                    code, said = await told(*plain, "--only", "4")
                assert (code, "it flies vehicle 4, as its bus shows" in said) == (3, True), said
                assert fourth.mode is NavMode.OFFBOARD
                os.kill(flying_child(joined), signal.SIGKILL)
                err = (await joined.communicate())[1].decode()
            assert joined.returncode == 4, err
            assert "Ended by signal 9: vehicle 4" in err
            await until(lambda: fourth.mode is NavMode.HOLD, 30.0, "its autopilot's failsafe", clock=team.clock)
            code, said = await commanded(team, mission, *addition(team))
            assert (code, "it is in the air already" in said) == (3, True), said
            recovery = shlex.split(re.search(r"`cordon (recover .*?)`", err)[1])  # type: ignore[index]
            killed_s = team.clock.now_s()
            async with running(*recovery, "--yes", "--no-log", "--json") as home:
                await until(lambda: fourth.mode is NavMode.OFFBOARD, waiting_for="offboard again")
                with hurried(team.clock):
                    await until(lambda: not fourth.armed, 200.0, "its landing", clock=team.clock)
                result, words = await home.communicate()
            landed_s = team.clock.now_s()
            assert home.returncode == 0, words.decode()
            assert b"sightings contradict" not in words, "the target's motion began with the flight of the others"
            assert team.aloft == {1, 2, 3}
            assert all(each.mode is NavMode.OFFBOARD for each in flown)
            [found] = json.loads(result)["vehicles"]
            assert (found["id"], found["treatment"], found["how"]) == (4, "bring home", "landed")
            assert team.off_start_m(4) < HOME_M
            print(f"MEASURED home {landed_s - killed_s:.0f} s after the command, {team.off_start_m(4):.2f} m off")
            async with running(*addition(team), "--mission", mission, "--no-log") as again:
                await until(lambda: fourth.armed or again.returncode is not None, waiting_for="its take-off")
                assert again.returncode is None, (await again.communicate())[1].decode()
                os.kill(flying_child(again), signal.SIGKILL)
                await again.communicate()
            kill_whole(flight.pid)
    print(f"MEASURED least distance {team.least_m:.2f} m, at like heights {team.least_level_m:.2f} m")
    assert team.least_level_m >= team.mission.safety.separation_m


async def test_one_that_is_not_in_the_file_comes_home_with_a_team_whose_flight_is_gone(
    mission_file: Callable[..., str], tmp_path: Path
) -> None:
    """They keep apart, it lands last, and the log is replayed bit for bit."""
    path = mission_file("case2", WITH_FOURTH, *UNLIKE)
    places_m = {1: (12.0, 2.0), 2: (12.0, -2.0), 3: (12.0, -6.0), 4: (8.0, 0.0)}
    async with team_of(path, starts_m=places_m) as team:
        mission, log = of_three(path), tmp_path / "home.mcap"
        await take_off(team, dict.fromkeys(FOUR, 8.0))
        async with team.watched():
            described = ("--add", "4", *addition(team)[3:])
            ended, said, result = await recovered(team, *described, path=mission, log=str(log))
        print(f"MEASURED least distance {team.least_m:.2f} m, at like heights {team.least_level_m:.2f} m")
        assert ended == 0, said
        assert not team.aloft
        assert max(map(team.off_start_m, FOUR)) < HOME_M
        assert team.least_level_m >= team.mission.safety.separation_m
        landed_s = {each["id"]: each["landed_at_s"] for each in result["vehicles"]}
        assert max(landed_s, key=landed_s.__getitem__) == 4
        assert landed_s.keys() == {*FOUR}
    code, said = await told("replay", str(log))
    assert code == 0, said


@dataclass(frozen=True, slots=True)
class FourInFlight:
    """A team on its ring with vehicle 4, which has joined: the processes, and their logs."""

    team: Team
    flight: Process
    joined: Process
    log: Path
    its_log: Path


@asynccontextmanager
async def four_in_flight(path: str) -> AsyncIterator[FourInFlight]:
    """Fly three vehicles of a mission, and add the fourth."""
    mission, log, its_log = of_three(path), Path(path).with_name("team.mcap"), Path(path).with_name("joined.mcap")
    async with (
        team_of(path) as team,
        asyncio.timeout(3.0 * PATIENCE_S),
        team.watched(),
        running("fly", mission, "--log", str(log), "--json") as flight,
    ):
        await until(lambda: any(each.armed for each in team.vehicles.values()), waiting_for="a take-off")
        with hurried(team.clock):
            await team.clock.sleep(20.0)
        with at_speed(team.clock, 1.0):
            async with running(*addition(team), "--mission", mission, "--log", str(its_log)) as joined:
                await until(lambda: team.vehicles[4].armed, 60.0, "its take-off", clock=team.clock)
                with hurried(team.clock):
                    await team.clock.sleep(SETTLING_S)
                    yield FourInFlight(team, flight, joined, log, its_log)


@pytest.mark.long
async def test_it_comes_home_once_the_others_do_and_not_when_one_of_them_does(
    mission_file: Callable[..., str],
) -> None:
    """Vehicle 1 lands with a low battery; an operator ends the flight of the others in their terminal."""
    async with four_in_flight(mission_file("case2", WITH_FOURTH, *UNLIKE, *NEAR_TARGET)) as each:
        team = each.team
        team.vehicles[1].battery_fraction = 0.19
        await until(lambda: not team.vehicles[1].armed, 200.0, "its landing", clock=team.clock)
        assert team.aloft == {2, 3, 4}
        each.flight.send_signal(signal.SIGINT)
        await until(lambda: team.aloft <= {4}, 200.0, "the landings of the others", clock=team.clock)
        assert team.aloft == {4}, "it lands last"
        await until(lambda: not team.aloft, 200.0, "its landing", clock=team.clock)
        _, its_err = (words.decode() for words in await each.joined.communicate())
        out, err = (words.decode() for words in await each.flight.communicate())
    ends = "the flight that it joined has ended: the others return and land (2, 3)"
    off_m = {i: team.off_start_m(i) for i in FOUR}
    print(f"MEASURED off their starts: {off_m}\nits terminal:\n{its_err}\nthat of the others:\n{err}")
    assert (each.joined.returncode, each.flight.returncode) == (4, 4)
    for said in (f"vehicle 4 comes home: {ends}", f"Ended by the operator: vehicle 4: {ends}"):
        assert said in its_err
    [end] = read_log(each.its_log).of_kind(4, VehicleEnd)
    assert (end.how, end.reason) == ("operator", ends)
    result = json.loads(out)
    assert result["ended"]["still_flying"] == [4]
    assert "vehicle 4: joined this flight and still flies (return and land)" in result["ended"]["reason"]
    assert {left["vehicle"] for left in result["departures"]} == {1}
    assert team.least_level_m >= team.mission.safety.separation_m
    assert max(off_m.values()) < HOME_M


@pytest.mark.long
async def test_a_team_whose_added_vehicle_fell_silent_in_the_air_has_not_kept_it(
    mission_file: Callable[..., str],
) -> None:
    """Its process is killed, with its supervisor: the vehicle holds, and the others fly on."""
    async with four_in_flight(mission_file("case2", WITH_FOURTH, *UNLIKE, *NEAR_TARGET)) as each:
        team = each.team
        for process in (supervisor := psutil.Process(each.joined.pid), *supervisor.children(recursive=True)):
            process.kill()
        await team.clock.sleep(SETTLING_S)
        for _ in range(2):
            each.flight.send_signal(signal.SIGINT)
            await team.clock.sleep(1.0)
        await until(lambda: team.aloft <= {4}, 200.0, "the landings of the others", clock=team.clock)
        out, err = (words.decode() for words in await each.flight.communicate())
    print(f"MEASURED the others' terminal:\n{err}")
    async with running("report", str(each.log), "--json") as report:
        reported, _ = await report.communicate()
    for code, words in ((each.flight.returncode, out), (report.returncode, reported.decode())):
        result = json.loads(words)
        assert code == 4
        assert result["verdicts"]["kept"] is False
        [left] = result["departures"]
        assert (left["vehicle"], left["place"], left["cause"]) == (
            4,
            "ring",
            "joined this flight and fell silent in the air",
        )
        assert (result["ended"]["how"], result["ended"]["vehicles"]) == ("lost", [4])
        [lost] = result["ended"]["unaccounted"]
        assert lost["vehicle"] == 4
