"""The plan of one tick: the aim of a tactic, and the state of its ring."""

import msgspec

from agents.control.encirclement import Approach
from agents.control.lmpc import QpStatus
from agents.ring.place import RingPlace
from agents.ring.shaped_coordinate import ShapedCoordinate
from agents.team.ring_scale import RingScale
from estimation.state import Vector
from estimation.vectors import Pair


class RingReport(msgspec.Struct, frozen=True):
    """The state of its ring that a vehicle in the tactic encircle puts into its status and sends to its peers.

    `mixing` is the share of the encirclement in the aim, `rate_rad_s` the angular rate at which the ring is flown.
    `slowed` states how the flown ring differs from the mission's and why, `news` any change of that, else None.
    `needed` is the ring that this vehicle can fly, `joined` whether it is a member of the ring; `place` and `approach`
    are None while it waits for a gap or has no target.
    """

    mixing: float
    rate_rad_s: float
    slowed: str
    needed: RingScale
    joined: bool
    place: RingPlace | None = None
    approach: Approach | None = None
    news: str | None = None
    reference: ShapedCoordinate | None = None


class Plan(msgspec.Struct, frozen=True):
    """The result of the planner: the aim (2,), the undisturbed aim (2,), its rate (2,), and how it was found.

    The aim is the input of the plant. The last stage makes it the setpoint: the same position, unless a velocity is fed
    forward with it. `velocity_m_s` is the velocity to feed forward; with None it follows from the aim. `ring` is None
    except in the tactic encircle.
    """

    aim_m: Vector
    undisturbed_aim_m: Vector
    aim_rate_m_s: Vector
    qp: QpStatus | None = None
    velocity_m_s: Pair | None = None
    ring: RingReport | None = None
