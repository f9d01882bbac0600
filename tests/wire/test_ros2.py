"""The bridge to ROS 2 on the wire: a node of the test's own packs and unpacks bytes by hand, and moves the ring."""

import asyncio
import json
import re
import signal
import struct
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from math import cos, dist, nan, pi, sin
from typing import NamedTuple

import numpy as np
import pytest
import zenoh

from gcs.flight.flight import FlightOutcome
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from gcs.ros2.sightings import PoseRefusal
from tests.support.cdr import Pose, pose_bytes, pose_of
from tests.support.flights import flying, in_flight, unseen_view
from tests.support.mission_text import LOW
from tests.support.wire import Served, free_port, hurried, running, served, until

pytestmark = pytest.mark.wire

SPEED = 5.0
TARGET_M_S = 0.5
DOMAIN = 7
POSE_KEY = (
    "geometry_msgs::msg::dds_::PoseStamped_/RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
)
COVARIANCE_KEY = (
    "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/"
    "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
)
"""Types with the hashes that ROS 2 publishes for geometry_msgs (REP 2011), as every installation has them."""
EXTERNAL = ("[target]\n", '[target]\nsource = "external"\n')
BEARING = ("x_bearing_deg = 90.0", "x_bearing_deg = 30.0")
RADIUS_M = 10.0


def enu_m(x_m: float, y_m: float) -> tuple[float, float, float]:
    """Return east, north, up of a place in the mission: x is 30 degrees clockwise from north, y to its left."""
    return x_m * sin(pi / 6) - y_m * cos(pi / 6), x_m * cos(pi / 6) + y_m * sin(pi / 6), 0.0


def centre_m(places_m: list[tuple[float, ...]]) -> tuple[float, float]:
    """Return the centre of the circle through three places; not numbers for places in a line, as in formation."""
    (ax, ay, *_), (bx, by, *_), (cx, cy, *_) = places_m
    rows = 2.0 * np.array([[bx - ax, by - ay], [cx - ax, cy - ay]])
    if abs(np.linalg.det(rows)) < 1e-6:
        return nan, nan
    east, north = np.linalg.solve(rows, [bx**2 - ax**2 + by**2 - ay**2, cx**2 - ax**2 + cy**2 - ay**2])
    return float(east), float(north)


@contextmanager
def ros_router() -> Iterator[str]:
    """Run a router as rmw_zenohd does, and return its endpoint."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with zenoh.open(zenoh_config("router", "listen", endpoint)):
        yield endpoint


def zenoh_config(mode: str, does: str, endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5(f"{does}/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


class Node:
    """A node of ROS that sees the target, and knows where the vehicles are."""

    def __init__(self, router: str) -> None:
        self.session = zenoh.open(zenoh_config("client", "connect", router))
        self.poses: dict[int, Pose] = {}
        self.goal_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self.attachments: dict[int, list[tuple[int, int, bytes]]] = {}
        for number in (1, 2, 3):
            self.session.declare_subscriber(f"{DOMAIN}/vehicle_{number}/pose/{POSE_KEY}", self._taker(number))

    def _taker(self, number: int) -> Callable[[zenoh.Sample], None]:
        def take(sample: zenoh.Sample) -> None:
            assert sample.attachment is not None
            sent, stamp_ns, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
            assert length == 16
            self.attachments.setdefault(number, []).append((sent, stamp_ns, gid))
            self.poses[number] = pose_of(sample.payload.to_bytes())

        return take

    @property
    def places_m(self) -> list[tuple[float, ...]]:
        """Where the vehicles are, in the frame of ROS."""
        return [self.poses[number].place_m for number in sorted(self.poses)]

    @property
    def off_ring_m(self) -> tuple[tuple[float, float], float]:
        """The centre of the circle through the vehicles, and by how much its radius differs from the ring's."""
        centre = centre_m(self.places_m)
        return centre, abs(dist(centre, self.places_m[0][:2]) - RADIUS_M)

    def put(self, type_key: str, payload: bytes) -> None:
        """Publish on the topic of sightings."""
        self.session.put(f"{DOMAIN}/tracker/pose/{type_key}", payload, attachment=struct.pack("<qqB16s", 1, 1, 16, b""))

    def see(self, place_m: Sequence[float]) -> None:
        """Publish a target's place, at the time of the newest pose: within 0.2 m to the east, 0.1 m to the north."""
        covariance = [0.0] * 36
        covariance[0], covariance[7], covariance[14] = 0.04, 0.01, 1.0
        newest = self.poses[1]
        stamp = (newest.seconds, newest.nanoseconds)
        self.put(COVARIANCE_KEY, pose_bytes(place_m, stamp=stamp, covariance=covariance))

    @asynccontextmanager
    async def seeing(self) -> AsyncIterator[None]:
        """Publish the target's place 20 times a second inside this context; it goes to `goal_m` at 0.5 m/s."""
        place_m, before_s = np.array(self.goal_m), self.time_s

        async def repeat() -> None:
            nonlocal place_m, before_s
            while True:
                way_m, passed_s, before_s = self.goal_m - place_m, self.time_s - before_s, self.time_s
                place_m = place_m + way_m * min(1.0, TARGET_M_S * passed_s / max(float(np.linalg.norm(way_m)), 1e-9))
                self.see(place_m.tolist())
                await asyncio.sleep(0.05)

        repeating = asyncio.create_task(repeat())
        try:
            yield
        finally:
            repeating.cancel()

    @property
    def time_s(self) -> float:
        """The time of the newest pose."""
        return self.poses[1].seconds + self.poses[1].nanoseconds / 1e9


class TrackedFlight(NamedTuple):
    """A flight of three stubs in formation, and a node of ROS beside it: the router, and the mission's file."""

    path: str
    router: str
    node: Node
    stubs: Served
    task: asyncio.Task[FlightOutcome]

    async def until(self, condition: Callable[[], bool], waiting_for: str) -> None:
        """Wait for a condition in flight."""
        await in_flight(self.task, condition, waiting_for, self.stubs.clock)

    def settled_about(self, place_m: tuple[float, ...]) -> bool:
        """Return whether the poses that the node has received are on a ring of the mission's radius about a place."""
        centre, off_m = self.node.off_ring_m
        return off_m < 0.3 and dist(centre, place_m[:2]) < 0.3


@pytest.fixture
async def tracked(mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[TrackedFlight]:
    """Return case2 along a bearing of 30 degrees in formation, with a target that only sensors outside see."""
    path = mission_file("case2", LOW, ('name = "case2"', 'name = "tracked"'), EXTERNAL, BEARING)
    mission, view, tactics = load_mission(path), unseen_view(), dict[int, str]()
    monkeypatch.setattr(view, "update", lambda rows, *_: tactics.update({row.vehicle_id: row.tactic for row in rows}))
    with ros_router() as router:
        node = Node(router)
        async with served(stub_configs(mission), SPEED) as stubs:
            plan = FlightPlan(mission, 600.0, mission.vehicles, speed=None, clock=stubs.clock.name)
            async with flying(plan, view) as task:
                flight = TrackedFlight(path, router, node, stubs, task)
                with hurried(stubs.clock):
                    await flight.until(lambda: list(tactics.values()) == ["formation"] * 3, "formation")
                yield flight
        node.session.close()  # type: ignore[no-untyped-call]


async def test_a_stream_of_poses_moves_the_ring_and_the_vehicles_poses_are_read_back(
    tracked: TrackedFlight, subtests: pytest.Subtests
) -> None:
    """What is no sighting does not move it, and is counted; the bridge ends, the flight goes on."""
    node, begun_m, moved_m = tracked.node, enu_m(8.0, 0.0), enu_m(14.0, -5.0)
    options = ("--router", tracked.router, "--domain", str(DOMAIN), "--sightings", "/tracker/pose")
    async with running("ros2", tracked.path, *options) as bridge:
        await until(lambda: bridge.returncode is not None or len(node.poses) == 3, waiting_for="the vehicles' poses")
        assert bridge.returncode is None, (await bridge.communicate())[1].decode()
        with subtests.test("poses are where the vehicles are, at the time of the team's clock"):
            for number, stub in tracked.stubs.vehicles.items():
                x_m, y_m, z_m = stub.airframe.position_m
                shown, (east_m, north_m, _) = node.poses[number], enu_m(x_m, y_m)
                assert shown.frame == "map"
                assert shown.place_m == pytest.approx((east_m, north_m, z_m), abs=1.0)
                assert shown.seconds == pytest.approx(tracked.stubs.clock.now_s(), abs=5.0)
        with subtests.test("messages are numbered, by a publisher of a name of its own"):
            for received in node.attachments.values():
                numbers = [sent for sent, _, _ in received]
                assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
            assert len({gid for received in node.attachments.values() for _, _, gid in received}) == 3
        with subtests.test("ROS lists node, publishers and subscriptions"):
            assert_listed(node.session)
        node.goal_m = begun_m
        async with node.seeing():
            with subtests.test("the team encircles what ROS sees"):
                await tracked.until(lambda: tracked.settled_about(begun_m), "a ring")
            with subtests.test("the ring follows it"):
                node.goal_m = moved_m
                await tracked.until(lambda: tracked.settled_about(moved_m), "the ring to follow")
            with subtests.test("what is no sighting changes nothing"):
                for _, type_key, payload in (refused := no_sightings(node.poses[1])):
                    node.put(type_key, payload)
                begin_s = tracked.stubs.clock.now_s()
                await tracked.until(lambda: tracked.stubs.clock.now_s() > begin_s + 10.0, "10 s")
                assert tracked.settled_about(moved_m)
        bridge.send_signal(signal.SIGINT)
        _, output = await bridge.communicate()
        assert bridge.returncode == 0
        summary = output.decode().splitlines()[-1]
        with subtests.test("each is counted by its reason; a busy computer's own late ones as well"):
            for refusal, _, _ in refused:
                assert re.search(rf"\b[1-9]\d*: {re.escape(refusal.value)}", summary), summary
    assert not tracked.task.done()


def assert_listed(session: zenoh.Session) -> None:
    """Check the tokens by which `ros2 node list` and `ros2 topic info` find it."""
    tokens = {str(reply.ok.key_expr) for reply in session.liveliness().get(f"@ros2_lv/{DOMAIN}/**") if reply.ok}
    (session_id,) = {token.split("/")[2] for token in tokens}
    begin = f"@ros2_lv/{DOMAIN}/{session_id}/0"
    expected = {f"{begin}/0/NN/%/%/cordon"}
    for number, (role, topic, type_key) in enumerate(
        [("MS", "%tracker%pose", POSE_KEY), ("MS", "%tracker%pose", COVARIANCE_KEY)]
        + [("MP", f"%vehicle_{vehicle}%pose", POSE_KEY) for vehicle in (1, 2, 3)]
    ):
        entity = number + 1 if role == "MS" else number + 9
        expected.add(f"{begin}/{entity}/{role}/%/%/cordon/{topic}/{type_key}/::,10:,:,:,,")
    assert tokens == expected


def no_sightings(pose: Pose) -> list[tuple[PoseRefusal, str, bytes]]:
    """Return messages that are no sightings of a target 60 m away, each with the reason why."""
    far_m, stamp = (60.0, 60.0, 0.0), (pose.seconds, pose.nanoseconds)
    whole = pose_bytes(far_m, stamp=stamp)
    return [
        (PoseRefusal.TYPE, "geometry_msgs::msg::dds_::PointStamped_/" + POSE_KEY.partition("/")[2], whole),
        (PoseRefusal.LENGTH, POSE_KEY, bytes(2000)),
        (PoseRefusal.MALFORMED, POSE_KEY, whole[:-9]),
        (PoseRefusal.NUMBERS, POSE_KEY, pose_bytes((60.0, nan, 0.0), stamp=stamp)),
        (PoseRefusal.FRAME, POSE_KEY, pose_bytes(far_m, stamp=stamp, frame="odom")),
        (PoseRefusal.STALE, POSE_KEY, pose_bytes(far_m, stamp=(pose.seconds - 60, 0))),
        (PoseRefusal.COVARIANCE, COVARIANCE_KEY, pose_bytes(far_m, stamp=stamp, covariance=[-1.0] * 36)),
    ]
