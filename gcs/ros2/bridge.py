"""The bridge: sightings of the target from a node of ROS 2 to a team, and the vehicles' poses to ROS.

It holds two sessions of Zenoh, which do not forward to each other: on the team's bus it is a sensor with the keys of
one, on the side of ROS, which has no keys, a client of its router.
"""

import asyncio
import json
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import atan2, hypot
from time import monotonic

import zenoh

from agents.ports import VehicleRefusedError
from agents.team.messages import BusMessage, MemberState
from agents.team.perception import TOPIC
from agents.team.text import printable
from gcs.console.command_client import TeamClock
from gcs.console.team_bus import guest_bus
from gcs.console.team_state import TeamMissions
from gcs.keys.identity import Identity
from gcs.mission.mission import Mission
from gcs.ros2.bag import pose_topic
from gcs.ros2.enu import enu_from_mission, yaw_enu_rad
from gcs.ros2.messages import POSE, POSE_COVARIANCE, Messages
from gcs.ros2.rmw_zenoh import RosEndpoint, attachment, gid, node_token
from gcs.ros2.sightings import PoseRefusal, PoseSightings, RefusedError, SightingDefaults
from gcs.viewer.drawing import MOVING_M_S

_CONNECT_MS = 5000
_MESSAGE_LIMIT_BYTES = 65_536
"""Zenoh drops larger messages before it has reassembled them."""
_WAITING_MAX = 64
"""Messages from ROS that wait for the event loop; more are dropped and counted."""
_POLL_S = 0.1


@dataclass(frozen=True, slots=True)
class RosSide:
    """Where ROS is: the endpoint of its router, its domain, and the topic of the sightings (`target/pose`)."""

    router: str
    domain: int
    sightings: str


class RosSession:
    """A session on the side of ROS: publishers of the vehicles' poses and a subscription to the sightings."""

    def __init__(self, side: RosSide, messages: Messages, take: Callable[[str, bytes], None]) -> None:
        """Join ROS; `take` gets the key and bytes of each message, on another thread. Blocks.

        Raises VehicleRefusedError if the router does not answer.
        """
        self._side, self._messages, self._take = side, messages, take
        settings: dict[str, object] = {
            "mode": "client",
            "connect/endpoints": [side.router],
            "connect/timeout_ms": _CONNECT_MS,
            "scouting/multicast/enabled": False,
            "adminspace/enabled": False,
            "transport/link/rx/max_message_size": _MESSAGE_LIMIT_BYTES,
            "transport/shared_memory/enabled": False,
        }
        try:
            config = zenoh.Config()
            for path, value in settings.items():
                config.insert_json5(path, json.dumps(value))
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise VehicleRefusedError(
                f"the router of ROS, {side.router}, does not answer",
                "start it by `ros2 run rmw_zenoh_cpp rmw_zenohd`, or name its endpoint by --router",
            ) from error
        self._id = str(self._session.info.zid())
        self._publishers: dict[int, _Publisher] = {}
        live = self._session.liveliness()
        self._tokens = [live.declare_token(node_token(side.domain, self._id))]
        for number, kind in enumerate((POSE, POSE_COVARIANCE), start=1):
            token = self._endpoint(side.sightings, kind).token(self._id, number, "MS")
            self._tokens.append(live.declare_token(token))
        # Of any type: those of another are counted.
        callback = zenoh.handlers.Callback(self._receive)
        self._session.declare_subscriber(f"{side.domain}/{side.sightings}/*/*", callback)

    def publish(self, vehicle_id: int, stamp_ns: int, payload: bytes) -> None:
        """Publish a vehicle's pose, best effort."""
        publisher = self._publishers.get(vehicle_id)
        if publisher is None:
            endpoint = self._endpoint(pose_topic(vehicle_id).removeprefix("/"), POSE)
            token = endpoint.token(self._id, 10 + vehicle_id, "MP")
            self._tokens.append(self._session.liveliness().declare_token(token))
            sending = self._session.declare_publisher(
                endpoint.key, congestion_control=zenoh.CongestionControl.DROP, express=True
            )
            publisher = self._publishers[vehicle_id] = _Publisher(sending, gid(token))
        publisher.send(stamp_ns, payload)

    def close(self) -> None:
        """Leave ROS; blocks."""
        self._session.close()  # type: ignore[no-untyped-call]

    def _endpoint(self, topic: str, kind: str) -> RosEndpoint:
        return RosEndpoint(self._side.domain, topic, kind, self._messages.type_hash(kind))

    def _receive(self, sample: zenoh.Sample) -> None:
        self._take(str(sample.key_expr), sample.payload.to_bytes())


class _Publisher:
    """A publisher of ROS, which numbers its messages from 1."""

    def __init__(self, sending: zenoh.Publisher, publisher: bytes) -> None:
        self._sending, self._gid, self._number = sending, publisher, 0

    def send(self, stamp_ns: int, payload: bytes) -> None:
        self._number += 1
        self._sending.put(payload, attachment=attachment(self._number, stamp_ns, self._gid))


class Bridge:
    """Carries sightings and poses between a team and ROS."""

    def __init__(
        self,
        mission: Mission,
        sensor: Identity,
        side: RosSide,
        defaults: SightingDefaults,
        report: Callable[[str], None],
    ) -> None:
        """Take the sensor to send sightings as; `report` is called with each new reason of a refusal.

        Raises InputError if rosbags is missing.
        """
        self._mission, self._side, self._report = mission, side, report
        self._messages = Messages(defaults.frame_id)
        self._bus = guest_bus(mission, sensor)
        self._clock, self._missions = TeamClock(), TeamMissions(mission)
        self._loop = asyncio.get_running_loop()
        self._lock = threading.Lock()
        self._waiting: deque[tuple[str, bytes]] = deque()
        self._ros: RosSession | None = None
        self._yaws_rad: dict[int, float] = {}
        self._reported = ""
        self.sightings = PoseSightings(mission, self._messages, defaults)
        """The sightings taken and refused so far."""
        self.poses = 0
        """How many poses were sent to ROS."""

    async def run(self, stop: asyncio.Event) -> None:
        """Carry messages until `stop`.

        Raises VehicleRefusedError if the router of ROS or the team's bus cannot be joined, or the team flies another
        mission.
        """
        self._ros = await asyncio.to_thread(RosSession, self._side, self._messages, self._receive)
        try:
            await self._bus.open(self._take, lambda *_: None, lambda *_: None)
            while not stop.is_set():
                self._missions.refuse_other()
                if (difference := self._missions.difference) and difference != self._reported:
                    self._reported = difference
                    self._report(difference)
                await _wait(stop)
        finally:
            await self._bus.close()
            await asyncio.to_thread(self._ros.close)

    @property
    def summary(self) -> str:
        """What it has carried, and what it refused, by reason."""
        refused = self.sightings.refused
        reasons = ", ".join(f"{count}: {reason.value}" for reason, count in sorted(refused.items(), key=str))
        carried = f"{self.poses} poses sent to ROS, {self.sightings.taken} sightings to the team"
        return f"{carried}, {refused.total()} messages refused{f' ({reasons})' if reasons else ''}"

    def _receive(self, key: str, payload: bytes) -> None:
        """Take a message of ROS, on a thread of Zenoh."""
        with self._lock:
            if len(self._waiting) >= _WAITING_MAX:
                self.sightings.refused[PoseRefusal.RATE] += 1
                return
            self._waiting.append((key, payload))
            if len(self._waiting) > 1:
                return
        self._loop.call_soon_threadsafe(self._forward)

    def _forward(self) -> None:
        with self._lock:
            waiting = list(self._waiting)
            self._waiting.clear()
        for key, payload in waiting:
            try:
                self._bus.publish(TOPIC, self._sighting(key, payload))
            except RefusedError as error:
                if self.sightings.refused[error.refusal] == 1:
                    self._report(printable(f"message of ROS refused, reported once: {error}"))

    def _sighting(self, key: str, payload: bytes) -> bytes:
        """Return the sighting in a message; raises RefusedError, also while no vehicle flies this mission."""
        now_s = monotonic()
        return self.sightings.take(key, payload, self._team_s(now_s), now_s)

    def _team_s(self, now_s: float) -> float | None:
        """Return the team's time, None while no vehicle flies this version of the mission."""
        try:
            self._missions.require_version("ros2")
        except VehicleRefusedError:
            return None
        return self._clock.now_s(now_s)

    def _take(self, message: BusMessage) -> None:
        """Take a message of the team."""
        self._missions.receive(message)
        if not isinstance(message, MemberState):
            return
        self._clock.receive(message.sender, message.time_s, monotonic())
        if self._ros is None or message.sender not in self._mission.ids:
            return
        frame, (x, y), (x_rate, y_rate) = self._mission.mission_frame(), message.position_m, message.velocity_m_s
        if hypot(x_rate, y_rate) >= MOVING_M_S:
            self._yaws_rad[message.sender] = atan2(y_rate, x_rate)
        stamp_ns, yaw_rad = round(message.time_s * 1e9), self._yaws_rad.get(message.sender, 0.0)
        place_m = enu_from_mission(frame, (x, y, message.altitude_m))
        self._ros.publish(message.sender, stamp_ns, self._messages.pose(stamp_ns, place_m, yaw_enu_rad(frame, yaw_rad)))
        self.poses += 1


async def _wait(stop: asyncio.Event) -> None:
    with suppress(TimeoutError):
        await asyncio.wait_for(stop.wait(), _POLL_S)
