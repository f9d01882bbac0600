"""The provenance of a plant: how it was identified, from which logs, and with which verdict."""

from enum import Enum
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from estimation.settings import Settings

COVARIANCE_OF = ("x.a0_per_s2", "x.a1_per_s", "y.a0_per_s2", "y.a1_per_s", "delay_s")
FEEDFORWARD = "feedforward"
_DATE = r"^\d{4}-((0[13578]|1[02])-(0[1-9]|[12]\d|3[01])|(0[469]|11)-(0[1-9]|[12]\d|30)|02-(0[1-9]|[12]\d))$"


def covariance_of(*, feedforward: bool) -> tuple[str, ...]:
    """Return the parameters in the order of an identification's covariance; `feedforward`, if any, is the last."""
    return (*COVARIANCE_OF, FEEDFORWARD) if feedforward else COVARIANCE_OF


class PlantGrade(Enum):
    """Whether a controller may use the identified plant."""

    GOOD = "good"
    USABLE = "usable"
    DO_NOT_FLY = "do not fly this"


def _tuples(value: object) -> object:
    """Return lists as tuples: TOML has lists only, and strict validation does not accept a list for a tuple."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _verdict(value: object) -> object:
    return next((verdict for verdict in PlantGrade if verdict.value == value), value)


def _iso(value: object) -> object:
    """Return a TOML date as text."""
    return value.isoformat() if hasattr(value, "isoformat") else value


class IdentifiedLog(Settings):
    """A log used for identification: the name of its file, and the SHA-256 of its bytes."""

    name: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


class Identification(Settings):
    """`[identified]`: how the plant of a profile was identified, as written by `cordon identify`."""

    method: str = Field(description="method and its version")
    date: Annotated[str, BeforeValidator(_iso), Field(pattern=_DATE)] = Field(description="ISO date")
    vehicle: int = Field(ge=0, le=255, description="MAVLink system id")
    autopilot: str = Field(description="autopilot of the log")
    firmware: str = Field(description="its version")
    logs: Annotated[tuple[IdentifiedLog, ...], BeforeValidator(_tuples), Field(min_length=1)] = Field(
        description="name and SHA-256 of each log"
    )
    setpoints: str = Field(description="assumed input between two logged setpoints")
    duration_s: float = Field(gt=0.0, description="data used")
    fit_x_percent: float = Field(le=100.0, description="validation fit: 100 (1 - rms error / rms motion)")
    fit_y_percent: float = Field(le=100.0, description="the same along y")
    delay_spread_s: float | None = Field(None, ge=0.0, le=10.0, description="variation of the delay, rms")
    verdict: Annotated[PlantGrade, BeforeValidator(_verdict)] = Field(description="whether to fly with the plant")
    reasons: Annotated[tuple[str, ...], BeforeValidator(_tuples)] = Field((), description="reasons for the verdict")
    covariance: Annotated[tuple[tuple[float, ...], ...], BeforeValidator(_tuples)] = Field(
        description="covariance of a0 and a1 of x, a0 and a1 of y, the delay, and the feed-forward if there is one"
    )

    @property
    def feeds(self) -> bool:
        """Whether velocities were sent with the setpoints."""
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
