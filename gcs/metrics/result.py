"""The result of a flight.

`FlightResult.to_json` is the `--json` output of sim, fly and report. A metric that does not apply is None
(null), never 0 and never NaN.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Literal

import numpy as np

from gcs.metrics.catalogue import Verdicts
from gcs.metrics.ending import TeamEnding
from gcs.metrics.json_output import json_output
from gcs.metrics.record import FlightEvent, LoopStatistics
from gcs.metrics.references import EngagementResult
from gcs.metrics.reynolds import ReynoldsResult
from gcs.metrics.ring import RingResult
from gcs.metrics.transitions import TransitionResult
from gcs.metrics.vehicles import EstimatedVehicleResult, VehicleResult


@dataclass(frozen=True, slots=True)
class EstimateResult:
    """The metrics from the vehicles' estimates, beside those from truth, which the verdicts judge.

    The window is that of the truth.
    """

    vehicles: tuple[EstimatedVehicleResult, ...]
    ring: RingResult
    closest_approach_m: float | None


@dataclass(frozen=True, slots=True)
class LoopResult:
    """The control loop: rate, ticks, missed ticks, and percentiles of the computing time."""

    rate_hz: float
    ticks: int
    missed: int
    tick_p50_us: float | None
    tick_p99_us: float | None

    @classmethod
    def of(cls, loop: LoopStatistics) -> "LoopResult":
        """Condense the statistics of a loop; the percentiles are None where no tick was timed."""
        p50_us, p99_us = np.percentile(loop.tick_us, (50, 99)).tolist() if loop.tick_us.size else (None, None)
        return cls(loop.rate_hz, loop.ticks, loop.missed, p50_us, p99_us)


@dataclass(frozen=True, slots=True)
class FlightResult:
    """The result of a flight, in the order of its JSON form.

    `estimate` holds the metrics from the vehicles' estimates where those from truth exist as well. `truth_missing` is
    why the metrics are from estimates although simulators sent truth, None otherwise. `ended` is None in logs of
    versions that did not record how a flight ended. `faults` are those injected into stub vehicles. `kinds` are the
    vehicles' kinds by id.
    """

    mission: str
    seed: int
    source: str
    reference: Literal["truth", "estimate"]
    duration_s: float
    window_s: tuple[float, float] | None
    vehicles: tuple[VehicleResult, ...]
    ring: RingResult
    transitions: tuple[TransitionResult, ...]
    reynolds: ReynoldsResult
    closest_approach_m: float | None
    guard_interventions: int | None
    guard_causes: dict[str, int]
    loop: LoopResult
    verdicts: Verdicts
    wall_time_s: float | None
    realtime_factor: float | None
    events: tuple[FlightEvent, ...] = ()
    estimate: EstimateResult | None = None
    truth_missing: str | None = None
    ended: TeamEnding | None = None
    engagement: EngagementResult = field(default_factory=EngagementResult)
    faults: tuple[str, ...] = ()
    kinds: Mapping[int, str] = field(default_factory=dict)

    @property
    def kinds_line(self) -> str:
        """The vehicles' kinds in one line; empty if they are unknown."""
        ids = {kind: [str(i) for i, each in self.kinds.items() if each == kind] for kind in self.kinds.values()}
        return "; ".join(f"{kind}: {', '.join(each)}" for kind, each in ids.items())

    @property
    def wall_time_line(self) -> str:
        """The wall time and the speed of the flight, such as `3.5 s (172× real time)`; empty if they are unknown."""
        if self.wall_time_s is None or self.realtime_factor is None:
            return ""
        rounded = float(f"{self.realtime_factor:.3g}")  # :g writes a rounded number above 1000 without an exponent
        return f"{self.wall_time_s:.1f} s ({rounded:g}× real time)"

    @property
    def ended_early(self) -> bool:
        """Whether the record shows that it ended in flight, before its mission was over."""
        return self.ended is not None and self.ended.is_early

    @property
    def all_hold(self) -> bool:
        """Whether no verdict fails; verdicts that do not apply are no failure."""
        return False not in self.verdicts.named().values()

    def untimed(self) -> "FlightResult":
        """Return the result with every wall time None, so that it depends on the mission and the seed alone."""
        loop = replace(self.loop, tick_p50_us=None, tick_p99_us=None)
        return replace(self, loop=loop, wall_time_s=None, realtime_factor=None)

    def to_dict(self) -> dict[str, object]:
        """Return the result as plain dicts and lists, keys in their documented order."""
        plain = {"mission": self.mission, "ended": None, **asdict(self)}  # how it ended comes before any figure
        for key in ("vehicles", "transitions", "faults"):
            plain[key] = list(plain[key])
        plain["events"] = [each.to_dict() for each in self.events]
        if self.estimate is not None:
            plain["estimate"]["vehicles"] = list(plain["estimate"]["vehicles"])
        if self.ended is not None:
            for key in ("vehicles", "unaccounted"):
                plain["ended"][key] = list(plain["ended"][key])
        plain["engagement"] = {name: list(ids) for name, ids in plain["engagement"].items()}
        plain["window_s"] = None if self.window_s is None else list(self.window_s)
        plain["verdicts"] = self.verdicts.named()
        plain["kinds"] = {str(i): kind for i, kind in self.kinds.items()}
        return plain

    def to_json(self) -> str:
        """Return the result as one line of JSON; raises ValueError rather than write NaN."""
        return json_output(self.to_dict())


def reference_line(result: FlightResult) -> str:
    """Return the source of the metrics and verdicts, in one line."""
    if result.reference == "truth":
        return "metrics and verdicts from the simulators' ground truth"
    missing = f" ({result.truth_missing})" if result.truth_missing else ""
    return f"metrics and verdicts from the vehicles' estimates of themselves and of the target{missing}"


SHORT_S = 60.0
"""The text says "only" for a window shorter than this."""


def window_line(result: FlightResult) -> str:
    """Return the part of the flight over which the ring is judged, and the reason; empty without a ring.

    The text reports a ring that settled and left its limits later.
    """
    if result.window_s is None:
        return ""
    (begins_s, ends_s), ring = result.window_s, result.ring
    only = "only " if ends_s - begins_s < SHORT_S else ""
    window = f"ring judged over {only}{ends_s - begins_s:.1f} s, from {begins_s:.1f} to {ends_s:.1f} s"
    if ring.unsettled_at_s is None:
        settles = ring.settling_time_s is not None
        why = "from settling to the end" if settles else "did not settle: last quarter of the flight"
        return f"{window}: {why}"
    settled = f"settled at {ring.first_settled_at_s:.1f} s, left its limits at {ring.unsettled_at_s:.1f} s"
    if ring.settling_time_s is None:
        return f"{window}: {settled}, did not settle again: last quarter of the flight"
    return f"{window}: {settled}, settled again at {begins_s:.1f} s"
