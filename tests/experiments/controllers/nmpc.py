"""Decentralised nonlinear MPC for the encirclement of a target, as a planner in place of cordon's own.

The formulation is that of the paper's references (Marasco et al. 2012, 2013), as the paper describes it: each vehicle
weights radius, angular rate and spacing over a horizon of the nonlinear polar model, with bounded inputs, and predicts
its neighbours at the ring's rate. Weights, horizon, bounds and estimates are those of cordon's planner.
"""

from math import atan2

import numpy as np

from agents.control.linearization import aim_for_acceleration
from agents.control.lmpc import QpStatus
from agents.control.plan import Plan
from agents.ring.place import RingPlace, ring_place
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.situation.task import Task
from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.polar import Polar, motion_from_polar, polar_from_motion
from estimation.state import VELOCITY, Vector
from tests.experiments.controllers.ring_programme import Neighbours, RingProgramme


class Nmpc:
    """Plans one vehicle's flight about the target, from wherever it is; formation and homing are cordon's."""

    def __init__(self, config: AgentConfig) -> None:
        self._plant, self._settings = config.plant, config.encirclement
        self._programme = RingProgramme(config.encirclement, config.clearance_rad)
        self._before_m_s2 = (0.0, 0.0)

    def plan(self, task: Task) -> Plan | None:
        """See `TaskPlanner`. If IPOPT finds no optimum, the vehicle continues with the previous accelerations."""
        situation, centre = task.situation, task.situation.acting_centre
        if task.tactic is not Tactic.ENCIRCLE or centre is None:
            self._begin_anew()
            return None
        motion = _damped(situation, centre, self._settings.radius_m, self._settings.angular_rate_rad_s)
        polar = polar_from_motion(motion, centre)
        if polar.radius_m < self._settings.radius_min_m:  # the polar model is singular at the target
            self._begin_anew()
            return None
        place = ring_place(polar.bearing_rad, _bearings_rad(task.peers, situation.acting_s, centre))
        optimum = self._programme.solve(polar, _neighbours(place), self._before_m_s2)
        if optimum.solved:
            outward, across = optimum.inputs_m_s2[0].tolist()
            self._before_m_s2 = outward, across
        wanted = _turned(polar.bearing_rad, *self._before_m_s2)
        aim_m = aim_for_acceleration(motion, wanted, situation.compensation, self._plant)
        status = QpStatus.BOUNDED if optimum.solved else QpStatus.FALLBACK
        return Plan(aim_m, aim_m, situation.acting_motion[VELOCITY], status)

    def _begin_anew(self) -> None:
        self._programme.reset()
        self._before_m_s2 = (0.0, 0.0)


def _damped(situation: Situation, centre: Vector, radius_m: float, rate_rad_s: float) -> Vector:
    """Return the motion (4,) to plan from, with the share `authority` of its deviation.

    The deviation is that from the ring at the vehicle's bearing.
    """
    motion = situation.acting_motion
    if situation.authority == 1.0:
        return motion
    on_ring = motion_from_polar(Polar(radius_m, polar_from_motion(motion, centre).bearing_rad, 0.0, rate_rad_s), centre)
    return np.asarray(on_ring + situation.authority * (motion - on_ring), dtype=np.float64)


def _bearings_rad(peers: tuple[MemberState, ...], at_s: float, centre: Vector) -> list[float]:
    """Return the bearings about the centre's motion (4,) of the peers that encircle it, extrapolated to a time."""
    x, y, *_ = centre.tolist()
    bearings = []
    for peer in peers:
        if peer.tactic == Tactic.ENCIRCLE.value:
            (peer_x, peer_y), (x_rate, y_rate), since_s = peer.position_m, peer.velocity_m_s, at_s - peer.time_s
            bearings.append(atan2(peer_y + y_rate * since_s - y, peer_x + x_rate * since_s - x))
    return bearings


def _neighbours(place: RingPlace) -> Neighbours | None:
    if place.lead_rad is None or place.lag_rad is None:
        return None
    return Neighbours(place.lead_rad, place.lag_rad, place.desired_rad)


def _turned(bearing_rad: float, outward: float, across: float) -> tuple[float, float]:
    """Return a vector along and across the radius at a bearing as one along x and y."""
    cosine, sine = np.cos(bearing_rad), np.sin(bearing_rad)
    return float(outward * cosine - across * sine), float(outward * sine + across * cosine)
