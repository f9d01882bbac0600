"""Where the numbers of a plant come from: what was identified, from which logs, and how far it can be trusted."""

from enum import Enum
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from estimation.settings import Settings

COVARIANCE_OF = ("x.a0_per_s2", "x.a1_per_s", "y.a0_per_s2", "y.a1_per_s", "delay_s")
FEEDFORWARD = "feedforward"
_DATE = r"^\d{4}-((0[13578]|1[02])-(0[1-9]|[12]\d|3[01])|(0[469]|11)-(0[1-9]|[12]\d|30)|02-(0[1-9]|[12]\d))$"


def covariance_of(*, feedforward: bool) -> tuple[str, ...]:
    """Return what the rows and columns of an identification's covariance are of; `feedforward` is the last if any."""
    return (*COVARIANCE_OF, FEEDFORWARD) if feedforward else COVARIANCE_OF


class PlantGrade(Enum):
    """Whether a controller may be built on what was identified."""

    GOOD = "good"
    USABLE = "usable"
    DO_NOT_FLY = "do not fly this"


def _tuples(value: object) -> object:
    """Return lists as tuples: TOML knows lists only, and strict validation takes no list for a tuple."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _verdict(value: object) -> object:
    return next((verdict for verdict in PlantGrade if verdict.value == value), value)


def _iso(value: object) -> object:
    """Return a date of TOML's as text: nothing here reckons with it."""
    return value.isoformat() if hasattr(value, "isoformat") else value


class IdentifiedLog(Settings):
    """A log that was identified from: the name of its file, and the SHA-256 of its bytes."""

    name: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


class Identification(Settings):
    """`[identified]`: how the plant of a profile was identified.

    `method` names the method and its version, `date` is the ISO date; `setpoints` says what was taken to happen between
    two logged setpoints; `vehicle` is the system id. `fit_x_percent` and `fit_y_percent` are the fit on a part of the
    flight that nothing was fitted to: 100 (1 - rms error / rms motion). `delay_spread_s` is how far the delay differs
    from time to time (rms), None in files of earlier versions. `covariance` is (5, 5) or, with feed-forward, (6, 6) in
    the order of `covariance_of`.
    """

    method: str
    date: Annotated[str, BeforeValidator(_iso), Field(pattern=_DATE)]
    vehicle: int = Field(ge=0, le=255)
    autopilot: str
    firmware: str
    logs: Annotated[tuple[IdentifiedLog, ...], BeforeValidator(_tuples), Field(min_length=1)]
    setpoints: str
    duration_s: float = Field(gt=0.0)
    fit_x_percent: float = Field(le=100.0)
    fit_y_percent: float = Field(le=100.0)
    delay_spread_s: float | None = Field(None, ge=0.0, le=10.0)
    verdict: Annotated[PlantGrade, BeforeValidator(_verdict)]
    reasons: Annotated[tuple[str, ...], BeforeValidator(_tuples)] = ()
    covariance: Annotated[tuple[tuple[float, ...], ...], BeforeValidator(_tuples)]

    @property
    def feeds(self) -> bool:
        """Whether it is of a vehicle that was sent velocities beside its setpoints."""
        return len(self.covariance) > len(COVARIANCE_OF)

    @model_validator(mode="after")
    def _is_square(self) -> "Identification":
        names = covariance_of(feedforward=self.feeds)
        size = len(names)
        if len(self.covariance) != size or any(len(row) != size for row in self.covariance):
            raise ValueError(f"covariance must have {size} rows of {size} numbers, for {', '.join(names)}")
        if any(self.covariance[at][at] < 0.0 for at in range(size)):
            raise ValueError("covariance has a negative variance on its diagonal")
        return self
