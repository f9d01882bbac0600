"""The drills on real sockets, and their controls: a team whose reactions are switched off fails each of them.

Two reactions cannot be switched off, for they are no settings: standing down for a foreign mode, and the supervisor.
Their controls judge what was recorded of a flight in which nothing happened; `tests/wire/test_supervisor.py` flies
without a supervisor.
"""

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

import pytest

from gcs.drill.faults import DRILLS
from gcs.drill.judge import failures, reacted_s
from gcs.drill.mission import drill_mission
from gcs.drill.roles import Roles
from gcs.drill.run import DrillRow, DrillRun
from gcs.drill.stubs import StubFlight
from gcs.mission.file import parse_mission

pytestmark = pytest.mark.wire

REACTIONS_OFF = (
    ("safety", "telemetry_timeout_s", 30.0),
    ("own_filter", "gate_timeout_s", 60.0),
    ("target", "stale_after_s", 600.0),
    ("failsafe", "battery_s", 60.0),
    ("failsafe", "estimator_s", 60.0),
    ("failsafe", "following_s", 60.0),
    ("failsafe", "peers_silent_s", 600.0),
    ("failsafe", "peer_silent_s", 600.0),
    ("tuning", "failsafe", {"doubt_m": 1000.0, "flood_per_s": 1e6}),
)
CONTROLLED = (
    "flood",
    "impostor",
    "liar",
    "one vehicle not heard",
    "nobody hears anybody",
    "telemetry frozen",
    "GPS jump",
    "estimator degraded",
    "estimator failing",
    "not following",
    "target lost",
    "battery low",
    "battery critical",
    "no way home",
    "killed agent",
)
CONTROL_SPEED = 4.0
UNDISTURBED_S = 2.0
UNWATCHING = 3
"""The vehicle of a trio whose failsafe is switched off."""


class Silent:
    def begin(self, step: str) -> None:
        pass

    def add(self, row: DrillRow) -> None:
        pass


class WithoutFailsafe(StubFlight):
    """A flight of vehicles that stay in offboard however long no agent sends them a setpoint.

    Before anything fails, no reaction to any drill is seen.
    """

    async def reach_mission(self, vehicles: Sequence[int], tactics: Callable[[int], str]) -> None:
        await super().reach_mission(vehicles, tactics)
        began_s = self.now_s()
        await asyncio.sleep(UNDISTURBED_S)
        roles = Roles(parse_mission(drill_mission("case2"), Path()))
        for drill in DRILLS:
            expected = drill.expect(roles, CONTROL_SPEED)
            found = failures(expected, self.log, began_s, self.now_s())
            assert bool(found) is expected.is_reaction, drill.fault
            assert (reacted_s(expected, self.log, began_s) is None) is expected.is_reaction, drill.fault

    def fail(self, fault: str, roles: Roles) -> None:
        for stub in self.stubs.values():
            assert stub.autopilot.parameters.set("COM_OF_LOSS_T", 60.0)
        super().fail(fault, roles)


class Unwatched(StubFlight):
    """A flight with a vehicle that does not watch for heartbeats; `modes` are those of all of them in the end."""

    modes: ClassVar[dict[int, str]] = {}

    async def __aexit__(self, *error: object) -> None:
        Unwatched.modes = {i: self.log.mode(i) for i in self.mission.ids}
        await super().__aexit__(*error)  # type: ignore[arg-type]

    def fail(self, fault: str, roles: Roles) -> None:
        assert self.stubs[UNWATCHING].autopilot.parameters.set("FS_GCS_ENABLE", 0)
        super().fail(fault, roles)


@pytest.mark.alone
async def test_every_drill_holds() -> None:
    drills = [
        drill for drill in DRILLS if not drill.ends_flight
    ]  # of the others one is flown in `tests/gcs/cli/test_cli.py`
    rows = await DrillRun("case2", StubFlight, drills, Silent()).run()
    for row in rows:
        print(f"MEASURED {row.fault}: {row.measured_s} of {row.limit_s} s: {row.holds} {row.detail}")
    assert [row.fault for row in rows] == [drill.fault for drill in drills]
    assert [row for row in rows if row.holds is not True] == []


@pytest.mark.long
async def test_control_with_the_reactions_switched_off_every_drill_fails() -> None:
    drills = [drill for drill in DRILLS if drill.fault in CONTROLLED]
    assert len(drills) == len(CONTROLLED)
    run = DrillRun("case2", WithoutFailsafe, drills, Silent(), speed=CONTROL_SPEED, changes=REACTIONS_OFF)
    for row in await run.run():
        print(f"CONTROL {row.fault}: {row.measured_s} of {row.limit_s} s: {row.holds} {row.detail}")
        assert row.holds is False, row
        assert row.measured_s is None, row
        assert "did not react" in row.detail, row


async def test_a_dead_cordon_is_left_by_the_ardupilots_that_watch_it_and_not_by_one_that_does_not() -> None:
    drills = [drill for drill in DRILLS if drill.fault == "killed agent"]
    (row,) = await DrillRun("ardupilot-trio", Unwatched, drills, Silent(), speed=CONTROL_SPEED).run()
    assert row.holds is False, row
    assert row.detail.count("did not react") == 1, row
    assert f"vehicle {UNWATCHING} did not react" in row.detail, row
    assert " within " not in row.detail, row
    assert Unwatched.modes == {1: "land", 2: "land", UNWATCHING: "offboard"}


async def test_control_on_a_plain_bus_a_stranger_is_obeyed() -> None:
    drills = [drill for drill in DRILLS if drill.fault == "stranger"]
    plain = (("network", "security", {"insecure": True}),)
    run = DrillRun("case2", StubFlight, drills, Silent(), speed=CONTROL_SPEED, changes=plain)
    (row,) = await run.run()
    assert row.holds is False, row
    assert "to 'hold'" in row.detail, row
