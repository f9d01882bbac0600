"""What a core gives back from a tick: a setpoint, messages for the peers, and its status."""

from typing import Literal

import msgspec

from agents.control.encirclement import Approach
from agents.control.lmpc import QpStatus
from agents.control.ring import RingPlace
from agents.ports import Setpoint
from agents.safety.guard import Guarded
from agents.tactics import Tactic
from agents.team.messages import CommandAnswer, MemberState
from estimation.polar import Polar
from estimation.state import (
    MOTION,
    OwnEstimate,
    TargetEstimate,
    Vector,
)


class Outgoing(msgspec.Struct, frozen=True):
    """A message for the peers: its topic and its bytes."""

    topic: str
    payload: bytes


class Note(msgspec.Struct, frozen=True):
    """Something that people want to read about afterwards: when, of what kind, what happened, and by which numbers."""

    time_s: float
    kind: Literal["tactic", "command", "failsafe", "guard", "ring"]
    text: str
    because: str = ""


class CoreStatus(msgspec.Struct, frozen=True):
    """What a vehicle is doing and what it believes, for people, logs and metrics.

    `alert` is the failsafe that holds it, empty if none; `notes` are what has happened, `answers` what peers
    have answered operators, both since the last tick. `slowed` says what of the mission's ring is not flown, and why;
    `ring_rate_rad_s` is the angular rate of the one that is, 0 off the ring. `target_altitude_m` is what it believes of
    the target's altitude where it follows that, `turning_rad_s` the rate at which it takes itself to go around.
    """

    vehicle_id: int
    time_s: float
    tactic: Tactic
    mixing: float
    own_estimate: OwnEstimate | None
    target_estimate: TargetEstimate | None
    polar: Polar | None
    place: RingPlace | None
    approach: Approach | None
    qp: QpStatus | None
    peers: tuple[MemberState, ...]
    messages_dropped: int
    alert: str
    notes: tuple[Note, ...]
    guarded: Guarded | None
    answers: tuple[CommandAnswer, ...] = ()
    slowed: str = ""
    ring_rate_rad_s: float = 0.0
    target_altitude_m: float | None = None
    turning_rad_s: float = 0.0

    @property
    def motion(self) -> Vector | None:
        """What it believes of its own motion (4,) = [x y x' y']."""
        return None if self.own_estimate is None else self.own_estimate.mean[MOTION]

    @property
    def target(self) -> Vector | None:
        """What it believes of the target's motion (4,) = [x y x' y']."""
        return None if self.target_estimate is None else self.target_estimate.mean


class TickOutput(msgspec.Struct, frozen=True):
    """What one tick asks for: a setpoint (None before telemetry and when stood down), messages, and the status."""

    setpoint: Setpoint | None
    messages: tuple[Outgoing, ...]
    status: CoreStatus
