"""Filters with other parameters: the recorded inputs run through the filters with both sets, side by side.

Their inputs are those of the core's filters - its telemetry, its own sightings and those received from peers - and the
setpoints that were sent. No decision is recomputed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from agents.broadcast import received_sighting
from agents.inputs import Command, Message, Start, TacticEvent, TimeScale
from agents.settings.config import AgentConfig
from agents.situation.targets import NAMELESS
from agents.situation.team_frame import TeamFrame
from agents.tactics import Tactic
from agents.team.clock_watch import ClockWatch
from agents.team.inbox import Inbox
from agents.team.messages import MemberState, OperatorCommand
from estimation.filters.own import OwnFilter
from estimation.filters.target import TargetFilter
from estimation.input_file import toml_content
from estimation.settings import OwnFilterSettings, Settings, TargetFilterSettings
from estimation.state import MOTION, POSITION, VELOCITY, Sighting, TargetEstimate, Telemetry, Vector
from gcs.console.table_view import number
from gcs.errors import InputError, KeyFault
from gcs.flightlog.reader import FlightLog
from gcs.flightlog.records import Decision, Truth
from gcs.metrics.journal import path_on_grid_m
from gcs.mission.mission import Mission, TargetSection
from gcs.mission.validation import unknown_key, validated
from gcs.replay.playback import MissingRecords, Turn, config_of, recorded_vehicles, turns

Innovation = tuple[Vector, Vector]
"""A measurement minus its prediction (m,), and the innovation covariance (m, m) of the filter."""


@dataclass(frozen=True, slots=True)
class FilterFigures:
    """The figures of one filter; None where a figure is unknown.

    `nis` is the mean normalised innovation squared over its dimension: 1 for a consistent filter. `refused` is the
    share of rejected measurements, `prediction_m` the distance of the accepted ones from their prediction, `error_m`
    the distance of the estimate from the truth (both rms).
    """

    measurements: int
    nis: float | None
    refused: float | None
    prediction_m: float | None
    error_m: float | None


class EstimateTrack:
    """The estimates of one filter over time, and the innovations of its measurements."""

    def __init__(self) -> None:
        self._motion: dict[float, Vector] = {}
        self._nis: list[float] = []
        self._prediction_error_m2: list[float] = []
        self._taken = self._refused = 0

    def add(self, time_s: float, motion: Vector) -> None:
        """Add the estimate (4,) = [x y x' y'] at a tick."""
        self._motion[time_s] = motion

    def add_measurement(self, accepted: bool, innovation: Innovation | None) -> None:
        """Add whether a measurement was accepted, and its innovation, None without a prediction."""
        self._taken += 1
        self._refused += not accepted
        if accepted and innovation is not None:
            off, spread = innovation
            self._nis.append(float(off @ np.linalg.solve(spread, off)) / off.size)
            self._prediction_error_m2.append(float(off[POSITION] @ off[POSITION]))

    def figures(self, truth_m: Callable[[Vector], Vector] | None) -> FilterFigures:
        """Return the figures; `truth_m` returns true positions (T, 2) at times (T,), NaN where they are not known."""
        return FilterFigures(
            self._taken,
            float(np.mean(self._nis)) if self._nis else None,
            self._refused / self._taken if self._taken else None,
            float(np.sqrt(np.mean(self._prediction_error_m2))) if self._prediction_error_m2 else None,
            None if truth_m is None or not self._motion else self._error_m(truth_m),
        )

    def _error_m(self, truth_m: Callable[[Vector], Vector]) -> float | None:
        time_s = np.array(list(self._motion))
        off = np.array(list(self._motion.values()))[:, POSITION] - truth_m(time_s)
        squared = np.sum(off**2, axis=1)
        known = squared[np.isfinite(squared)]
        return float(np.sqrt(known.mean())) if known.size else None

    def difference(self, other: "EstimateTrack", part: slice) -> Vector:
        """Return the difference (T, 2) of two tracks at the times at which both have an estimate."""
        times = [time_s for time_s in self._motion if time_s in other._motion]
        return np.array([self._motion[time_s][part] - other._motion[time_s][part] for time_s in times])


def rms_difference(one: EstimateTrack, other: EstimateTrack, part: slice) -> float | None:
    """Return the rms difference of two tracks in position or velocity, None without common times."""
    apart = one.difference(other, part)
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) if apart.size else None


FILTERS = ("own_filter", "target_filter")
_S = TypeVar("_S", bound=Settings)

FilterInput = Telemetry | Sighting | TacticEvent | Command | OperatorCommand


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """The parameters of both filters."""

    own_filter: OwnFilterSettings
    target_filter: TargetFilterSettings


@dataclass(frozen=True, slots=True)
class Change:
    """A setting of a filter: its value in the flight, and the value that is tried.

    Where vehicles flew with different values, `recorded` holds them by the vehicles' ids.
    """

    key: str
    recorded: object
    tried: object


@dataclass(frozen=True, slots=True)
class FilterComparison:
    """One filter of one vehicle with the recorded and with the tried parameters, and their rms difference.

    `target` is the name of the target that the filter follows, None unless the mission has several.
    """

    vehicle_id: int
    filter: str
    target: str | None
    recorded: FilterFigures
    tried: FilterFigures
    difference_m: float | None
    difference_m_s: float | None


@dataclass(frozen=True, slots=True)
class WhatIf:
    """The changed parameters and their outcomes; `gaps` name missing records of the log, and what is not shown."""

    mission: str
    changes: tuple[Change, ...]
    outcomes: tuple[FilterComparison, ...]
    gaps: tuple[str, ...]


def recorded_filters(mission: Mission) -> dict[int, FilterSettings]:
    """Return the settings of both filters with which each vehicle of a mission flies, by the vehicles' ids."""
    return {each.id: FilterSettings(each.own_filter, mission.target_filter) for each in mission.vehicles}


def changed_filters(mission: Mission, changes: Sequence[str]) -> dict[int, FilterSettings]:
    """Return the same with values of KEY=VALUE changed for every vehicle; raises InputError with every fault."""
    faults: list[KeyFault] = []
    values: dict[str, dict[str, object]] = {name: {} for name in FILTERS}
    for change in changes:
        key, is_set, text = change.partition("=")
        section, _, name = key.strip().partition(".")
        if not is_set or not name:
            faults.append(KeyFault(repr(change), "it must be KEY=VALUE, for example own_filter.gate_sigma=4"))
        elif section not in FILTERS:
            faults.append(unknown_key("", section, list(FILTERS)))
        else:
            try:
                (values[section][name],) = toml_content(f"value = {text}").values()
            except ValueError:  # also more than one value
                faults.append(KeyFault(f"{section}.{name}", f"{text!r} is not a TOML value"))
    own = validated(OwnFilterSettings, values["own_filter"], "own_filter", faults)
    target = validated(TargetFilterSettings, values["target_filter"], "target_filter", faults)
    if faults or own is None or target is None:
        raise InputError([f"--set: {fault}" for fault in faults])
    return {
        vehicle_id: FilterSettings(_with_set(recorded.own_filter, own), _with_set(recorded.target_filter, target))
        for vehicle_id, recorded in recorded_filters(mission).items()
    }


def _with_set(settings: _S, changes: _S) -> _S:
    """Return settings with those of `changes` that are set there."""
    return settings.model_copy(update={key: getattr(changes, key) for key in changes.model_fields_set})


def what_if(
    log: FlightLog, mission: Mission, tried: Mapping[int, FilterSettings], on_tick: Callable[[], None] = lambda: None
) -> WhatIf:
    """Run every vehicle's filters with the recorded and with the tried parameters; raises LogError."""
    outcomes, gaps, nameless = list[FilterComparison](), list[str](), list[str]()
    recorded = recorded_filters(mission)
    for vehicle_id in recorded_vehicles(log):
        config = config_of(log, mission, vehicle_id)
        feed, runs = (
            Feed(config),
            [FilterRun(config, settings) for settings in (recorded[vehicle_id], tried[vehicle_id])],
        )
        for turn in turns(log, vehicle_id):
            if isinstance(turn, MissingRecords):
                gaps.append(f"vehicle {vehicle_id}: {turn.reason}")
                continue
            inputs = list(feed.inputs(turn))
            for run in runs:
                run.take(turn, inputs)
            if turn.tick is not None:
                on_tick()
        outcomes += _outcomes(vehicle_id, runs, *_truth(log, mission, vehicle_id, feed.start_s))
        nameless += [f"vehicle {vehicle_id}: sightings that name no target"] if runs[0].has_nameless else []
    changes = tuple(_changes(recorded, tried))
    concerned = {change.key.partition(".")[0] for change in changes}
    if "target_filter" in concerned:
        gaps += nameless
    shown = tuple(outcome for outcome in outcomes if f"{outcome.filter}_filter" in concerned)
    return WhatIf(log.run.mission, changes, shown, tuple(gaps))


class Feed:
    """Converts the inputs of a core into the inputs of its filters."""

    def __init__(self, config: AgentConfig) -> None:
        self._vehicle_id, self._targets = config.vehicle_id, config.targets
        self._inbox = Inbox(config.vehicle_id, config.slots, ClockWatch())
        self._time_scale = 1.0
        self.start_s: float | None = None

    def inputs(self, turn: Turn) -> Iterator[FilterInput]:
        """Return the filter inputs of a turn, and the inputs that may change the tactic, in order."""
        for item in turn.inputs:
            match item:
                case TimeScale():
                    self._time_scale = item.factor
                case Start():
                    self.start_s = item.at_s
                case Telemetry() | Sighting() | TacticEvent() | Command():
                    yield item
                case Message():
                    yield from self._received(item)

    def _received(self, item: Message) -> Iterator[FilterInput]:
        message = item.message
        if not self._inbox.accepts(message, item.now_s, self._time_scale):
            return
        if isinstance(message, OperatorCommand):
            yield message
        for package in message.sightings if isinstance(message, MemberState) else ():
            if self._vehicle_id in package.recipients:
                with suppress(ValueError):  # the core refused it in flight, too
                    yield received_sighting(package, self._targets)


class FilterRun:
    """One vehicle's filters with one set of parameters, and their figures.

    Each of several targets has a filter, by its name. Sightings that do not name one of several are not associated, as
    `TargetTracks` does in flight: `has_nameless` is whether there were any.
    """

    def __init__(self, config: AgentConfig, settings: FilterSettings) -> None:
        self._vehicle_id = config.vehicle_id
        self._own = OwnFilter(config.plant, settings.own_filter)
        self._targets = {name: TargetFilter(settings.target_filter) for name in config.targets or (NAMELESS,)}
        self._frame = TeamFrame(replace(config, own_filter=settings.own_filter))
        self._sighted: list[Sighting] = []
        self._seen: dict[str, TargetEstimate] = {}
        noise = settings.own_filter
        self._noise = np.diag([noise.position_noise_m**2] * 2 + [noise.velocity_noise_m_s**2] * 2)
        self._turns = noise.disturbance_turns
        self._mission_rate_rad_s = config.encirclement.angular_rate_rad_s
        self.own, self.targets = EstimateTrack(), {name: EstimateTrack() for name in self._targets}
        self.has_nameless = False

    def take(self, turn: Turn, inputs: Sequence[FilterInput]) -> None:
        """Feed a turn to the filters, and store the estimates at its tick."""
        for item in inputs:
            if isinstance(item, Telemetry):
                self._measure(self._frame.telemetry(item))
            elif isinstance(item, Sighting):
                self._sighted.append(self._frame.shared(item) if item.sensor_id == self._vehicle_id else item)
            elif turn.decision is not None and turn.decision.tactic != Tactic.ENCIRCLE.value:
                # A command to leave the ring acts at once; every other change of tactic happens in the tick.
                self._turn(turn.decision)
        if turn.tick is None:
            return
        now_s = turn.tick.now_s
        self._see(now_s)
        own = self._own.estimate(now_s)
        known = {name: target.estimate(now_s) for name, target in self._targets.items()}
        self._seen = {name: each for name, each in known.items() if each is not None}
        if own is not None:
            self.own.add(now_s, own.mean[MOTION])
        for name, each in self._seen.items():
            self.targets[name].add(now_s, each.mean)
        if turn.decision is not None:
            self._turn(turn.decision)
            if turn.decision.guard is not None:
                self._own.command(now_s, np.array(turn.decision.guard.setpoint_m))

    def _turn(self, decision: Decision) -> None:
        rate_rad_s = decision.ring_rate_rad_s if decision.turning_rad_s is None else decision.turning_rad_s
        if rate_rad_s is None:
            rate_rad_s = self._mission_rate_rad_s if decision.tactic == Tactic.ENCIRCLE.value else 0.0
        self._own.turn_disturbance(rate_rad_s if self._turns else 0.0)

    def _measure(self, telemetry: Telemetry) -> None:
        prior, refused = self._own.estimate(telemetry.time_s), self._own.refused
        self._own.measure(telemetry)
        accepted = self._own.refused == refused
        innovation = None
        if prior is not None and prior.time_s == telemetry.time_s:
            measured = np.array([*telemetry.position_m[:2], *telemetry.velocity_m_s[:2]])
            innovation = measured - prior.mean[MOTION], prior.covariance[MOTION, MOTION] + self._noise
        self.own.add_measurement(accepted, innovation)

    def _see(self, now_s: float) -> None:
        """Process the sightings since the last tick, and the shift of the team's frame that follows from them."""
        for sighting in self._frame.sightings(now_s, self._sighted, self._seen):
            name = NAMELESS if NAMELESS in self._targets else sighting.target
            self.has_nameless |= name is None
            if name in self._targets:
                self._sight(sighting, self._targets[name], self.targets[name])
        self._sighted.clear()
        off_x, off_y = self._frame.follow()
        if off_x or off_y:
            self._own.shift(-off_x, -off_y)

    def _sight(self, sighting: Sighting, target: TargetFilter, track: EstimateTrack) -> None:
        prior, refused = target.estimate(sighting.time_s), target.refused
        target.sight(sighting)
        accepted = target.refused == refused
        innovation = None
        # A delayed sighting is inserted at its own time, for which there is no prior estimate to compare it with.
        if prior is not None and prior.time_s == sighting.time_s:
            xx, xy, yy = sighting.covariance_m2
            spread = prior.covariance[POSITION, POSITION] + np.array([[xx, xy], [xy, yy]])
            innovation = np.array(sighting.position_m) - prior.mean[POSITION], spread
        track.add_measurement(accepted, innovation)


_Truth = Callable[[Vector], Vector] | None
"""Returns true positions (T, 2) at times (T,), NaN where they are not known; None if none is known."""


def _truth(log: FlightLog, mission: Mission, vehicle_id: int, start_s: float | None) -> tuple[_Truth, list[_Truth]]:
    """Return the true positions of a vehicle and of all targets in a mission that began at `start_s`."""
    truth, targets = list(log.of_kind(vehicle_id, Truth)), mission.every_target
    if not truth:
        return None, [None for _ in targets]
    true_s = np.array([each.time_s for each in truth])
    place_m = np.array([each.position_m[:2] for each in truth])

    def own_m(time_s: Vector) -> Vector:
        columns = [np.interp(time_s, true_s, column, np.nan, np.nan) for column in place_m.T]
        return np.column_stack(columns)

    if start_s is None or (log.target_path is None and mission.target.evades is not None):
        return own_m, [None for _ in targets]
    return own_m, [partial(_true_target_m, log, each, start_s) for each in targets]


def _true_target_m(log: FlightLog, target: TargetSection, start_s: float, time_s: Vector) -> Vector:
    """Return a target's true positions (T, 2) in a mission that began at `start_s`, NaN where they are not known."""
    if log.target_path is not None:
        return path_on_grid_m(*log.target_path, time_s)
    place_m, _ = target.motion.over(time_s - start_s)
    return np.where(time_s[:, None] >= start_s, place_m, np.nan)


def _outcomes(
    vehicle_id: int, runs: Sequence[FilterRun], own_m: _Truth, targets_m: Sequence[_Truth]
) -> Iterator[FilterComparison]:
    recorded, tried = runs
    targets = zip(recorded.targets.items(), tried.targets.values(), targets_m, strict=True)
    for name, target, one, other, true in (
        ("own", None, recorded.own, tried.own, own_m),
        *(("target", name or None, one, other, true) for (name, one), other, true in targets),
    ):
        yield FilterComparison(
            vehicle_id,
            name,
            target,
            one.figures(true),
            other.figures(true),
            rms_difference(one, other, POSITION),
            rms_difference(one, other, VELOCITY),
        )


def _changes(recorded: Mapping[int, FilterSettings], tried: Mapping[int, FilterSettings]) -> Iterator[Change]:
    """Return the settings that differ for any vehicle; tried is one value for all of them."""
    for section, model in (("own_filter", OwnFilterSettings), ("target_filter", TargetFilterSettings)):
        for name in model.model_fields:
            before, after = (
                {vehicle_id: getattr(getattr(each, section), name) for vehicle_id, each in settings.items()}
                for settings in (recorded, tried)
            )
            if before != after:
                values = list(before.values())
                same = all(value == values[0] for value in values)
                yield Change(f"{section}.{name}", values[0] if same else before, next(iter(after.values())))


_COLUMNS = (
    "NIS/dof\n",
    "refused\n",
    "prediction\nrms [m]",
    "error\nrms [m]",
    "difference\nrms [m]",
    "difference\n[m/s]",
)


def what_if_view(what: WhatIf) -> RenderableType:
    """Return the filters side by side for a terminal."""
    lines = [Text(f"{change.key}: {change.recorded} -> {change.tried}", style="bold") for change in what.changes]
    if not lines:
        return Text("no parameter changed: the values are those of the flight", style="yellow")
    gaps = [Text(f"{gap}: the filters continue without them", style="yellow") for gap in what.gaps]
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    for name in ("", "filter", ""):
        table.add_column(name, no_wrap=True)
    for name in _COLUMNS:
        table.add_column(Text(name, justify="right"), justify="right", no_wrap=True)
    for each in what.outcomes:
        followed = each.filter if each.target is None else f"{each.filter} {each.target}"
        table.add_row(str(each.vehicle_id), followed, "recorded", *_cells(each.recorded))
        difference = number(each.difference_m, ".4f"), number(each.difference_m_s, ".4f")
        table.add_row("", "", "tried", *_cells(each.tried), *difference, style="cyan")
    return Group(*lines, *gaps, table)


def what_if_dict(what: WhatIf) -> dict[str, Any]:
    """Return the same as plain data."""
    return {
        "changes": {change.key: {"recorded": change.recorded, "tried": change.tried} for change in what.changes},
        "filters": [asdict(each) for each in what.outcomes],
        "gaps": list(what.gaps),
    }


def _cells(figures: FilterFigures) -> tuple[str, ...]:
    return (
        number(figures.nis, ".3f"),
        number(figures.refused, ".2%"),
        number(figures.prediction_m, ".4f"),
        number(figures.error_m, ".4f"),
    )
