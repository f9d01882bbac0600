"""What is waited for on the ground, by the findings of checks one after the other."""

import asyncio
from collections.abc import Sequence
from types import SimpleNamespace
from typing import cast

import pytest

from agents.ports import VehicleRefusedError
from gcs.flight.preparation import FIRST_REPORTS_S, Readiness, blocker_lines, start_blockers
from gcs.flight.team import FlightTeam
from gcs.preflight.findings import MISSION, Finding, Grade
from tests.support.simulated_loop import run_simulated

WELL = Finding(Grade.PASS, 1, "gps", "GPS: 3D fix, 14 satellites")
FEASIBLE = (Finding(Grade.PASS, MISSION, "settling", "3 vehicles settle after about 12 s"),)
WARNED = Finding(Grade.WARNING, 1, "battery", "its battery is at 40%", "it may not last", "charge it")


def lack(vehicle: int, found: str, *, temporary: bool = True) -> Finding:
    return Finding(Grade.REFUSE, vehicle, "gps", found, "why", "next", temporary=temporary)


NO_FIX = lack(2, "GPS: no fix, 0 satellites")
CLOCKS = Finding(Grade.REFUSE, MISSION, "clocks", "they run at different speeds", "why", "next")
WRONG = lack(3, "COM_OF_LOSS_T = 6", temporary=False)


class FakeTeam:
    """A team whose checks find one list after the other, the last one for ever."""

    def __init__(self, wait_s: float, *checks: Sequence[Finding], speeds: Sequence[bool] = (True,)) -> None:
        self.checks, self.speeds = list(checks), list(speeds)
        self.settled_s: list[float] = []
        self.recorded: list[object] = []
        self.lines: list[str] = []
        self.measured = 0
        self.plan = SimpleNamespace(wait_s=wait_s, speed=None, is_governed=False, findings=self._findings)
        self.begin_vehicle = self.recorded.append
        self.view = SimpleNamespace(is_live=False, print_line=self.lines.append, update=lambda *_: None)

    async def facts(self, settle_s: float) -> list[str]:
        self.settled_s.append(settle_s)
        await asyncio.sleep(0.01)
        return [f"facts {len(self.settled_s)}"]

    async def computer(self) -> None:
        """It is a team of stubs: how late this computer is does not matter."""

    async def measure_speed(self) -> None:
        self.measured += 1
        await asyncio.sleep(0.01)
        if not (self.speeds.pop(0) if len(self.speeds) > 1 else self.speeds[0]):
            raise VehicleRefusedError("vehicle 1 sends no attitude", "check the link")

    def _findings(self, _facts: object, _computer: None, feasible: Sequence[Finding]) -> Sequence[Finding]:
        assert feasible is FEASIBLE
        return self.checks.pop(0) if len(self.checks) > 1 else self.checks[0]


def readiness(team: FakeTeam) -> Readiness:
    feasible: asyncio.Future[Sequence[Finding]] = asyncio.get_running_loop().create_future()
    feasible.set_result(FEASIBLE)
    return Readiness(cast(FlightTeam, team), feasible)


async def checked(team: FakeTeam) -> Sequence[Finding]:
    return await readiness(team).findings()


async def test_a_team_that_is_ready_is_checked_once() -> None:
    team = FakeTeam(30.0, [WELL, WARNED], [NO_FIX])
    assert await checked(team) == [WELL, WARNED]
    assert team.settled_s == [FIRST_REPORTS_S]
    assert team.lines == []


async def test_what_waiting_cannot_change_is_checked_once_more_and_refused() -> None:
    team = FakeTeam(30.0, [NO_FIX, WRONG], [NO_FIX, WRONG], [WELL])
    assert await checked(team) == [NO_FIX, WRONG]
    assert team.lines == []
    assert await checked(FakeTeam(0.0, [NO_FIX], [WELL])) == [NO_FIX], "without a wait"
    assert await checked(FakeTeam(30.0, [CLOCKS], [WELL], [CLOCKS])) == [WELL], "a busy computer measured it wrong"


async def test_vehicles_about_to_be_ready_are_waited_for() -> None:
    both = [NO_FIX, lack(3, NO_FIX.found)]
    team = FakeTeam(30.0, both, both, [NO_FIX, WARNED], [WARNED, CLOCKS], [WARNED])
    assert await checked(team) == [WARNED], "what is found in the moment they become ready is measured again"
    assert team.recorded == ["facts 5"], "the log holds what was true at the end"
    assert team.measured == 1
    first, second = team.lines
    assert "vehicles 2, 3: GPS: no fix, 0 satellites" in first
    assert "vehicle 2: GPS: no fix, 0 satellites" in second


def test_the_wait_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    async def waited() -> None:
        monkeypatch.setattr("gcs.flight.preparation.time.monotonic", asyncio.get_running_loop().time)
        team = FakeTeam(0.2, [NO_FIX])
        assert await checked(team) == [NO_FIX]
        assert len(team.settled_s) == 20, "each takes 10 ms"
        refused = readiness(FakeTeam(0.05, speeds=(False,)))
        with pytest.raises(VehicleRefusedError, match="no attitude"):
            await refused.measure_speed()

    run_simulated(waited())


async def test_what_waiting_uncovers_is_refused_at_once() -> None:
    team = FakeTeam(30.0, [NO_FIX], [NO_FIX, WRONG], [NO_FIX, WRONG], [WELL])
    assert await checked(team) == [NO_FIX, WRONG]


async def test_a_speed_that_cannot_be_measured_yet() -> None:
    team = FakeTeam(30.0, speeds=(False, False, True))
    await readiness(team).measure_speed()
    assert team.measured == 3


def test_the_first_refusal_of_a_vehicle_or_the_mission_forbids_its_start() -> None:
    assert start_blockers(2, [WARNED, lack(1, "no fix")]) == ""
    assert start_blockers(2, [WARNED, lack(1, "no fix"), lack(2, "a 2D fix")]) == "gps: a 2D fix"
    assert start_blockers(2, [CLOCKS, lack(1, "no fix")]) == f"clocks: {CLOCKS.found}"


def test_vehicles_that_lack_the_same_share_a_line() -> None:
    lines = blocker_lines([NO_FIX, lack(3, NO_FIX.found), lack(3, "home position: not healthy")])
    assert [line.strip() for line in lines] == [
        "vehicles 2, 3: GPS: no fix, 0 satellites",
        "vehicle 3: home position: not healthy",
    ]
