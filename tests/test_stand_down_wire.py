"""The pilot wins: who changes a vehicle's flight mode has it, until an operator sends the vehicle back by command."""

import asyncio
import socket
from collections import defaultdict
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from agents.agent import Ending
from gcs.flight import Flight, FlightPlan, fly
from gcs.live import LiveView
from gcs.mission import Mission
from gcs.mission_file import parse_mission
from gcs.operator import Operator
from gcs.stubs import stub_configs
from sitl.autopilot import Autopilot
from sitl.modes import NavMode
from sitl.process import unix_clock
from sitl.server import serve

pytestmark = pytest.mark.wire

SPEED = 4.0
CASE2 = Path(__file__).parents[1] / "gcs" / "missions" / "case2.toml"


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as attempt:
        attempt.bind(("127.0.0.1", 0))
        return int(attempt.getsockname()[1])


@pytest.fixture
def mission() -> Mission:
    """Return case2 on ports of its own."""
    text = CASE2.read_text(encoding="utf-8")
    for port in ("14540", "14541", "14542"):
        text = text.replace(port, str(free_port(socket.SOCK_DGRAM)))
    for port in ("7461", "7462", "7463"):
        text = text.replace(port, str(free_port(socket.SOCK_STREAM)))
    return parse_mission(text.replace('name = "case2"', 'name = "stand-down"'), CASE2.parent)


class Setpoints:
    """When each stub vehicle received setpoints, and the vehicles themselves by their start."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.received_s: defaultdict[Autopilot, list[float]] = defaultdict(list)
        receive = Autopilot.receive_setpoint

        def spy(autopilot: Autopilot, time_s: float, target: object) -> None:
            self.received_s[autopilot].append(asyncio.get_running_loop().time())
            receive(autopilot, time_s, target)  # type: ignore[arg-type]

        monkeypatch.setattr(Autopilot, "receive_setpoint", spy)

    def vehicle_at(self, start_m: tuple[float, float]) -> Autopilot:
        def away(autopilot: Autopilot) -> float:
            x, y, _ = autopilot.airframe.position_m
            return abs(x - start_m[0]) + abs(y - start_m[1])

        return min(self.received_s, key=away)


async def until(condition: Callable[[], bool], timeout_s: float = 20.0) -> float:
    """Wait for a condition and return when it came true."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + timeout_s
    while not condition():
        assert loop.time() < end_s, "it never came true"
        await asyncio.sleep(0.005)
    return loop.time()


async def test_a_foreign_mode_is_obeyed_at_once_and_left_only_by_command(
    mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    setpoints = Setpoints(monkeypatch)
    output = StringIO()
    rows: dict[int, str] = {}
    view = LiveView(Console(file=output))
    monkeypatch.setattr(view, "update", lambda team, *_: rows.update({row.vehicle_id: row.tactic for row in team}))
    stop = asyncio.Event()
    stubs = asyncio.create_task(serve(stub_configs(mission), speed=SPEED, now_s=unix_clock(SPEED), stop=stop))
    plan = FlightPlan(mission, 60.0, mission.vehicles, stubs=False, speed=SPEED)
    flight: asyncio.Task[Flight] = asyncio.create_task(fly(plan, view))
    try:
        await until(lambda: list(rows.values()) == ["formation"] * 3)
        await asyncio.sleep(1.0)
        taken = setpoints.vehicle_at((0.0, -5.0))  # vehicle 3, gone to its place in line
        taken.select(NavMode.HOLD)
        told_s = await until(lambda: rows[3] == "stood down", 2.0) + 0.1  # those still in the sockets arrive first
        await asyncio.sleep(1.5)
        late = [at_s for at_s in setpoints.received_s[taken] if at_s > told_s]
        assert late == [], "setpoints after standing down"
        assert taken.mode is NavMode.HOLD
        assert (rows[1], rows[2]) == ("formation", "formation")

        answers = await Operator(mission).command("resume", (3,), 3)
        assert answers[3] is not None
        await until(lambda: taken.mode is NavMode.OFFBOARD, 3.0)
        assert setpoints.received_s[taken][-1] > told_s
        outcomes = (await flight).outcomes
    finally:
        flight.cancel()
        stop.set()
        await asyncio.gather(stubs, flight, return_exceptions=True)
    assert [outcome.ending for outcome in outcomes.values()] == [Ending.COMPLETED] * 3


async def test_a_vehicle_that_was_taken_is_not_landed_at_the_end(
    mission: Mission, monkeypatch: pytest.MonkeyPatch
) -> None:
    setpoints = Setpoints(monkeypatch)
    rows: dict[int, str] = {}
    view = LiveView(Console(file=StringIO()))
    monkeypatch.setattr(view, "update", lambda team, *_: rows.update({row.vehicle_id: row.tactic for row in team}))
    stop = asyncio.Event()
    stubs = asyncio.create_task(serve(stub_configs(mission), speed=SPEED, now_s=unix_clock(SPEED), stop=stop))
    flight = asyncio.create_task(fly(FlightPlan(mission, 20.0, mission.vehicles, stubs=False, speed=SPEED), view))
    try:
        await until(lambda: list(rows.values()) == ["formation"] * 3)
        taken = setpoints.vehicle_at((0.0, 0.0))
        taken.select(NavMode.HOLD)
        outcomes = (await flight).outcomes
    finally:
        stop.set()
        await asyncio.gather(stubs, flight, return_exceptions=True)
    endings = {vehicle_id: outcome.ending for vehicle_id, outcome in outcomes.items()}
    assert endings == {1: Ending.COMPLETED, 2: Ending.STOOD_DOWN, 3: Ending.COMPLETED}
    assert taken.armed, "left in the air to whoever took it"
    assert "'hold'" in outcomes[2].reason
