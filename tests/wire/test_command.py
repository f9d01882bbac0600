"""An operator's commands to a flying team, from another terminal and by keys: answered, obeyed, able to end it."""

import asyncio
import fcntl
import os
import pty
import re
import sys
import termios
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, contextmanager
from math import inf
from pathlib import Path
from typing import Any

import pytest

from agents.flight_end import FlightEnd
from agents.settings.shapes import Shape
from agents.shell.outcome import Outcome
from agents.shell.start_agreement import PeerClocks
from agents.shell.zenoh_bus import ParticipantBus
from agents.team.codec import encode
from agents.team.messages import MissionIdentity, RingValues, StartProposal
from agents.team.perception import ExternalSighting
from agents.team.verbs import Verb
from gcs.console.command_client import CommandClient
from gcs.flight.flight import FlightOutcome
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.keys.team_keys import team_keys
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.station.broadcast import Published
from gcs.station.live_team import LiveTeam
from sitl.autopilot.autopilot import StubAutopilot
from sitl.autopilot.modes import NavMode
from sitl.server.governed_clock import GovernedClock
from tests.support.flights import flying, in_flight, unseen_view
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.page.station import asked, commanding, received, station
from tests.support.wire import computers_apart, hurried, running, served, until

pytestmark = pytest.mark.wire

SPEED = 5.0
PILOT_QUESTION = "take vehicle 2 from pilot or autopilot?"
SLOW = 0.5
"""The speed at which a vehicle that lands is still in the air when the next command arrives, by the wall's clock."""


class Team:
    """A mission in flight on stubs of this process: what each vehicle does, and what was said about it."""

    def __init__(self, mission: Mission, path: str) -> None:
        self.mission = mission
        self.path = path
        self.clock: GovernedClock
        self.vehicles: dict[int, StubAutopilot] = {}
        self.tactics: dict[int, str] = {}
        self.said: list[str] = []
        self.flight: asyncio.Task[FlightOutcome]

    async def outcomes(self) -> dict[int, Outcome]:
        return (await self.flight).outcomes

    async def command(
        self, verb: Verb, vehicle: int | None = None, argument: Shape | RingValues | None = None
    ) -> dict[int, str]:
        asked = self.mission.ids if vehicle is None else (vehicle,)
        answers = await CommandClient(self.mission).command(verb, asked, vehicle, argument)
        assert None not in answers.values(), answers
        return {i: answer.did for i, answer in answers.items() if answer is not None}


FlyTeam = Callable[[], AbstractAsyncContextManager[Team]]


@pytest.fixture
def fly_team(mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> FlyTeam:
    """Return a way to fly case2 on stubs, until it is in formation."""

    @asynccontextmanager
    async def in_formation() -> AsyncIterator[Team]:
        path = mission_file("case2", LOW, ('name = "case2"', 'name = "commanded"'))
        mission = load_mission(path)
        team = Team(mission, path)
        view = unseen_view()
        monkeypatch.setattr(
            view, "update", lambda rows, *_: team.tactics.update({row.vehicle_id: row.tactic for row in rows})
        )
        monkeypatch.setattr(view, "print_line", lambda text, *_: team.said.append(text))
        async with served(stub_configs(mission), SPEED) as stubs:
            team.clock, team.vehicles = stubs.clock, stubs.vehicles
            plan = FlightPlan(mission, 300.0, mission.vehicles, speed=None, clock=stubs.clock.name)
            async with flying(plan, view) as team.flight:
                await until(
                    lambda: team.flight.done() or any(each.armed for each in team.vehicles.values()),
                    waiting_for="a take-off",
                )
                with hurried(stubs.clock):
                    await in_flight(
                        team.flight, lambda: list(team.tactics.values()) == ["formation"] * 3, "formation", stubs.clock
                    )
                yield team

    return in_formation


LIAR, OTHER = 2, MissionIdentity("survey", "0" * 16)


@contextmanager
def lying(clock: GovernedClock, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let a vehicle of this process propose starts of another mission 100 times a second, in place of its own.

    Its time is right: it obeys commands, which are dated by it.
    """
    publish, buses = ParticipantBus.publish, set[ParticipantBus]()

    def published(bus: ParticipantBus, topic: str, payload: bytes) -> None:
        if bus.vehicle_id == LIAR:
            buses.add(bus)
        if bus not in buses or topic != "start":
            publish(bus, topic, payload)

    async def lie() -> None:
        while True:
            for bus in buses:
                publish(bus, "start", encode(StartProposal(LIAR, clock.now_s(), None, mission=OTHER)))
            await asyncio.sleep(0.01)

    monkeypatch.setattr(ParticipantBus, "publish", published)
    lies = asyncio.create_task(lie())
    try:
        yield
    finally:
        lies.cancel()


async def test_a_team_obeys_commands_encircles_what_is_pointed_out_and_falls_at_the_word(
    fly_team: FlyTeam, subtests: pytest.Subtests, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One of the vehicles lies all the time."""
    async with fly_team() as team, AsyncExitStack() as stack:
        stack.enter_context(lying(team.clock, monkeypatch))
        with subtests.test("command and page name the vehicle that lies"):
            ran = await stack.enter_async_context(running("command", "hold", "--mission", team.path))
            _, told = await ran.communicate()
            assert ran.returncode == 0, told.decode()
            assert "vehicle 2 reports 'survey', not 'commanded'; hold was sent" in told.decode()
            pictures = list[Published]()
            watching = asyncio.create_task(LiveTeam(team.mission).run(pictures.append))
            stack.callback(watching.cancel)
            named = "vehicle 2 reports 'survey', not 'commanded'"
            await until(lambda: getattr(pictures[-1], "link", "") == named if pictures else False)
            assert set(await team.command("resume")) == {1, 2, 3}
        with subtests.test("every command is answered by what the vehicle does"):
            changes = dict.fromkeys((1, 2, 3), "takes its place in the shape 'wedge'")
            assert await team.command("formation", argument="wedge") == changes
            assert await team.command("hold") == dict.fromkeys((1, 2, 3), "holds")
            await until(lambda: team.tactics == dict.fromkeys((1, 2, 3), "hold"))
            assert await team.command("resume", 1) == {1: "resumes its mission"}
            await until(lambda: team.tactics == {1: "formation", 2: "hold", 3: "hold"})
            assert set(await team.command("resume")) == {1, 2, 3}
        with subtests.test("a target that is pointed out is encircled"):
            sensor, unsure = team_keys(team.mission).identity("sensor"), (0.25, 0.0, 0.25)
            sighting = ExternalSighting("mission", (8.0, 0.0), unsure, 0.8, 0.2)
            assert set(await CommandClient(team.mission, sensor).send_sighting(sighting, 0.0)) == {1, 2, 3}
            pointing_out = asyncio.create_task(CommandClient(team.mission, sensor).send_sighting(sighting, 60.0))
            stack.callback(pointing_out.cancel)
            await until(lambda: list(team.tactics.values()) == ["encircle"] * 3)
        with subtests.test("all fly the ring that is commanded, and the page shows it"):
            wanted = await team.command("ring", argument=RingValues(7.0, -0.1, 9.0))
            assert wanted == dict.fromkeys((1, 2, 3), "changes to a ring of 7 m, -0.1 rad/s, 9 m high")
            await until(lambda: ring_radius_m(pictures[-1]) == 7.0)
            await until(lambda: all(abs(rate_rad_s + 0.1) < 0.005 for rate_rad_s in rates_rad_s(pictures[-1])))
            await until(lambda: heights_m(pictures[-1]) == pytest.approx([9.0] * 3, abs=0.2))
        with subtests.test("a kill cuts the motors, whatever the vehicle does"):
            await _kill_all(team, monkeypatch, tmp_path)
    for line in ("vehicle 2: formation by", "vehicle 2: hold by", "vehicle 3: kill by"):
        assert any(line in said for said in team.said), team.said


def ring_radius_m(picture: Published) -> float | None:
    """Return the commanded radius in a picture, None without one."""
    ring = getattr(picture, "ring", None)
    return None if ring is None else ring.radius_m


def heights_m(picture: Published) -> list[float | None]:
    """Return the heights of the vehicles in a picture."""
    return [each.height_m for each in getattr(picture, "vehicles", ())]


def rates_rad_s(picture: Published) -> list[float]:
    """Return the angular rates of the vehicles in a picture, infinite for one off the ring."""
    rates = [each.angular_rate_rad_s for each in getattr(picture, "vehicles", ())]
    return [inf if each is None else each for each in rates] or [inf]


async def _kill(team: Team, vehicle_id: int, armed: tuple[int, ...], page: Path | None = None) -> None:
    """Kill a vehicle in the air; the others that are armed stay so."""
    killed = team.vehicles[vehicle_id]
    assert killed.armed
    assert not killed.landed, "it has to be in the air, or this shows nothing"
    fell = asyncio.create_task(until(lambda: not killed.armed))
    if page is None:
        assert await team.command("kill", vehicle_id) == {vehicle_id: "motors cut"}
    else:
        await _kill_by_page(team, vehicle_id, page)
    await fell
    await until(lambda: any(f"vehicle {vehicle_id}: kill by" in line for line in team.said))
    assert all(team.vehicles[i].armed for i in armed), "nobody else was meant"


async def _kill_by_page(team: Team, vehicle_id: int, folder: Path) -> None:
    async with station(team.mission, folder) as served_page, served_page.connected() as page:
        await commanding(page)
        await page.send(asked("k", "kill", [vehicle_id], confirmation="kill"))
        while not (answer := await received(page, "answer"))["is_final"]:
            pass
    assert (answer["vehicle_id"], answer["did"]) == (vehicle_id, "motors cut")


async def _kill_all(team: Team, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Kill one on its mission, one on its way down, and one that a pilot has and that does not obey at once."""
    disarm, refusals = StubAutopilot.disarm, 2

    def stubborn(autopilot: StubAutopilot, *, force: bool = False) -> Any:
        nonlocal refusals
        refusals -= force
        return disarm(autopilot, force=force and refusals < 0)

    await _kill(team, 3, armed=(1, 2), page=folder)
    team.clock.set_speed(SLOW)
    assert await team.command("land", 2) == {2: "lands"}
    await until(lambda: team.vehicles[2].mode is NavMode.LAND)
    await _kill(team, 2, armed=(1,))
    team.clock.set_speed(SPEED)
    team.vehicles[1].select(NavMode.HOLD)
    await until(lambda: team.tactics[1] == "pilot override")
    monkeypatch.setattr(StubAutopilot, "disarm", stubborn)
    assert await team.command("kill", 1) == {1: "motors cut"}
    assert not team.vehicles[1].armed
    assert refusals < 0, "the kill is repeated"
    outcomes = await team.outcomes()
    assert {outcome.how for outcome in outcomes.values()} == {FlightEnd.KILLED}
    assert all(outcome.flew for outcome in outcomes.values())


async def test_a_team_of_two_obeys_within_a_second_though_a_clock_is_a_minute_off(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each hovers: it waits for the other, whose time cannot be right. On the ground they would not have armed."""
    computers_apart(monkeypatch, 0.0, 60.0)
    monkeypatch.setattr(PeerClocks, "require_one_time", lambda _clocks: None)
    mission = load_mission(with_first_vehicles(mission_file("case2", LOW), 2))
    async with served(stub_configs(mission), SPEED) as stubs, AsyncExitStack() as stack:
        for each in mission.vehicles:
            plan = FlightPlan(mission, 300.0, (each,), speed=None, clock=stubs.clock.name)
            await stack.enter_async_context(flying(plan))
        vehicles = stubs.vehicles.values()
        with hurried(stubs.clock):
            await until(lambda: all(each.mode is NavMode.OFFBOARD and not each.landed for each in vehicles))
            await stubs.clock.sleep(2.0)  # until their links report it
        stubs.clock.set_speed(1.0)
        for verb, did in (("hold", "holds"), ("kill", "motors cut")):
            answers = await CommandClient(mission).command(verb, mission.ids, None)  # type: ignore[arg-type]
            assert {i: answer and answer.did for i, answer in answers.items()} == dict.fromkeys((1, 2), did)
            assert all(answer and answer.after_s < 1.0 for answer in answers.values()), answers
        assert not any(each.armed for each in vehicles)


async def test_keys_command_the_vehicles_of_their_own_process_and_of_the_others(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mission_file("case2", LOW)
    mission = load_mission(path)
    tactics = dict[int, str]()
    view = unseen_view()
    monkeypatch.setattr(view, "update", lambda rows, *_: tactics.update({row.vehicle_id: row.tactic for row in rows}))
    async with served(stub_configs(mission), SPEED) as stubs:
        child, person = pty.fork()
        if child == 0:
            os.environ |= {"TERM": "xterm", "COLUMNS": "120"}
            command = [sys.executable, "-m", "gcs", "fly", path, "--only", "1", "--duration", "300"]
            os.execv(sys.executable, command)
        terminal, shown = Terminal(person), termios.tcgetattr(person)
        # Until it has joined the clock, the other process is not waited for: it is first.
        await until(lambda: stubs.vehicles[1].armed, waiting_for="the other process has armed its vehicle")
        plan = FlightPlan(mission, 300.0, mission.vehicles[1:], speed=None, clock=stubs.clock.name)
        stubs.clock.set_speed(1.0)  # the other process waits for these two, which take wall time to connect
        async with AsyncExitStack() as stack, flying(plan, view) as flight:
            stack.callback(terminal.close)
            await until(lambda: all(each.armed for each in stubs.vehicles.values()), waiting_for="all have armed")
            stubs.clock.set_speed(SPEED)
            with hurried(stubs.clock):
                await until(lambda: list(tactics.values()) == ["formation"] * 2, 300.0, clock=stubs.clock)
            stubs.clock.set_speed(1.0)  # keys are typed by the wall's clock
            assert "h hold" in terminal.text
            terminal.type("h")
            await until(lambda: list(tactics.values()) == ["hold"] * 2)
            await until(lambda: bool(re.search("vehicle 1: hold by [^ ]+: holds", terminal.text)))
            await until(lambda: "vehicle 2: answers: holds" in terminal.text)
            stubs.vehicles[2].select(NavMode.HOLD)  # its pilot
            await until(lambda: tactics[2] == "pilot override" and "2: hold -> pilot override" in terminal.text)
            await by_hand(terminal, "rrr")
            await until(lambda: PILOT_QUESTION in terminal.text)
            await by_hand(terminal, "kkkkkk")
            await until(lambda: "cut the motors of 3 vehicles" in terminal.text)
            terminal.type("kkkkyyyy")
            await until(lambda: "pasted" in terminal.text)
            assert tactics == {2: "pilot override", 3: "hold"}
            assert all(vehicle.armed for vehicle in stubs.vehicles.values())
            asked = terminal.text.count(PILOT_QUESTION)
            await by_hand(terminal, "2r")
            await until(lambda: terminal.text.count(PILOT_QUESTION) > asked)
            await by_hand(terminal, "y")
            await until(
                lambda: tactics == {2: "formation", 3: "hold"},
                waiting_for=f"a resumed vehicle: {terminal.text[-2000:]}",
            )
            await by_hand(terminal, "kkill\n")
            await until(lambda: not any(vehicle.armed for vehicle in stubs.vehicles.values()))
            outcomes = (await flight).outcomes
            assert {outcome.how for outcome in outcomes.values()} == {FlightEnd.KILLED}
            await until(lambda: terminal.ended, waiting_for="the end of the other process")
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 4
            assert termios.tcgetattr(person) == shown


async def test_a_kill_from_another_terminal_asks_first(mission_file: Callable[..., str]) -> None:
    path = mission_file("case2")
    child, person = pty.fork()
    if child == 0:
        os.environ |= {"TERM": "xterm", "COLUMNS": "120"}
        os.execv(sys.executable, [sys.executable, "-m", "gcs", "command", "kill", "--vehicle", "2", "--mission", path])
    terminal = Terminal(person)
    try:
        await until(lambda: "Cut the motors of vehicle 2 of case2" in terminal.text)
        terminal.type("n\n")
        await until(lambda: terminal.ended)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
        assert "no command was sent" in terminal.text
    finally:
        terminal.close()


TIOCGPTN = 0x80045430
"""Linux: the number of the far end of a pseudo-terminal."""


async def by_hand(terminal: "Terminal", keys: str) -> None:
    """Type keys one after the other, each after the program has handled the one before it.

    Keys that are handled in quick succession count as pasted. A program on a busy computer may handle one long after it
    has read it, but before it draws twice.
    """
    for key in keys:
        terminal.type(key)
        await until(lambda: terminal.is_read, waiting_for="the key read")
        for _ in range(2):
            drawn = terminal.text
            await until(lambda drawn=drawn: terminal.text != drawn, waiting_for="the view drawn")  # type: ignore[misc]
        await asyncio.sleep(0.05)


class Terminal:
    """A person at a terminal: what is shown there, and what is typed."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self.text = ""
        self.ended = False
        asyncio.get_running_loop().add_reader(fd, self._read)

    @property
    def is_read(self) -> bool:
        """Whether the program has read everything that was typed."""
        number = int.from_bytes(fcntl.ioctl(self._fd, TIOCGPTN, bytes(4)), sys.byteorder)
        far_end = os.open(f"/dev/pts/{number}", os.O_RDWR | os.O_NOCTTY)
        try:
            return int.from_bytes(fcntl.ioctl(far_end, termios.FIONREAD, bytes(4)), sys.byteorder) == 0
        finally:
            os.close(far_end)

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
