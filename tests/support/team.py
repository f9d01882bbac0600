"""A vehicle's peers, with the limits of a mission's defaults."""

from agents.safety.failsafe import POSITION_ALERTS
from agents.settings.sections import FailsafeSettings, SafetySettings
from agents.team.clock_watch import ClockWatch
from agents.team.consistency_check import ConsistencyCheck, Limits
from agents.team.team import Team


def a_team() -> Team:
    return Team(ConsistencyCheck(Limits(SafetySettings(), FailsafeSettings().doubt_m), ClockWatch(), POSITION_ALERTS))
