"""The status texts of an autopilot, and which of them explain a refusal."""

import re
import time
from collections import deque
from collections.abc import Iterable
from enum import StrEnum
from math import inf
from typing import NamedTuple

from mavsdk.plugins.telemetry import StatusTextType

from gcs.autopilots.registry import AUTOPILOTS

TEXTS_KEPT = 20
CHECK_S = 35.0
"""How long a failed check counts: ArduPilot repeats them every 30 s."""
_CHECK = re.compile("|".join(each.failed_check for each in AUTOPILOTS), re.IGNORECASE)
_REFUSAL = re.compile(
    r"\b(denied|reject(ed|ing)|refus(ed|ing)|not available|not possible|mode change\b.*\bfailed)\b", re.IGNORECASE
)


class HealthItem(StrEnum):
    """The items of an autopilot's health report, as shown to people."""

    GYROMETER = "gyrometer calibration"
    ACCELEROMETER = "accelerometer calibration"
    MAGNETOMETER = "magnetometer calibration"
    LOCAL_POSITION = "local position"
    GLOBAL_POSITION = "global position"
    HOME_POSITION = "home position"
    ARMING = "arming checks"


POSITION_ITEMS = (HealthItem.LOCAL_POSITION, HealthItem.GLOBAL_POSITION, HealthItem.HOME_POSITION)
_ABOUT = {
    HealthItem.GYROMETER: re.compile("gyro", re.IGNORECASE),
    HealthItem.ACCELEROMETER: re.compile("accel", re.IGNORECASE),
    HealthItem.MAGNETOMETER: re.compile(r"compass|\bmag", re.IGNORECASE),
    **dict.fromkeys(POSITION_ITEMS, re.compile(r"pos|estimat|ekf|ahrs|gps|gnss|home|navigation", re.IGNORECASE)),
    HealthItem.ARMING: re.compile(""),
}
"""Patterns of failed checks that explain each health item; arming depends on all of them."""


class _StatusText(NamedTuple):
    received_s: float
    severe: bool
    text: str


class StatusTexts:
    """The newest status texts by the monotonic clock [s].

    Autopilots report progress in the same way as reasons. A text explains a refused request if it follows it and
    states a refusal, or is at least an error. It explains a vehicle that is not ready if it names a failed check.
    """

    def __init__(self) -> None:
        self._texts: deque[_StatusText] = deque(maxlen=TEXTS_KEPT)
        self._passed_s = -inf

    def take(self, text: str, severity: StatusTextType) -> None:
        """Add a text that arrives now."""
        self._texts.append(_StatusText(time.monotonic(), severity >= StatusTextType.ERROR, text.strip()))

    def refusing(self, since_s: float) -> tuple[str, ...]:
        """Return the texts that explain the refusal of what was requested at `since_s`."""
        late = (each for each in self._texts if each.received_s >= since_s)
        return _distinct(each.text for each in late if each.severe or names_refusal(each.text))

    def failed_checks(self) -> tuple[str, ...]:
        """Return the checks that failed recently."""
        since_s = max(self._passed_s, time.monotonic() - CHECK_S)
        return _distinct(each.text for each in self._texts if each.received_s > since_s and names_check(each.text))

    def note_pass(self) -> None:
        """Note that all checks pass now."""
        self._passed_s = time.monotonic()


def names_check(text: str) -> bool:
    """Return whether a text of an autopilot names a check that failed."""
    return _CHECK.search(text) is not None


def names_refusal(text: str) -> bool:
    """Return whether a text of an autopilot states a refusal."""
    return names_check(text) or _REFUSAL.search(text) is not None


def explains(text: str, items: Iterable[HealthItem]) -> bool:
    """Return whether a failed check explains one of these health items."""
    return any(_ABOUT[item].search(text) for item in items)


def quoted(texts: Iterable[str]) -> str:
    """Return texts in quotation marks; empty without any."""
    return ", ".join(f"“{text}”" for text in texts)


def _distinct(texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(texts))
