"""The reports of a vehicle to those who look on: what they say, how often they come, and what has them come at once."""

import asyncio

import numpy as np
import pytest

from agents.outputs import CoreStatus
from agents.ports import FlightMode, GpsThreat, VehicleStatus
from agents.shell.life import Phase
from agents.shell.reporter import estimator_words, target_report
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.codec import decode
from agents.team.messages import (
    LINK_SILENT_S,
    REPORT_TOPIC,
    AutopilotReport,
    MemberState,
    TargetReport,
    VehicleReport,
)
from estimation.state import OwnEstimate, Sighting, TargetEstimate
from tests.support.fake_flight import EPOCH_S, FakeFlight
from tests.support.simulated_loop import run_simulated

ON_TIME_S = 0.2
"""How much later than a change a report of it may come."""


class Listener:
    """The reports of a flight, and when each was sent [s]."""

    def __init__(self, flight: FakeFlight) -> None:
        self.reports: list[tuple[float, VehicleReport]] = []
        publish = flight.bus.publish

        def published(topic: str, payload: bytes) -> None:
            publish(topic, payload)
            if topic == REPORT_TOPIC:
                report = decode(payload)
                assert isinstance(report, VehicleReport)
                self.reports.append((asyncio.get_running_loop().time(), report))

        flight.bus.publish = published  # type: ignore[method-assign]

    @property
    def newest(self) -> VehicleReport:
        return self.reports[-1][1]

    def first(self, mode: str) -> float:
        return next(at_s for at_s, report in self.reports if report.mode == mode)


def test_a_flight_is_reported_once_a_second_and_changes_at_once() -> None:
    async def main() -> None:
        flight = FakeFlight()
        listener = Listener(flight)
        await flight.agent.connect()
        flight.agent.announce()
        await asyncio.sleep(2.95)
        assert len(listener.reports) == 3, "on the ground too"
        assert (listener.newest.mode, listener.newest.armed, listener.newest.start_s) == ("ready", False, None)
        await flight.begin(20.0)
        await flight.until(Phase.FLYING)
        await asyncio.sleep(5.0)
        report = listener.newest
        assert (report.mode, report.armed, report.in_air, report.ended) == ("offboard", True, True, "")
        assert report.duration_s == 20.0
        assert report.start_s is not None
        assert EPOCH_S < report.start_s < report.time_s
        assert report.yaw_rad is not None
        assert report.link_age_s is not None
        assert report.link_age_s <= 0.06

        count = len(listener.reports)
        await asyncio.sleep(6.0)
        assert len(listener.reports) - count in (5, 6)
        flight.link.change(satellites=7, battery=0.4, endurance_s=321.0, gps_dimensions=3, estimator_ratio=0.1)
        await asyncio.sleep(1.2)
        report = listener.newest
        assert (report.autopilot, report.estimator) == (AutopilotReport(0.4, 321.0, 3, 7), "good")

        await flight.outcome()
        last_s = {at_s for at_s, report in listener.reports if report.ended == "landed"}
        assert listener.newest.ended == "landed"
        assert len(last_s) >= 3, "a busy computer may lose one, and none follows"
        assert max(last_s) < asyncio.get_running_loop().time(), "the bus is left later"

    run_simulated(main())


def test_the_start_is_reported_before_any_state_of_the_mission() -> None:
    """Vehicles near their target are on the ring at their first tick; onlookers have the time from reports alone."""

    async def main() -> None:
        flight = FakeFlight()
        sent: list[VehicleReport | MemberState] = []
        publish = flight.bus.publish

        def published(topic: str, payload: bytes) -> None:
            publish(topic, payload)
            message = decode(payload)
            if isinstance(message, VehicleReport | MemberState):
                sent.append(message)

        flight.bus.publish = published  # type: ignore[method-assign]
        await flight.agent.connect()
        flight.agent.announce()
        await flight.begin(20.0)
        await flight.until(Phase.FLYING)
        await asyncio.sleep(1.0)
        started = next(i for i, each in enumerate(sent) if isinstance(each, VehicleReport) and each.start_s is not None)
        flown = next(i for i, each in enumerate(sent) if isinstance(each, MemberState) and each.tactic != "standby")
        assert started < flown
        await flight.outcome()

    run_simulated(main())


def test_the_target_is_reported_with_the_tick_that_first_knows_it() -> None:
    async def main() -> None:
        flight = FakeFlight()
        listener = Listener(flight)
        await flight.begin(60.0)
        await flight.until(Phase.FLYING)
        for _ in range(3):
            await asyncio.sleep(2.93)
            known = [each for each in flight.statuses if each.target_estimate is not None]
            reported = [report for _, report in listener.reports if report.target is not None]
            assert (known, reported) == ([], [])
        flight.core.take(Sighting(flight.clock.now_s(), 1, (200.0, 0.0), (0.01, 0.0, 0.01), 0.9, 0.1))
        await asyncio.sleep(5.0)
        first_s = next(each.time_s for each in flight.statuses if each.target_estimate is not None)
        assert next(report.time_s for _, report in listener.reports if report.target is not None) == first_s
        await flight.outcome()

    run_simulated(main())


def test_the_mission_s_end_and_the_landing_after_a_stop_are_announced() -> None:
    async def main() -> None:
        flight = FakeFlight()
        listener = Listener(flight)
        await flight.begin(80.0)
        await flight.until(Phase.FLYING)
        await asyncio.sleep(5.0)
        assert (listener.newest.outlook, flight.agent.outlook) == (None, None)
        await asyncio.sleep(17.0)
        start_s = listener.newest.start_s
        assert start_s is not None
        assert listener.newest.outlook is not None
        change = listener.newest.outlook.next
        assert change is not None
        assert (change.tactic, change.cause) == ("land", "mission's end")
        assert change.at_s == pytest.approx(start_s + 80.0)
        flight.stop.request()
        await asyncio.sleep(ON_TIME_S + 0.1)
        stopped = listener.newest
        assert stopped.outlook is not None
        assert stopped.outlook.next is not None
        assert (stopped.outlook.next.tactic, stopped.outlook.next.cause) == ("land", "stop")
        assert 2.6 <= stopped.outlook.next.at_s - stopped.time_s <= 3.0
        await flight.outcome()
        assert listener.newest.outlook is None


def test_the_place_is_reported_until_states_are_sent() -> None:
    async def main() -> None:
        flight = FakeFlight()
        listener = Listener(flight)
        await flight.agent.connect()
        flight.agent.announce()
        await asyncio.sleep(1.5)
        assert listener.newest.position_m == (0.0, 0.0, 0.0)
        await flight.begin(20.0)
        await flight.until(Phase.TAKE_OFF)
        for height_m in (1.0, 2.0, 3.0):
            flight.link.position_m = (0.0, 0.0, height_m)
            await asyncio.sleep(0.1 + ON_TIME_S)
            assert listener.newest.position_m == (0.0, 0.0, height_m)
        await flight.until(Phase.FLYING)
        await asyncio.sleep(1.5)
        assert listener.newest.position_m is None, "its states hold it"

    run_simulated(main())


def test_a_link_that_is_cut_is_reported_within_a_second() -> None:
    async def main() -> None:
        flight = FakeFlight()
        listener = Listener(flight)
        await flight.begin(60.0)
        await flight.until(Phase.FLYING)
        await asyncio.sleep(5.0)
        cut_s = asyncio.get_running_loop().time()
        flight.link.telemetry = False
        await asyncio.sleep(3.0)
        cut = [at_s for at_s, report in listener.reports if report.is_link_cut]
        assert LINK_SILENT_S <= cut[0] - cut_s + 0.05 <= LINK_SILENT_S + ON_TIME_S + 0.05
        flight.link.telemetry = True
        back_s = asyncio.get_running_loop().time()
        await asyncio.sleep(1.0)
        back = [at_s for at_s, report in listener.reports if at_s > back_s and not report.is_link_cut]
        assert back[0] - back_s <= ON_TIME_S + 0.05
        flight.command("kill")
        await flight.outcome()
        assert listener.newest.ended == "killed: an operator had its motors cut"

    run_simulated(main())


def test_a_vehicle_in_reserve_is_reported_as_such_until_it_flies() -> None:
    async def main() -> None:
        flight = FakeFlight()
        listener = Listener(flight)
        await flight.agent.connect()
        flight.agent.announce()
        flight.agent.stand_by(60.0)
        await asyncio.sleep(0.1)
        assert (listener.newest.in_reserve, bool(listener.newest.ended)) == (True, True)
        flying = asyncio.create_task(flight.agent.fly_again(60.0, flight.stop))
        await flight.until(Phase.FLYING)
        assert (listener.newest.in_reserve, listener.newest.ended) == (None, "")
        flight.stop.request()
        await flying

    run_simulated(main())


def test_an_end_is_reported_at_once_where_nothing_else_changes() -> None:
    async def main() -> None:
        flight = FakeFlight()
        listener = Listener(flight)
        await flight.begin(60.0)
        await flight.until(Phase.FLYING)
        flight.link.change(mode=FlightMode.HOLD)
        await flight.until(Phase.PILOT_OVERRIDE)
        await asyncio.sleep(2.5)
        assert (listener.newest.mode, listener.newest.ended) == ("hold", "")
        flight.stop.request()
        flight.stop.request()
        await flight.until(Phase.ENDED)
        assert listener.newest.ended.startswith("pilot: the flight mode became 'hold'")
        await flight.outcome()

    run_simulated(main())


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (VehicleStatus(), ""),
        (VehicleStatus(estimator_ratio=0.2, estimator_sensor="height"), "good"),
        (VehicleStatus(estimator_ratio=1.2, estimator_sensor="height"), "height rejected"),
        (VehicleStatus(estimator_ratio=1.2, estimator_fault="no attitude"), "no attitude"),
        (VehicleStatus(estimator_ratio=0.2, gps_threat=GpsThreat.SPOOFED), "GPS spoofed"),
        (VehicleStatus(estimator_fault="x" * 40), "x" * 32),
        (VehicleStatus(estimator_fault="a\x1b[2J"), "a?[2J"),
    ],
)
def test_the_estimator_in_words(status: VehicleStatus, words: str) -> None:
    assert estimator_words(status) == words


def test_the_estimate_of_the_target_is_reported() -> None:
    spread = (4.0, 1.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.5, 0.0, 0.5)
    target = TargetEstimate(100.0, np.array([1.0, 2.0, 0.3, -0.4]), spread, 98.5, 0.8, 0.2)
    axis = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
    own = OwnEstimate(100.0, np.zeros(6), (axis, axis))
    situation = Situation(100.0, 100.1, own, np.zeros(4), np.zeros(2), target, None, None)
    status = CoreStatus(vehicle_id=1, time_s=100.0, tactic=Tactic.ENCIRCLE, situation=situation)
    assert target_report(status) == TargetReport((1.0, 2.0), (0.3, -0.4), (4.0, 1.0, 9.0), 1.5)
    assert target_report(CoreStatus(vehicle_id=1, time_s=100.0, tactic=Tactic.STANDBY)) is None
