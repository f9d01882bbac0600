"""Who is ready to start, from what vehicles send of themselves."""

import pytest

from agents.team.messages import BusMessage, MissionIdentity, StartProposal, VehicleReport
from gcs.console.command_client import StartReports
from gcs.mission.file import load_mission

MISSION = load_mission("case2")
OTHER = MissionIdentity("case2", "0" * 16)


def report(start_blockers: str | None = "", *, armed: bool = False, ended: str = "") -> VehicleReport:
    return VehicleReport(2, 10.0, "hold", armed, start_blockers=start_blockers, clock_off_s=0.02, ended=ended)


def proposal(mission: MissionIdentity | None) -> StartProposal:
    return StartProposal(2, 10.0, None, ready=False, mission=mission)


@pytest.mark.parametrize(
    ("messages", "present", "state", "reason"),
    [
        ((report(),), False, "missing", "no agent is on the bus"),
        ((), True, "missing", "has not found its autopilot"),
        ((report(), proposal(MISSION.identity)), True, "ready", ""),
        ((report("GPS: no fix"),), True, "missing", "GPS: no fix"),
        ((report(), proposal(OTHER)), True, "missing", "another version"),
        ((report(None),), True, "missing", "--wait-for-start"),
        ((report(None, armed=True),), True, "flying", ""),
        ((report(None, ended="landed"),), True, "missing", "has ended: landed"),
        ((report("GPS: no fix"), report()), True, "ready", ""),
    ],
)
def test_a_vehicle_is_ready_flying_or_missing(
    messages: tuple[BusMessage, ...], present: bool, state: str, reason: str
) -> None:
    roll = StartReports(MISSION)
    for message in messages:
        roll.receive(message)
    standing = next(each for each in roll.states({2} if present else ()) if each.vehicle == 2)
    assert standing.state == state
    assert reason in standing.reason
    assert bool(standing.reason) == bool(reason)
