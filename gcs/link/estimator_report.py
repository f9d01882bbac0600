"""The report of an autopilot's estimator: innovation test ratios, the states that it provides, and the wind."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, isfinite

ATTITUDE, POS_HORIZ_REL, POS_HORIZ_ABS, POS_VERT_ABS, PRED_POS_HORIZ_REL, PRED_POS_HORIZ_ABS = 1, 8, 16, 32, 256, 512


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


@dataclass(frozen=True, slots=True)
class EstimatorDialect:
    """One autopilot's estimator report: message, field of each test ratio, and meaning of its flags.

    Any bit of `relative` or `absolute` stands for a horizontal position; `errors` maps a bit to its fault. Its `wind`
    has a message of its own, with that number; the speed is that of the components named.
    """

    message: str
    number: int
    ratios: Mapping[str, str]
    relative: int
    absolute: int
    errors: Mapping[int, str]
    glitch: int
    wind: str
    wind_number: int
    wind_components: tuple[str, ...]


PX4_ESTIMATOR = EstimatorDialect(
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
    "WIND_COV",
    231,
    ("wind_x", "wind_y"),
)
ARDUPILOT_ESTIMATOR = EstimatorDialect(
    "EKF_STATUS_REPORT",
    193,
    {
        "horizontal position": "pos_horiz_variance",
        "height": "pos_vert_variance",
        "velocity": "velocity_variance",
        "compass": "compass_variance",
    },
    # Disarmed, it may report only the position predicted for flight, which its own arming checks use.
    POS_HORIZ_REL | POS_HORIZ_ABS | PRED_POS_HORIZ_REL | PRED_POS_HORIZ_ABS,
    POS_HORIZ_ABS | PRED_POS_HORIZ_ABS,
    {1024: "not initialized"},
    1 << 15,
    "WIND",
    168,
    ("speed",),
)
"""The bits above POS_HORIZ_ABS differ: 1024 is a GPS glitch on PX4, and not initialized on ArduPilot."""


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
