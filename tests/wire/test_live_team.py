"""The pictures of a team that flies in another process: against its stubs."""

import asyncio
import json
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from math import atan2, cos, dist, radians, sin

import numpy as np
import pytest

from agents.shell.clock import MissionClock, WallClock
from estimation.state import Vector
from gcs.console.vehicle_view import VehicleView
from gcs.flight.stubs import prepared_configs
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.station.live_team import LiveTeam
from gcs.station.picture import EventPicture, MissionPicture, OperatorRights, TeamPicture
from sitl.autopilot.modes import NavMode
from sitl.server.server import Stub
from tests.support.mission_text import LOW
from tests.support.wire import PATIENCE_S, running, served, until

pytestmark = [pytest.mark.wire, pytest.mark.long]

SPEED, DURATION_S = 4.0, 100.0
SOON = (
    ("distance_max_m = 12.0", "distance_max_m = 40.0"),
    ("range_m = 15.0", "range_m = 60.0"),
    ("start_m = [35.0, -5.0]", "start_m = [14.0, 0.0]"),
    ("velocity_m_s = [0.1, 0.0]", "velocity_m_s = [0.05, 0.0]"),
    (
        "separation_m = 3.0",
        "separation_m = 3.0\nfence_m = [[-30.0, -40.0], [60.0, -40.0], [60.0, 40.0], [-30.0, 40.0]]",
    ),
)
"""What makes the ring form soon, inside a fence."""
WITHIN_S = 0.5
"""How old what is shown may be [wall s], where the team flies at its full speed."""
NEAR_M = 0.15
"""How far off what is shown may be: the states go on unchanged within 0.1 m."""
MODES = {NavMode.OFFBOARD: "offboard", NavMode.HOLD: "hold", NavMode.LAND: "land", NavMode.TAKE_OFF: "take-off"}


@dataclass(frozen=True)
class Truth:
    """The true state of a team at one time of its clock."""

    time_s: float
    noted_s: float
    place_m: dict[int, tuple[float, float, float]]
    velocity_m_s: dict[int, tuple[float, float]]
    yaw_rad: dict[int, float]
    mode: dict[int, str]
    battery: dict[int, float]

    @classmethod
    def of(cls, time_s: float, stubs: dict[int, Stub], mission: Mission) -> "Truth":
        bodies = {i: stub.autopilot.airframe for i, stub in stubs.items()}
        x_bearing_rad = radians(mission.frame.x_bearing_deg)
        return cls(
            time_s,
            time.monotonic(),
            {i: body.position_m for i, body in bodies.items()},
            {i: body.velocity_m_s[:2] for i, body in bodies.items()},
            {i: x_bearing_rad - body.heading_rad for i, body in bodies.items()},
            {i: MODES.get(stub.autopilot.mode, "other") for i, stub in stubs.items()},
            {i: stub.autopilot.battery_fraction for i, stub in stubs.items()},
        )

    def nearest(self, vehicle_id: int) -> float:
        here_m = self.place_m[vehicle_id][:2]
        return min(dist(here_m, there_m[:2]) for i, there_m in self.place_m.items() if i != vehicle_id)

    def fence_margin(self, vehicle_id: int) -> float:
        x, y, _ = self.place_m[vehicle_id]
        return min(x + 30.0, 60.0 - x, y + 40.0, 40.0 - y)


@dataclass
class Scene:
    """A flight of stubs that are in this process, and what a page is sent of it."""

    mission: Mission
    stubs: dict[int, Stub] = field(default_factory=dict)
    truths: deque[Truth] = field(default_factory=lambda: deque(maxlen=200))
    teams: list[TeamPicture] = field(default_factory=list)
    clock: MissionClock = field(default_factory=WallClock)
    events: list[EventPicture] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    compared: int = 0

    def publish(self, picture: MissionPicture | TeamPicture | EventPicture) -> None:
        match picture:
            case TeamPicture():
                self.teams.append(picture)
                if picture.ring_members == 3 and all(each.fence_margin_m is not None for each in picture.vehicles):
                    self.compare(picture)
            case EventPicture():
                self.events.append(picture)
            case _:
                pytest.fail(f"published {picture}")

    @property
    def team(self) -> TeamPicture:
        return self.teams[-1]

    def compare(self, team: TeamPicture) -> None:
        """Note what of a picture was true at no time in the last half second."""
        before = [each for each in self.truths if each.time_s < self.clock.now_s() - WITHIN_S * SPEED]
        # What is shown may be newer than the truth that was noted last.
        recent = [*list(self.truths)[len(before) :], Truth.of(self.clock.now_s(), self.stubs, self.mission)]
        self.compared += 1
        age_max_s = time.monotonic() - before[-1].noted_s  # on a busy computer the team flies more slowly
        for shown in team.vehicles:
            self.faults += [
                f"{shown.vehicle_id}: {name}" for name, true in checks(shown, recent, age_max_s) if not true
            ]

    async def follow_truth(self) -> None:
        while True:
            if self.stubs:
                self.truths.append(Truth.of(self.clock.now_s(), self.stubs, self.mission))
            await self.clock.sleep(0.08)


def checks(shown: VehicleView, recent: Sequence[Truth], age_max_s: float) -> Iterable[tuple[str, bool]]:
    """Return for each field of a vehicle in control whether it was true at a time of late."""
    i = shown.vehicle_id

    def some(off: Callable[[Truth], float], near: float) -> bool:
        return any(abs(off(each)) <= near for each in recent)

    assert shown.position_m is not None
    assert shown.velocity_m_s is not None
    place_m, velocity_m_s, yaw_rad = shown.position_m, shown.velocity_m_s, shown.yaw_rad or 0.0
    yield "position", off_path_m(place_m, [each.place_m[i] for each in recent]) <= NEAR_M
    yield "velocity", some(lambda each: dist(velocity_m_s, each.velocity_m_s[i]), 0.3)
    yield "yaw", some(lambda each: angle(yaw_rad - each.yaw_rad[i]), 0.1)
    yield "mode", any(shown.mode == each.mode[i] for each in recent)
    yield "battery", abs((shown.autopilot.battery or 0.0) - recent[-1].battery[i]) <= 0.011
    yield "nearest", some(lambda each: (shown.nearest_m or 0.0) - each.nearest(i), 2.0 * NEAR_M)
    yield "fence margin", some(lambda each: (shown.fence_margin_m or 0.0) - each.fence_margin(i), NEAR_M)
    yield "satellites", (shown.autopilot.satellites, shown.autopilot.gps_dimensions, shown.estimator) == (14, 3, "good")
    yield "age", shown.age_s is not None and shown.age_s < age_max_s and not shown.is_stale
    yield "link age", shown.link_age_s is not None and shown.link_age_s < WITHIN_S
    yield "alert", (shown.alert, shown.advice, shown.severity, shown.has_ended) == ("", "", "information", False)


def off_path_m(place_m: tuple[float, float, float], path_m: Sequence[tuple[float, float, float]]) -> float:
    """Return how far a place is off the way along places: on a busy computer few of them were noted."""
    return min(off_leg_m(np.array(place_m), np.array(one), np.array(other)) for one, other in pairwise(path_m))


def off_leg_m(place_m: Vector, one_m: Vector, other_m: Vector) -> float:
    leg_m = other_m - one_m
    along = float(np.clip((place_m - one_m) @ leg_m / max(float(leg_m @ leg_m), 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(place_m - one_m - along * leg_m))


def angle(turn_rad: float) -> float:
    return atan2(sin(turn_rad), cos(turn_rad))


@asynccontextmanager
async def stubs(scene: Scene) -> AsyncIterator[None]:
    """Serve the mission's vehicles in this process."""
    async with served(prepared_configs(scene.mission, scene.mission.ids, 1.0), SPEED) as vehicles:
        scene.stubs, scene.clock = vehicles.stubs, vehicles.clock
        yield


@asynccontextmanager
async def watched(scene: Scene) -> AsyncIterator[None]:
    """Make pictures of it."""
    tasks = [asyncio.create_task(scene.follow_truth())]
    tasks.append(asyncio.create_task(LiveTeam(scene.mission, "sitl").run(scene.publish)))
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
        assert all(isinstance(each, asyncio.CancelledError) for each in ended), ended


async def test_pictures_are_the_truth_until_the_flight_ends(mission_file: Callable[..., str]) -> None:
    path = mission_file("case2", *SOON, LOW)
    scene = Scene(load_mission(path))
    live = LiveTeam(scene.mission)
    assert live.mission(OperatorRights("anna")).operator.name == "anna"
    async with stubs(scene), watched(scene):
        await until(lambda: bool(scene.teams) and "no flight" in scene.team.link, waiting_for="it waits for a flight")
        async with running("fly", path, "--duration", f"{DURATION_S:g}", "--no-log", "--json") as process:
            # A vehicle connects before its first motion arrives.
            await until(lambda: all(each.position_m for each in scene.team.vehicles), waiting_for="all on the ground")
            assert scene.team.link == ""
            for each in scene.team.vehicles:
                assert not each.is_stale
                assert each.position_m is not None
                assert dist(each.position_m, scene.truths[-1].place_m[each.vehicle_id]) < NEAR_M
            await until(lambda: scene.compared > 50, waiting_for="a ring of three")
            output, errors = await asyncio.wait_for(process.communicate(), PATIENCE_S)
            assert process.returncode in (0, 1), errors.decode()
        # The flight may be seen to be over before its last reports have arrived.
        await until(lambda: scene.team.ending == "landed", waiting_for="the end")
        assert [each.ending for each in scene.team.vehicles] == ["landed"] * 3
        await until(lambda: "no flight" in scene.team.link, waiting_for="the flight is over")
    assert not scene.faults, (len(scene.faults), scene.compared, scene.faults[:20])
    for vehicle_id in (1, 2, 3):
        texts = [each.text for each in scene.events if each.vehicle_id == vehicle_id]
        assert {"connected, tactic standby", "flight ended: landed"} <= set(texts)
        assert any(text.endswith(" -> return and land") for text in texts), texts
    assert [each.number for each in scene.events] == list(range(1, len(scene.events) + 1))
    assert json.loads(output)
