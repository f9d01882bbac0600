"""Replay of recorded inputs through new cores, and comparison of every decision with the recorded one."""

from collections.abc import Callable
from dataclasses import dataclass

from agents.core import VehicleCore
from agents.inputs import CoreInput, Start
from agents.outputs import TickOutput
from agents.recording import replay_input
from gcs.flightlog.reader import FlightLog
from gcs.flightlog.records import Decision, decision_of
from gcs.flightlog.run import mission_of
from gcs.flightlog.schema import Codec
from gcs.mission.planner import ChosenPlanner
from gcs.replay.comparison import FieldDifference, close, differences, identical, versions_that_differ
from gcs.replay.playback import MissingRecords, Turn, config_of, recorded_vehicles, tick_count, turns


@dataclass(frozen=True, slots=True)
class Moment:
    """A point in a vehicle's flight: the tick, counted from 1, and the time on the core's clock.

    `time_s` is None where the log ends before the tick. `start_s` is the mission's start on the same clock, None before
    it is known. `inputs` are those since the previous tick.
    """

    tick: int
    time_s: float | None
    start_s: float | None
    inputs: tuple[CoreInput, ...]

    def mission_time(self, time_s: float) -> str:
        """Return a time on the core's clock as seconds of the mission; before its start they are negative."""
        return f"{time_s:.3f} s (vehicle clock)" if self.start_s is None else f"{time_s - self.start_s:.3f} s"


@dataclass(frozen=True, slots=True)
class DecisionDifference:
    """The first decision of a vehicle that differs from the recorded one."""

    moment: Moment
    fields: tuple[FieldDifference, ...]


@dataclass(frozen=True, slots=True)
class Failure:
    """The first exception inside a vehicle's core; `recorded` is true if the core also failed during the flight."""

    moment: Moment
    error: str
    recorded: bool


@dataclass(slots=True)
class VehicleReplay:
    """The replay of one vehicle: its ticks in the log, how many were compared, and how many were identical.

    `gap` states the tick from which the log cannot be compared, and the reason; empty if it was compared to the end.
    """

    vehicle_id: int
    ticks: int
    compared: int = 0
    identical: int = 0
    difference: DecisionDifference | None = None
    failure: Failure | None = None
    gap: str = ""


@dataclass(frozen=True, slots=True)
class Replay:
    """The replay of a log. If `other_versions` names any, decisions are compared within the tolerance."""

    mission: str
    other_versions: tuple[str, ...]
    vehicles: tuple[VehicleReplay, ...]

    @property
    def same(self) -> bool:
        """Whether every compared decision is the same and no core failed."""
        return all(each.difference is None and each.failure is None for each in self.vehicles)


def replay(log: FlightLog, on_tick: Callable[[], None] = lambda: None, planner: ChosenPlanner | None = None) -> Replay:
    """Replay every vehicle of a log, with the planner if the flight's was not cordon's.

    Raises LogError where the log does not hold the mission.
    """
    mission, other = mission_of(log), versions_that_differ(log.run, planner)
    factory = None if planner is None else planner.factory
    vehicles = []
    for vehicle_id in recorded_vehicles(log):
        core = VehicleCore(config_of(log, mission, vehicle_id), factory)
        player = _Player(vehicle_id, tick_count(log, vehicle_id), core, exact=not other)
        for turn in turns(log, vehicle_id):
            if not player.play(turn):
                break
            if isinstance(turn, Turn) and turn.tick is not None:
                on_tick()
        vehicles.append(player.result)
    return Replay(log.run.mission, other, tuple(vehicles))


class _Player:
    """Feeds one vehicle's recorded inputs to its core."""

    def __init__(self, vehicle_id: int, ticks: int, core: VehicleCore, *, exact: bool) -> None:
        self._core = core
        self._same = identical if exact else close
        self._codec = Codec(Decision)
        self._tick = 0
        self._start_s: float | None = None
        self.result = VehicleReplay(vehicle_id, ticks)

    def play(self, turn: Turn | MissingRecords) -> bool:
        """Feed the inputs of a turn, compare the decision, and return whether the rest of the log can be compared."""
        if isinstance(turn, MissingRecords):
            self.result.gap = f"{turn.reason}: no comparison from tick {self._tick + 1} on"
            return False
        output, error = self._played(turn.inputs)
        tick = turn.tick
        self._tick += tick is not None
        moment = Moment(self._tick, None if tick is None else tick.now_s, self._start_s, turn.inputs)
        if error and self.result.failure is None:
            self.result.failure = Failure(moment, error, recorded=turn.decision is None and tick is not None)
        if tick is not None and not (turn.decision is None and turn.is_last):
            self._compare(turn, None if output is None else decision_of(output), moment)
        return True

    def _played(self, inputs: tuple[CoreInput, ...]) -> tuple[TickOutput | None, str]:
        """Return the core's output and the first exception; the core continues after it, as it did in flight."""
        output, failed = None, ""
        for item in inputs:
            if isinstance(item, Start):
                self._start_s = item.at_s
            try:
                output = replay_input(self._core, item)
            except Exception as error:  # a finding of the replay, which continues
                failed = failed or f"{type(error).__name__}: {error}"
        return output, failed

    def _compare(self, turn: Turn, replayed: Decision | None, moment: Moment) -> None:
        result = self.result
        result.compared += 1
        if turn.decision is None or replayed is None:
            found = [] if turn.decision is replayed else [FieldDifference("", *map(_named, (turn.decision, replayed)))]
        elif self._codec.encode(replayed, turn.number) == turn.payload:
            found = []
        else:
            found = differences(turn.decision, replayed, self._same)
        if not found:
            result.identical += 1
        elif result.difference is None:
            result.difference = DecisionDifference(moment, tuple(found))


def _named(decision: Decision | None) -> str:
    return "no decision" if decision is None else "a decision"
