"""A stranger on a team's plain bus, at its worst, while a team of stubs flies.

What it may still do there, speaking on a vehicle's own key, takes certificates to prevent (docs/safety.md).
"""

import asyncio
import json
import re
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from io import StringIO
from math import inf
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import pytest
from rich.console import Console

from agents.outputs import CoreStatus
from agents.safety.failsafe import Condition
from agents.tactics import Tactic
from agents.team.codec import decode, encode
from agents.team.messages import CommandAnswer, OperatorCommand, StartProposal
from agents.team.perception import ExternalSighting, encode_sighting
from gcs.console.command_client import CommandClient
from gcs.console.live import LiveView
from gcs.console.watch import WatchView, watch
from gcs.flight.flight import FlightOutcome
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.metrics.journal import Journal
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade
from sitl.server.governed_clock import GovernedClock
from tests.support.flights import flying, in_flight
from tests.support.mission_text import INSECURE, LOW
from tests.support.paths import ROOT, finds_tests
from tests.support.unauthorised_client import FAR_M, UnauthorisedClient, state
from tests.support.wire import PATIENCE_S, repeated, served, until

pytestmark = pytest.mark.wire

SPEED = 5.0
ESCAPE = "\x1b[2J\x1b]0;mine\x07"
CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]")


class Scene:
    """A flying team, and everything that is shown of it."""

    def __init__(self, mission: Mission, monkeypatch: pytest.MonkeyPatch) -> None:
        self.mission = mission
        self.clock: GovernedClock
        self.latest: dict[int, CoreStatus] = {}
        self.alerts: set[str] = set()
        self.strange_peers = 0
        self.outside_s: dict[int, float] = {}
        """When each vehicle reported that it knows its target from outside only."""
        self.followed_s: dict[int, float] = {}
        """When each left the formation for a target."""
        self.findings: list[Finding] = []
        self.text = StringIO()
        self.watched = StringIO()
        self.flight: asyncio.Task[FlightOutcome]
        note = Journal.note

        def noted(journal: Journal, status: CoreStatus, tick_us: float | None) -> None:
            self.latest[status.vehicle_id] = status
            self.alerts.add(status.alert)
            self.strange_peers += sum(peer.position_m == FAR_M for peer in status.peers)
            if status.alert == Condition.TARGET_FROM_OUTSIDE.value:
                self.outside_s.setdefault(status.vehicle_id, status.time_s)
            if status.tactic is Tactic.ENCIRCLE:
                self.followed_s.setdefault(status.vehicle_id, status.time_s)
            note(journal, status, tick_us)

        monkeypatch.setattr(Journal, "note", noted)

    @property
    def endpoints(self) -> list[str]:
        return [vehicle.section.endpoint for vehicle in self.mission.vehicles]

    @property
    def now_s(self) -> float:
        """The team's time."""
        return max(status.time_s for status in self.latest.values())

    @property
    def tactics(self) -> list[str]:
        return [self.latest[i].tactic.value if i in self.latest else "" for i in (1, 2, 3)]

    def drops_lies(self) -> bool:
        """Whether vehicle 2 has dropped messages for each reason that a key in the name of another one gives."""
        drops = self.latest[2].drops
        return min(drops.unknown_key, drops.not_a_member, drops.own_id) > 0

    async def command(self, verb: str, shape: str | None = None) -> dict[int, tuple[str, float]]:
        """Return what each vehicle answers, and after how long, to an operator who has received the team."""
        client = CommandClient(self.mission)
        await client.open()
        try:
            await until(lambda: client._missions.is_same, PATIENCE_S)
            answers = await client.command(verb, self.mission.ids, None, shape)  # type: ignore[arg-type]
        finally:
            await client.close()
        return {i: ("", 9.9) if answer is None else (answer.did, answer.after_s) for i, answer in answers.items()}


@asynccontextmanager
async def attacked(mission: Mission, monkeypatch: pytest.MonkeyPatch, log: Path | None = None) -> AsyncIterator[Scene]:
    """Fly on stubs of this process, with a watch beside."""
    scene, stop = Scene(mission, monkeypatch), asyncio.Event()
    async with served(stub_configs(mission), SPEED) as stubs:
        scene.clock = stubs.clock
        plan = FlightPlan(mission, 300.0, mission.vehicles, speed=SPEED, clock=stubs.clock.name)
        view = LiveView(Console(file=scene.text, width=300))
        async with flying(plan, view, scene.findings) as scene.flight:
            watching = asyncio.create_task(watch(mission, WatchView(Console(file=scene.watched, width=300)), stop))
            try:
                yield scene
            finally:
                stop.set()
                await asyncio.gather(watching, return_exceptions=True)


@contextmanager
def flood(kind: str, scene: Scene, lasting_s: float, rate_hz: float) -> Iterator["Popen[str]"]:
    """Let a stranger in a process of its own flood the bus."""
    arguments = [kind, scene.mission.network.team, str(lasting_s), str(rate_hz), *scene.endpoints]
    command = [sys.executable, "-m", "tests.support.unauthorised_client", *arguments]
    with Popen(command, cwd=ROOT, env=finds_tests(), stdout=PIPE, text=True) as flood:
        try:
            yield flood
        finally:
            flood.kill()


async def spoken(
    stranger: UnauthorisedClient, message: Callable[[], list[tuple[str, bytes]]], lasting_s: float = inf
) -> None:
    """Say something ten times a second."""
    end_s = time.monotonic() + lasting_s
    while time.monotonic() < end_s:
        for key, payload in message():
            stranger.put(key, payload)
        await asyncio.sleep(0.1)


async def spoken_until(
    stranger: UnauthorisedClient, message: Callable[[], list[tuple[str, bytes]]], condition: Callable[[], bool]
) -> None:
    """Say something for half a second, and again until a condition holds."""
    end_s = time.monotonic() + PATIENCE_S
    await spoken(stranger, message, 0.5)
    while not condition():
        assert time.monotonic() < end_s, "it had no effect"
        await spoken(stranger, message, 0.5)


def calls_while_busy(lasting_s: float) -> int:
    """Return how many calls other threads ask of the event loop while it is busy: they all wait for it."""
    loop, calls = asyncio.get_running_loop(), 0
    ask = loop.call_soon_threadsafe

    def counted(*arguments: Any, **named: Any) -> asyncio.Handle:
        nonlocal calls
        calls += 1
        return ask(*arguments, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "call_soon_threadsafe", counted)
        time.sleep(lasting_s)
    return calls


async def holds_at_once(scene: Scene) -> None:
    answers = await scene.command("hold")
    assert {did for did, _ in answers.values()} <= {"holds", "was holding already"}, answers
    assert max(after_s for _, after_s in answers.values()) < 0.5, answers


def resident_mb() -> float:
    """The memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


async def test_a_team_flies_on_while_a_stranger_lies_and_floods(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    mission = load_mission(mission_file("case2", ('name = "case2"', 'name = "attacked"'), LOW, INSECURE))
    async with attacked(mission, monkeypatch) as scene:
        stranger = UnauthorisedClient(mission.network.team, scene.endpoints)

        def past_start() -> list[tuple[str, bytes]]:
            now_s = scene.clock.now_s()
            proposals = [StartProposal(sender, now_s, start_s) for sender in (1, 2, 3) for start_s in (0.0, 1e12)]
            return [(f"start/{each.sender}", encode(each)) for each in proposals]

        with subtests.test("a start in 1970, or in the year 33658, from a vehicle's own key"):
            agreeing = asyncio.create_task(spoken(stranger, past_start))
            await in_flight(scene.flight, lambda: scene.tactics == ["formation"] * 3, "formation", scene.clock)
            await scene.clock.sleep(5.0)
            agreeing.cancel()
            assert scene.tactics == ["formation"] * 3

        with subtests.test("states in the names of vehicles, on other keys"):

            def lies() -> list[tuple[str, bytes]]:
                said = [state(sender, scene.now_s) for sender in (1, 2, 3)]
                keys = ("member/0", "member/9", "start/9", "start/1", "answer/2", "hello/3", "alive/1", "member/1")
                return [(key, encode(each)) for each in said for key in keys if key != f"member/{each.sender}"]

            await spoken_until(stranger, lies, scene.drops_lies)
            assert scene.strange_peers == 0

        with subtests.test("commands on other keys than those of verb and operator"):
            number = iter(range(1000, 9999))

            def orders() -> list[tuple[str, bytes]]:
                keys = ("member/3", "command/3", "command/hold/eve", "command/kill/eve", "command/land/pat", "x/1")
                return [
                    (key, encode(OperatorCommand(scene.now_s, verb, None, "pat", next(number))))
                    for key in keys
                    for verb in ("hold", "kill")
                ]

            await spoken_until(stranger, orders, lambda: scene.latest[2].drops.wrong_sender > 0)
            assert scene.tactics == ["formation"] * 3

        with subtests.test("clocks and answers of others do not reach an operator"):
            heard: list[OperatorCommand] = []

            def hear(sample: Any) -> None:
                message = decode(sample.payload.to_bytes())
                assert isinstance(message, OperatorCommand)
                heard.append(message)
                for sender in (1, 2, 3):
                    for key in ("answer/9", f"answer/{sender % 3 + 1}", f"member/{sender}"):
                        stranger.put(key, encode(CommandAnswer(sender, message.time_s, message.number, "motors cut")))

            subscriber = stranger.session.declare_subscriber(f"cordon/{mission.network.team}/command/**", hear)
            dated = lambda: [(key, encode(state(99, 9e11))) for key in ("member/99", "member/7")]  # noqa: E731
            dating = asyncio.create_task(spoken(stranger, dated))
            await asyncio.sleep(0.3)
            answers = await scene.command("formation", "wedge")
            dating.cancel()
            subscriber.undeclare()  # type: ignore[no-untyped-call]
            assert {did for did, _ in answers.values()} == {"takes its place in the shape 'wedge'"}, answers

        with subtests.test("control characters reach neither terminal nor log"):

            def escapes() -> list[tuple[str, bytes]]:
                order = OperatorCommand(scene.now_s, "formation", None, ESCAPE, 77, "line")
                return [
                    ("command/formation/eve", encode(order)),
                    ("member/2", encode(state(2, scene.now_s, ESCAPE))),
                    ("answer/2", encode(CommandAnswer(2, scene.now_s, 77, ESCAPE))),
                    ("perception/eve", json.dumps({"frame": "mission", ESCAPE: 1}, ensure_ascii=False).encode()),
                    ("perception/eve", json.dumps({ESCAPE: 1}, ensure_ascii=False).encode()),
                ]

            await spoken(stranger, escapes, 0.5)
            await asyncio.sleep(0.3)
            for shown in (scene.text.getvalue(), scene.watched.getvalue()):
                assert "connected" in shown or "refused" in shown, "it shows something at all"
                assert not CONTROL.search(shown), CONTROL.findall(shown)
            notes = [note.text for status in scene.latest.values() for note in status.notes]
            assert not any(map(CONTROL.search, notes)), notes
        stranger.close()
        for kind in ("junk", "valid"):
            scene.clock.set_speed(1.0)  # the stranger floods by the wall's clock
            with subtests.test(kind), flood(kind, scene, 2.0 * PATIENCE_S, 4000.0):
                scene.alerts.clear()
                await until(lambda: "bus flooded" in scene.alerts, waiting_for="the alert")
                calls = calls_while_busy(0.1)
                assert calls < 50, "what waits for a busy computer grows with what a stranger sends"
                await repeated(partial(holds_at_once, scene))
        scene.clock.set_speed(SPEED)
        with subtests.test("large payloads"):
            before_mb = resident_mb()
            with flood("large", scene, 3.0, 2.0) as flooding:
                await until(lambda: flooding.poll() is not None)
            await asyncio.sleep(0.5)
            assert resident_mb() - before_mb < 20.0
        await until(
            lambda: all(status.alert == "" for status in scene.latest.values()), waiting_for="the end of the alert"
        )
        await until(lambda: "dropped: unknown key" in scene.watched.getvalue(), waiting_for="the reasons in the watch")
        assert set(scene.tactics) == {"hold"}
        assert not scene.flight.done()

        with subtests.test("sightings before the own sensors see the target"):
            await scene.command("resume")
            await until(lambda: scene.tactics == ["formation"] * 3, waiting_for="the formation")
            await lured(scene)


async def lured(scene: Scene) -> None:
    """Lead vehicles away by sightings: they say so, before the flight and before they follow."""
    assert all(status.target is None for status in scene.latest.values()), "the own sensors see it"
    assert [each.grade for each in scene.findings if each.check == "mission fence"] == [Grade.WARNING]
    stranger = UnauthorisedClient(scene.mission.network.team, scene.endpoints)
    began_s, motion = scene.now_s, scene.latest[2].motion
    assert motion is not None

    def lure() -> list[tuple[str, bytes]]:
        place = (float(motion[0]), float(motion[1]) - 5.0 - 0.4 * (scene.now_s - began_s))
        return [("perception/eve", encode_sighting(ExternalSighting("mission", place, (0.01, 0.0, 0.01), 0.9, 0.1)))]

    luring = asyncio.create_task(spoken(stranger, lure))
    try:
        await until(lambda: bool(scene.followed_s) and len(scene.outside_s) == 3, waiting_for="a vehicle that follows")
        text = Condition.TARGET_FROM_OUTSIDE.value
        await until(lambda: text in scene.text.getvalue() and text in scene.watched.getvalue(), waiting_for="its alert")
    finally:
        luring.cancel()
        stranger.close()
    for vehicle_id, since_s in scene.followed_s.items():
        assert scene.outside_s[vehicle_id] <= since_s, "it follows a stranger and did not say so"
