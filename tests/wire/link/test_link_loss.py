"""Links that break in mid-ring and autopilots that restart there: what the vehicle, its agent and the others do."""

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import replace
from io import StringIO
from itertools import pairwise
from math import dist
from typing import Any, Self, cast

import pytest
from rich.console import Console

from agents.flight_end import FlightEnd
from agents.ports import FlightMode, Setpoint, VehicleRefusedError
from agents.shell.clock import WallClock
from agents.shell.ticker import Ticker
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Telemetry
from gcs.console.command_client import CommandClient
from gcs.console.live import LiveView
from gcs.console.vehicle_view import TeamRow
from gcs.flight.flight import FlightOutcome, fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.link.config import LinkConfig
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.link.ports import free_ports
from gcs.link.rates import ATTITUDE, LOCAL_POSITION_NED
from gcs.metrics.journal import event_line
from gcs.metrics.record import FlightEvent
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade
from sitl.autopilot.autopilot import StubAutopilot
from sitl.autopilot.guidance import PositionTarget
from sitl.autopilot.modes import NavMode
from sitl.server.endpoint import StubClock
from sitl.server.governed_clock import GovernedClock
from sitl.server.server import Stub, StubConfig
from tests.support.wire import LOOPBACK, hurried, served_by, stub_clock, until

pytestmark = pytest.mark.wire

SPEED = 5.0
RATE_HZ = 20.0
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0))
PLANT = Plant(PlantAxis(0.8, 0.87), PlantAxis(0.8, 0.87))
NEAR = (
    ("distance_max_m = 15.0", "distance_max_m = 40.0"),
    ("range_m = 25.0", "range_m = 60.0"),
    ("start_m = [20.0, 0.0]", "start_m = [12.0, 0.0]"),
    ("radius_m = 10.0", "radius_m = 8.0"),
    ("angular_rate_rad_s = 0.15", "angular_rate_rad_s = 0.1"),
    ("altitude_m = 8.0", "altitude_m = 3.0"),
    ('layer_m = 3.0\nlanding = "return"', 'landing = "in_place"'),
)
"""What makes the ring form soon, and the flight end soon."""
HOLD_ON_LOSS = 5


class Restarting:
    """One stub vehicle of this process, which can be killed and started again."""

    def __init__(self, config: StubConfig, clock: StubClock) -> None:
        self.config = config
        self.stub: Stub | None = None
        self._clock = clock
        self._stack = AsyncExitStack()

    @property
    def vehicle(self) -> StubAutopilot:
        """Its autopilot since the newest start."""
        assert self.stub is not None
        return self.stub.autopilot

    @property
    def setpoint_s(self) -> float:
        """When the newest setpoint since then has arrived."""
        assert self.stub is not None
        return self.stub.setpoint_s

    async def start(self) -> None:
        stubs = await self._stack.enter_async_context(served_by(self._clock, [self.config]))
        self.stub = stubs[self.config.vehicle_id]

    async def kill(self) -> None:
        await self._stack.aclose()


class Relay(asyncio.DatagramProtocol):
    """Carries datagrams between a vehicle and its ground station, until it is cut, or one end is deaf."""

    def __init__(self, there: tuple[str, int] | None = None) -> None:
        self.cut = self.deaf = False
        self.there = there
        self.other = self
        self._transport: asyncio.DatagramTransport | None = None

    @classmethod
    async def between(cls, vehicle_port: int, ground_port: int) -> Self:
        """Listen for a vehicle on one port, and pass on to a ground station that listens on another."""
        loop = asyncio.get_running_loop()
        front, back = cls(), cls((LOOPBACK, ground_port))
        front.other, back.other = back, front
        await loop.create_datagram_endpoint(lambda: front, local_addr=(LOOPBACK, vehicle_port))
        await loop.create_datagram_endpoint(lambda: back, local_addr=(LOOPBACK, 0))
        return front

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.there = addr
        if not (self.cut or self.other.cut):
            self.other.send(data)

    def send(self, data: bytes) -> None:
        if self._transport is not None and self.there is not None and not self.deaf:
            self._transport.sendto(data, self.there)

    def close(self) -> None:
        for each in (self, self.other):
            if each._transport is not None:
                each._transport.close()


class Team:
    """A mission in flight: its stubs, what the live view shows of each vehicle, and the links."""

    clock: GovernedClock

    def __init__(self, mission: Mission, monkeypatch: pytest.MonkeyPatch) -> None:
        self.mission = mission
        self.rows: dict[int, TeamRow] = {}
        self.links: dict[int, MavsdkLink] = {}
        self.configs = {config.vehicle_id: config for config in stub_configs(mission)}
        self.stubs: dict[int, Restarting] = {}
        self._view = LiveView(Console(file=StringIO()))
        monkeypatch.setattr(self._view, "update", lambda team, *_: self.rows.update({r.vehicle_id: r for r in team}))
        self.events: list[FlightEvent] = []
        line = event_line

        def shown(event: FlightEvent, start_s: float | None) -> str:
            self.events.append(event)
            return line(event, start_s)

        monkeypatch.setattr("gcs.flight.watch.event_line", shown)
        make = MavsdkLink.__init__

        def made(link: MavsdkLink, hub: MavsdkHub, config: LinkConfig, *rest: Any) -> None:
            self.links[config.system_id] = link
            make(link, hub, config, *rest)

        monkeypatch.setattr(MavsdkLink, "__init__", made)

    @asynccontextmanager
    async def flying(self, duration_s: float) -> AsyncIterator["asyncio.Task[FlightOutcome]"]:
        """Fly until all are in the ring, evenly spaced; then it is the test's turn."""
        with stub_clock(SPEED) as self.clock:
            self.stubs = {i: Restarting(config, self.clock) for i, config in self.configs.items()}
            for stub in self.stubs.values():
                await stub.start()
            vehicles = self.mission.vehicles
            plan = FlightPlan(self.mission, duration_s, vehicles, speed=SPEED, clock=self.clock.name)
            flight = asyncio.create_task(fly(plan, self._view, self._tell))
            try:
                await self.until(lambda: flight.done() or self.any_armed, 300.0, "a take-off")
                with hurried(self.clock):
                    await self.until(lambda: flight.done() or self.spaced(120.0, 1, 2, 3), 300.0, "a ring of three")
                assert not flight.done(), flight.result()
                yield flight
            finally:
                flight.cancel()
                await asyncio.gather(flight, return_exceptions=True)
                for stub in self.stubs.values():
                    await stub.kill()

    @property
    def any_armed(self) -> bool:
        return any(stub.vehicle.armed for stub in self.stubs.values())

    async def until(self, condition: Callable[[], bool], within_s: float, waiting_for: str = "it") -> float:
        """Wait for a condition on the team's clock; return when it became true."""
        return await until(condition, within_s, waiting_for, clock=self.clock)

    @staticmethod
    def _tell(findings: Sequence[Finding]) -> None:
        assert [each for each in findings if each.grade is Grade.REFUSE] == []

    def tactics(self, *vehicle_ids: int) -> list[str]:
        return [self.rows[i].tactic for i in vehicle_ids]

    def holds_s(self, vehicle_id: int) -> list[float]:
        """Return when the vehicle began to hold, by its agent: what is shown of it follows the wall's clock."""
        return [e.time_s for e in self.events if e.vehicle == vehicle_id and e.text.startswith("encircle -> hold")]

    def spaced(self, degrees: float, *vehicle_ids: int) -> bool:
        leads = [self.rows[i].lead_rad if i in self.rows else None for i in vehicle_ids]
        return all(lead is not None and abs(math.degrees(lead) - degrees) < 10.0 for lead in leads)

    async def telemetry_settles(self, vehicle_id: int) -> None:
        """Wait until samples of the vehicle's motion arrive at the requested rate, by its own clock."""
        rate_hz, end_s = 0.0, self.clock.now_s() + 60.0
        while self.clock.now_s() < end_s and rate_hz != pytest.approx(RATE_HZ, rel=0.03):
            with self.arrivals_s(vehicle_id) as arrived_s:
                await self.clock.sleep(5.0)
            rate_hz = len(arrived_s) / 5.0
        assert rate_hz == pytest.approx(RATE_HZ, rel=0.03)

    @contextmanager
    def arrivals_s(self, vehicle_id: int) -> Iterator[list[float]]:
        """Note when samples of the vehicle's motion arrive: what the sockets hold may be late on a busy computer."""
        parts, arrived_s = self.links[vehicle_id]._parts, list[float]()
        assert parts is not None
        feed = parts.feed
        take = feed._take_motion

        def note(frame: bytes) -> None:
            arrived_s.append(self.clock.now_s())
            take(frame)

        hub, system_id = self.links[vehicle_id]._hub, self.links[vehicle_id]._config.system_id
        hub.listen(system_id, {LOCAL_POSITION_NED: feed._posting(note), ATTITUDE: feed._note_attitude})
        try:
            yield arrived_s
        finally:
            hub.listen(system_id, {LOCAL_POSITION_NED: feed._posting(take), ATTITUDE: feed._note_attitude})


@pytest.fixture
def team(mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> Team:
    return Team(load_mission(mission_file("px4-trio", *NEAR)), monkeypatch)


async def test_a_link_cut_for_five_seconds(team: Team) -> None:
    (relayed,) = free_ports(1)
    relay = await Relay.between(relayed, team.configs[3].client_port)
    team.configs[3] = replace(team.configs[3], client_port=relayed)
    async with team.flying(600.0):
        clock, vehicle = team.clock, team.stubs[3].vehicle
        vehicle.parameters.set("COM_OBL_RC_ACT", HOLD_ON_LOSS)
        with team.arrivals_s(3) as arrived_s:
            await clock.sleep(0.5)
            relay.cut = True
            cut_s = clock.now_s()
            # Its agent holds for want of telemetry; it knows no more than that. Its own failsafe flies the vehicle.
            await team.until(lambda: bool(team.holds_s(3)), 30.0, "holding")
        held_s = team.holds_s(3)[0] - arrived_s[-1]
        assert held_s == pytest.approx(team.mission.safety.telemetry_timeout_s, abs=0.3)
        await team.until(lambda: vehicle.mode is NavMode.HOLD, 30.0, "the failsafe")
        # MAVSDK takes a link as lost after 3 s of the wall, at any speed.
        await until(lambda: not team.links[3].status.connected, waiting_for="the loss")
        await team.until(lambda: team.spaced(180.0, 1, 2), 60.0, "a ring of two")
        relay.cut, back_s = False, clock.now_s()
        await team.until(lambda: team.tactics(3) == ["pilot override"], 40.0, "standing down")
        await team.until(
            lambda: team.links[3]._parts is not None and team.links[3]._parts.feed.origin_m is not None, 50.0
        )
        await clock.sleep(2.5)
        assert vehicle.mode is NavMode.HOLD, "it came back into offboard by itself"
        assert team.stubs[3].setpoint_s <= cut_s + 0.5, "setpoints after the cut"
        await team.telemetry_settles(3)
        print(f"held after {held_s:.2f} s, rates back {clock.now_s() - back_s - 5.0:.2f} s after the link")

        answers = await CommandClient(team.mission).command("resume", (3,), 3)
        assert answers[3] is not None
        await team.until(
            lambda: vehicle.mode is NavMode.OFFBOARD and team.tactics(3) == ["encircle"], 60.0, "the return"
        )
        assert team.stubs[3].setpoint_s > back_s

        # One that has disarmed rests in offboard, and has to be left alone all the same.
        team.stubs[1].vehicle.disarm(force=True)
        stood_down_s = await team.until(lambda: team.tactics(1) == ["pilot override"], 40.0, "standing down") + 0.5
        assert team.links[1].status.mode is FlightMode.OFFBOARD
        await clock.sleep(2.5)
        assert team.stubs[1].setpoint_s <= stood_down_s
    relay.close()


async def test_setpoints_that_do_not_arrive_are_told_as_that_and_offboard_is_requested_again(team: Team) -> None:
    (relayed,) = free_ports(1)
    relay = await Relay.between(relayed, team.configs[3].client_port)
    team.configs[3] = replace(team.configs[3], client_port=relayed)
    async with team.flying(600.0):
        clock, vehicle, link = team.clock, team.stubs[3].vehicle, team.links[3]
        vehicle.parameters.set("COM_OBL_RC_ACT", HOLD_ON_LOSS)
        relay.other.deaf = True  # the link loses what the vehicle sends
        await clock.sleep(0.3)
        relay.other.deaf = False
        await until(lambda: link.pace.losses.lost >= 1.0, waiting_for="the count of what was lost")
        relay.deaf = True
        await team.until(lambda: vehicle.mode is NavMode.HOLD, 30.0, "the failsafe")
        await team.until(lambda: bool(team.holds_s(3)), 30.0, "holding")
        assert link.status.mode is FlightMode.HOLD
        relay.deaf = False
        await team.until(lambda: vehicle.mode is NavMode.OFFBOARD, 30.0, "offboard")
        await clock.sleep(5.0)
        assert team.tactics(3) == ["hold"], "neither handed over nor resumed by itself"
        assert vehicle.mode is NavMode.OFFBOARD
        told = [each.text for each in team.events if each.vehicle == 3 and each.kind == "failsafe"]
        assert any(text.startswith("setpoints not received") for text in told), told
        assert not any(text.startswith("pilot") for text in told)
    relay.close()


@pytest.mark.long
async def test_autopilots_that_restart_in_mid_ring(team: Team) -> None:
    duration_s = 100.0
    # Vehicle 1 comes back with the address it had, as a PX4 or a radio does; vehicle 3 after a silence with another.
    team.configs[1] = replace(team.configs[1], port=free_ports(1)[0])
    async with team.flying(duration_s) as flight:
        clock, before = team.clock, {i: stub.vehicle for i, stub in team.stubs.items()}
        await asyncio.gather(team.stubs[1].kill(), team.stubs[3].kill())
        await clock.sleep(2.0)
        await team.stubs[1].start()
        # One that is back within a second never shows as a lost link.
        await team.until(lambda: team.tactics(1) == ["pilot override"], 40.0, "standing down")
        stood_down_s = clock.now_s() + 0.5
        assert team.links[1].status.connected
        # MAVSDK takes a link as lost after 3 s of the wall, at any speed.
        await until(lambda: not team.links[3].status.connected, waiting_for="the loss")
        assert team.tactics(3) == ["hold"]
        back_s = clock.now_s()
        await team.stubs[3].start()
        await team.until(lambda: team.tactics(3) == ["pilot override"], 40.0, "standing down")
        await team.telemetry_settles(1)
        await team.telemetry_settles(3)
        assert team.stubs[1].setpoint_s <= stood_down_s
        assert team.stubs[3].setpoint_s <= back_s
        assert team.stubs[2].setpoint_s > back_s
        for i in (1, 3):
            assert team.stubs[i].vehicle is not before[i]
            assert not team.stubs[i].vehicle.armed
        assert team.tactics(2) == ["encircle"]

        # To resume is refused, for there is nothing to return from: it stands on the ground.
        answers = await CommandClient(team.mission).command("resume", (1,), 1)
        assert answers[1] is not None
        assert "disarmed" in answers[1].did
        assert team.tactics(1) == ["pilot override"]
        with hurried(clock):
            outcomes = (await flight).outcomes
    endings = [outcomes[i].how for i in (1, 2, 3)]
    assert endings == [FlightEnd.PILOT, FlightEnd.LANDED, FlightEnd.PILOT], outcomes
    for i in (1, 3):
        assert outcomes[i].reason == "it disarmed, which cordon did not request: its autopilot restarted"
        assert "log" in outcomes[i].next_step


DEAD = 6
TICK_S = 0.05


async def arm(link: MavsdkLink) -> None:
    parts = link._parts
    assert parts is not None
    await parts.calls.command("arm", parts.action.arm)


async def test_dead_links_do_not_starve_a_living_one(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = free_ports(DEAD + 1)
    configs = [StubConfig(i, port, PLANT, FRAME, (4.0 * i, 0.0)) for i, port in enumerate(ports, start=1)]
    clock = WallClock()  # what MAVSDK's threads cost the event loop is about the wall
    stubs = [Restarting(config, clock) for config in configs]
    for stub in stubs:
        await stub.start()
    fresh_s: dict[float, float] = {}
    take = StubAutopilot.receive_setpoint

    def note(autopilot: StubAutopilot, time_s: float, target: PositionTarget) -> None:
        # MAVSDK repeats the last one by itself: what counts is when each new one comes.
        fresh_s.setdefault(round(target.position_m[2], 4), time.monotonic())
        take(autopilot, time_s, target)

    monkeypatch.setattr(StubAutopilot, "receive_setpoint", note)
    hub = MavsdkHub()
    links = [
        MavsdkLink(hub, LinkConfig(f"udpin://{LOOPBACK}:{each.client_port}", each.vehicle_id, FRAME), clock)
        for each in configs
    ]
    await asyncio.gather(*(link.connect(lambda sample: None) for link in links))
    living, *dead = links
    await asyncio.gather(*(stub.kill() for stub in stubs[1:]))
    sent_s: dict[float, float] = {}
    calls = asyncio.gather(*map(arm, dead), return_exceptions=True)
    async for tick in Ticker(TICK_S, clock):
        z = round(0.001 * (tick.index + 1), 4)
        sent_s[z] = time.monotonic()
        living.send(Setpoint((4.0, 0.0, z)))
        if calls.done():
            break
    assert len(sent_s) * TICK_S > 1.0, "the dead ones took no time"
    refusals = await calls
    assert [type(refusal) for refusal in refusals] == [VehicleRefusedError] * DEAD
    assert all("did not answer" in str(refusal) for refusal in refusals), refusals
    late_s = sorted(fresh_s[z] - at_s for z, at_s in sent_s.items() if z in fresh_s)
    gaps_s = [after - before for before, after in pairwise(sorted(sent_s.values()))]
    assert len(late_s) >= len(sent_s) - 2
    # Dead links would delay most of them; a computer that is busy with something else delays a few.
    assert late_s[len(late_s) * 3 // 4] < 0.1
    assert sorted(gaps_s)[len(gaps_s) * 3 // 4] < 3.0 * TICK_S
    for link in links:
        await link.close()
    await hub.close()
    await stubs[0].kill()


async def test_an_autopilot_that_says_nothing_unasked_is_asked_again_after_a_restart() -> None:
    (port,) = free_ports(1)
    with stub_clock(SPEED) as clock:
        stub = Restarting(StubConfig(1, port, PLANT, FRAME, autopilot="ardupilot"), clock)
        await stub.start()
        hub, samples = MavsdkHub(clock), list[Telemetry]()
        link = MavsdkLink(hub, LinkConfig(f"udpin://{LOOPBACK}:{port}", 1, FRAME), clock)
        await link.connect(samples.append)
        await until(lambda: len(samples) > 20, 15.0, "telemetry", clock=clock)
        await stub.kill()
        samples.clear()
        stub.config = replace(stub.config, start_position_m=(7.0, 3.0), origin_offset_m=(0.5, -0.3, 0.0))
        await stub.start()
        await until(lambda: bool(samples), 60.0, "telemetry", clock=clock)
        assert link.status.connected
        assert dist(samples[0].position_m, (7.0, 3.0, 0.0)) < 0.02, "by the origin it had before"
        samples.clear()
        await clock.sleep(5.0)
        assert len(samples) / 5.0 == pytest.approx(RATE_HZ, rel=0.03)
        await link.close()
        await hub.close()
        await stub.kill()
