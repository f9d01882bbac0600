"""Preflight checks of the autopilot's estimator: its innovation test ratios, and the states that it provides."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite

from gcs.mission.mission import Mission
from gcs.preflight.findings import AutopilotKind, EstimatorReport, Finding, Grade, VehicleFacts, limited

RATIO_MAX, RATIO_RESERVE = 1.0, 0.5
"""The estimator rejects a sensor at a test ratio above 1; 0.5 is the former arming limit of PX4."""
ATTITUDE, POS_HORIZ_REL, POS_HORIZ_ABS, POS_VERT_ABS, PRED_POS_HORIZ_REL, PRED_POS_HORIZ_ABS = 1, 8, 16, 32, 256, 512


@dataclass(frozen=True, slots=True)
class _Dialect:
    """One autopilot's estimator report: message, field of each test ratio, and meaning of its flags.

    Any bit of `relative` or `absolute` stands for a horizontal position; `errors` maps a bit to its fault.
    """

    message: str
    number: int
    ratios: Mapping[str, str]
    relative: int
    absolute: int
    errors: Mapping[int, str]
    glitch: int


DIALECTS: Mapping[AutopilotKind, _Dialect] = {
    AutopilotKind.PX4: _Dialect(
        "ESTIMATOR_STATUS",
        230,
        {
            "horizontal position": "pos_horiz_ratio",
            "height": "pos_vert_ratio",
            "velocity": "vel_ratio",
            "compass": "mag_ratio",
        },
        POS_HORIZ_REL | POS_HORIZ_ABS,
        POS_HORIZ_ABS,
        {2048: "accelerometer error"},
        1024,
    ),
    AutopilotKind.ARDUPILOT: _Dialect(
        "EKF_STATUS_REPORT",
        193,
        {
            "horizontal position": "pos_horiz_variance",
            "height": "pos_vert_variance",
            "velocity": "velocity_variance",
            "compass": "compass_variance",
        },
        # Disarmed, it may report the position predicted for flight only, as its own arming checks use.
        POS_HORIZ_REL | POS_HORIZ_ABS | PRED_POS_HORIZ_REL | PRED_POS_HORIZ_ABS,
        POS_HORIZ_ABS | PRED_POS_HORIZ_ABS,
        {1024: "not initialized"},
        1 << 15,
    ),
}
"""The bits above POS_HORIZ_ABS differ: 1024 is a GPS glitch on PX4, and not initialized on ArduPilot."""
STEPS = {
    "horizontal position": "leave it at rest with a clear view of the sky; indoors check the positioning system",
    "height": "leave it at rest for a minute, or restart the autopilot; shield the barometer from wind and sun",
    "velocity": "leave it at rest for a minute with a clear view of the sky, or restart the autopilot",
    "compass": "move the vehicle away from steel, cables and cars; if the ratio stays high, calibrate the compass",
}
WHY = "the estimated position or heading may jump or drift in flight, and the vehicle is controlled by it"
RESTART = "leave the vehicle at rest, restart the autopilot, and read its messages in a ground station"


def estimator_report(kind: AutopilotKind, fields: Mapping[str, object]) -> EstimatorReport | None:
    """Return the report in a message's fields; None without flags. A ratio that is not a number is left out."""
    dialect, flags = DIALECTS.get(kind), fields.get("flags")
    if dialect is None or not isinstance(flags, int):
        return None
    values = {name: fields.get(field) for name, field in dialect.ratios.items()}
    faults = [fault for bit, fault in dialect.errors.items() if flags & bit]
    faults += ["no attitude"] if not flags & ATTITUDE else []
    faults += ["no height"] if not flags & POS_VERT_ABS else []
    return EstimatorReport(
        ratios={
            name: float(value) for name, value in values.items() if isinstance(value, int | float) and isfinite(value)
        },
        relative=bool(flags & dialect.relative),
        absolute=bool(flags & dialect.absolute),
        wrong=tuple(faults),
        glitch=bool(flags & dialect.glitch),
    )


def estimator(facts: VehicleFacts, mission: Mission) -> Iterator[Finding]:
    """Check the estimator report: the available states, and each high test ratio, or else the highest one."""
    report = facts.estimator
    if report is None or not report.ratios:
        message = DIALECTS[facts.autopilot].message
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
            yield Finding(Grade.PASS, facts.subject, "estimator", found)


def _position(facts: VehicleFacts, report: EstimatorReport, *, local: bool) -> Iterator[Finding]:
    """Check that the estimator has the position that the mission needs; a lost position is another check."""
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
    return Finding(grade, facts.subject, "estimator", found, WHY, step)
