"""Types of the preflight: the facts about a vehicle on the ground, and the findings of the checks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite

from agents.ports import VehicleStatus
from estimation.frames import Triple
from gcs.autopilots.autopilot import Autopilot, Evidence, VehicleKind
from gcs.autopilots.registry import UNKNOWN
from gcs.link.batteries import BatteryReport
from gcs.link.gimbal import NO_GIMBAL_FACTS, GimbalFacts
from gcs.link.rates import Losses
from gcs.link.relay.gate import LinkReport
from gcs.link.self_reports import EstimatorReport
from gcs.link.status_texts import HealthItem


class Whole(Enum):
    """The subjects of findings that are not about a single vehicle."""

    MISSION = "mission"
    """The mission, or the whole team."""
    COMPUTER = "this computer"
    """The computer that flies."""


Subject = int | Whole
"""A vehicle by its id, or a whole."""
MISSION, COMPUTER = Whole.MISSION, Whole.COMPUTER


class Grade(Enum):
    """The severity of a finding."""

    REFUSE = "refuse"
    """Do not take off."""
    WARNING = "warning"
    """It may fly; the operator decides."""
    PASS = "pass"


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check: what was found, and unless it passed, the reason and the next step.

    A `temporary` one may be resolved by waiting: the vehicle is not ready yet.
    """

    grade: Grade
    about: Subject
    check: str
    found: str
    why: str = ""
    next_step: str = ""
    temporary: bool = False

    def __post_init__(self) -> None:
        if self.grade is not Grade.PASS and not (self.why and self.next_step):
            raise ValueError(f"{self.check} of {self.subject}: {self.grade.value} without a reason and a next step")

    @property
    def subject(self) -> str:
        """What it is about, as text."""
        return subjects_text([self.about])

    @classmethod
    def graded(
        cls, grade: Grade, about: Subject, check: str, found: str, why: str, next_step: str, *, temporary: bool = False
    ) -> "Finding":
        """Return a finding of a computed grade; a pass has no next step."""
        well = grade is Grade.PASS
        return cls(grade, about, check, found, why, "" if well else next_step, temporary and not well)


def subjects_text(subjects: Sequence[Subject]) -> str:
    """Return the subjects of findings that are alike as one text."""
    names = [each.value if isinstance(each, Whole) else str(each) for each in subjects]
    if isinstance(subjects[0], Whole) and len(subjects) == 1:
        return names[0]
    return f"vehicle{'s' if len(subjects) > 1 else ''} {', '.join(names)}"


@dataclass(frozen=True, slots=True)
class GpsFix:
    """The report of a GPS receiver: `dimensions` of its fix (0 without one, 2 or 3), and its satellites, if known."""

    dimensions: int
    satellites: int | None


@dataclass(frozen=True, slots=True)
class FenceArea:
    """An inclusion or exclusion polygon of the autopilot's geofence in the mission frame [m]; circles are polygons."""

    corners_m: tuple[tuple[float, float], ...]
    stay_in: bool

    def __post_init__(self) -> None:
        if len(self.corners_m) < 3 or not all(isfinite(number) for corner in self.corners_m for number in corner):
            raise ValueError("a fence area needs at least three finite corners")


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleFacts:
    """The reports of one vehicle on the ground; None for what it did not report.

    `unreachable` and `lost` hold (reason, next step) of a vehicle that does not answer, and of one without a position;
    of a `silent` one nothing is received.
    `failed_checks` are the status texts of its failed arming checks. Positions are in the mission frame [m], rates in
    the autopilot's time, whose rate relative to wall time is `clock_ratio`. `firmware` is a version, empty if it is not
    reported. Parameters, `estimator`, `fence_areas` and the rally points `rally_m` that could not be read are None.
    `link` is the traffic with its system id, from it and from others; `link_bytes_s` is the traffic per second on its
    connection, from all vehicles there, and `losses` what the connection loses. `uid` and `vendor_id` are those of its
    AUTOPILOT_VERSION. `gimbal` is that of a camera that the mission points. Raises ValueError for numbers that are
    not finite.
    """

    vehicle_id: int
    unreachable: tuple[str, str] | None = None
    silent: bool = False
    autopilot: Autopilot = UNKNOWN
    firmware: str = ""
    multicopter: bool = False
    status: VehicleStatus = field(default_factory=VehicleStatus)
    mode_received: bool = True
    health: Mapping[HealthItem, bool] = field(default_factory=dict)
    failed_checks: tuple[str, ...] = ()
    origin_m: Triple | None = None
    lost: tuple[str, str] | None = None
    position_m: Triple | None = None
    gps: GpsFix | None = None
    batteries: tuple[BatteryReport, ...] = ()
    estimator: EstimatorReport | None = None
    clock_ratio: float | None = None
    telemetry_rate_hz: float | None = None
    telemetry_rate_asked_hz: float = 20.0
    parameters: Mapping[str, float | None] = field(default_factory=dict)
    fence_areas: tuple[FenceArea, ...] | None = ()
    rally_m: tuple[tuple[float, float], ...] | None = ()
    link: LinkReport = field(default_factory=LinkReport)
    link_bytes_s: float | None = None
    losses: Losses = field(default_factory=Losses)
    system_id: int = 0
    uid: int | None = None
    vendor_id: int | None = None
    gimbal: GimbalFacts = NO_GIMBAL_FACTS

    def __post_init__(self) -> None:
        numbers = [self.telemetry_rate_hz or 0.0, self.telemetry_rate_asked_hz, self.clock_ratio or 0.0]
        numbers += [*(self.origin_m or ()), *(self.position_m or ())]
        numbers += [value for value in self.parameters.values() if value is not None]
        if not all(map(isfinite, numbers)):
            raise ValueError(f"the facts about vehicle {self.vehicle_id} hold a number that is not finite")

    @property
    def is_ready(self) -> bool:
        """Whether it has reported its health, and all items are good."""
        return bool(self.health) and all(self.health.values())

    @property
    def kind(self) -> VehicleKind:
        """The kind of vehicle, from its reports."""
        return self.autopilot.kind(
            Evidence(self.system_id, self.uid, self.vendor_id, hil=self.link.hil, parameters=self.parameters)
        )

    def parameter(self, *names: str) -> float | None:
        """Return the first of these parameters that could be read: names depend on the firmware version."""
        values = (self.parameters.get(name) for name in names)
        return next((value for value in values if value is not None), None)


def limited(value: float, limit: float, reserve: float) -> Grade:
    """Grade a value that must not exceed `limit`, and should not exceed the fraction `reserve` of it."""
    if value > limit:
        return Grade.REFUSE
    return Grade.WARNING if value > reserve * limit else Grade.PASS


def tolerated(value: float, tolerance: float, limit: float) -> Grade:
    """Grade a value that should not exceed `tolerance`, and must not exceed `limit`."""
    if value > limit:
        return Grade.REFUSE
    return Grade.WARNING if value > tolerance else Grade.PASS
