"""From the ground to the ground over UDP: looked at before arming, refused in the autopilot's words, and once again."""

import asyncio
import re
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from io import StringIO

import pytest

from agents.flight_end import FlightEnd
from agents.ports import VehicleRefusedError
from agents.shell.start_agreement import StartAgreement
from agents.shell.zenoh_bus import single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team import participant
from agents.team.codec import encode
from agents.team.messages import TOPICS, BusMessage, StartProposal
from gcs.flight.flight import FlightOutcome, fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.findings import Finding, Grade
from sitl.autopilot.autopilot import StubAutopilot
from sitl.autopilot.modes import NavMode
from sitl.autopilot.px4 import Px4
from sitl.server.governed_clock import Alarm, GovernedClock
from sitl.server.shared_clock import ClockName, Rank
from tests.support.flights import unseen_view
from tests.support.mission_text import INSECURE, LOW
from tests.support.wire import Served, running, served, until
from tests.support.wording import facts_missing

pytestmark = pytest.mark.wire

SPEED = 5.0


async def flown(mission: Mission, stubs: Served, findings: list[Finding]) -> FlightOutcome:
    plan = FlightPlan(mission, 5.0, mission.vehicles, speed=None, clock=stubs.clock.name)
    return await fly(plan, unseen_view(), findings.extend)


class Watched:
    """The stub vehicles by the order in which they were made, and what was asked of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.vehicles: list[StubAutopilot] = []
        self.asked: list[str] = []
        make, arm, select = StubAutopilot.__init__, StubAutopilot.arm, StubAutopilot.select

        def noted_make(autopilot: StubAutopilot, *arguments: object, **named: object) -> None:
            self.vehicles.append(autopilot)
            make(autopilot, *arguments, **named)  # type: ignore[arg-type]

        def noted_arm(autopilot: StubAutopilot) -> object:
            self.asked.append("arm")
            return arm(autopilot)

        def noted_select(autopilot: StubAutopilot, mode: NavMode) -> object:
            self.asked.append(mode.name)
            return select(autopilot, mode)

        monkeypatch.setattr(StubAutopilot, "__init__", noted_make)
        monkeypatch.setattr(StubAutopilot, "arm", noted_arm)
        monkeypatch.setattr(StubAutopilot, "select", noted_select)


async def test_what_the_check_refuses_is_told_and_nothing_is_armed(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = load_mission(mission_file("case2"))
    one, two, three = stub_configs(mission)
    watched, told = Watched(monkeypatch), list[Finding]()
    async with served([one, replace(two, battery_fraction=0.1), three], SPEED) as stubs:
        with pytest.raises(VehicleRefusedError, match="nothing was armed") as refused:
            await flown(mission, stubs, told)
    grave = [(finding.subject, finding.found) for finding in told if finding.grade is Grade.REFUSE]
    assert grave == [("vehicle 2", "its battery is at 10%")]
    assert "cordon check" in refused.value.next_step
    assert watched.asked == [], "looking changes nothing"


async def test_a_refusal_to_arm_is_told_in_the_autopilots_own_words(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mission_file("case2")
    words = "Arming denied: press the safety switch first"
    monkeypatch.setattr(Px4, "_arming_fault", lambda _autopilot: words)
    async with served(stub_configs(load_mission(path)), SPEED), running("fly", path, "--json") as process:
        out, err = await process.communicate()
    assert (process.returncode, out) == (3, b"")
    refusals = [line for line in err.decode().splitlines() if "refused to arm" in line]
    assert len(refusals) == 3, err.decode()
    assert all(f"“{words}”" in line for line in refusals)
    assert "Traceback" not in err.decode()


@pytest.mark.parametrize(("ahead_s", "refused"), [(0.7, True), (0.2, False)])
async def test_a_peer_whose_computer_has_another_time(
    ahead_s: float, refused: bool, mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agents.shell.start_agreement.START_TIMEOUT_S", 5.0)
    mission = load_mission(mission_file("case2", INSECURE))
    one, _, three = mission.vehicles
    watched, told = Watched(monkeypatch), list[Finding]()
    async with served(stub_configs(mission)[:1], SPEED) as stubs, mustering(mission, three, ahead_s, stubs.clock):
        plan = FlightPlan(mission, 5.0, (one,), speed=None, clock=stubs.clock.name)
        outcome = (await fly(plan, unseen_view(), told.extend)).outcomes[1]
    assert outcome.how is FlightEnd.REFUSED
    assert outcome.flew is not refused
    if refused:
        assert "arm" not in watched.asked
        assert re.fullmatch(r"this computer's clock is 0\.[67]\d s behind that of vehicle 3's", outcome.reason)
        assert "chrony" in outcome.next_step
    else:
        (finding,) = (each for each in told if each.check == "clock offset")
        assert finding.grade is Grade.WARNING
        assert re.fullmatch(r"its computer's clock is 0\.[12]\d s behind that of vehicle 3's", finding.found)


def compare_clocks_when_all_are_heard(monkeypatch: pytest.MonkeyPatch, vehicles: int) -> None:
    """Let no vehicle compare clocks before all are heard: one that is alone on the bus takes off and compares later."""
    heard: set[int] = set()
    receive, compare_clocks = StartAgreement.receive, StartAgreement.compare_clocks

    def receive_and_note(agreement: StartAgreement, message: BusMessage) -> None:
        if isinstance(message, StartProposal):
            heard.add(message.sender)
        receive(agreement, message)

    async def compare(agreement: StartAgreement) -> None:
        agreement.announce()
        while len(heard) < vehicles:
            await asyncio.sleep(0.01)
        await compare_clocks(agreement)

    monkeypatch.setattr(StartAgreement, "receive", receive_and_note)
    monkeypatch.setattr(StartAgreement, "compare_clocks", compare)


async def test_two_that_are_started_together_and_differ_in_time_do_not_even_arm(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    offsets_s = iter((0.0, 0.7))

    class ComputersClock(GovernedClock):
        def __init__(self, name: ClockName, rank: Rank) -> None:
            super().__init__(name, rank)
            self._ahead_s = next(offsets_s)

        def now_s(self) -> float:
            return super().now_s() + self._ahead_s

        def call_at(self, time_s: float, call: Callable[[], object]) -> Alarm:
            return super().call_at(time_s - self._ahead_s, call)

    monkeypatch.setattr("gcs.flight.flight.GovernedClock", ComputersClock)
    compare_clocks_when_all_are_heard(monkeypatch, 2)
    mission = load_mission(mission_file("case2"))
    watched, two = Watched(monkeypatch), mission.vehicles[:2]
    async with served(stub_configs(mission)[:2], SPEED) as stubs:
        plans = [FlightPlan(mission, 5.0, (each,), speed=None, clock=stubs.clock.name) for each in two]
        flights = await asyncio.gather(*(fly(plan, unseen_view()) for plan in plans))
    one, other = (outcome for flight in flights for outcome in flight.outcomes.values())
    assert (one.how, one.flew, other.how, other.flew) == (FlightEnd.REFUSED, False, FlightEnd.REFUSED, False)
    assert re.fullmatch(r"this computer's clock is 0\.[67]\d s behind that of vehicle 2's", one.reason)
    assert re.fullmatch(r"this computer's clock is 0\.[67]\d s ahead of that of vehicle 1's", other.reason)
    assert "arm" not in watched.asked


@asynccontextmanager
async def mustering(
    mission: Mission, vehicle: MissionVehicle, ahead_s: float, clock: GovernedClock
) -> AsyncIterator[None]:
    """Let one vehicle be up and ready on a computer whose clock is ahead, and never propose a start."""
    others = [each.section.endpoint for each in mission.vehicles if each.id != vehicle.id]
    own = participant.vehicle(vehicle.id)
    bus = single_bus(own, BusTeam(mission.network.team, mission.ids), vehicle.section.endpoint, others)
    await bus.open(lambda *_: None, lambda *_: None, lambda *_: None)

    async def speak() -> None:
        while True:
            bus.publish(TOPICS[StartProposal].name, encode(StartProposal(vehicle.id, clock.now_s() + ahead_s, None)))
            await clock.sleep(0.05)

    speaking = asyncio.create_task(speak())
    try:
        yield
    finally:
        speaking.cancel()
        await bus.close()


async def test_a_vehicle_that_finds_its_place_late_is_waited_for_and_a_second_mission_follows_at_once(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = load_mission(mission_file("case2", LOW))
    one, two, three = stub_configs(mission)
    watched, told, written = Watched(monkeypatch), list[Finding](), StringIO()

    def waits() -> str:
        return "\n".join(line for line in written.getvalue().splitlines() if line.startswith("  "))

    async with served([one, replace(two, localised=False), three], SPEED) as stubs:
        plan = FlightPlan(mission, 5.0, mission.vehicles, speed=None, clock=stubs.clock.name)
        finding = asyncio.create_task(_find_itself(watched.vehicles[1], lambda: "it has no valid position" in waits()))
        for _ in range(2):
            flight = await fly(plan, unseen_view(written), told.extend)
            assert [outcome.how for outcome in flight.outcomes.values()] == [FlightEnd.LANDED] * 3
            assert not any(vehicle.armed for vehicle in watched.vehicles)
        await finding
    assert watched.asked.count("arm") == 6
    assert not [each for each in told if each.grade is Grade.REFUSE]
    assert all(line.startswith("  vehicle 2: ") for line in waits().splitlines())
    assert facts_missing(waits(), "GPS: no fix") == []


async def _find_itself(vehicle: StubAutopilot, when: Callable[[], bool]) -> None:
    await until(when)
    vehicle._localised = True
