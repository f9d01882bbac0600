"""From the ground to the ground over UDP: looked at before arming, refused in the autopilot's words, and once again."""

import asyncio
import re
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from math import dist

import pytest

from agents.control.return_and_land import ARRIVED_M
from agents.flight_end import FlightEnd
from agents.shell.start_agreement import StartAgreement
from agents.team.messages import BusMessage, StartProposal
from gcs.flight.flight import fly
from gcs.flight.plan import FlightPlan
from gcs.flight.stubs import stub_configs
from gcs.mission.file import load_mission
from gcs.preflight.findings import Finding, Grade
from sitl.autopilot.autopilot import StubAutopilot
from sitl.autopilot.px4 import Px4
from tests.support.flights import unseen_view
from tests.support.mission_text import LOW, with_first_vehicles
from tests.support.wire import computers_apart, running, served, until
from tests.support.wording import facts_missing

pytestmark = pytest.mark.wire

SPEED = 5.0


async def test_a_refusal_to_arm_is_told_in_the_autopilots_own_words(
    mission_file: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = with_first_vehicles(mission_file("case2"), 2)
    words = "Arming denied: press the safety switch first"
    monkeypatch.setattr(Px4, "_arming_fault", lambda _autopilot: words)
    async with served(stub_configs(load_mission(path)), SPEED), running("fly", path, "--json") as process:
        out, err = await process.communicate()
    assert (process.returncode, out) == (3, b"")
    refusals = [line for line in err.decode().splitlines() if "refused to arm" in line]
    assert len(refusals) == 2, err.decode()
    assert all(f"“{words}”" in line for line in refusals)
    assert "Traceback" not in err.decode()


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
    computers_apart(monkeypatch, 0.0, 0.7)
    compare_clocks_when_all_are_heard(monkeypatch, 2)
    armings = list[StubAutopilot]()
    monkeypatch.setattr(StubAutopilot, "arm", armings.append)
    mission = load_mission(mission_file("case2"))
    two = mission.vehicles[:2]
    async with served(stub_configs(mission)[:2], SPEED) as stubs:
        plans = [FlightPlan(mission, 5.0, (each,), speed=None, clock=stubs.clock.name) for each in two]
        flights = await asyncio.gather(*(fly(plan, unseen_view()) for plan in plans))
    one, other = (outcome for flight in flights for outcome in flight.outcomes.values())
    assert (one.how, one.flew, other.how, other.flew) == (FlightEnd.REFUSED, False, FlightEnd.REFUSED, False)
    assert re.fullmatch(r"this computer's clock is 0\.[67]\d s behind that of vehicle 2's", one.reason)
    assert re.fullmatch(r"this computer's clock is 0\.[67]\d s ahead of that of vehicle 1's", other.reason)
    assert armings == []


async def test_a_vehicle_that_finds_its_place_late_is_waited_for_and_a_second_mission_follows_at_once(
    mission_file: Callable[..., str],
) -> None:
    mission = load_mission(with_first_vehicles(mission_file("case2", LOW), 2))
    one, two = stub_configs(mission)
    told, written = list[Finding](), StringIO()

    def waits() -> str:
        return "\n".join(line for line in written.getvalue().splitlines() if line.startswith("  "))

    async with served([one, replace(two, localised=False)], SPEED) as stubs:
        plan = FlightPlan(mission, 2.0, mission.vehicles, speed=None, clock=stubs.clock.name)
        finding = asyncio.create_task(_find_itself(stubs.vehicles[2], lambda: "it has no valid position" in waits()))
        for _ in range(2):
            flight = await fly(plan, unseen_view(written), told.extend)
            assert [outcome.how for outcome in flight.outcomes.values()] == [FlightEnd.LANDED] * 2
            assert not any(vehicle.armed for vehicle in stubs.vehicles.values())
        await finding
    assert not [each for each in told if each.grade is Grade.REFUSE]
    assert all(line.startswith("  vehicle 2: ") for line in waits().splitlines())
    assert facts_missing(waits(), "GPS: no fix") == []


RALLY = """[choreography]
landing = "return"
layer_m = 3.0

[[safety.rally]]
name = "west"
place_m = [-12.0, 3.0]

[[safety.rally]]
name = "east"
place_m = [6.0, 2.0]

[safety]"""


async def test_a_team_lands_at_its_spots_of_the_nearest_rally_point(mission_file: Callable[..., str]) -> None:
    """After 20 s at 0.2 m/s along x vehicles are 4 m from their starts, where y is 4 and 0, and 2 m from the east."""
    mission = load_mission(with_first_vehicles(mission_file("case2", LOW, ("[safety]", RALLY)), 2))
    async with served(stub_configs(mission), 10.0) as stubs:
        plan = FlightPlan(mission, 20.0, mission.vehicles, speed=None, clock=stubs.clock.name)
        flight = await fly(plan, unseen_view())
        assert [outcome.how for outcome in flight.outcomes.values()] == [FlightEnd.LANDED] * 2
        landed = {i: vehicle.airframe.position_m for i, vehicle in stubs.vehicles.items()}
    for vehicle_id, spot in ((1, (6.0, 4.0)), (2, (6.0, 0.0))):
        assert dist(landed[vehicle_id][:2], spot) < ARRIVED_M, landed
        assert landed[vehicle_id][2] == pytest.approx(0.0, abs=0.1)


async def _find_itself(vehicle: StubAutopilot, when: Callable[[], bool]) -> None:
    await until(when)
    vehicle._localised = True
