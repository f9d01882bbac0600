"""The message rates of a vehicle."""

from dataclasses import dataclass, replace
from itertools import chain, takewhile


@dataclass(frozen=True, slots=True)
class Traffic:
    """Counts of one connection since it was opened.

    `missed` are frames from its vehicles that never arrived, by the gaps in their sequence numbers. `buffer_free` is
    the free share of the radio's transmit buffer by the newest RADIO_STATUS, None where no radio reports.
    """

    up_bytes: int = 0
    down_bytes: int = 0
    received: int = 0
    missed: int = 0
    buffer_free: float | None = None

    def lost_share(self, before: "Traffic") -> float:
        """Return the share of frames that were lost since an earlier count."""
        received, missed = self.received - before.received, self.missed - before.missed
        return missed / (received + missed) if missed > 0 else 0.0


STATUS_MIN_HZ, TELEMETRY_MIN_HZ = 0.5, 5.0
SETPOINT_MIN_HZ = 5.0
"""PX4 leaves offboard below 2 Hz: two setpoints in a row may be lost."""
STATUS_STEP, STEP = 0.5, 0.75


@dataclass(frozen=True, slots=True)
class Rates:
    """The rates of a vehicle's motion and status, and of the setpoints sent to it [Hz].

    `clock_hz` is the rate of its attitude while its clock is measured.
    """

    telemetry_hz: float
    status_hz: float
    setpoint_hz: float
    clock_hz: float = 10.0

    def changed_from(self, before: "Rates") -> str:
        """Return the changes as text."""
        pairs = (
            ("motion", before.telemetry_hz, self.telemetry_hz),
            ("status", before.status_hz, self.status_hz),
            ("setpoints", before.setpoint_hz, self.setpoint_hz),
        )
        return ", ".join(f"{name} {old:.3g} to {new:.3g} Hz" for name, old, new in pairs if old != new)


def rate_levels(full: Rates) -> tuple[Rates, ...]:
    """Return the rates from `full` down to the least, in the order in which control degrades.

    Status comes first, then motion, then setpoints; each stops at its least rate, or where it begins below it.
    """
    status = _steps(full.status_hz, STATUS_STEP, STATUS_MIN_HZ)
    telemetry = _steps(full.telemetry_hz, STEP, TELEMETRY_MIN_HZ)
    setpoint = _steps(full.setpoint_hz, STEP, SETPOINT_MIN_HZ)
    slow = replace(full, status_hz=status[-1])
    slower = replace(slow, telemetry_hz=telemetry[-1])
    return tuple(
        chain(
            (replace(full, status_hz=rate_hz) for rate_hz in status),
            (replace(slow, telemetry_hz=rate_hz) for rate_hz in telemetry[1:]),
            (replace(slower, setpoint_hz=rate_hz) for rate_hz in setpoint[1:]),
        )
    )


def _steps(full_hz: float, step: float, least_hz: float) -> list[float]:
    powers = (full_hz * step**power for power in range(1, 64))
    lower = list(takewhile(lambda rate_hz: rate_hz > least_hz, powers))
    return [full_hz, *lower, *([least_hz] if full_hz > least_hz else [])]
