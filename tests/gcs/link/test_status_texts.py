"""Which status texts explain a refusal, with texts in the words of PX4 1.17 and ArduCopter 4.7."""

import pytest
from mavsdk.plugins.telemetry import StatusTextType

from gcs.link.status_texts import StatusTexts, names_check, names_refusal

INFO, WARNING, CRITICAL = StatusTextType.INFO, StatusTextType.WARNING, StatusTextType.CRITICAL
PROGRESS = {
    "Ready for takeoff!": INFO,
    "Armed by external command": INFO,
    "[logger] ./log/2026-11-20/10_14_42.ulg": INFO,
    "Frame: QUAD/PLUS": INFO,
    "EKF3 IMU0 MAG0 in-flight yaw alignment complete": INFO,
    "Arming motors": INFO,
    "GCS Failsafe Cleared": WARNING,
}
CHECKS = {
    "Preflight Fail: ekf2 missing data": CRITICAL,
    "Arming denied: Resolve system health failures first": CRITICAL,
    "PreArm: Need Position Estimate": CRITICAL,
    "Arm: AHRS: waiting for home": CRITICAL,
}
REFUSALS = {
    "Switching to Offboard is currently not available": CRITICAL,
    "Disarming denied: not landed": CRITICAL,
    "Mode change to GUIDED failed: requires position": WARNING,
}


class Clock:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        monkeypatch.setattr("time.monotonic", lambda: self.now_s)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def received(*tables: dict[str, StatusTextType]) -> StatusTexts:
    texts = StatusTexts()
    for text, severity in (each for table in tables for each in table.items()):
        texts.take(text, severity)
    return texts


def test_texts_are_told_apart_by_their_words() -> None:
    assert [text for text in PROGRESS if names_refusal(text)] == []
    assert [text for text in CHECKS if not names_check(text)] == []
    assert [text for text in REFUSALS if names_check(text) or not names_refusal(text)] == []


def test_a_refusal_is_explained_by_what_came_after_the_request(clock: Clock) -> None:
    texts = received({**CHECKS, **REFUSALS})
    clock.now_s += 1.0
    requested_s = clock.now_s
    texts.take("Armed by external command", INFO)
    assert texts.refusing(requested_s) == ()
    texts.take(" Mode change to GUIDED failed: requires position\n", WARNING)
    texts.take("Press the switch", CRITICAL)
    assert texts.refusing(requested_s) == ("Mode change to GUIDED failed: requires position", "Press the switch")


def test_failed_checks_count_until_they_pass_or_are_not_repeated(clock: Clock) -> None:
    texts = received({**REFUSALS, **CHECKS})
    assert texts.failed_checks() == tuple(CHECKS)
    clock.now_s += 30.0
    texts.take("PreArm: Need Position Estimate", CRITICAL)
    assert texts.failed_checks().count("PreArm: Need Position Estimate") == 1
    clock.now_s += 6.0
    assert texts.failed_checks() == ("PreArm: Need Position Estimate",)
    texts.note_pass()
    assert texts.failed_checks() == ()
    assert texts.refusing(0.0) == (*REFUSALS, *CHECKS), "an autopilot that reports that it is ready may refuse to arm"
