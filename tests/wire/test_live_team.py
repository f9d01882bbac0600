"""The pictures of a team that flies in another process: against its stubs, its log, and its replay.

Its log is replayed: every decision is the same again.
"""

import asyncio
import json
import os
import sys
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from math import atan2, cos, dist, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.inputs import Start
from agents.shell.clock import MissionClock, WallClock
from agents.team.codec import decode
from agents.team.messages import MemberState
from estimation.state import Vector
from gcs.console.vehicle_view import VehicleView
from gcs.flight.stubs import prepared_configs
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Decision
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.replay.cores import replay
from gcs.replay.timeline import timeline_of
from gcs.station.live_team import LiveTeam
from gcs.station.picture import EventPicture, FlightPicture, MissionPicture, OperatorRights, TeamPicture
from gcs.station.recorded_flight import recorded_flight
from sitl.autopilot.modes import NavMode
from sitl.server.server import Stub
from tests.support.mission_text import LOW
from tests.support.wire import served, until

pytestmark = [pytest.mark.wire, pytest.mark.long]

SPEED, DURATION_S = 4.0, 50.0
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
NEAR_M, NEAR_RAD = 0.15, 0.03
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
    published_s: list[float] = field(default_factory=list)
    clock: MissionClock = field(default_factory=WallClock)
    events: list[EventPicture] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    compared: int = 0

    def publish(self, picture: MissionPicture | TeamPicture | EventPicture) -> None:
        match picture:
            case TeamPicture():
                self.teams.append(picture)
                self.published_s.append(self.clock.now_s())
                if picture.ring_members == 3 and all(each.fence_margin_m is not None for each in picture.vehicles):
                    self.compare(picture)
            case EventPicture():
                self.events.append(picture)
            case _:
                pytest.fail(f"published {picture}")

    @property
    def team(self) -> TeamPicture:
        return self.teams[-1]

    def vehicle(self, vehicle_id: int) -> VehicleView:
        return next(each for each in self.team.vehicles if each.vehicle_id == vehicle_id)

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
async def fly(mission: str, log: Path, duration_s: float) -> AsyncIterator[asyncio.subprocess.Process]:
    """Fly in a process of its own."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gcs", "fly", mission, "--duration", f"{duration_s:g}", "--log", str(log), "--json"),
        stdout=pipe, stderr=pipe, env={**os.environ, "TERM": "dumb", "NO_COLOR": "1"},
    )  # fmt: skip
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


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


def compare_tactics(scene: Scene, log: FlightLog, vehicle_id: int) -> None:
    """Compare the changes of tactic with the log: in order and to the last; one that lasts for a tick may be missed."""
    decided = iter([each for each, _ in groupby(decision.tactic for decision in log.of_kind(vehicle_id, Decision))])
    shown = [tuple(each.text.split(" -> ")) for each in scene.events if each.vehicle_id == vehicle_id]
    changes = [each for each in shown if len(each) == 2 and not each[0].startswith("mode ")]
    assert [before for before, _ in changes] == ["standby", *(after for _, after in changes[:-1])]
    assert all(after in decided for _, after in changes), changes
    assert list(decided) == []


async def test_pictures_are_the_truth_until_the_flight_ends(mission_file: Callable[..., str], tmp_path: Path) -> None:
    path, log_path = mission_file("case2", *SOON, LOW), tmp_path / "flight.mcap"
    scene = Scene(load_mission(path))
    live = LiveTeam(scene.mission)
    assert live.mission(OperatorRights("anna")).operator.name == "anna"
    async with stubs(scene), watched(scene):
        await until(lambda: bool(scene.teams) and "no flight" in scene.team.link, waiting_for="it waits for a flight")
        async with fly(path, log_path, DURATION_S) as process:
            # A vehicle connects before its first motion arrives.
            await until(lambda: all(each.position_m for each in scene.team.vehicles), waiting_for="all on the ground")
            assert scene.team.link == ""
            for each in scene.team.vehicles:
                assert not each.is_stale
                assert each.position_m is not None
                assert dist(each.position_m, scene.truths[-1].place_m[each.vehicle_id]) < NEAR_M
            await until(lambda: scene.compared > 50, waiting_for="a ring of three", clock=scene.clock)
            output, errors = await process.communicate()
            assert process.returncode in (0, 1), errors.decode()
        # The flight may be seen to be over before its last reports have arrived.
        await until(lambda: scene.team.ending == "landed", waiting_for="the end")
        assert [each.ending for each in scene.team.vehicles] == ["landed"] * 3
        await until(lambda: "no flight" in scene.team.link, waiting_for="the flight is over")
    assert not scene.faults, (len(scene.faults), scene.compared, scene.faults[:20])
    log = read_log(log_path)
    compare_with_log(scene, log)
    compare_with_replay(scene, recorded_flight(log))
    replay_bit_for_bit(log)
    texts = {(each.vehicle_id, each.text) for each in scene.events}
    for vehicle_id in (1, 2, 3):
        for text in ("connected, tactic standby", "flight ended: landed"):
            assert (vehicle_id, text) in texts
        compare_tactics(scene, log, vehicle_id)
    assert [each.number for each in scene.events] == list(range(1, len(scene.events) + 1))
    assert json.loads(output)


def compare_with_log(scene: Scene, log: FlightLog) -> None:
    """Compare time, tactic, setpoint, ring and target with what the flight recorded, and with where the target was."""
    start_s = next(log.of_kind(1, Start)).at_s
    decisions = {i: list(log.of_kind(i, Decision)) for i in (1, 2, 3)}
    compared = 0
    for team, now_s in list(zip(scene.teams, scene.published_s, strict=True))[::5]:
        if team.ring_members < 3 or team.time_s is None or team.remaining_s is None:
            continue
        assert abs(team.time_s - (now_s - start_s)) <= WITHIN_S * SPEED
        assert abs(team.time_s + team.remaining_s - DURATION_S) < 1e-6
        target_m = scene.mission.target.motion.position_m(team.time_s)
        assert team.target is not None
        assert dist(team.target.position_m, target_m) < NEAR_M
        assert 0.0 <= team.target.sighting_age_s < WITHIN_S * SPEED
        for shown in team.vehicles:
            near = [each for each in decisions[shown.vehicle_id] if abs(each.time_s - now_s) <= WITHIN_S * SPEED]
            compare_with_decisions(shown, near)
            compared += 1
    assert compared > 30


def compare_with_replay(scene: Scene, replayed: FlightPicture) -> None:
    """Compare what the page replays with what it showed in flight at that time of the mission."""
    assert replayed.teams[-1].ending == "Landed and disarmed"
    last_s = replayed.teams[-1].time_s or 0.0
    assert all((each.time_s or 0.0) <= last_s for each in replayed.events), "the last picture shows them all"
    timed = [(team.time_s, team) for team in replayed.teams if team.time_s is not None]
    compared = 0
    for team in (each for each in scene.teams if each.ring_members == 3):
        assert team.time_s is not None
        (one_s, one), (other_s, other) = sorted(timed, key=lambda each: abs(each[0] - (team.time_s or 0.0)))[:2]
        assert abs(one_s - team.time_s) <= abs(other_s - one_s)
        for live, *later in zip(team.vehicles, one.vehicles, other.vehicles, strict=True):
            compared += 1
            for name in ("vehicle_id", "tactic", "mode", "estimator", "alert", "is_stale"):
                assert getattr(live, name) in {getattr(each, name) for each in later}, name
            near = later[0]
            assert live.autopilot.satellites == near.autopilot.satellites
            assert live.autopilot.gps_dimensions == near.autopilot.gps_dimensions
            assert abs((live.autopilot.battery or 0.0) - (near.autopilot.battery or 0.0)) <= 0.011
            assert dist(live.position_m or (), near.position_m or ()) < 1.0
    assert compared >= 3 * 5, compared


def replay_bit_for_bit(log: FlightLog) -> None:
    """Replay the flight: every decision is the same again."""
    replayed = replay(log)
    assert (replayed.same, replayed.other_versions) == (True, ())
    assert [vehicle.vehicle_id for vehicle in replayed.vehicles] == [1, 2, 3]
    for vehicle in replayed.vehicles:
        assert vehicle.ticks == vehicle.compared == vehicle.identical
        assert vehicle.ticks > 0.7 * 10.0 * DURATION_S, "it has flown, and skipped few ticks"
    lines = [entry.text for entry in timeline_of(log, 2).entries]
    for passage in ("standby -> formation: start", "formation -> encircle: engage", "mode offboard"):
        assert passage in lines
    assert any(line.startswith("return and land -> land") for line in lines)


def compare_with_decisions(shown: VehicleView, near: Sequence[Any]) -> None:
    """Compare with decisions before and after the picture: the page may hear of a ring's member before a vehicle."""
    assert shown.aim_m is not None
    assert any(each.tactic == shown.tactic for each in near)
    sent = [decode(each.payload) for decision in near for each in decision.sent]
    assert shown.aim_m in [each.aim_m for each in sent if isinstance(each, MemberState)]
    polar = [each.polar for each in near if each.polar is not None]
    assert min(abs(each.radius_m - (shown.radius_m or 0.0)) for each in polar) < NEAR_M
    assert min(abs(each.angular_rate_rad_s - (shown.angular_rate_rad_s or 0.0)) for each in polar) < NEAR_RAD
    leads_rad = [each.place.lead_rad for each in near if each.place is not None and each.place.lead_rad is not None]
    assert not leads_rad or min(abs(each - (shown.lead_rad or 0.0)) for each in leads_rad) < 2.0 * NEAR_RAD
