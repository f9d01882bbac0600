"""The planner of an identification flight: to the box, then part by part, with interruptions by a hold."""

from math import hypot, inf

import numpy as np

from agents.control.aims import towards
from agents.control.excitation import approach_lead_m, programme
from agents.control.plan import Plan
from agents.settings.config import AgentConfig
from agents.settings.sections import ExcitationSettings
from agents.situation.situation import Situation
from estimation.state import POSITION, Vector

NEAR_M = 1.0
NEAR_SHARE = 0.25
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
