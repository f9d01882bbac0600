"""The catalogue: a row for each metric and each verdict of a flight.

Verdicts are judged by these rows, and the terminal's summary, reports, comparisons and sweeps are made from them. A new
metric is a field of the result and a row here; a new verdict is a row, a field of `Verdicts` and a tolerance.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from json import dumps
from typing import TYPE_CHECKING, Any, Literal

from gcs.metrics.references import DesiredRing, VerdictTolerances

if TYPE_CHECKING:
    from gcs.metrics.result import FlightResult

Worst = Literal["max", "min"]


@dataclass(frozen=True, slots=True)
class Criterion:
    """How a verdict judges a metric, and the words around the metric's value in the verdict's evidence.

    `tolerance` is a field of `VerdictTolerances`; without one the metric is evidence alone. `desired` is the field of
    `DesiredRing` from which the deviation is judged, instead of the value itself.
    """

    verdict: str
    tolerance: str = ""
    subject: str = ""
    noun: str = "error"
    kind: str = "rms"
    desired: str = ""


@dataclass(frozen=True, slots=True)
class Metric:
    """A metric: its place in the result, its meaning, and how it is shown and judged.

    `name` is the path in its part of the result and in the JSON output, unless `get` returns the value. Tables show
    metrics that have a `label`, in `unit` and `form`; `narrow` is the label of a narrow column. `worst` is the extreme
    that is the worst, if any; a comparison names the best unless `ranked` is false, as the best depends on the mission.
    `timed` metrics depend on the computer, and a sweep leaves them out; it draws those `drawn` by default.
    """

    name: str
    meaning: str
    label: str = ""
    unit: str = ""
    form: str = ""
    narrow: str = ""
    kind: type[bool | int | float | str] = float
    worst: Worst | None = None
    ranked: bool = True
    timed: bool = False
    drawn: bool = False
    judged: Criterion | None = None
    get: Callable[[Any], Any] | None = None

    def of(self, part: Any) -> Any:
        """Return the value in a part of a result, None where it does not apply."""
        if self.get is not None:
            return self.get(part)
        for name in self.name.split("."):
            part = None if part is None else getattr(part, name)
        return part

    def text(self, part: Any) -> str:
        """Return the value without its unit, a dash for None."""
        value = self.of(part)
        return "–" if value is None else format(value, self.form)

    def amount(self, value: float) -> str:
        """Return a value with its unit; a sign only if it is negative."""
        return f"{value:{self.form.removeprefix('+')}}{self.spaced_unit}"

    @property
    def spaced_unit(self) -> str:
        """The unit as it follows a number."""
        return self.unit if self.unit == "°" else f" {self.unit}"

    @property
    def heading(self) -> str:
        """The label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def farthest(self, values: list[float], ring: DesiredRing) -> float:
        """Return the worst value: the smallest, or else the largest deviation from what is desired."""
        if self.worst == "min":
            return min(values)
        desired = getattr(ring, self.judged.desired) if self.judged and self.judged.desired else 0.0
        return max(abs(value - desired) for value in values)


FLIGHT = (
    Metric("ended.how", "how the flight ended", kind=str),
    Metric("ended.reason", "why", kind=str),
    Metric("duration_s", "simulated time flown", "duration", "s", ".1f"),
    Metric("window_begin_s", "start of the ring metrics' window", get=lambda r: r.window_s and r.window_s[0]),
    Metric("window_end_s", "end of that window", get=lambda r: r.window_s and r.window_s[1]),
    Metric("ring.settling_time_s", "time from the last engagement to the settled ring",
        "settling time", "s", ".1f", worst="max", drawn=True),
    Metric("ring.spacing_error_rms_deg", "error of the spacings, rms",
        "spacing error rms", "°", ".2f", worst="max", drawn=True, judged=Criterion("C3", "spacing_error_rms_deg")),
    Metric("ring.spacing_error_max_deg", "error of the spacings, largest",
        "spacing error max", "°", ".2f", worst="max", judged=Criterion("C3", noun="", kind="max")),
    Metric("ring.judged_s", "time with a ring in the window", "ring judged", "s", ".1f", worst="min"),
    Metric("ring.judged_share", "share of all time with a ring", worst="min"),
    Metric("ring.members_min", "fewest vehicles on the ring meanwhile", kind=int, worst="min"),
    Metric("ring.first_settled_at_s", "when the ring first settled, if it left its limits later"),
    Metric("ring.unsettled_at_s", "when a settled ring last left its limits"),
    Metric("closest_approach_m", "smallest distance between two vehicles",
        "closest approach", "m", ".3f", worst="min", drawn=True,
        judged=Criterion("separation", "separation_m", noun="closest approach", kind="")),
    Metric("ways_closest_m", "smallest distance between two vehicles before the mission's start or after its end",
        "closest on the ways out and home", "m", ".3f", worst="min",
        judged=Criterion("separation", "separation_m", noun="on the ways out and home", kind="")),
    Metric("departures", "vehicles that left formation or ring not by order",
        "vehicles that left", form=".0f", kind=int, worst="max", drawn=True,
        get=lambda r: None if r.departures is None else len({each.vehicle for each in r.departures})),
    Metric("not_judged", "verdicts that could not be judged",
        kind=str, get=lambda r: ", ".join(r.not_judged) or None),
    Metric("guard_interventions", "setpoints that the guard moved",
        "setpoints moved by the guard", form=".0f", kind=int, worst="max", ranked=False, drawn=True),
    Metric("guard_causes", "setpoints that the guard moved, by cause, as JSON",
        kind=str, get=lambda r: dumps(r.guard_causes, sort_keys=True)),
    Metric("engagement.to_engage", "vehicles expected to engage",
        kind=int, get=lambda r: len(r.engagement.to_engage)),
    Metric("engagement.engaged", "vehicles that engaged",
        kind=int, worst="min", get=lambda r: len(r.engagement.engaged)),
    Metric("loop.rate_hz", "rate of the control loop"),
    Metric("loop.ticks", "ticks of all vehicles", kind=int),
    Metric("loop.missed", "missed ticks", "missed ticks", form=".0f", kind=int, worst="max"),
    Metric("loop.tick_p50_us", "computing time of a tick, median",
        "computing time, median", "µs", ".0f", worst="max", timed=True),
    Metric("loop.tick_p99_us", "computing time of a tick that 99 % do not exceed",
        "computing time, 99 %", "µs", ".0f", worst="max", timed=True),
    Metric("realtime_factor", "mission time per wall time", "real-time factor", form=".2f", timed=True),
)  # fmt: skip
"""Of the flight."""
PHASES = {"formation": "in formation", "ring": "in the window of the ring metrics", "flight": "whole flight"}
"""The phases for which Reynolds' rules are measured, with their meanings."""
FLOCKING = (
    Metric("separation_min_m", "distance to the nearest other vehicle, smallest",
        "nearest other, min", "m", ".2f", "nearest\nmin [m]", worst="min", ranked=False),
    Metric("separation_mean_m", "distance to the nearest other vehicle, mean",
        "nearest other, mean", "m", ".2f", "nearest\nmean [m]", worst="min", ranked=False),
    Metric("alignment_error_rms_m_s", "velocity relative to the team's mean, rms",
        "velocity mismatch rms", "m/s", ".3f", "mismatch\nrms [m/s]", worst="max", ranked=False),
    Metric("alignment_order_mean", "length of the mean direction of flight",
        "order parameter, mean", "", ".3f", "order\nmean"),
    Metric("cohesion_mean_m", "distance to the team's centroid, mean",
        "distance from centroid, mean", "m", ".2f", "centroid\nmean [m]"),
    Metric("cohesion_max_m", "distance to the team's centroid, largest",
        "distance from centroid, max", "m", ".2f", "centroid\nmax [m]"),
)  # fmt: skip
"""Of each phase of `PHASES`."""
VEHICLE = (
    Metric("engaged_at_s", "time of the engagement",
        "engaged", "s", ".1f", "engaged\n[s]", worst="max", ranked=False),
    Metric("tactic", "tactic at the end", kind=str),
    Metric("radius_error_rms_m", "error of the radius, rms",
        "radius error rms", "m", ".3f", "radius\nrms [m]", worst="max", drawn=True,
        judged=Criterion("C1", "radius_error_rms_m")),
    Metric("radius_error_max_m", "error of the radius, largest",
        "radius error max", "m", ".3f", "radius\nmax [m]", worst="max"),
    Metric("angular_rate_mean_rad_s", "angular rate, mean over time",
        "mean rate", "rad/s", "+.4f", "mean rate\n[rad/s]",
        judged=Criterion(
            "C2", "angular_rate_error_rad_s", noun="mean", kind="mean error", desired="angular_rate_rad_s")),
    Metric("angular_rate_error_rms_rad_s", "error of the angular rate, rms",
        "rate error rms", "rad/s", ".4f", "rate rms\n[rad/s]", worst="max", drawn=True),
    Metric("formation_speed_error_rms_m_s", "error of the speed in formation, rms",
        "formation speed error rms", "m/s", ".3f", "speed rms\n[m/s]", worst="max", drawn=True,
        judged=Criterion("formation", "formation_speed_error_rms_m_s", "speed")),
    Metric("formation_spacing_error_rms_m", "error of the distance to the predecessor in formation, rms",
        "formation spacing error rms", "m", ".3f", "spacing\nrms [m]", worst="max", drawn=True,
        judged=Criterion("formation", "formation_spacing_error_rms_m", "spacing")),
    Metric("height_error_rms_m", "error of the height on a ring with an altitude or a tilt, rms", worst="max"),
    Metric("pointing_error_rms_deg", "angle between the camera, as its gimbal reports it, and the target, rms",
        worst="max"),
)  # fmt: skip
"""Of each vehicle."""
ON_RING = tuple(each for each in VEHICLE if each.name.startswith(("radius", "angular_rate", "height", "pointing")))
"""Of each vehicle on a ring."""
TRANSITION = (
    Metric("settling_time_s", "time from an engagement to the settled ring", worst="max"),
    Metric("settling_predicted_s", "the same as predicted by law and bounds, without plants and noise", worst="max"),
    Metric("speed_max_m_s", "highest speed relative to the target", worst="max"),
    Metric("forwards_min_m_s", "lowest speed along the ring in its direction", worst="min"),
    Metric("acceleration_max_m_s2", "largest acceleration", worst="max"),
    Metric("spacing_overshoot_deg", "overshoot of a spacing beyond the wanted one", worst="max"),
    Metric("spacing_monotonic", "V (18) never grew from 5 s on", kind=bool, worst="min"),
)
"""Of each transition of the ring."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """A verdict: the name that the paper and the JSON output use, what it judges, and what it means that it holds."""

    name: str
    subject: str
    meaning: str

    @property
    def title(self) -> str:
        """The name, with its subject after a number of the paper's."""
        return self.name if self.name.islower() else f"{self.name} {self.subject}"


VERDICTS = (
    Verdict("C1", "radius", "radius within its tolerance"),
    Verdict("C2", "angular rate", "angular rate within its tolerance"),
    Verdict("C3", "spacing", "spacing within its tolerance"),
    Verdict("formation", "speed and spacing", "formation within its tolerances"),
    Verdict("separation", "closest approach", "separation kept"),
    Verdict("engaged", "vehicles that were to", "all vehicles expected to engage did"),
    Verdict("kept", "vehicles that left", "no vehicle left formation or ring not by order"),
)
"""The paper's conditions first, as in the JSON output."""


OF_THE_RING = ("C1", "C2", "C3")
"""The verdicts that are of one ring."""


class VerdictState(StrEnum):
    """What a flight shows of a verdict, in the words for people."""

    PASSES = "passes"
    FAILS = "fails"
    NOT_JUDGED = "not judged"
    """The mission asks for it, and the flight does not show it."""
    NOT_ASKED = "does not apply"

    @property
    def sign(self) -> str:
        """It as a sign."""
        return {self.PASSES: "✓", self.FAILS: "✗", self.NOT_JUDGED: "?", self.NOT_ASKED: "–"}[self]


@dataclass(frozen=True, slots=True)
class Verdicts:
    """The paper's conditions C1 (radius), C2 (angular rate), C3 (spacing), the formation, separation, and engagement.

    `engaged` is whether all that were to engage the target did, `kept` whether all kept their places until they were
    ordered away. True passes, False fails, None does not apply or could not be judged.
    """

    c1: bool | None = None
    c2: bool | None = None
    c3: bool | None = None
    formation: bool | None = None
    separation: bool | None = None
    engaged: bool | None = None
    kept: bool | None = None

    def named(self) -> dict[str, bool | None]:
        """Return the verdicts by name."""
        return {each.name: getattr(self, each.name.lower()) for each in VERDICTS}


def evidence(verdict: str, result: "FlightResult") -> Iterator[tuple[Metric, Criterion, list[float]]]:
    """Return the metrics of a verdict, each with its known values: of the vehicles, or of the flight; none without."""
    for metrics, parts in ((VEHICLE, result.vehicles), (FLIGHT, (result,))):
        for metric in metrics:
            if metric.judged is not None and metric.judged.verdict == verdict:
                known = [value for part in parts if (value := metric.of(part)) is not None]
                if known:
                    yield metric, metric.judged, known


def judge(result: "FlightResult", ring: DesiredRing, tolerances: VerdictTolerances) -> Verdicts:
    """Return the verdicts: each passes if its known metrics keep their tolerances, in finite time - (8), (9), (10)."""
    held = {}
    for verdict in VERDICTS:
        kept = []
        for metric, judged, values in evidence(verdict.name, result):
            if judged.tolerance:
                worst, allowed = metric.farthest(values, ring), getattr(tolerances, judged.tolerance)
                kept.append(worst >= allowed if metric.worst == "min" else worst <= allowed)
        # (8), (9) and (10) are of every vehicle: those that were measured may fail them, not pass for all.
        whole = verdict.name not in OF_THE_RING or result.ring.judged_from_s is not None
        held[verdict.name.lower()] = False if False in kept else True if kept and whole else None
    stayed = None if result.departures is None else not result.departures
    return replace(Verdicts(**held), engaged=result.engagement.holds, kept=stayed)


def not_judged(result: "FlightResult") -> tuple[str, ...]:
    """Return the verdicts, by name, that the mission asks for and that a flight, once judged, does not show.

    The ring is asked for where a vehicle engaged or was to by the plan, its spacing where that are two. The formation
    is asked for in flights without a ring.
    """
    engagement = result.engagement
    on_ring = len({*engagement.to_engage, *engagement.engaged, *engagement.pending})
    flown = result.departures is not None
    asked = {
        "C1": on_ring > 0,
        "C2": on_ring > 0,
        "C3": on_ring > 1 and result.ring.members_min != 1,
        "formation": flown and not on_ring,
        "separation": flown and len(result.vehicles) > 1,
        "engaged": bool(engagement.pending),
    }
    return tuple(name for name, held in result.verdicts.named().items() if asked.get(name) and held is None)
