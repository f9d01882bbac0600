"""The report of an autopilot's estimator: innovation test ratios, the states that it provides, and the wind."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, isfinite

from gcs.autopilots.autopilot import ATTITUDE, POS_VERT_ABS, SENSORS, EstimatorDialect


@dataclass(frozen=True, slots=True)
class EstimatorReport:
    """An estimator's report: test ratios by sensor (above 1 the sensor is rejected), available states, and faults.

    `relative` and `absolute`: a horizontal position is available, from its start or on Earth; `wrong` names its errors.
    Raises ValueError for ratios that are not finite.
    """

    ratios: Mapping[str, float]
    relative: bool
    absolute: bool
    wrong: tuple[str, ...] = ()
    glitch: bool = False

    def __post_init__(self) -> None:
        if not all(map(isfinite, self.ratios.values())):
            raise ValueError(f"a test ratio of {dict(self.ratios)} is not finite")


def wind_m_s(dialect: EstimatorDialect, fields: Mapping[str, object]) -> float | None:
    """Return the horizontal wind's speed in a message's fields; None where a component is not a number."""
    parts = [fields.get(name) for name in dialect.wind_components]
    known = [float(part) for part in parts if isinstance(part, int | float) and isfinite(part)]
    return hypot(*known) if len(known) == len(parts) else None


def estimator_report(dialect: EstimatorDialect, fields: Mapping[str, object]) -> EstimatorReport | None:
    """Return the report in a message's fields; None without flags. A ratio that is not a number is left out."""
    flags = fields.get("flags")
    if not isinstance(flags, int):
        return None
    values = {name: fields.get(field) for name, field in zip(SENSORS, dialect.ratios, strict=True)}
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
