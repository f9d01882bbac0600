"""Preflight checks of the autopilot's estimator: its innovation test ratios, and the states that it provides."""

from collections.abc import Iterator

from agents.safety.failsafe import RATIO_MAX, RATIO_RESERVE
from gcs.link.estimator_report import EstimatorReport
from gcs.mission.mission import Mission
from gcs.preflight.findings import Finding, Grade, VehicleFacts, limited

STEPS = {
    "horizontal position": "leave it at rest with a clear view of the sky; indoors check the positioning system",
    "height": "leave it at rest for a minute, or restart the autopilot; shield the barometer from wind and sun",
    "velocity": "leave it at rest for a minute with a clear view of the sky, or restart the autopilot",
    "compass": "move the vehicle away from steel, cables and cars; if the ratio stays high, calibrate the compass",
}
WHY = "the estimated position or heading may jump or drift in flight, and the vehicle follows it"
RESTART = "leave the vehicle at rest, restart the autopilot, and read its messages in a ground station"


def estimator(facts: VehicleFacts, mission: Mission) -> Iterator[Finding]:
    """Check the estimator report: the available states, and each test ratio above the limit, or else the highest."""
    report = facts.estimator
    if report is None or not report.ratios:
        message = facts.autopilot.estimator.message
        found = f"estimator report ({message}) not received: sensor consistency is unknown"
        yield _finding(facts, Grade.WARNING, found, "check the estimator with a ground station, and check the link")
        return
    for fault in report.wrong:
        yield _finding(facts, Grade.REFUSE, f"estimator fault: {fault}", RESTART)
    yield from _position(facts, report, local=mission.frame.local)
    if report.glitch:
        yield _finding(facts, Grade.WARNING, "estimator reports a GPS glitch", STEPS["horizontal position"])
    highest = max(report.ratios, key=lambda name: report.ratios[name])
    for name, ratio in report.ratios.items():
        grade = limited(ratio, RATIO_MAX, RATIO_RESERVE)
        if grade is not Grade.PASS:
            state = "rejected by the estimator" if grade is Grade.REFUSE else "innovation test ratio too high"
            found = f"{name}: {state} (test ratio {ratio:.2f}, limit {RATIO_MAX:g})"
            yield _finding(facts, grade, found, STEPS[name])
        elif name == highest:
            found = f"estimator: highest innovation test ratio {ratio:.2f} ({name}), limit {RATIO_MAX:g}"
            yield Finding(Grade.PASS, facts.vehicle_id, "estimator", found)


def _position(facts: VehicleFacts, report: EstimatorReport, *, local: bool) -> Iterator[Finding]:
    """Check that the estimator provides the position that the mission needs; a missing position is another check."""
    lost = facts.origin_m is None or facts.position_m is None
    if lost or report.absolute or (local and report.relative):
        return
    if local:
        step = "check the positioning system (cameras, odometry), then restart the autopilot"
        yield _finding(facts, Grade.REFUSE, "estimator has no horizontal position", step)
    else:
        found = "estimator has no global horizontal position"
        yield _finding(facts, Grade.REFUSE, found, "wait for GPS with a clear view of the sky")


def _finding(facts: VehicleFacts, grade: Grade, found: str, step: str) -> Finding:
    return Finding(grade, facts.vehicle_id, "estimator", found, WHY, step, temporary=True)
