"""Stability of a configuration's control loops on its own plant, by their eigenvalues.

Near the reference no constraint is active: the LMPC is a linear feedback, and the delay is predicted exactly. This
leaves one sampled linear loop for each axis of the formation, for the radius and for the bearing, and one for the
references on the ring, whose deviations from their places all follow the same law.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor, inf, log

import numpy as np

from agents.control.lmpc_cost import formation_programme, ring_programme
from agents.ring.transition import transition_of
from agents.settings.config import AgentConfig
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import Vector
from gcs.errors import KeyFault
from gcs.mission.mission import LinkSection, Mission, MissionSection

_BEFORE = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """A closed loop: the section of its gains, its name, and the largest modulus of its eigenvalues.

    A vehicle follows its reference around the ring by those that are `of_bearing`.
    """

    section: str
    name: str
    modulus: float
    of_bearing: bool = False

    def decay_per_s(self, rate_hz: float) -> float:
        """Return the slowest decay rate of a deviation [1/s]."""
        return -rate_hz * log(self.modulus) if self.modulus > 0.0 else inf

    @property
    def margin(self) -> float:
        """The distance of all eigenvalues from the unit circle; negative if the loop is unstable."""
        return 1.0 - self.modulus


def loops(config: AgentConfig) -> Iterator[ClosedLoop]:
    """Yield every loop of a vehicle, for the whole team in formation and on the ring."""
    settings, members = config.encirclement, len(config.slots)
    relative = formation_programme(config).gains
    polar = ring_programme(settings).gains
    for index, axis in enumerate((config.plant.x, config.plant.y)):
        motion = _Sampled(config, axis, index)
        own = [index, index + 2]
        place = motion.loop(relative.state[index, own], relative.previous[index, index])
        yield ClosedLoop("formation", f"keeping its place along {'xy'[index]}", _modulus(place))
        radius = motion.linearised(polar.state[0, [0, 2]], polar.previous[0, 0])
        yield ClosedLoop("encirclement", f"keeping the radius along {'xy'[index]}", _modulus(radius))
        bearing = motion.linearised(polar.state[1, [1, 3]], polar.previous[1, 1])
        yield ClosedLoop("encirclement", f"keeping the bearing along {'xy'[index]}", _modulus(bearing), of_bearing=True)
    if members > 1:
        yield ClosedLoop("encirclement", "the spacing", _modulus(_spacing(config, members)))


def _spacing(config: AgentConfig, members: int) -> Vector:
    """Return the transition (2, 2) of a reference's deviation; it uses the others' of the previous tick.

    The deviations of all sum to zero: those of the others are its own with the opposite sign.
    """
    gain = config.encirclement.spacing_gain_per_s / config.rate_hz
    return np.array([[1.0 - gain * (1.0 - 1.0 / members), -gain / members], [1.0, 0.0]])


def _modulus(transition: Vector) -> float:
    """Return the largest modulus of the eigenvalues."""
    return float(np.abs(np.linalg.eigvals(transition)).max())


class _Sampled:
    """One axis of the plant between two ticks, sampled as the controller does: halfway through a setpoint's hold."""

    def __init__(self, config: AgentConfig, axis: PlantAxis, index: int) -> None:
        period_s = 1.0 / config.rate_hz
        own = [index, index + 2]
        whole, half = exact_step(config.plant, period_s), exact_step(config.plant, period_s / 2.0)
        self._axis = axis
        # State [e e' X_before]; halfway, the next setpoint is assumed to move on as the vehicle does.
        self._next = np.hstack([whole.transition[np.ix_(own, own)], np.zeros((2, 1))])
        self._push = whole.input_gain[own, index]
        push = half.input_gain[own, index]
        self._middle = np.hstack([half.transition[np.ix_(own, own)], push[:, None]])
        self._middle = self._middle + np.outer(push * period_s, self._middle[1])

    def loop(self, by_motion: Vector, by_previous: float) -> Vector:
        """Return the transition (3, 3) if the feedback's output is the setpoint."""
        setpoint = by_motion @ self._middle + by_previous * _BEFORE
        return np.vstack([self._next + np.outer(self._push, setpoint), setpoint])

    def linearised(self, by_motion: Vector, by_previous: float) -> Vector:
        """Return the transition (4, 4) if the feedback's output is an acceleration that the plant is inverted for."""
        position, velocity = self._middle
        wanted = np.append(by_motion @ self._middle, by_previous)
        lead = np.append(self._axis.a1_per_s * velocity, 0.0) + wanted
        setpoint = np.append(position, 0.0) + lead / self._axis.a0_per_s2
        moved = np.hstack([self._next, np.zeros((2, 1))]) + np.outer(self._push, setpoint)
        return np.vstack([moved, setpoint, wanted])


_GAIN = "tuning.encirclement.spacing_gain_per_s"
_NEUTRAL = 1e-6
"""A marginally stable loop is accepted: a spacing gain of 0 is allowed."""
_ADVICE = {
    "formation": "raise increment_weight or lower position_weight of [tuning.formation], or raise mission.rate_hz",
    "encirclement": "weights, gains and prediction_step_s of [tuning.encirclement] and mission.rate_hz depend on each "
    "other: start from their defaults",
}


def unstable_loops(mission: Mission) -> Iterator[KeyFault]:
    """Return the worst unstable loop of each section on every plant of the mission, with its margin.

    If all are stable: a spacing gain that vehicles cannot follow, or else one with which spacings overshoot.
    """
    checked: set[Plant] = set()
    found: list[KeyFault] = []
    for index, vehicle in enumerate(mission.vehicles):
        if vehicle.plant in checked:
            continue
        checked.add(vehicle.plant)
        every = list(loops(mission.agent_config(vehicle)))
        unstable = list(_unstable(every, index))
        found += unstable or _not_followed(every, index, mission)
    yield from found
    if not any(fault.place == _GAIN for fault in found):
        yield from _overshoots(mission)


def _unstable(every: Sequence[ClosedLoop], index: int) -> Iterator[KeyFault]:
    for section, advice in _ADVICE.items():
        worst = min((loop for loop in every if loop.section == section), key=lambda loop: loop.margin)
        if worst.margin < -_NEUTRAL:
            yield KeyFault(
                section,
                f"{worst.name} is unstable with the plant of vehicles[{index}]: its largest eigenvalue "
                f"has modulus {worst.modulus:.3f}, a margin of {worst.margin:+.3f} to 1; {advice}",
            )


def _not_followed(every: Sequence[ClosedLoop], index: int, mission: Mission) -> Iterator[KeyFault]:
    gain_per_s, ring = mission.encirclement.spacing_gain_per_s, transition_of(mission.encirclement)
    followed_per_s = min(loop.decay_per_s(mission.mission.rate_hz) for loop in every if loop.of_bearing)
    if len(mission.vehicles) > 1 and min(gain_per_s, ring.damped_gain_per_s) > followed_per_s > _NEUTRAL:
        yield KeyFault(
            _GAIN,
            f"{gain_per_s} 1/s is faster than vehicles[{index}] follows its "
            f"reference with this plant; at most {floor(followed_per_s * 100.0) / 100.0} 1/s",
        )


def _overshoots(mission: Mission) -> Iterator[KeyFault]:
    gain_per_s = mission.encirclement.spacing_gain_per_s
    damped_per_s = transition_of(mission.encirclement).damped_gain_per_s
    if len(mission.vehicles) > 1 and gain_per_s > damped_per_s:
        yield KeyFault(
            _GAIN,
            f"with {gain_per_s} 1/s spacings overshoot: places on the ring are changed with a jerk that is too small "
            f"for it; at most {floor(damped_per_s * 100.0) / 100.0} 1/s",
        )


def kept_up(mission: MissionSection | None, link: LinkSection | None) -> Iterator[KeyFault]:
    """Check that the link's setpoint rate does not exceed the rate of the control loop."""
    if mission is None or link is None:
        return
    if link.setpoint_rate_hz is not None and link.setpoint_rate_hz > mission.rate_hz:
        yield KeyFault(
            "link.setpoint_rate_hz",
            f"{link.setpoint_rate_hz} Hz is more than mission.rate_hz = {mission.rate_hz} Hz: "
            "the loop computes no more setpoints; leave this key out to send all of them",
        )
