"""Formation flight: LMPC on the error dynamics between a vehicle and its predecessor.

With E = p_i - p_{i-1} and both vehicles on the same plant, E responds to the difference of the two aims as the plant
responds to an aim. The leader's predecessor is the mission line: a virtual vehicle on it, at the mission's speed.
"""

from collections.abc import Collection
from functools import lru_cache

import msgspec
import numpy as np

from agents.control.lmpc import Bounds, Lmpc, QpStatus, StateBound
from agents.control.lmpc_cost import formation_programme
from agents.settings.config import AgentConfig
from estimation.plant.model import Plant
from estimation.state import POSITION, VELOCITY, Vector


class Predecessor(msgspec.Struct, frozen=True):
    """A predecessor's motion (4,) and undisturbed aim (2,) at the moment when the follower's setpoint acts."""

    motion: Vector
    aim_m: Vector


class FormationPlan(msgspec.Struct, frozen=True):
    """The aim (2,), the undisturbed aim (2,), which followers need, and the solver's status."""

    aim_m: Vector
    undisturbed_aim_m: Vector
    status: QpStatus


class FormationPlanner:
    """Plans one vehicle's flight relative to its predecessor; its only state is the last relative aim."""

    def __init__(self, config: AgentConfig) -> None:
        settings = config.formation
        self._a0_per_s2 = config.plant.a0_per_s2
        self._lead_max_m, self._speed_max_m_s = config.safety.setpoint_lead_max_m, settings.speed_max_m_s
        self._control_horizon = settings.control_horizon
        self._reference = np.zeros((settings.horizon, 4))
        self._relative_aim_m: Vector | None = None
        self._lmpc = Lmpc(formation_programme(config), settings.prediction_step_s)

    def reset(self) -> None:
        """Clear the last relative aim, when predecessor or tactic have changed."""
        self._relative_aim_m = None

    def plan(
        self,
        motion: Vector,
        disturbance_m_s2: Vector,
        predecessor: Predecessor,
        offset_m: tuple[float, float],
    ) -> FormationPlan:
        """Plan from the vehicle's motion (4,) so that it keeps `offset_m` from its predecessor."""
        separation = np.array(offset_m)
        if self._relative_aim_m is None:
            self._relative_aim_m = separation
        self._reference[:, POSITION] = separation
        bounds = self._bounds(motion, predecessor)
        plan = self._lmpc.solve(motion - predecessor.motion, self._reference, self._relative_aim_m, bounds)
        self._relative_aim_m = plan.first_input
        undisturbed = predecessor.aim_m + plan.first_input
        compensation = disturbance_m_s2 / self._a0_per_s2
        return FormationPlan(undisturbed - compensation, undisturbed, plan.status)

    def _bounds(self, motion: Vector, predecessor: Predecessor) -> Bounds:
        """Bound the aim's lead ahead of the vehicle, and the vehicle's speed."""
        leads_m = [
            (from_m - self._lead_max_m, from_m + self._lead_max_m)
            for from_m in (motion[POSITION] - predecessor.aim_m).tolist()
        ]
        speeds_m_s = [
            StateBound(-self._speed_max_m_s - its_m_s, self._speed_max_m_s - its_m_s)
            for its_m_s in predecessor.motion[VELOCITY].tolist()
        ]
        return Bounds(leads_m * self._control_horizon, speeds_m_s)


def mission_line(plant: Plant, start_m: tuple[float, float], speed_m_s: float, mission_time_s: float) -> Predecessor:
    """Return the leader's predecessor: a vehicle in steady flight along x, on the line from `start_m`.

    In steady flight the plant lags its aim by `a1 / a0` times the speed. The aim leads by as much, so that the ramp is
    followed without lag.
    """
    x_m, y_m = start_m[0] + speed_m_s * mission_time_s, start_m[1]
    lead_m = speed_m_s * plant.x.a1_per_s / plant.x.a0_per_s2
    return Predecessor(np.array((x_m, y_m, speed_m_s, 0.0)), np.array((x_m + lead_m, y_m)))


def leader_of(flying: Collection[int], slots: tuple[int, ...], appointed: int) -> int:
    """Return the leader: the appointed vehicle, or once it has left, the flying one in the slot nearest to its own."""
    place = slots.index(appointed)
    return min(flying, key=lambda member: (abs(slots.index(member) - place), slots.index(member)))


@lru_cache(maxsize=256)
def predecessor_of(vehicle_id: int, flying: frozenset[int], slots: tuple[int, ...], appointed: int) -> int | None:
    """Return the vehicle to keep station on: the next in line towards the leader; None for the leader."""
    line = [member for member in slots if member in flying]
    own, leader = line.index(vehicle_id), line.index(leader_of(flying, slots, appointed))
    if own == leader:
        return None
    return line[own - 1] if own > leader else line[own + 1]
