"""Stability of a configuration's control loops on its own plant, by their eigenvalues.

Near the reference no constraint is active: the LMPC is a linear feedback, and the delay is predicted exactly. This
leaves one sampled linear loop for each axis of the formation, for the radius and for the bearing, and one for each mode
of the references on an evenly spaced ring. In the k-th of n modes, neighbouring references deviate with a phase
difference of 2 pi k / n.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, inf, log, tau

import numpy as np

from agents.control.programme import formation_programme, ring_programme
from agents.ring.place import scaled_gain_per_s
from agents.settings.config import AgentConfig
from estimation.plant.model import PlantAxis, exact_step
from estimation.state import Vector

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
    for mode in range(1, members // 2 + 1):  # the other modes mirror these
        yield ClosedLoop("encirclement", f"mode {mode} of the spacing", _modulus(_spacing(config, members, mode)))


def _spacing(config: AgentConfig, members: int, mode: int) -> Vector:
    """Return the transition (2, 2) of a mode of the references; each uses the others' of the previous tick."""
    gain = 2.0 / 3.0 * scaled_gain_per_s(members, config.encirclement.spacing_gain_per_s) / config.rate_hz
    return np.array([[1.0 - gain, gain * cos(tau * mode / members)], [1.0, 0.0]])


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
