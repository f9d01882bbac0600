"""The vehicle link against stub vehicles over UDP and MAVSDK, at ten times real time."""

import asyncio
import re
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, nullcontext
from math import dist, hypot, radians
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from mavsdk.plugins.action import ActionError, ActionResult
from mavsdk.plugins.telemetry import StatusTextType

from agents.ports import FlightMode, Setpoint, VehicleLink, VehicleRefusedError, VehicleStatus
from agents.shell import clock as shell_clock
from agents.shell.clock import MissionClock, WallClock
from agents.shell.ticker import Ticker
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Telemetry
from gcs.link import calls as link_calls
from gcs.link.calls import VehicleCalls, find_origin
from gcs.link.config import LinkConfig
from gcs.link.feed import LOST_AFTER_S, VehicleFeed
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import SILENCE_MAX_S, WATCH_PERIOD_S, MavsdkLink
from gcs.link.ports import require_usable
from gcs.link.rates import RateController, Rates
from gcs.link.relay.relay import Relay
from gcs.link.status_texts import StatusTexts
from gcs.link.streams import Streams
from sitl.autopilot.autopilot import StubAutopilot
from sitl.autopilot.guidance import PositionTarget
from sitl.mavlink.protocol import MavlinkVehicle
from sitl.mavlink_constants import MessageId, Outgoing
from sitl.server.governed_clock import GovernedClock
from sitl.server.server import StubConfig
from tests.support.wire import (
    PATIENCE_S,
    Served,
    free_port,
    repeated,
    served,
    served_by,
    stub_clock,
    stub_process,
    until,
)

pytestmark = pytest.mark.wire

SPEED = 10.0
PLANT = Plant(PlantAxis(1.51, 1.90), PlantAxis(1.87, 2.40), delay_s=0.2)
BEARING_RAD = radians(35.0)
FRAME = MissionFrame(Geodetic(47.397742, 8.545594, 488.0), x_bearing_rad=BEARING_RAD)
QUANTUM_M = 0.012  # GPS_GLOBAL_ORIGIN counts in 1e-7 degrees


@asynccontextmanager
async def link_on(
    clock: MissionClock, link_url: str, system_id: int, frame: MissionFrame = FRAME, **settings: Any
) -> AsyncIterator[tuple[MavsdkLink, list[Telemetry]]]:
    """Connect to a vehicle."""
    hub, telemetry = MavsdkHub(clock), list[Telemetry]()
    link = MavsdkLink(hub, LinkConfig(link_url, system_id, frame, **settings), clock)
    try:
        await link.connect(telemetry.append)
        yield link, telemetry
    finally:
        await link.close()
        await hub.close()


def udp_in(config: StubConfig) -> str:
    return f"udpin://127.0.0.1:{config.client_port}"


@asynccontextmanager
async def served_here() -> AsyncIterator[tuple[Served, str]]:
    """Serve a stub in this process, where it can be watched, and yield its url."""
    config = StubConfig(1, free_port(), PLANT, FRAME)
    async with served([config], SPEED) as stubs:
        yield stubs, udp_in(config)


@asynccontextmanager
async def linked(**settings: Any) -> AsyncIterator[tuple[MavsdkLink, list[Telemetry], GovernedClock]]:
    """Serve a stub in this process and connect to it."""
    async with (
        served_here() as (served, link_url),
        link_on(served.clock, link_url, 1, **settings) as (link, telemetry),
    ):
        yield link, telemetry, served.clock


async def hold_setpoint(link: VehicleLink, setpoint: Setpoint, clock: MissionClock, duration_s: float) -> None:
    end_s = clock.now_s() + duration_s
    while clock.now_s() < end_s:
        link.send(setpoint)
        await clock.sleep(0.1)


async def test_a_flight_from_connecting_to_landing_and_another_one() -> None:
    # Three origins: the mission's, 5 m lower and turned; the vehicle's home; and its estimator's, half a metre off.
    mission = MissionFrame(FRAME.geodetic_from_mission((10.0, -20.0, -5.0)), x_bearing_rad=radians(-70.0))
    start_m = mission.mission_from_geodetic(FRAME.geodetic_from_mission((40.0, -25.0, 0.0)))
    config = StubConfig(2, free_port(), PLANT, FRAME, (40.0, -25.0), origin_offset_m=(0.45, -0.3, 0.25))
    with stub_clock(SPEED) as clock, stub_process([config], clock.name) as process:
        async with link_on(clock, udp_in(config), 2, mission, truth=True) as (link, telemetry):
            assert link.truth is not None
            link.truth.on_sample = list[Telemetry]().append
            await clock.sleep(3.0)
            assert dist(telemetry[-1].position_m, start_m) < QUANTUM_M
            assert link.truth.newest is not None
            assert dist(link.truth.newest.position_m, start_m) < QUANTUM_M
            for altitude_m in (9.0, 8.0):
                await link.take_off(altitude_m)
                assert (link.status.armed, link.status.in_air, link.status.mode) == (True, True, FlightMode.HOLD)
                assert abs(telemetry[-1].position_m[2] - altitude_m) < 0.5
                goal_m = (start_m[0] + 3.0, start_m[1] - 2.0, altitude_m)
                link.send(Setpoint(goal_m))
                await link.start_offboard()
                assert mode_of(link) is FlightMode.OFFBOARD
                await hold_setpoint(link, Setpoint(goal_m), clock, 7.0)
                assert dist(telemetry[-1].position_m, goal_m) < 0.05
                await link.stop_offboard()
                assert mode_of(link) is FlightMode.HOLD
                await link.land()
                assert not link.status.armed
                await clock.sleep(1.0)
        truth = process.stop().tracks[0].position_m[-1].tolist()
    truth_m = mission.mission_from_geodetic(FRAME.geodetic_from_mission((truth[0], truth[1], truth[2])))
    assert dist(truth_m, (*goal_m[:2], 5.0)) < 0.05
    assert dist(truth_m, telemetry[-1].position_m) < QUANTUM_M
    received = link.truth.track()
    assert dist(truth_m, received.position_m[-1].tolist()) < QUANTUM_M
    fastest = max(range(received.time_s.size), key=lambda place: hypot(*received.velocity_m_s[place, :2]))
    seen = min(telemetry, key=lambda sample: abs(sample.time_s - received.time_s[fastest]))
    assert hypot(*received.velocity_m_s[fastest, :2]) > 1.0
    assert received.velocity_m_s[fastest].tolist() == pytest.approx(seen.velocity_m_s, abs=0.3)
    assert (link.dropped, link.unsent) == (0, 0)


def mode_of(link: VehicleLink) -> FlightMode:
    return link.status.mode


async def test_velocity_and_yaw_are_in_the_mission_frame_and_what_is_out_of_order_is_refused() -> None:
    async with linked() as (link, telemetry, clock):
        began_s = clock.now_s()
        assert await link.measure_speed() == 1.0
        assert clock.now_s() - began_s == pytest.approx(1.0, abs=0.01), "a governed clock needs no measurement"
        with pytest.raises(VehicleRefusedError, match="no setpoint") as refusal:
            await link.start_offboard()
        assert refusal.value.next_step == "send setpoints first"
        await link.take_off(3.0)
        with pytest.raises(VehicleRefusedError, match="vehicle 1 is already in the air"):
            await link.take_off(3.0)
        yaw_rad = radians(20.0)
        setpoint = Setpoint((12.0, 0.0, 3.0), yaw_rad)
        link.send(setpoint)
        await link.start_offboard()
        telemetry.clear()
        await hold_setpoint(link, setpoint, clock, 10.0)
        fastest = max(telemetry, key=lambda sample: sample.velocity_m_s[0])
        assert fastest.velocity_m_s[0] > 3.0
        assert abs(fastest.velocity_m_s[1]) < 0.1
        heading_deg = await heading_of(link)
        assert heading_deg == pytest.approx(35.0 - 20.0, abs=1.0)
        await link.land()  # stops offboard by itself
        link.send(setpoint)
        assert link._parts is not None
        assert not link._parts.offboard.is_active()
        assert link.status.mode is not FlightMode.OFFBOARD
        assert not link.status.armed


async def heading_of(link: MavsdkLink) -> float:
    assert link._parts is not None
    return float((await link._parts.calls.run(link._parts.feed.plugin.attitude_euler)).yaw_deg)


def sent_by_stubs(monkeypatch: pytest.MonkeyPatch) -> Counter[int]:
    """Return the counts of the messages that stubs of this process send."""
    sent = Counter[int]()
    send = MavlinkVehicle._send

    def note(vehicle: MavlinkVehicle, outgoing: Outgoing) -> None:
        sent[outgoing[0]] += 1
        send(vehicle, outgoing)

    monkeypatch.setattr(MavlinkVehicle, "_send", note)
    return sent


async def test_everything_comes_at_the_rates_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    sent = sent_by_stubs(monkeypatch)
    pace = RateController(Rates(telemetry_hz=10.0, status_hz=2.0, setpoint_hz=20.0, clock_hz=25.0))
    async with linked(pace=pace) as (_, telemetry, clock):
        await clock.sleep(3.0)
        sent.clear()
        telemetry.clear()
        await clock.sleep(10.0)
        came_hz = {message: count / 10.0 for message, count in sent.items()}
        elapsed_s = telemetry[-1].time_s - telemetry[0].time_s
        assert (len(telemetry) - 1) / elapsed_s == pytest.approx(10.0, rel=0.01)
        assert came_hz[MessageId.LOCAL_POSITION_NED] == pytest.approx(10.0, rel=0.02)
        assert came_hz[MessageId.ATTITUDE] == pytest.approx(2.0, rel=0.06)
        assert came_hz[MessageId.EXTENDED_SYS_STATE] == pytest.approx(2.0, rel=0.06)
        for message in (MessageId.SYS_STATUS, MessageId.GPS_RAW_INT, MessageId.GLOBAL_POSITION_INT):
            assert came_hz[message] <= 2.0 * 1.06, message


async def test_setpoints_are_handed_on_at_the_rate_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[float] = []
    take = StubAutopilot.receive_setpoint

    def note(autopilot: StubAutopilot, time_s: float, target: PositionTarget) -> None:
        received.append(target.position_m[2])
        take(autopilot, time_s, target)

    monkeypatch.setattr(StubAutopilot, "receive_setpoint", note)
    pace = RateController(Rates(20.0, 2.0, 5.0), limits_setpoints=True)
    # By the wall, as the relay keeps the rate.
    config, clock = StubConfig(1, free_port(), PLANT, FRAME), WallClock(2.0)
    async with served_by(clock, [config]), link_on(clock, udp_in(config), 1, pace=pace) as (link, _):

        async def attempt() -> None:
            received.clear()
            began_s = clock.now_s()
            async for tick in Ticker(0.05, clock):
                link.send(Setpoint((0.0, 0.0, 0.001 * tick.index)))
                if clock.now_s() - began_s > 4.0:
                    break
            assert len(received) / 4.0 == pytest.approx(5.0, rel=0.15)

        await repeated(attempt)


async def test_setpoints_that_a_bound_link_holds_back_do_not_hold_up_the_clock() -> None:
    pace = RateController(Rates(20.0, 2.0, 5.0), limits_setpoints=True)
    async with served_here() as (served, link_url), link_on(served.clock, link_url, 1, pace=pace) as (link, _):
        clock, began_wall_s = served.clock, time.monotonic()
        for index in range(100):
            link.send(Setpoint((0.0, 0.0, 0.001 * index)))
            await clock.sleep(0.05)
        assert time.monotonic() - began_wall_s < 25.0, "half a second of the wall for each"
        assert served.stubs[1].setpoints > 0


async def test_the_clock_is_measured_at_its_own_rate_for_a_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    # By the wall, as of a vehicle that is no stub of the flight: a governed clock is not measured.
    sent = sent_by_stubs(monkeypatch)
    pace = RateController(Rates(telemetry_hz=10.0, status_hz=2.0, setpoint_hz=20.0, clock_hz=25.0))
    config, clock = StubConfig(1, free_port(), PLANT, FRAME), WallClock(5.0)
    async with served_by(clock, [config]), link_on(clock, udp_in(config), 1, pace=pace) as (link, _):

        async def attempt() -> None:
            sent.clear()
            assert await link.measure_speed(1.0) == 5.0
            assert sent[MessageId.ATTITUDE] >= 0.8 * 25.0 * 5.0
            sent.clear()
            await clock.sleep(5.0)
            assert sent[MessageId.ATTITUDE] / 5.0 == pytest.approx(2.0, abs=0.6)

        await repeated(attempt)


def test_a_speed_near_a_whole_number_is_that_number(subtests: pytest.Subtests) -> None:
    rows: tuple[tuple[float, float | None], ...] = (
        (1.0, 1.0),
        (1.08, 1.0),
        (0.93, 1.0),
        (0.5, 0.5),
        (4.7, 5.0),
        (1.45, 1.45),
        (-3.0, None),
    )
    for rate, ratio in rows:
        with subtests.test(rate=rate, ratio=ratio):
            times = [(100.0 + 0.1 * step, 7.0 + 0.1 * step * rate) for step in range(10)]
            assert link_calls.clock_ratio(times, 1.0) == (None if ratio is None else pytest.approx(ratio))
            assert link_calls.clock_ratio(times[:4], 1.0) is None
            assert link_calls.clock_ratio([], 1.0) is None


async def test_a_vehicle_left_in_offboard_comes_down_and_flies_again() -> None:
    async with served_here() as (served, link_url):
        clock = served.clock
        async with link_on(clock, link_url, 1) as (link, telemetry):
            await link.take_off(3.0)
            link.send(Setpoint(telemetry[-1].position_m))
            await link.start_offboard()
        # With the link closed nobody repeats the setpoint: the failsafe lands it, in a mode that does not arm.
        async with link_on(clock, link_url, 1) as (link, _):
            await until(lambda: not link.status.armed, 50.0, clock=clock)
            assert link.status.mode not in (FlightMode.HOLD, FlightMode.READY)
            await link.take_off(3.0)
            await link.land()


async def test_silence_is_refused() -> None:
    port = free_port()
    hub = MavsdkHub()
    link = MavsdkLink(hub, LinkConfig(f"udpin://127.0.0.1:{port}", 1, FRAME, heartbeat_timeout_s=1.0), WallClock())
    with pytest.raises(VehicleRefusedError) as refusal:
        await link.connect(lambda sample: None)
    assert refusal.value.reason == f"no heartbeat on udpin://127.0.0.1:{port} within 1 s"
    assert "cordon sitl" in refusal.value.next_step
    link.send(Setpoint((0.0, 0.0, 0.0)))
    assert link.unsent == 1
    assert link.status == VehicleStatus()
    with pytest.raises(VehicleRefusedError, match="not connected"):
        await link.land()
    await link.close()
    await hub.close()


async def test_a_search_that_is_cancelled_while_its_connection_opens_leaves_nothing_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opens, goes_on, start = threading.Event(), threading.Event(), Relay.start

    def held(relay: Relay) -> None:
        opens.set()
        goes_on.wait(PATIENCE_S)
        start(relay)

    monkeypatch.setattr(Relay, "start", held)
    hub, url = MavsdkHub(), f"udpin://127.0.0.1:{free_port()}"
    finding = asyncio.create_task(hub.find(url, 1, PATIENCE_S))
    await until(opens.is_set)
    finding.cancel()
    await asyncio.sleep(0.0)
    goes_on.set()
    with pytest.raises(asyncio.CancelledError):
        await finding
    require_usable(url)
    await hub.close()


def test_mavsdk_writes_nothing_to_standard_output() -> None:
    script = (
        "import asyncio\n"
        "from gcs.link.hub import MavsdkHub\n"
        "async def main():\n"
        "    hub = MavsdkHub()\n"
        f"    await asyncio.gather(hub.find('udpin://127.0.0.1:{free_port()}', 1, 0.2), return_exceptions=True)\n"
        "    await hub.close()\n"
        "asyncio.run(main())\n"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert (ran.stdout, ran.stderr) == ("", "")


async def test_two_vehicles_with_one_system_id_are_refused() -> None:
    hub = MavsdkHub()
    async with served_here() as (_, near), served_here() as (_, twin):
        try:
            await hub.find(near, 1, PATIENCE_S)
            with pytest.raises(VehicleRefusedError, match="system id 1 is used on both") as refusal:
                await hub.find(twin, 1, PATIENCE_S)
            assert "MAV_SYS_ID" in refusal.value.next_step
            # The wrong id in the mission does not help the twin either.
            with pytest.raises(VehicleRefusedError, match="carries system id 1, not 3"):
                await hub.find(twin, 3, PATIENCE_S)
            await hub.release(near, 1)
            await hub.find(twin, 1, PATIENCE_S)
        finally:
            await hub.close()


async def test_urls_that_lead_nowhere_are_refused(subtests: pytest.Subtests) -> None:
    rows: tuple[str, ...] = (
        "carrier-pigeon://coop",
        "udpin://",
        "serial:///dev/null:57600",
    )
    for bad in rows:
        with subtests.test(bad=bad):
            hub = MavsdkHub()
            for _ in range(2):  # a refusal leaves nothing behind
                with pytest.raises(VehicleRefusedError, match="cannot be opened"):
                    await hub.find(bad, 1, 1.0)
            await hub.close()


async def test_a_silence_is_noticed_while_a_request_for_a_rate_waits_for_its_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Streams, "wrong", lambda _: {int(MessageId.ATTITUDE): 2.0})
    async with served_here() as (served, link_url), link_on(served.clock, link_url, 1) as (link, _):
        await served.clock.sleep(3.0)
        served.stubs[1].faults.link_cut = True
        cut_s = served.clock.now_s()
        parts = link._parts
        assert parts is not None
        lost_s = await until(lambda: parts.feed.origin_m is None, 60.0, "the loss", clock=served.clock)
        assert lost_s - cut_s <= SILENCE_MAX_S + 2.0 * WATCH_PERIOD_S


async def test_a_link_is_lost_by_the_governed_clock_and_not_where_mavsdk_waits_for_a_busy_computer() -> None:
    async with served_here() as (served, link_url), link_on(served.clock, link_url, 1) as (link, telemetry):
        parts, clock = link._parts, served.clock
        assert parts is not None
        parts.feed._take_connected(False)
        telemetry.clear()
        await until(lambda: bool(telemetry), waiting_for="telemetry", clock=clock)
        assert link.status.connected
        served.stubs[1].faults.link_cut = True
        cut_s = clock.now_s()
        lost_s = await until(lambda: not link.status.connected, 60.0, "the loss", clock=clock)
        assert LOST_AFTER_S - 0.1 < lost_s - cut_s < LOST_AFTER_S + 2.0 * WATCH_PERIOD_S
        served.stubs[1].faults.link_cut = False
        parts.feed._take_connected(True)
        assert link.status.connected


class FakeFeed:
    """A feed that nothing arrives on."""

    def __init__(self, origin: Callable[[], object]) -> None:
        self.status = VehicleStatus(connected=True)
        self.plugin = SimpleNamespace(get_gps_global_origin=origin)
        self.reports = SimpleNamespace(direct=SimpleNamespace(send_command=lambda _: None))
        self.attitude_clock: Callable[[float], Awaitable[list[tuple[float, float]]]]
        self.texts = StatusTexts()
        self.texts.take("EKF3 IMU0 is using GPS", StatusTextType.INFO)
        self.texts.take("Preflight Fail: no GPS", StatusTextType.CRITICAL)

    def failing(self) -> str:
        return "global position, arming checks"


@pytest.fixture
def calls_and_feed(monkeypatch: pytest.MonkeyPatch) -> tuple[VehicleCalls, FakeFeed]:
    monkeypatch.setattr(shell_clock, "_WALL_WAIT_MIN_S", 0.005)
    monkeypatch.setattr(link_calls, "TEXT_DELAY_S", 0.0)
    feed = FakeFeed(lambda: SimpleNamespace(latitude_deg=float("nan"), longitude_deg=0.0, altitude_m=0.0))
    return VehicleCalls(4, cast(VehicleFeed, feed), WallClock(10.0), dict), feed


@pytest.mark.parametrize(
    ("rate", "delay_s", "ratio"),
    [(1.0, -0.5, 1.0), (1.0, 0.9, 1.0), (2.0, 0.5, 2.0), (0.85, 0.0, 0.85)],
)
async def test_a_clock_is_measured_for_longer_than_messages_may_have_waited(
    calls_and_feed: tuple[VehicleCalls, FakeFeed], rate: float, delay_s: float, ratio: float
) -> None:
    calls, feed = calls_and_feed
    at_s = 0.0

    async def attitudes(duration_s: float) -> list[tuple[float, float]]:
        """Return attitudes that arrive later by `delay_s` than those of the first second."""
        nonlocal at_s
        began_s, at_s = at_s, at_s + duration_s
        sent_s = np.arange(began_s, at_s, 0.1)
        return [(time_s + delay_s * min(time_s, 1.0), rate * time_s) for time_s in sent_s.tolist()]

    feed.attitude_clock = attitudes
    measured = await calls.clock_ratio(Rates(20.0, 2.0, 20.0), 1.5)
    assert measured == pytest.approx(ratio, rel=0.1)
    assert ratio != round(ratio) or measured == ratio
    assert at_s < 15.0


async def test_a_vehicle_that_finds_itself_nowhere_is_refused(calls_and_feed: tuple[VehicleCalls, FakeFeed]) -> None:
    calls, feed = calls_and_feed
    with pytest.raises(VehicleRefusedError) as refusal:
        await find_origin(calls, cast(VehicleFeed, feed), FRAME, WallClock(10.0), 0.1)
    for fact in ("0.1 s", "(global position, arming checks)", "“Preflight Fail: no GPS”"):
        assert fact in refusal.value.reason
    assert "is using GPS" not in refusal.value.reason
    feed.plugin.get_gps_global_origin = lambda: Geodetic(-33.9, 151.2, 20.0)
    with pytest.raises(VehicleRefusedError, match="km from the mission's origin") as refusal:
        await find_origin(calls, cast(VehicleFeed, feed), FRAME, WallClock(10.0), 0.1)
    assert "[frame]" in refusal.value.next_step
    await calls.close()


async def test_a_refused_command_says_why_in_the_autopilots_words(
    calls_and_feed: tuple[VehicleCalls, FakeFeed],
) -> None:
    calls, feed = calls_and_feed
    attempts = []

    def arm() -> None:
        attempts.append(1)
        feed.texts.take("Arming denied: throttle not at minimum", StatusTextType.CRITICAL)
        raise ActionError(ActionResult.COMMAND_DENIED, "arm()")

    feed.status = VehicleStatus(connected=False)
    with pytest.raises(VehicleRefusedError) as refusal:
        await calls.command("arm", arm, refusals=3)
    for fact in (
        "vehicle 4 refused to arm (COMMAND_DENIED)",
        "link is lost",
        "“Arming denied: throttle not at minimum”",
    ):
        assert fact in refusal.value.reason
    assert "no GPS" not in refusal.value.reason, "it came before the command"
    assert len(attempts) == 3
    await calls.close()


@pytest.mark.parametrize(
    ("results", "refusals", "fault"),
    [
        ([ActionResult.TIMEOUT] * 3, 1, ""),
        ([ActionResult.PARAMETER_ERROR] * 3, 1, ""),
        ([ActionResult.TIMEOUT] * 4, 1, "did not answer the command to fly"),
        ([ActionResult.COMMAND_DENIED], 1, "refused to fly (COMMAND_DENIED)"),
        ([ActionResult.TIMEOUT, ActionResult.COMMAND_DENIED], 1, "refused to fly (COMMAND_DENIED)"),
        ([ActionResult.COMMAND_DENIED, ActionResult.TIMEOUT, ActionResult.COMMAND_DENIED], 3, ""),
        ([ActionResult.COMMAND_DENIED] * 3, 3, "refused to fly (COMMAND_DENIED)"),
    ],
)
async def test_a_command_is_repeated_while_it_is_not_answered(
    calls_and_feed: tuple[VehicleCalls, FakeFeed], results: list[ActionResult], refusals: int, fault: str
) -> None:
    calls, _ = calls_and_feed
    left = list(results)

    def fly() -> None:
        if left:
            raise ActionError(left.pop(0), "fly()")
        made.append(1)

    made: list[int] = []
    with pytest.raises(VehicleRefusedError, match=re.escape(fault)) if fault else nullcontext():
        await calls.command("fly", fly, refusals=refusals)
    assert (left, len(made)) == ([], 0 if fault else 1)
    await calls.close()


@pytest.mark.parametrize("result", [ActionResult.TIMEOUT, ActionResult.FAILED])
async def test_an_effect_that_is_received_counts_more_than_an_answer(
    calls_and_feed: tuple[VehicleCalls, FakeFeed], result: ActionResult
) -> None:
    calls, _ = calls_and_feed
    made: list[int] = []

    def fly() -> None:
        made.append(1)
        raise ActionError(result, "fly()")

    await calls.command("fly", fly, done=lambda: bool(made))
    assert len(made) == 1
    made.clear()
    await calls.command_until("fly", fly, lambda: bool(made), attempts=2, each_s=0.01)
    assert len(made) == 1
    with pytest.raises(VehicleRefusedError, match="sent 2 times"):
        await calls.command_until("fly", fly, lambda: True, attempts=2, each_s=0.01)
    await calls.close()


async def test_closing_waits_for_calls_in_flight(calls_and_feed: tuple[VehicleCalls, FakeFeed]) -> None:
    calls, _ = calls_and_feed
    done: list[bool] = []

    def slow() -> None:
        begun.set()
        time.sleep(0.2)
        done.append(True)

    begun = threading.Event()
    call = asyncio.create_task(calls.run(slow))
    await until(begun.is_set)
    await calls.close()
    assert done == [True]
    await call


INDOORS = MissionFrame(None, x_bearing_rad=BEARING_RAD)


async def test_a_vehicle_without_gps_flies_in_a_local_frame_from_where_it_was_told_to_begin() -> None:
    goal_m = (4.0, 3.0, 2.0)
    config = StubConfig(3, free_port(), PLANT, INDOORS, (2.0, 1.0), origin_offset_m=(-1.5, 0.5, 0.0), gps=False)
    with stub_clock(SPEED) as clock, stub_process([config], clock.name) as process:
        async with link_on(clock, udp_in(config), 3, INDOORS, origin_m=(0.5, 1.5, 0.0)) as (link, telemetry):
            await until(lambda: bool(telemetry), clock=clock)
            assert dist(telemetry[-1].position_m, (2.0, 1.0, 0.0)) < 1e-3
            await link.take_off(goal_m[2])
            link.send(Setpoint(goal_m))
            await link.start_offboard()
            await hold_setpoint(link, Setpoint(goal_m), clock, 7.0)
            assert dist(telemetry[-1].position_m, goal_m) < 0.05
            await link.land()
        truth = process.stop().tracks[0].position_m[-1].tolist()
    assert dist(truth, (*goal_m[:2], 0.0)) < 0.05


VELOCITY = (0.9, -0.6, 0.0)
AXIS = PlantAxis(0.8, 0.87)


async def test_a_velocity_beside_the_setpoint_reaches_the_vehicle() -> None:
    """It keeps up with a setpoint that moves, and without its velocity trails it as its plant does."""
    config = StubConfig(1, free_port(), Plant(AXIS, AXIS, 0.0, 1.0), FRAME)
    async with served([config], SPEED) as here, link_on(here.clock, udp_in(config), 1) as (link, telemetry):
        clock = here.clock

        async def trail_s(velocity: tuple[float, ...], from_m: tuple[float, float]) -> float:
            """Move the setpoint steadily for a while; return how long after it the vehicle is where it was."""
            start_s, lags_s = clock.now_s(), []
            async for tick in Ticker(0.05, clock):
                x, y = (p + rate * (clock.now_s() - start_s) for p, rate in zip(from_m, VELOCITY[:2], strict=True))
                link.send(Setpoint((x, y, 5.0), velocity_m_s=velocity))
                behind = np.array([x, y]) - telemetry[-1].position_m[:2]
                lags_s.append(float(behind @ VELOCITY[:2]) / float(np.dot(VELOCITY, VELOCITY)))
                if tick.deadline_s > start_s + 10.0:
                    break
            return float(np.mean(lags_s[-30:]))

        await link.take_off(5.0)
        link.send(Setpoint((0.0, 0.0, 5.0), velocity_m_s=(0.0, 0.0, 0.0)))
        await link.start_offboard()
        fed_s = await trail_s(VELOCITY, (0.0, 0.0))
        x, y, _ = telemetry[-1].position_m
        unfed_s = await trail_s((), (x, y))
    assert fed_s == pytest.approx(0.0, abs=0.1), "a tick, and the age of the telemetry"
    assert unfed_s - fed_s == pytest.approx(AXIS.a1_per_s / AXIS.a0_per_s2, abs=0.05)
