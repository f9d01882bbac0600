"""What forbids the start of a vehicle that waits on the ground."""

from gcs.flight.preparation import start_blockers
from gcs.preflight.findings import MISSION, Finding, Grade


def test_the_first_refusal_of_the_vehicle_or_the_mission_counts() -> None:
    def finding(grade: Grade, subject: str, found: str) -> Finding:
        return Finding(grade, subject, "GPS", found, "why", "next")

    warned = finding(Grade.WARNING, "vehicle 2", "7 satellites")
    other = finding(Grade.REFUSE, "vehicle 1", "no fix")
    assert start_blockers(2, [warned, other]) == ""
    assert start_blockers(2, [warned, other, finding(Grade.REFUSE, "vehicle 2", "a 2D fix")]) == "GPS: a 2D fix"
    assert start_blockers(2, [finding(Grade.REFUSE, MISSION, "none at all"), other]) == "GPS: none at all"
