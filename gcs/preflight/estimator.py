"""Preflight, what the autopilot's estimator says of itself: whether its sensors agree, and what it knows by them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite

from gcs.mission.mission import Mission
from gcs.preflight.findings import (
    AutopilotKind,
    EstimatorReport,
    Finding,
    Grade,
    VehicleFacts,
    limited,
)

RATIO_MAX, RATIO_RESERVE = 1.0, 0.5
"""A test ratio above 1 is that of a sensor that the estimator rejects; half of it is what PX4 used to arm by."""
ATTITUDE, POS_HORIZ_REL, POS_HORIZ_ABS, POS_VERT_ABS, PRED_POS_HORIZ_REL, PRED_POS_HORIZ_ABS = 1, 8, 16, 32, 256, 512


@dataclass(frozen=True, slots=True)
class _Dialect:
    """One autopilot's report: the message, the field of each test ratio, and what its flags mean.

    `relative` and `absolute` tell a horizontal position by any of their bits, `errors` what is wrong when a bit is set.
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
        {2048: "its accelerometer reads wrong"},
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
        # Disarmed, it may only say which position it would have in flight: its own arming checks go by that.
        POS_HORIZ_REL | POS_HORIZ_ABS | PRED_POS_HORIZ_REL | PRED_POS_HORIZ_ABS,
        POS_HORIZ_ABS | PRED_POS_HORIZ_ABS,
        {1024: "it has not begun yet"},
        1 << 15,
    ),
}
"""The bits above POS_HORIZ_ABS differ: 1024 is a glitch of PX4's GPS, and an ArduPilot that has not begun."""
STEPS = {
    "horizontal position": "leave it at rest with a free view of the sky; indoors check what tells its place",
    "height": "leave it at rest for a minute, or restart the autopilot; shield its barometer from wind and sun",
    "velocity": "leave it at rest for a minute with a free view of the sky, or restart the autopilot",
    "compass": "move it away from steel, cables and cars; if that does not help, calibrate its compass",
}
WHY = "what it takes for its place and heading may jump or drift away in the air, and it is steered by that"
RESTART = "leave it at rest, restart the autopilot, and look at its messages with a ground station"


def estimator_report(kind: AutopilotKind, fields: Mapping[str, object]) -> EstimatorReport | None:
    """Return what a report's fields mean; None where they are none. A ratio that is not a number is left out."""
    dialect, flags = DIALECTS.get(kind), fields.get("flags")
    if dialect is None or not isinstance(flags, int):
        return None
    told = {name: fields.get(field) for name, field in dialect.ratios.items()}
    wrong = [what for bit, what in dialect.errors.items() if flags & bit]
    wrong += ["it knows no attitude"] if not flags & ATTITUDE else []
    wrong += ["it knows no height"] if not flags & POS_VERT_ABS else []
    return EstimatorReport(
        ratios={
            name: float(value) for name, value in told.items() if isinstance(value, int | float) and isfinite(value)
        },
        relative=bool(flags & dialect.relative),
        absolute=bool(flags & dialect.absolute),
        wrong=tuple(wrong),
        glitch=bool(flags & dialect.glitch),
    )


def estimator(facts: VehicleFacts, mission: Mission) -> Iterator[Finding]:
    """Check the estimator's own report: what it knows, and each test ratio that is high, or else the highest."""
    report = facts.estimator
    if report is None or not report.ratios:
        message = DIALECTS[facts.autopilot].message
        found = f"its estimator's report ({message}) could not be read: whether its sensors agree is not known"
        yield _finding(facts, Grade.WARNING, found, "look at its estimator with a ground station, and check the link")
        return
    for what in report.wrong:
        yield _finding(facts, Grade.REFUSE, f"its estimator is not well: {what}", RESTART)
    yield from _position(facts, report, local=mission.frame.local)
    if report.glitch:
        yield _finding(facts, Grade.WARNING, "its estimator sees its GPS jump", STEPS["horizontal position"])
    highest = max(report.ratios, key=lambda name: report.ratios[name])
    for name, ratio in report.ratios.items():
        grade = limited(ratio, RATIO_MAX, RATIO_RESERVE)
        if grade is not Grade.PASS:
            what = "rejects what it is told about" if grade is Grade.REFUSE else "hardly believes what it is told about"
            found = f"its estimator {what} its {name}: test ratio {ratio:.2f}, of {RATIO_MAX:g} at most"
            yield _finding(facts, grade, found, STEPS[name])
        elif name == highest:
            found = f"its estimator's sensors agree: highest test ratio {ratio:.2f}, of {RATIO_MAX:g} at most ({name})"
            yield Finding(Grade.PASS, facts.subject, "estimator", found)


def _position(facts: VehicleFacts, report: EstimatorReport, *, local: bool) -> Iterator[Finding]:
    """Check that it has the horizontal position that the mission flies by; one that is lost is told of elsewhere."""
    lost = facts.origin_m is None or facts.position_m is None
    if lost or report.absolute or (local and report.relative):
        return
    if local:
        step = "check what tells its place (cameras, odometry), and restart the autopilot once that works"
        yield _finding(facts, Grade.REFUSE, "its estimator has no horizontal position", step)
    else:
        found = "its estimator has no horizontal position on Earth"
        yield _finding(facts, Grade.REFUSE, found, "wait for GPS: give it a free view of the sky")


def _finding(facts: VehicleFacts, grade: Grade, found: str, step: str) -> Finding:
    return Finding(grade, facts.subject, "estimator", found, WHY, step)
