"""The output of a tick: a setpoint, messages for the peers, and the core's status."""

import msgspec

from agents.control.encirclement import Approach
from agents.control.lmpc import QpStatus
from agents.control.plan import Plan
from agents.drops import NO_DROPS, Drops
from agents.notes import Note
from agents.ports import Setpoint
from agents.ring.place import RingPlace
from agents.safety.guard import Guarded
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.codec import decode
from agents.team.messages import BusMessage, CommandAnswer, MemberState, Outlook
from estimation.polar import Polar
from estimation.state import MOTION, OwnEstimate, TargetEstimate, Vector


class Outgoing(msgspec.Struct, frozen=True):
    """A message for the peers: its topic and its bytes."""

    topic: str
    payload: bytes

    def received(self) -> BusMessage:
        """Return the message as its receivers decode it."""
        return decode(self.payload)


class CoreStatus(msgspec.Struct, frozen=True, kw_only=True):
    """The results of a tick's stages, for displays, logs and metrics.

    `situation`, `plan` and `guarded` are None before any telemetry; `plan` and `guarded` are as sent. `alert` is the
    failsafe condition that it reacts to, empty if none; `outlook` is None while nothing is due; `notes` are the events,
    `answers` the peers' answers to operators, both since the last tick. `target_altitude_m` is the estimate of the
    target's altitude if the mission follows it, `drops` are the messages dropped so far, `turning_rad_s` is the assumed
    frequency of the ring-frequency disturbance. `ring` is the number of the ring that it is on or flies to, and that
    its situation refers to, 0 in a mission of one ring. `added` is the vehicle that is not in the mission file and has
    joined, None without one.
    """

    vehicle_id: int
    time_s: float
    tactic: Tactic
    situation: Situation | None = None
    plan: Plan | None = None
    guarded: Guarded | None = None
    peers: tuple[MemberState, ...] = ()
    drops: Drops = NO_DROPS
    alert: str = ""
    outlook: Outlook | None = None
    notes: tuple[Note, ...] = ()
    answers: tuple[CommandAnswer, ...] = ()
    target_altitude_m: float | None = None
    turning_rad_s: float = 0.0
    ring: int = 0
    added: int | None = None

    @property
    def own_estimate(self) -> OwnEstimate | None:
        """The estimate of its own motion, None before any telemetry."""
        return None if self.situation is None else self.situation.own

    @property
    def target_estimate(self) -> TargetEstimate | None:
        """The estimate of the target, None without one."""
        return None if self.situation is None else self.situation.target

    @property
    def polar(self) -> Polar | None:
        """The present polar state about the ring's centre, None without a target."""
        return None if self.situation is None else self.situation.polar

    @property
    def motion(self) -> Vector | None:
        """The estimate of its own motion (4,) = [x y x' y']."""
        return None if self.situation is None else self.situation.own.mean[MOTION]

    @property
    def target(self) -> Vector | None:
        """The estimate of the target's motion (4,) = [x y x' y']."""
        target = self.target_estimate
        return None if target is None else target.mean

    @property
    def qp(self) -> QpStatus | None:
        """How the plan was found, None if nothing was solved for it."""
        return None if self.plan is None else self.plan.qp

    @property
    def place(self) -> RingPlace | None:
        """The place among the members of the ring, None off the ring."""
        return None if self.plan is None or self.plan.ring is None else self.plan.ring.place

    @property
    def approach(self) -> Approach | None:
        """The region relative to the ring, None off the ring."""
        return None if self.plan is None or self.plan.ring is None else self.plan.ring.approach

    @property
    def mixing(self) -> float:
        """The share of the encirclement in the aim."""
        return 0.0 if self.plan is None or self.plan.ring is None else self.plan.ring.mixing

    @property
    def slowed(self) -> str:
        """How the flown ring differs from the mission's, and why; empty if it does not."""
        return "" if self.plan is None or self.plan.ring is None else self.plan.ring.slowed

    @property
    def ring_rate_rad_s(self) -> float:
        """The angular rate at which the ring is flown, 0 off the ring."""
        return 0.0 if self.plan is None or self.plan.ring is None else self.plan.ring.rate_rad_s


class LandingCause(msgspec.Struct, frozen=True):
    """The cause of an early landing: a condition of the failsafe table, or an operator's command; the other is empty.

    `verb` is the command's, `origin` the operator, empty if unknown.
    """

    condition: str = ""
    verb: str = ""
    origin: str = ""

    @property
    def reason(self) -> str:
        """The condition, or the command and its origin, as text."""
        return self.condition or f"{self.verb} by {self.origin or 'the operator'}"


class TickOutput(msgspec.Struct, frozen=True):
    """The result of a tick: a setpoint (None before telemetry, and while a pilot flies), messages, and the status."""

    setpoint: Setpoint | None
    messages: tuple[Outgoing, ...]
    status: CoreStatus
