"""What a vehicle sends to its peers, made from its estimates and its plan."""

from agents.control.plan import Plan, RingReport
from agents.drops import Drops
from agents.orders import Reshaping
from agents.outputs import Outgoing
from agents.situation.situation import Situation, Task
from agents.team.codec import encode
from agents.team.messages import TOPICS, CommandAnswer, MemberState, NeighbourAngle, PeerMessage, TargetPackage
from estimation.frames import wrap_signed_rad
from estimation.polar import Polar
from estimation.state import MOTION, Sighting


def member_state(
    vehicle_id: int,
    task: Task,
    sent: Plan,
    alert: str,
    reshaping: Reshaping | None,
    drops: Drops,
    angle: NeighbourAngle | None,
    sightings: tuple[TargetPackage, ...],
) -> Outgoing:
    """Publish tactic, motion and the undisturbed aim, taken back from when it acts to the present, and its parts."""
    situation = task.situation
    x, y, x_rate, y_rate = situation.own.mean[MOTION].tolist()
    aim_x, aim_y = sent.undisturbed_aim_m.tolist()
    rate_x, rate_y = sent.aim_rate_m_s.tolist()
    ahead_s = situation.acting_s - situation.now_s
    return _outgoing(
        MemberState(
            vehicle_id,
            situation.now_s,
            task.tactic.value,
            (x, y),
            (x_rate, y_rate),
            (aim_x - rate_x * ahead_s, aim_y - rate_y * ahead_s),
            (rate_x, rate_y),
            situation.height_m,
            situation.position_sigma_m,
            alert,
            None if reshaping is None else reshaping.shape,
            0.0 if reshaping is None else reshaping.time_s,
            drops,
            angle,
            sightings,
        )
    )


def neighbour_angle(vehicle_id: int, situation: Situation, polar: Polar, ring: RingReport) -> NeighbourAngle:
    """Return the place on the ring, the reference's as well, and what of the ring this vehicle can fly."""
    reference, needed, now_s = ring.reference, ring.needed, situation.now_s
    ahead_s = situation.acting_s - now_s
    return NeighbourAngle(
        vehicle_id,
        now_s,
        polar.bearing_rad,
        polar.angular_rate_rad_s,
        polar.radius_m,
        needed.rate,
        needed.radius,
        None if reference is None else wrap_signed_rad(reference.value - reference.rate * ahead_s),
        0.0 if reference is None else reference.rate,
    )


def target_package(vehicle_id: int, sighting: Sighting, recipients: tuple[int, ...]) -> TargetPackage:
    """Return a raw sighting as the peers within reach receive it."""
    return TargetPackage(
        vehicle_id,
        sighting.time_s,
        sighting.position_m,
        sighting.covariance_m2,
        sighting.importance,
        sighting.threat,
        recipients,
        sighting.altitude_m,
        sighting.altitude_sigma_m,
        sighting.frame_sigma_m,
        sighting.frame_correlation_s,
    )


def received_sighting(package: TargetPackage) -> Sighting:
    """Return the sighting in a peer's package; raises ValueError where its numbers cannot be one."""
    return Sighting(
        package.time_s,
        package.sender,
        package.position_m,
        package.covariance_m2,
        package.importance,
        package.threat,
        package.altitude_m,
        package.altitude_sigma_m,
        package.frame_sigma_m,
        package.frame_correlation_s,
    )


def command_answer(answer: CommandAnswer) -> Outgoing:
    """Publish what became of an operator's command."""
    return _outgoing(answer)


def _outgoing(message: PeerMessage) -> Outgoing:
    return Outgoing(TOPICS[type(message)].name, encode(message))
