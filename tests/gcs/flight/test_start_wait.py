"""What forbids the start of a vehicle that waits on the ground."""

from gcs.flight.preparation import start_blockers
from gcs.preflight.findings import MISSION, Finding, Grade, Subject


def test_the_first_refusal_of_the_vehicle_or_the_mission_counts() -> None:
    def finding(grade: Grade, about: Subject, found: str) -> Finding:
        return Finding(grade, about, "GPS", found, "why", "next")

    warned = finding(Grade.WARNING, 2, "7 satellites")
    other = finding(Grade.REFUSE, 1, "no fix")
    assert start_blockers(2, [warned, other]) == ""
    assert start_blockers(2, [warned, other, finding(Grade.REFUSE, 2, "a 2D fix")]) == "GPS: a 2D fix"
    assert start_blockers(2, [finding(Grade.REFUSE, MISSION, "none at all"), other]) == "GPS: none at all"
