"""The drills that need no socket, below the wire, and their control: a team whose reactions are switched off fails.

One reaction cannot be switched off, for it is no setting: standing down for a foreign mode. Its control judges an
undisturbed flight. The other drills fly in `tests/wire/test_drill.py`.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Self

import pytest

from estimation.frames import Triple
from estimation.profile.profile import ProfileLibrary
from gcs.drill.faults import DRILLS, Roles
from gcs.drill.flight import DrillFlight
from gcs.drill.judge import failures, reacted_s
from gcs.drill.run import DrillRun, drill_mission
from gcs.flight.faults.catalogue import required_fault
from gcs.flight.faults.team_faults import TeamFaults
from gcs.mission.file import parse_mission
from tests.support.drills import Silent
from tests.support.fake_flight import SimulatedClock
from tests.support.simulated_loop import run_simulated
from tests.support.simulated_team import SimulatedTeam

ON_SOCKETS = (
    *("stranger", "flood", "impostor", "origin moved", "link cut", "lost in the air"),
    *("killed agent", "frozen agent", "frozen interpreter"),
)
BELOW = [drill for drill in DRILLS if drill.fault not in ON_SOCKETS]
REACTIONS_OFF = (
    ("safety", "telemetry_timeout_s", 30.0),
    ("target", "stale_after_s", 600.0),
    ("failsafe", "peers_silent_s", 600.0),
    ("failsafe", "peer_silent_s", 600.0),
    ("tuning", "failsafe", {"battery_s": 60.0, "estimator_s": 60.0, "following_s": 60.0, "doubt_m": 1000.0}),
)
UNDISTURBED_S = 2.0
AIRBORNE_M = 0.5


class FlightBelowTheWire(DrillFlight):
    """A flight of a drill in simulated time."""

    def __init__(self, text: str, speed: float, profile_texts: Mapping[str, str] | None = None) -> None:
        super().__init__(text, speed, profile_texts=profile_texts)
        self.clock = SimulatedClock(1.0)
        self.team = SimulatedTeam(self.mission, self._receive, self._observe)
        self._received: dict[int, int] = {}

    async def __aenter__(self) -> Self:
        await self.team.__aenter__()
        await self.team.begin()
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.team.__aexit__(*error)

    @property
    def has_begun(self) -> bool:
        return True

    def _observe(self) -> None:
        now_s = self.now_s()
        autopilots = {i: link.autopilot for i, link in self.team.links.items()}
        for i, autopilot in autopilots.items():
            self.log.note_mode(now_s, i, autopilot.mode.name.lower() if autopilot.armed else "disarmed")
            if autopilot.setpoints_received != self._received.get(i):
                self._received[i], self.log.setpoint_s[i] = autopilot.setpoints_received, now_s
        frames = {i: autopilot.airframe for i, autopilot in autopilots.items()}
        self.log.note_places(now_s, {i: f.position_m for i, f in frames.items() if f.height_m > AIRBORNE_M})

    def places_m(self) -> Mapping[int, Triple]:
        return {i: link.autopilot.airframe.position_m for i, link in self.team.links.items()}

    def fail(self, fault: str, roles: Roles) -> None:
        injection = required_fault(fault).inject(self._scene(roles))
        self.team.faults.set(injection.team)
        for i, each in injection.vehicles.items():
            self.team.links[i].inject(each)

    def clear_faults(self) -> None:
        self.team.faults.set(TeamFaults())
        for link in self.team.links.values():
            link.faults.clear()

    async def resume(self, vehicle: int) -> None:
        self.team.command("resume", vehicle)


class Undisturbed(FlightBelowTheWire):
    """Before anything fails, no reaction to any drill is seen."""

    async def reach_mission(self, vehicles: Sequence[int], tactics: Callable[[int], str]) -> None:
        await super().reach_mission(vehicles, tactics)
        began_s = self.now_s()
        await asyncio.sleep(UNDISTURBED_S)
        roles = Roles(parse_mission(drill_mission("case2"), None))
        for drill in DRILLS:
            expected = drill.expect(roles)
            found = failures(expected, self.log, began_s, self.now_s())
            assert bool(found) is expected.is_reaction, drill.fault
            assert (reacted_s(expected, self.log, began_s) is None) is expected.is_reaction, drill.fault


class Unreacting(Undisturbed):
    """Its filters do not follow a jump of the position."""

    def __init__(self, text: str, speed: float) -> None:
        stub = ProfileLibrary(None)
        stub.load("stub")
        super().__init__(text, speed, {"stub": f"{stub.texts['stub']}[own_filter]\ngate_timeout_s = 60.0\n"})


def test_every_drill_holds(subtests: pytest.Subtests) -> None:
    rows = run_simulated(DrillRun("case2", FlightBelowTheWire, BELOW, Silent(), speed=1.0).run())
    assert [row.fault for row in rows] == [drill.fault for drill in BELOW]
    for row in rows:
        with subtests.test(row.fault):
            assert row.holds is True, row


def test_control_with_the_reactions_switched_off_every_drill_fails(subtests: pytest.Subtests) -> None:
    uncontrolled = ("half of all messages lost", "latency", "foreign mode")
    drills = [drill for drill in BELOW if drill.fault not in uncontrolled]
    run = DrillRun("case2", Unreacting, drills, Silent(), speed=1.0, changes=REACTIONS_OFF)
    rows = run_simulated(run.run())
    assert [row.fault for row in rows] == [drill.fault for drill in drills]
    for row in rows:
        with subtests.test(row.fault):
            assert row.holds is False, row
            assert row.measured_s is None, row
            assert "did not react" in row.detail, row
