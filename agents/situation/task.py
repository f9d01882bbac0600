"""The task of a tick, decided from the estimated situation."""

import msgspec

from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.messages import MemberState


class Task(msgspec.Struct, frozen=True):
    """The decision of a tick: the tactic to fly in a situation, and the altitude layer.

    `layer_m` is that of the vehicle, in metres above the mission's origin; a planner plans x and y alone. `peers` are
    the newest states of the others, each at its own time: those of distant peers are up to a second old.
    """

    tactic: Tactic
    situation: Situation
    layer_m: float
    peers: tuple[MemberState, ...]
