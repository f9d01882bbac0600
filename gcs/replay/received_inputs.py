"""What a vehicle's agent had received about its neighbours and its own state at a tick, from its log."""

from math import hypot, inf
from typing import NamedTuple

from agents.inputs import LateTicks, Message, Start, TimeScale
from agents.tactics import Tactic
from agents.team.messages import MemberState
from estimation.state import Telemetry
from gcs.flightlog.records import Decision
from gcs.replay.playback import Turn


class Neighbour(NamedTuple):
    """A peer and its distance, extrapolated with the velocity that the peer reported."""

    vehicle_id: int
    distance_m: float


class ReceivedInputs:
    """Accumulates a vehicle's inputs turn by turn."""

    def __init__(self) -> None:
        self.start_s: float | None = None
        self.time_scale = 1.0
        self.height_m = 0.0
        self.late_ticks = 0
        self.last: Decision | None = None
        self.members: dict[int, MemberState] = {}

    def take(self, turn: Turn) -> None:
        """Add the next turn."""
        for item in turn.inputs:
            match item:
                case Start():
                    self.start_s = item.at_s
                case TimeScale():
                    self.time_scale = item.factor
                case LateTicks():
                    self.late_ticks = item.count
                case Telemetry():
                    self.height_m = item.position_m[2]
                case Message(message=MemberState() as state):
                    self.members[state.sender] = state
        if self.last is not None and self.last.tactic == Tactic.LAND.value:
            self.late_ticks = 0  # ticks during a landing have no fixed rate: late ones are not counted
        self.last = turn.decision or self.last

    def nearest(self, decision: Decision) -> Neighbour | None:
        """Return the nearest member among the peers of a decision, None without peers or without an own estimate."""
        if decision.own is None:
            return None
        x, y = decision.own.mean[:2]
        nearest = None
        for member in (self.members[peer] for peer in decision.peers if peer in self.members):
            age_s = decision.time_s - member.time_s
            away_x, away_y = (
                there + rate * age_s - here
                for there, rate, here in zip(member.position_m, member.velocity_m_s, (x, y), strict=True)
            )
            distance_m = hypot(away_x, away_y, member.altitude_m - self.height_m)
            if distance_m < (nearest.distance_m if nearest else inf):
                nearest = Neighbour(member.sender, distance_m)
        return nearest
