"""What a vehicle tells its peers, made from what it believes and does: ready to be sent."""

from agents.control.plan import Plan
from agents.orders import Reshaping
from agents.outputs import Outgoing
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.messages import (
    TOPICS,
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    PeerMessage,
    TargetPackage,
    encode,
)
from agents.team.ring_scale import RingScale
from estimation.polar import Polar
from estimation.state import MOTION, Sighting


def member_state(
    vehicle_id: int,
    tactic: Tactic,
    situation: Situation,
    plan: Plan,
    *,
    altitude_m: float,
    alert: str,
    reshaping: Reshaping | None,
) -> Outgoing:
    """Tell tactic, motion and the undisturbed setpoint, taken back from when it acts to the present."""
    x, y, x_rate, y_rate = situation.own.mean[MOTION].tolist()
    setpoint_x, setpoint_y = plan.undisturbed_m.tolist()
    rate_x, rate_y = plan.rate_m_s.tolist()
    ahead_s = situation.acting_s - situation.now_s
    return _outgoing(
        MemberState(
            vehicle_id,
            situation.now_s,
            tactic.value,
            (x, y),
            (x_rate, y_rate),
            (setpoint_x - rate_x * ahead_s, setpoint_y - rate_y * ahead_s),
            (rate_x, rate_y),
            altitude_m,
            situation.position_sigma_m,
            alert,
            *((None, 0.0) if reshaping is None else (reshaping.shape, reshaping.told_s)),
        )
    )


def neighbour_angle(vehicle_id: int, now_s: float, polar: Polar, needed: RingScale) -> Outgoing:
    """Tell the place on the ring, and what of the ring this vehicle can fly."""
    return _outgoing(
        NeighbourAngle(
            vehicle_id,
            now_s,
            polar.bearing_rad,
            polar.angular_rate_rad_s,
            polar.radius_m,
            needed.rate,
            needed.radius,
        )
    )


def target_package(vehicle_id: int, sighting: Sighting, recipients: tuple[int, ...]) -> Outgoing:
    """Tell a raw sighting to the peers within reach."""
    return _outgoing(
        TargetPackage(
            vehicle_id,
            sighting.time_s,
            sighting.position_m,
            sighting.covariance_m2,
            sighting.importance,
            sighting.threat,
            recipients,
            sighting.altitude_m,
            sighting.altitude_sigma_m,
        )
    )


def sighting_told(package: TargetPackage) -> Sighting:
    """Return the sighting that a peer has told; raises ValueError for one that none can be."""
    return Sighting(
        package.time_s,
        package.sender,
        package.position_m,
        package.covariance_m2,
        package.importance,
        package.threat,
        package.altitude_m,
        package.altitude_sigma_m,
    )


def command_answer(answer: CommandAnswer) -> Outgoing:
    """Tell operators what was made of a command."""
    return _outgoing(answer)


def _outgoing(message: PeerMessage) -> Outgoing:
    return Outgoing(TOPICS[type(message)].name, encode(message))
