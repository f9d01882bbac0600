"""The result of a flight.

`FlightResult.to_json` is the `--json` output of sim, fly and report. A metric that does not apply is None
(null), never 0 and never NaN.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import msgspec
import numpy as np

from estimation.plant.watch import Difference
from gcs.metrics.catalogue import OF_THE_RING, Verdicts, VerdictState
from gcs.metrics.departures import Departure
from gcs.metrics.ending import TeamEnding
from gcs.metrics.json_output import json_output
from gcs.metrics.record import FlightEvent, LoopStatistics
from gcs.metrics.references import EngagementResult
from gcs.metrics.reynolds import ReynoldsResult
from gcs.metrics.ring import SETTLED_FOR_S, RingResult
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
class PlantResult:
    """Whether the plant of a vehicle's profile is valid for a flight, and the vehicle's latency as text.

    `verdict` is how the vehicle differs if another plant explains the flight better, None without enough excitation.
    """

    id: int
    profile: str
    verdict: Literal["valid"] | Difference | None
    text: str
    latency: str

    @property
    def differs(self) -> bool:
        """Whether another plant explains the flight better."""
        return self.verdict not in (None, "valid")


_NOT_OF_A_RING = ("tactic", "formation_speed_error_rms_m_s", "formation_spacing_error_rms_m")


@dataclass(frozen=True, slots=True)
class NamedRing:
    """One ring of a flight over several: its name, that of its target, and its `result` as that of a flight over it.

    The vehicles of the result are those that were on the ring. Its engagement is who was, its closest approach and
    guard are not those of the flight.
    """

    name: str
    target: str
    result: "FlightResult"

    def to_dict(self) -> dict[str, object]:
        """Return it as plain data: what is of the ring alone."""
        result, estimate = self.result, self.result.estimate
        vehicles = [
            {name: value for name, value in msgspec.to_builtins(each).items() if name not in _NOT_OF_A_RING}
            for each in result.vehicles
        ]
        plain = {"name": self.name, "target": self.target, "window_s": result.window_s, "vehicles": vehicles}
        of_ring = {"ring": result.ring, "transitions": result.transitions}
        by_estimate = None if estimate is None else {"vehicles": estimate.vehicles, "ring": estimate.ring}
        verdicts = {name: self.verdict(name) for name in OF_THE_RING}
        return {
            **plain,
            **msgspec.to_builtins({**of_ring, "estimate": by_estimate}),
            "verdicts": verdicts,
            "not_judged": self.not_judged,
        }

    @property
    def about(self) -> str:
        """The words " about " and its target's name, empty where that is the ring's or there is none."""
        return f" about {self.target}" if self.target not in ("", self.name) else ""

    def verdict(self, name: str) -> bool | None:
        """Return whether a verdict holds on the ring, by name."""
        return self.result.verdicts.named()[name]

    @property
    def not_judged(self) -> tuple[str, ...]:
        """The verdicts of the ring that the mission asks for and the flight does not show."""
        return tuple(each for each in self.result.not_judged if each in OF_THE_RING)


@dataclass(frozen=True, slots=True)
class FlightResult:
    """The result of a flight, in the order of its JSON form.

    `estimate` holds the metrics by estimate beside those by truth. `truth_missing` is why there are none by truth
    although simulators sent it. `ended` is None in logs of versions that did not record it. `faults` are those injected
    into stub vehicles. `kinds` are by id. `departures` are those not by order. `not_judged` are verdicts that the
    mission asks for. `plants` are a report's. `rings` are those of a mission of several, empty else; what the other
    keys hold then is stated in `gcs/metrics/rings.py`.
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
    departures: tuple[Departure, ...] | None = None
    ways_closest_m: float | None = None
    not_judged: tuple[str, ...] = ()
    plants: tuple[PlantResult, ...] | None = None
    rings: tuple[NamedRing, ...] = ()

    @property
    def kinds_line(self) -> str:
        """The vehicles' kinds in one line; empty if they are unknown."""
        ids = {kind: [str(i) for i, each in self.kinds.items() if each == kind] for kind in self.kinds.values()}
        return "; ".join(f"{kind}: {', '.join(each)}" for kind, each in ids.items())

    @property
    def wall_time_line(self) -> str:
        """Wall time and speed, such as `3.5 s (172× real time)`; empty if unknown."""
        if self.wall_time_s is None or self.realtime_factor is None:
            return ""
        rounded = float(f"{self.realtime_factor:.3g}")  # :g writes a rounded number above 1000 without an exponent
        return f"{self.wall_time_s:.1f} s ({rounded:g}× real time)"

    @property
    def ended_early(self) -> bool:
        """Whether it ended in flight, before its mission was over."""
        return self.ended is not None and self.ended.is_early

    @property
    def passes(self) -> bool | None:
        """Whether all verdicts that the mission asks for pass; None if one could not be judged."""
        return False if False in self.verdicts.named().values() else None if self.not_judged else True

    @property
    def all_hold(self) -> bool:
        """Whether `passes` is True."""
        return self.passes is True

    def untimed(self) -> "FlightResult":
        """Return the result with every wall time None, so that it depends on the mission and the seed alone."""
        loop = replace(self.loop, tick_p50_us=None, tick_p99_us=None)
        return replace(self, loop=loop, wall_time_s=None, realtime_factor=None)

    def to_dict(self) -> dict[str, object]:
        """Return the result as plain dicts and lists, keys in their documented order; `rings` only where there are."""
        plain = {
            "mission": self.mission,
            "ended": None,
            **msgspec.to_builtins(replace(self, rings=()), str_keys=True),
        }
        del plain["rings"]
        if self.rings:
            plain["rings"] = [each.to_dict() for each in self.rings]
        plain["events"] = [each.to_dict() for each in self.events]
        plain["verdicts"] = self.verdicts.named()
        return plain

    def to_json(self) -> str:
        """Return the result as one line of JSON; raises ValueError rather than write NaN."""
        return json_output(self.to_dict())


def verdict_states(result: FlightResult) -> dict[str, VerdictState]:
    """Return what a flight shows of each verdict, by name."""
    states = {True: VerdictState.PASSES, False: VerdictState.FAILS, None: VerdictState.NOT_ASKED}
    return {
        name: VerdictState.NOT_JUDGED if name in result.not_judged else states[held]
        for name, held in result.verdicts.named().items()
    }


def reference_line(result: FlightResult) -> str:
    """Return the source of the metrics and verdicts, in one line."""
    if result.reference == "truth":
        return "metrics and verdicts from the simulators' ground truth"
    missing = f" ({result.truth_missing})" if result.truth_missing else ""
    return f"metrics and verdicts from the vehicles' estimates of themselves and of the target{missing}"


_SAME_S = 1e-3
SHORT_S, SHORT_SHARE = 60.0, 0.5
"""The text says "only" where the ring was judged for less than this, or than this share of the time on it."""


def is_briefly_judged(ring: RingResult) -> bool:
    """Whether a ring was judged for a short time, or a small share of its time."""
    return ring.judged_s is not None and (ring.judged_s < SHORT_S or (ring.judged_share or 0.0) < SHORT_SHARE)


def is_too_brief(result: FlightResult) -> bool:
    """Return whether all on the ring were measured, but for too short a time to judge the ring."""
    return result.ring.judged_from_s is not None and "C1" in result.not_judged


def judged_line(result: FlightResult) -> str:
    """Return how long, from when and with how many vehicles the ring was judged; empty without a ring."""
    ring, flown = result.ring, len(result.vehicles)
    if ring.judged_s is None or ring.judged_share is None:
        return ""
    if ring.judged_from_s is None:
        measured = any(vehicle.radius_error_rms_m is not None for vehicle in result.vehicles)
        return "not every vehicle on the ring was measured" if measured else "no vehicle was on the ring at the end"
    if is_too_brief(result):
        return f"only {ring.judged_s:.1f} s from {ring.judged_from_s:.1f} s on, and {SETTLED_FOR_S:g} s are needed"
    only = "only " if is_briefly_judged(ring) else ""
    # Its whole time is 100 %: a share is not rounded up to it.
    share = min(ring.judged_share, 0.99) if ring.judged_share < 1.0 else 1.0
    of = "" if ring.members_min == flown else f", with {ring.members_min} of {flown} vehicles"
    return f"judged over {only}{ring.judged_s:.1f} s from {ring.judged_from_s:.1f} s on, {share:.0%} of its time{of}"


def settled_line(result: FlightResult) -> str:
    """Return how long after the last engagement the ring settled, and the prediction; empty if it did not settle."""
    if result.ring.settling_time_s is None:
        return ""
    # It settled when its window begins; later ones may not have been judged.
    began_s = (0.0 if result.window_s is None else result.window_s[0]) - result.ring.settling_time_s
    begun = (each for each in result.transitions if abs(each.begins_at_s - began_s) < _SAME_S)
    predicted_s = next((each.settling_predicted_s for each in begun), None)
    beside = "" if predicted_s is None else f" (predicted: {predicted_s:.1f} s)"
    return f"settled after {result.ring.settling_time_s:.1f} s{beside}"


def window_line(result: FlightResult) -> str:
    """Return the part of the flight over which the ring is judged, and the reason; empty without a ring.

    The text reports a ring that settled and left its limits later.
    """
    if result.window_s is None:
        return ""
    begins_s, ring = result.window_s[0], result.ring
    if ring.judged_from_s is None or is_too_brief(result):
        return f"ring not judged: {judged_line(result)}"
    window = f"ring {judged_line(result)}"
    if result.window_s[1] < result.duration_s:
        window = f"{window}, until {result.window_s[1]:.1f} s, as what began then had no time to settle"
    if ring.unsettled_at_s is None:
        settles = ring.settling_time_s is not None
        why = "from settling to the end" if settles else "did not settle: last quarter of the flight"
        return f"{window}: {why}"
    settled = f"settled at {ring.first_settled_at_s:.1f} s, left its limits at {ring.unsettled_at_s:.1f} s"
    if ring.settling_time_s is None:
        return f"{window}: {settled}, did not settle again: last quarter of the flight"
    return f"{window}: {settled}, settled again at {begins_s:.1f} s"
