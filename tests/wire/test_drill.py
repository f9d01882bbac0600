"""The drills on real sockets and processes, and their control: a team whose reactions are switched off fails them.

The others fly below the wire in `tests/gcs/drill/test_drills.py`; of those that end a flight, one is flown in
`tests/wire/test_verbs.py`. A supervisor cannot be switched off: `tests/wire/test_supervisor.py` flies without one.
"""

from collections.abc import Callable
from typing import ClassVar

import pytest

from gcs.drill.faults import DRILLS, Roles
from gcs.drill.run import DrillRun
from gcs.drill.stubs import StubFlight
from sitl.server.governed_clock import GovernedClock
from tests.support.drills import Silent
from tests.support.mission_text import LOW

pytestmark = pytest.mark.wire

FLOWN = ("stranger", "flood", "impostor", "origin moved", "link cut", "lost in the air")
"""The drills that need sockets and end no flight."""
REACTIONS_OFF = (
    ("tuning", "failsafe", {"doubt_m": 1000.0, "flood_per_s": 1e6}),
    ("network", "security", {"insecure": True}),
)
CONTROLLED = ("stranger", "flood", "impostor", "killed agent")
CONTROL_SPEED = 4.0
UNWATCHING = 3
"""The vehicle of a trio whose failsafe is switched off."""


class Patient(StubFlight):
    """A flight that goes on slower while, by the wall's clock, a vehicle that is lost is commanded in vain."""

    def fail(self, fault: str, roles: Roles) -> None:
        super().fail(fault, roles)
        if fault == "lost in the air":
            assert isinstance(self.clock, GovernedClock)
            self.clock.set_speed(CONTROL_SPEED)


class WithoutFailsafe(StubFlight):
    """A flight of vehicles that stay in offboard however long no agent sends them a setpoint."""

    def fail(self, fault: str, roles: Roles) -> None:
        for stub in self.stubs.values():
            assert stub.autopilot.parameters.set("COM_OF_LOSS_T", 60.0)
        super().fail(fault, roles)


class Unwatched(StubFlight):
    """A flight with a vehicle that does not watch for heartbeats; `modes` are those of all of them in the end."""

    modes: ClassVar[dict[int, str]] = {}

    async def __aexit__(self, *error: object) -> None:
        Unwatched.modes = {i: self.log.mode(i) for i in self.mission.ids}
        await super().__aexit__(*error)

    def fail(self, fault: str, roles: Roles) -> None:
        assert self.stubs[UNWATCHING].autopilot.parameters.set("FS_GCS_ENABLE", 0)
        super().fail(fault, roles)


@pytest.mark.long
async def test_drills_that_need_sockets_hold(mission_file: Callable[..., str]) -> None:
    drills = [drill for drill in DRILLS if drill.fault in FLOWN]
    rows = await DrillRun(mission_file("case2", LOW), Patient, drills, Silent()).run()
    for row in rows:
        print(f"MEASURED {row.fault}: {row.measured_s} of {row.limit_s} s: {row.holds} {row.detail}")
    assert [row.fault for row in rows] == [*FLOWN]
    assert [row for row in rows if row.holds is not True] == []


@pytest.mark.long
async def test_control_with_the_reactions_switched_off_every_drill_fails(mission_file: Callable[..., str]) -> None:
    drills = [drill for drill in DRILLS if drill.fault in CONTROLLED]
    mission = mission_file("case2", LOW)
    run = DrillRun(mission, WithoutFailsafe, drills, Silent(), speed=CONTROL_SPEED, changes=REACTIONS_OFF)
    rows = await run.run()
    assert [row.fault for row in rows] == [*CONTROLLED]
    for row in rows:
        print(f"CONTROL {row.fault}: {row.measured_s} of {row.limit_s} s: {row.holds} {row.detail}")
        assert row.holds is False, row
        assert row.measured_s is None, row
        assert ("to 'hold'" if row.fault == "stranger" else "did not react") in row.detail, row


@pytest.mark.long
async def test_a_dead_cordon_is_left_by_the_ardupilots_that_watch_it_and_not_by_one_that_does_not() -> None:
    drills = [drill for drill in DRILLS if drill.fault == "killed agent"]
    (row,) = await DrillRun("ardupilot-trio", Unwatched, drills, Silent(), speed=CONTROL_SPEED).run()
    assert row.holds is False, row
    assert row.detail.count("did not react") == 1, row
    assert f"vehicle {UNWATCHING} did not react" in row.detail, row
    assert " within " not in row.detail, row
    assert Unwatched.modes == {1: "land", 2: "land", UNWATCHING: "offboard"}
