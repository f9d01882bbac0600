"""An operator's commands to a flying team, from another terminal and by keys: answered, obeyed, able to end it."""

import asyncio
import json
import os
import pty
import re
import sys
import termios
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from agents.shell.outcome import Ending, Outcome
from agents.team.perception import TOPIC, ExternalSighting
from gcs.console.command_client import CommandClient
from gcs.console.live import LiveView
from gcs.console.team_bus import guest_bus
from gcs.flight.flight import Flight, fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.keys.team_keys import team_keys
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from sitl.autopilot.modes import NavMode
from sitl.autopilot.px4 import Autopilot
from tests.support.mission_text import LOW_M
from tests.support.wire import Served, served, until

pytestmark = pytest.mark.wire

SPEED = 5.0
HIGH_M = 8.0
"""High enough that a vehicle is still in the air when the next command arrives while it climbs or lands."""


class Team:
    """A mission in flight on stubs of this process: what each vehicle does, and what was said about it."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.watch: Served
        self.tactics: dict[int, str] = {}
        self.said: list[str] = []
        self.flight: asyncio.Task[Flight]

    async def outcomes(self) -> dict[int, Outcome]:
        return (await asyncio.wait_for(self.flight, 60.0)).outcomes

    async def command(self, verb: str, vehicle: int | None = None, shape: str | None = None) -> dict[int, str]:
        asked = self.mission.ids if vehicle is None else (vehicle,)
        answers = await CommandClient(self.mission).command(verb, asked, vehicle, shape)  # type: ignore[arg-type]
        assert None not in answers.values(), answers
        return {i: answer.did for i, answer in answers.items() if answer is not None}


FlyTeam = Callable[..., AbstractAsyncContextManager[Team]]


@pytest.fixture
def fly_team(mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> FlyTeam:
    """Return a way to fly case2 on stubs."""

    @asynccontextmanager
    async def flying(
        *, speed: float = SPEED, until_tactic: str = "formation", hover_s: float = 5.0, altitude_m: float = LOW_M
    ) -> AsyncIterator[Team]:
        changes = (
            ('name = "case2"', 'name = "commanded"'),
            ("[safety]\n", f"[safety]\nabort_hover_s = {hover_s}\n"),
            ("endpoint =", f"altitude_m = {altitude_m}\nendpoint ="),
        )
        mission = load_mission(mission_file("case2", *changes))
        team = Team(mission)
        view = LiveView(Console(file=StringIO()))
        monkeypatch.setattr(
            view, "update", lambda rows, *_: team.tactics.update({row.vehicle_id: row.tactic for row in rows})
        )
        monkeypatch.setattr(view, "print_line", lambda text, *_: team.said.append(text))
        async with served(stub_configs(mission), speed) as team.watch:
            plan = FlightPlan(mission, 120.0, mission.vehicles, speed=speed)
            team.flight = asyncio.create_task(fly(plan, view))
            try:
                if until_tactic:
                    await until(lambda: team.flight.done() or list(team.tactics.values()) == [until_tactic] * 3, 60.0)
                    assert not team.flight.done(), team.flight.result()
                yield team
            finally:
                team.flight.cancel()
                await asyncio.gather(team.flight, return_exceptions=True)

    return flying


async def test_a_team_obeys_commands_and_encircles_a_target_that_is_pointed_out(
    fly_team: FlyTeam, subtests: pytest.Subtests
) -> None:
    async with fly_team(altitude_m=HIGH_M) as team:
        with subtests.test("nobody follows a sighting that cannot be"):
            await _point_out_what_cannot_be(team)
        with subtests.test("every command is answered by what the vehicle does"):
            changes = dict.fromkeys((1, 2, 3), "takes its place in the shape 'wedge'")
            assert await team.command("formation", shape="wedge") == changes
            assert await team.command("hold") == dict.fromkeys((1, 2, 3), "holds")
            assert await team.command("hold", 2) == {2: "was holding already"}
            await asyncio.sleep(0.5)
            assert team.tactics == dict.fromkeys((1, 2, 3), "hold")
            assert await team.command("resume", 1) == {1: "resumes its mission"}
            await asyncio.sleep(0.5)
            assert team.tactics == {1: "formation", 2: "hold", 3: "hold"}
            assert await team.command("resume") == {
                1: "was on its mission already",
                2: "resumes its mission",
                3: "resumes its mission",
            }
        with subtests.test("a target that is pointed out is encircled"):
            sensor, unsure = team_keys(team.mission).identity("sensor"), (0.25, 0.0, 0.25)
            sighting = ExternalSighting("mission", (8.0, 0.0), unsure, 0.8, 0.2)
            assert set(await CommandClient(team.mission, sensor).send_sighting(sighting, 0.0)) == {1, 2, 3}
            await until(lambda: list(team.tactics.values()) == ["encircle"] * 3, 20.0)
        with subtests.test("who returns, and who lands already"):
            assert await team.command("land", 3) == {3: "lands"}
            assert await team.command("rtl") == {
                1: "returns and lands",
                2: "returns and lands",
                3: "refused: it is landing",
            }
            assert {outcome.ending for outcome in (await team.outcomes()).values()} == {Ending.STOPPED}
    for line in ("vehicle 2: formation by", "vehicle 2: hold by", "vehicle 3: land by"):
        assert any(line in said for said in team.said), team.said


async def _point_out_what_cannot_be(team: Team) -> None:
    """Let a sensor send sightings that cannot be, twice: each vehicle tells why it drops one, once."""
    good: dict[str, object] = {"frame": "mission", "position": [8.0, 0.0], "covariance_m2": [0.25, 0.0, 0.25]}
    good |= {"importance": 0.8, "threat": 0.2}
    bad: tuple[tuple[dict[str, object], str], ...] = (
        ({"frame": "utm"}, "unknown frame ('utm'"),
        ({"time_s": 1e11}, "in the future"),
        ({"covariance_m2": [1.0, 1.0, 1.0]}, "not positive definite"),
        ({"covariance_m2": [1e200, 1e200, 1e200]}, "see docs/target.md"),
        ({"position": [1e7, 0.0]}, "too far away (10000 km"),
    )
    camera = guest_bus(team.mission, team_keys(team.mission).identity("sensor"))
    seen: set[int] = set()
    await camera.open(lambda *_: None, lambda *_: None, lambda vehicle_id, _: seen.add(vehicle_id))
    await until(lambda: seen >= {1, 2, 3})
    payloads = [json.dumps(good | changes).encode() for changes, _ in bad]
    for payload in (*payloads, *payloads):
        camera.publish(TOPIC, payload)
    await until(lambda: sum(words in said for said in team.said for _, words in bad) >= 3 * len(bad))
    await camera.close()
    assert [sum(words in said for said in team.said) for _, words in bad] == [3] * len(bad), team.said
    assert set(team.tactics.values()) == {"formation"}


async def test_an_abort_hovers_then_lands_by_itself_unless_resumed(fly_team: FlyTeam) -> None:
    # Two commands more have to come in the meantime, four seconds of the wall's.
    async with fly_team(hover_s=20.0) as team:
        did = await team.command("abort")
        assert did == dict.fromkeys((1, 2, 3), "holds, lands in 20 s unless resumed")
        assert await team.command("resume", 1) == {1: "resumes its mission"}
        assert await team.command("abort", 2) == {2: "lands"}
        await until(lambda: not team.watch.vehicles[2].armed and not team.watch.vehicles[3].armed, 20.0)
        assert team.tactics[1] == "formation"
        assert team.watch.vehicles[1].armed
        assert any("vehicle 3: abort by" in line and "lands, no resume" in line for line in team.said), team.said


async def _kill(team: Team, vehicle_id: int, armed: tuple[int, ...]) -> None:
    """Kill a vehicle in the air; the others that are armed stay so."""
    killed = team.watch.vehicles[vehicle_id]
    assert killed.armed
    assert not killed.landed, "it has to be in the air, or this shows nothing"
    fell = asyncio.create_task(until(lambda: not killed.armed, 3.0))
    assert await team.command("kill", vehicle_id) == {vehicle_id: "motors cut"}
    await fell
    await until(lambda: any(f"vehicle {vehicle_id}: kill by" in line for line in team.said), 2.0)
    assert all(team.watch.vehicles[i].armed for i in armed), "nobody else was meant"


async def test_a_kill_cuts_the_motors_whatever_the_vehicle_is_doing(
    fly_team: FlyTeam, monkeypatch: pytest.MonkeyPatch
) -> None:
    disarm, refusals = Autopilot.disarm, 2

    def stubborn(autopilot: Autopilot, *, force: bool = False) -> Any:
        nonlocal refusals
        refusals -= force
        return disarm(autopilot, force=force and refusals < 0)

    async with fly_team(altitude_m=HIGH_M) as team:
        await _kill(team, 3, armed=(1, 2))
        # On its way down.
        assert await team.command("land", 2) == {2: "lands"}
        await until(lambda: team.watch.vehicles[2].mode is NavMode.LAND)
        await _kill(team, 2, armed=(1,))
        # A pilot has taken it over; and it does not obey at once: the kill is repeated.
        team.watch.vehicles[1].select(NavMode.HOLD)
        await until(lambda: team.tactics[1] == "pilot override")
        monkeypatch.setattr(Autopilot, "disarm", stubborn)
        assert await team.command("kill", 1) == {1: "motors cut"}
        assert not team.watch.vehicles[1].armed
        assert refusals < 0
        outcomes = await team.outcomes()
    assert {outcome.ending for outcome in outcomes.values()} == {Ending.KILLED}
    assert all(outcome.flew for outcome in outcomes.values())


@pytest.mark.long
async def test_on_its_way_up_one_vehicle_is_told_to_land_and_another_is_killed(fly_team: FlyTeam) -> None:
    # Nobody has told a time yet: the operator has the wall's, so the team has to fly at the wall's pace.
    async with fly_team(speed=1.0, until_tactic="", altitude_m=HIGH_M) as team:
        vehicles = team.watch.vehicles
        await until(lambda: len(vehicles) == 3 and not any(vehicle.landed for vehicle in vehicles.values()))
        assert await team.command("land", 2) == {2: "lands"}
        await until(lambda: vehicles[2].mode is NavMode.LAND, 6.0)
        await _kill(team, 3, armed=(1, 2))
        outcomes = await team.outcomes()  # the mission needs everybody: vehicle 1 comes down without being told
    assert [outcomes[i].ending for i in (1, 2, 3)] == [Ending.FAILSAFE, Ending.STOPPED, Ending.KILLED]
    assert outcomes[3].flew
    assert not any(vehicle.armed for vehicle in vehicles.values())


@pytest.mark.long
async def test_a_team_holds_within_200_ms_of_the_word(fly_team: FlyTeam) -> None:
    async with fly_team(speed=1.0) as team:
        answers = await CommandClient(team.mission).command("hold", team.mission.ids, None)
    after_s = [answer.after_s for answer in answers.values() if answer is not None and answer.did == "holds"]
    assert len(after_s) == 3
    assert max(after_s) < 0.2


async def test_keys_command_the_vehicles_of_their_own_process_and_of_the_others(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mission_file("case2")
    mission = load_mission(path)
    tactics = dict[int, str]()
    view = LiveView(Console(file=StringIO()))
    monkeypatch.setattr(view, "update", lambda rows, *_: tactics.update({row.vehicle_id: row.tactic for row in rows}))
    async with served(stub_configs(mission), SPEED) as watch:
        child, person = pty.fork()
        if child == 0:
            os.environ |= {"TERM": "xterm", "COLUMNS": "120"}
            command = [sys.executable, "-m", "gcs", "fly", path, "--only", "1", "--speed", str(SPEED)]
            os.execv(sys.executable, command)
        terminal, shown = Terminal(person), termios.tcgetattr(person)
        plan = FlightPlan(mission, 120.0, mission.vehicles[1:], speed=SPEED)
        flight = asyncio.create_task(fly(plan, view))
        try:
            await until(lambda: list(tactics.values()) == ["formation"] * 2, 30.0)
            assert "h hold" in terminal.text
            terminal.type("h")
            await until(lambda: list(tactics.values()) == ["hold"] * 2)
            await until(lambda: bool(re.search("vehicle 1: hold by [^ ]+: holds", terminal.text)))
            await until(lambda: "vehicle 2: answers: holds" in terminal.text)
            watch.vehicles[2].select(NavMode.HOLD)  # its pilot
            await until(lambda: tactics[2] == "pilot override" and "2: hold -> pilot override" in terminal.text)
            await by_hand(terminal, "rrr")
            await until(lambda: "take vehicle 2 from the pilot?" in terminal.text)
            await by_hand(terminal, "kkkkkk")
            await until(lambda: "cut the motors of 3 vehicles" in terminal.text)
            terminal.type("kkkkyyyy")
            await until(lambda: "pasted" in terminal.text)
            assert tactics == {2: "pilot override", 3: "hold"}
            assert all(vehicle.armed for vehicle in watch.vehicles.values())
            await by_hand(terminal, "2ry")
            await until(lambda: tactics == {2: "formation", 3: "hold"})
            await by_hand(terminal, "kkill\n")
            await until(lambda: not any(vehicle.armed for vehicle in watch.vehicles.values()))
            outcomes = (await flight).outcomes
            assert {outcome.ending for outcome in outcomes.values()} == {Ending.KILLED}
            await until(lambda: terminal.ended, 20.0, "the end of the other process")
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 4
            assert termios.tcgetattr(person) == shown
        finally:
            terminal.close()
            flight.cancel()
            await asyncio.gather(flight, return_exceptions=True)


@pytest.mark.parametrize(("typed", "told"), [("n", "no command was sent"), ("y", "no flight of team")])
async def test_a_kill_from_another_terminal_asks_first(typed: str, told: str, mission_file: Callable[..., str]) -> None:
    path = mission_file("case2")
    child, person = pty.fork()
    if child == 0:
        os.environ |= {"TERM": "xterm", "COLUMNS": "120"}
        os.execv(sys.executable, [sys.executable, "-m", "gcs", "command", "kill", "--vehicle", "2", "--mission", path])
    terminal = Terminal(person)
    try:
        await until(lambda: "Cut the motors of vehicle 2 of case2" in terminal.text)
        terminal.type(f"{typed}\n")
        await until(lambda: terminal.ended)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
        assert told in terminal.text
    finally:
        terminal.close()


async def by_hand(terminal: "Terminal", keys: str) -> None:
    for key in keys:
        terminal.type(key)
        await asyncio.sleep(0.05)


class Terminal:
    """A person at a terminal: what is shown there, and what is typed."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self.text = ""
        self.ended = False
        asyncio.get_running_loop().add_reader(fd, self._read)

    def type(self, keys: str) -> None:
        os.write(self._fd, keys.encode())

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._fd)
        os.close(self._fd)

    def _read(self) -> None:
        try:
            self.text += os.read(self._fd, 65536).decode(errors="replace")
        except OSError:
            self.ended = True
            asyncio.get_running_loop().remove_reader(self._fd)
