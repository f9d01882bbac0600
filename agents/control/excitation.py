"""The programme of an identification flight: its setpoints over time, and the motion that they are predicted to cause.

Steps between random levels excite mainly delay and stiffness, swept sines mainly the damping and the dynamics beyond
second order. Each axis is excited alone, then both together with different signals. For a plant with feed-forward the
sines are sent with their velocities and the steps without: together they identify both inputs. The plant is linear, so
one simulated flight at unit amplitude gives the largest amplitude within the box and the speed limit, also for plants
that differ from the profile.
"""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise, product
from math import cos, exp, hypot, inf, log, pi, sin
from typing import Final

import msgspec
import numpy as np

from agents.control.aims import towards
from agents.control.plan import Plan
from agents.settings.config import AgentConfig
from agents.settings.sections import ExcitationSettings
from agents.situation.situation import Situation
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import POSITION, VELOCITY, Vector

LEVELS: Final = 7
"""The number of levels from one side of the box to the other."""
STEP_LARGEST: Final = 0.75
"""In amplitudes: with a smaller largest step the levels use more of the box at the same speed."""
BOX_RESERVE: Final = 0.85
"""The share of the box that the plan uses; the rest is a margin for wind and slow position errors."""
LEAD_RESERVE: Final = 0.9
APPROACH_SHARE: Final = 0.5
"""The speed of the flight to the middle of the box, as a share of the speed limit."""


class Steps(msgspec.Struct, frozen=True):
    """Levels of unit amplitude, and when each begins, starting at 0."""

    from_s: tuple[float, ...]
    level: tuple[float, ...]

    def at(self, time_s: float) -> float:
        """Return the level at a time."""
        return self.level[max(bisect_right(self.from_s, time_s) - 1, 0)]

    def rate_per_s(self, _time_s: float) -> float:
        """Return zero: between jumps the level is constant."""
        return 0.0


class Sweep(msgspec.Struct, frozen=True):
    """A sine whose frequency changes exponentially; above `knee_hz` its amplitude falls, which bounds its speed."""

    from_hz: float
    to_hz: float
    knee_hz: float
    seconds: float

    def at(self, time_s: float) -> float:
        """Return the value at a time."""
        frequency_hz, turns = self._reached(time_s)
        return min(1.0, self.knee_hz / frequency_hz) * sin(2.0 * pi * turns)

    def rate_per_s(self, time_s: float) -> float:
        """Return the rate of change at a time."""
        frequency_hz, turns = self._reached(time_s)
        falls_per_s = self._growth_per_s if frequency_hz > self.knee_hz else 0.0
        slope = 2.0 * pi * frequency_hz * cos(2.0 * pi * turns) - falls_per_s * sin(2.0 * pi * turns)
        return min(1.0, self.knee_hz / frequency_hz) * slope

    @property
    def _growth_per_s(self) -> float:
        return log(self.to_hz / self.from_hz) / self.seconds

    def _reached(self, time_s: float) -> tuple[float, float]:
        """Return the frequency at a time, and the number of periods completed."""
        frequency_hz = self.from_hz * exp(self._growth_per_s * time_s)
        return frequency_hz, (frequency_hz - self.from_hz) / self._growth_per_s


Signal = Steps | Sweep | None


class Part(msgspec.Struct, frozen=True):
    """A part of the programme: its begin and end, the signal of each axis, and the amplitude of both."""

    name: str
    begin_s: float
    end_s: float
    signals: tuple[Signal, Signal]
    amplitude_m: float

    def offset_m(self, time_s: float) -> tuple[float, float]:
        """Return the setpoint at a time of the programme, relative to the middle of the box."""
        x, y = (0.0 if each is None else each.at(time_s - self.begin_s) for each in self.signals)
        return self.amplitude_m * x, self.amplitude_m * y

    def velocity_m_s(self, time_s: float) -> tuple[float, float]:
        """Return the setpoint's velocity at a time of the programme."""
        x, y = (0.0 if each is None else each.rate_per_s(time_s - self.begin_s) for each in self.signals)
        return self.amplitude_m * x, self.amplitude_m * y


class ExcitationProgramme(msgspec.Struct, frozen=True):
    """All parts in order; before each part and after the last, the vehicle rests in the middle of the box."""

    parts: tuple[Part, ...]
    duration_s: float

    def part(self, time_s: float) -> Part | None:
        """Return the part at a time of the programme, None at rest."""
        return next((part for part in self.parts if part.begin_s <= time_s < part.end_s), None)


class MotionExtent(msgspec.Struct, frozen=True):
    """The maxima of a motion - reach along either axis, speed, acceleration, lead of the aim - and its path length."""

    reach_m: float
    speed_m_s: float
    acceleration_m_s2: float
    lead_m: float
    distance_m: float


class Preview(msgspec.Struct, frozen=True):
    """The programme's predicted space, speed and time on the profile's plant; `reach_m` is from the box's middle."""

    duration_s: float
    reach_m: float
    speed_m_s: float
    acceleration_m_s2: float
    distance_m: float


@lru_cache(maxsize=64)
def programme(config: AgentConfig) -> ExcitationProgramme:
    """Return the programme of an identification flight; `config` must have `excitation`."""
    settings = config.excitation
    assert settings is not None
    random = np.random.default_rng(settings.seed)
    begin_s, parts = _approach_s(settings), []
    for name, signals, seconds in _signals(settings, random):
        amplitude_m = _amplitude_m(config, settings, signals, seconds)
        parts.append(Part(name, begin_s, begin_s + seconds, signals, amplitude_m))
        begin_s += seconds + settings.rest_s
    return ExcitationProgramme(tuple(parts), begin_s)


def preview(config: AgentConfig) -> Preview:
    """Return the predicted space, speed and time of the programme."""
    whole = programme(config)
    motions = [_flown(config.plant, config.rate_hz, part) for part in whole.parts]
    settings = config.excitation
    way_m = 0.0 if settings is None else hypot(*settings.offset_m)
    return Preview(
        whole.duration_s,
        max(motion.reach_m for motion in motions),
        max(motion.speed_m_s for motion in motions),
        max(motion.acceleration_m_s2 for motion in motions),
        way_m + sum(motion.distance_m for motion in motions),
    )


def approach_lead_m(config: AgentConfig, speed_max_m_s: float) -> float:
    """Return the lead of the setpoint on the flight to the box: a1/a0 times the speed."""
    axes = (config.plant.x, config.plant.y)
    return APPROACH_SHARE * speed_max_m_s * min(axis.a1_per_s / axis.a0_per_s2 for axis in axes)


def _approach_s(settings: ExcitationSettings) -> float:
    """Return the longest time for the flight to the middle of the box and coming to rest there."""
    return 1.5 * hypot(*settings.offset_m) / (APPROACH_SHARE * settings.speed_max_m_s) + 2.0 * settings.rest_s


def _signals(
    settings: ExcitationSettings, random: np.random.Generator
) -> Iterator[tuple[str, tuple[Signal, Signal], float]]:
    def steps() -> Steps:
        return _steps(settings, random)

    up = _sweep(settings, settings.sweep_from_hz, settings.sweep_to_hz)
    down = _sweep(settings, settings.sweep_to_hz, settings.sweep_from_hz)
    yield "steps along x", (steps(), None), settings.steps_s
    yield "steps along y", (None, steps()), settings.steps_s
    yield "steps along both", (steps(), steps()), settings.steps_s
    yield "sweep along x", (up, None), settings.sweep_s
    yield "sweep along y", (None, up), settings.sweep_s
    # One rises while the other falls, so that the axes are never excited by the same signal.
    yield "sweep along both", (up, down), settings.sweep_s


def _steps(settings: ExcitationSettings, random: np.random.Generator) -> Steps:
    highest = LEVELS // 2
    levels = [k / highest for k in range(-highest, highest + 1)]
    times_s, chosen, now_s, level = [], [], 0.0, 0.0
    while now_s < settings.steps_s:
        level = float(random.choice([each for each in levels if 0.0 < abs(each - level) <= STEP_LARGEST]))
        times_s.append(now_s)
        chosen.append(level)
        now_s += float(random.uniform(settings.level_shortest_s, settings.level_longest_s))
    return Steps(tuple(times_s), tuple(chosen))


def _sweep(settings: ExcitationSettings, from_hz: float, to_hz: float) -> Sweep:
    knee_hz = settings.speed_max_m_s / (2.0 * pi * settings.half_width_m)
    return Sweep(from_hz, to_hz, max(knee_hz, settings.sweep_from_hz), settings.sweep_s)


def _amplitude_m(
    config: AgentConfig, settings: ExcitationSettings, signals: tuple[Signal, Signal], seconds: float
) -> float:
    """Return the largest amplitude that stays within all limits, each peak being proportional to it."""
    unit = Part("", 0.0, seconds, signals, 1.0)
    known = _flown(config.plant, config.rate_hz, unit)
    doubted = [_flown(plant, config.rate_hz, unit) for plant in _uncertain_plants(config.plant, settings.plant_doubt)]
    acceleration_m_s2 = min(settings.acceleration_max_m_s2, config.safety.acceleration_max_m_s2)
    return min(
        BOX_RESERVE * settings.half_width_m,  # the setpoints stay inside as well
        BOX_RESERVE * settings.half_width_m / max(motion.reach_m for motion in doubted),
        settings.speed_max_m_s / max(motion.speed_m_s for motion in doubted),
        acceleration_m_s2 / known.acceleration_m_s2,
        LEAD_RESERVE * config.safety.setpoint_lead_max_m / known.lead_m,
    )


def _uncertain_plants(plant: Plant, doubt: float) -> Iterator[Plant]:
    """Return the plant, and those whose parameters are at the limits of their uncertainty."""
    for stiffer, damped in ((1.0, 1.0), *product((1.0 - doubt, 1.0 + doubt), repeat=2)):
        x, y = (PlantAxis(axis.a0_per_s2 * stiffer, axis.a1_per_s * damped) for axis in (plant.x, plant.y))
        yield replace(plant, x=x, y=y)


def _flown(plant: Plant, rate_hz: float, part: Part) -> MotionExtent:
    """Simulate a part and the return to the middle; without the plant's delay, which only shifts the motion in time."""
    seconds = part.end_s - part.begin_s
    times_s = [part.begin_s + k / rate_hz for k in range(round(seconds * rate_hz))]
    aims = [plant.aim_m(part.offset_m(time_s), part.velocity_m_s(time_s)) for time_s in times_s]
    aims += [np.zeros(2)] * round(seconds * rate_hz)
    step, still = exact_step(plant, 1.0 / rate_hz), np.zeros(2)
    states = [np.zeros(4)]
    for aim in aims:
        states.append(step.advance(states[-1], aim, still))
    path = np.array(states)
    lead = np.array(aims) - path[:-1, POSITION]
    push = plant.a0_per_s2 * lead - plant.a1_per_s * path[:-1, VELOCITY]
    return MotionExtent(
        float(np.abs(path[:, POSITION]).max()),
        _largest(path[:, VELOCITY]),
        _largest(push),
        _largest(lead),
        sum(hypot(*(after - before).tolist()) for before, after in pairwise(path[:, POSITION])),
    )


def _largest(vectors: Vector) -> float:
    return float(np.hypot(*vectors.T).max())


NEAR_M: Final = 1.0
NEAR_SHARE: Final = 0.25
"""A part begins only if the vehicle rests this near the middle of its box, in metres and in half-widths."""


class Exciter:
    """Plans one vehicle's identification flight; the programme runs on the mission's clock.

    A part begins only while the vehicle rests in the middle of the box. After a hold the vehicle returns there and
    flies the next part at its scheduled time.
    """

    def __init__(self, config: AgentConfig, settings: ExcitationSettings) -> None:
        """Make the programme; the box is relative to the vehicle's start, which must be known."""
        self._programme = programme(config)
        home_x, home_y = config.home_m or (0.0, 0.0)
        self._middle_m: Vector = np.array([home_x + settings.offset_m[0], home_y + settings.offset_m[1]])
        self._near_m = max(NEAR_M, NEAR_SHARE * settings.half_width_m)
        self._lead_m = approach_lead_m(config, settings.speed_max_m_s)
        self._plant = config.plant
        self._stiffness_per_s2 = config.plant.a0_per_s2
        self._against_wind_m: Vector = np.zeros(2)
        self._start_s = inf
        self._ready = False

    def start(self, at_s: float) -> None:
        """Begin the programme at `at_s`."""
        self._start_s = at_s

    def reset(self) -> None:
        """Restart from the vehicle's present position."""
        self._ready = False

    def plan(self, situation: Situation) -> Plan:
        """Return the aim of the present part, or rest in the middle of the box."""
        time_s = situation.now_s - self._start_s
        part = self._programme.part(time_s)
        if part is None:
            self._ready = hypot(*(situation.own.mean[POSITION] - self._middle_m).tolist()) < self._near_m
        if part is None or not self._ready:
            # The wind compensation is frozen during a part, so that only the programme moves the aim.
            self._against_wind_m = -situation.disturbance / self._stiffness_per_s2
            aim, velocity = towards(self._middle_m, situation.acting_motion[POSITION], self._lead_m), (0.0, 0.0)
        else:
            velocity = part.velocity_m_s(time_s)
            aim = self._middle_m + self._plant.aim_m(part.offset_m(time_s), velocity)
        return Plan(aim + self._against_wind_m, aim, np.zeros(2), velocity_m_s=velocity)
