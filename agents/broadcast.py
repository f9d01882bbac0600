"""The messages that a vehicle sends to its peers, made from its estimates and its plan."""

from collections.abc import Sequence

import msgspec

from agents.command_handler import Reshaping
from agents.control.plan import Plan, RingReport
from agents.drops import Drops
from agents.outputs import Outgoing
from agents.ring.chooser import RingChooser
from agents.safety.traffic import KnownTraffic
from agents.settings.config import AgentConfig
from agents.situation.own_sensor import OwnSensors
from agents.situation.situation import Situation
from agents.situation.task import Task
from agents.team.codec import encode
from agents.team.messages import (
    TOPICS,
    CommandAnswer,
    CommandedRing,
    Goal,
    MemberState,
    NeighbourAngle,
    RingChoice,
    TargetPackage,
)
from agents.team.send_rate import SendRate
from agents.team.team import Team
from estimation.polar import Polar
from estimation.state import MOTION, POSITION, Sighting
from estimation.vectors import wrap_signed_rad


class StateBroadcast:
    """Makes one vehicle's state messages and decides when they are sent.

    `often` is set while another vehicle is, or soon comes, close enough to need states at the full rate.
    `commanded_rings` are the rings that operators commanded, by their numbers, empty if they did not, `ring` is the
    number of the vehicle's own, None for none, `goal` the place that it is on its way to, and `goal_s` when it was
    sent there.
    """

    def __init__(
        self,
        config: AgentConfig,
        team: Team,
        own_sensors: OwnSensors,
        chooser: RingChooser | None,
        traffic: KnownTraffic,
    ) -> None:
        """Take the chooser of the ring in a mission of several, whose bids are sent with the states, and the traffic
        that the own autopilot receives, which is sent as well.
        """
        self._vehicle_id = config.vehicle_id
        self._communication_radius_m = config.communication_radius_m
        self._targets = {name: number for number, name in enumerate(config.targets)}
        self._team, self._own_sensors, self._chooser, self._traffic = team, own_sensors, chooser, traffic
        self._rate = SendRate(config.rate_hz)
        self._revision = 0
        self.often = True
        self.ring: int | None = None
        self.commanded_rings: tuple[CommandedRing, ...] = ()
        self.goal: Goal | None = None
        self.goal_s: float | None = None

    def messages(
        self, task: Task, sent: Plan, alert: str, reshaping: Reshaping | None, drops: Drops
    ) -> tuple[Outgoing, ...]:
        """Return the messages that are due: the state, with the place on the ring and a sighting of the own sensor."""
        situation, ring = task.situation, sent.ring
        if not self._rate.may(situation.now_s):
            return ()
        angle = None
        if ring is not None and ring.joined and situation.polar is not None:
            references = self._team.ring.references(self._vehicle_id)
            angle = neighbour_angle(self._vehicle_id, situation, situation.polar, ring, references)
        state = self._state(task, sent, alert, reshaping, drops, angle)
        # While it approaches its place on the ring, the others make room from its published states.
        joins = ring is not None and (ring.mixing < 1.0 or not ring.joined)
        chooser = self._chooser
        bids_anew = chooser is not None and chooser.revision != self._revision
        if not self._rate.due(state, often=self.often or joins or bids_anew):
            return ()
        if chooser is not None and state.choice is not None:
            self._revision = chooser.revision
            choice = msgspec.structs.replace(state.choice, bids=chooser.payload(state.time_s))
            state = msgspec.structs.replace(state, choice=choice)
        if traffic := self._traffic.shared(state.time_s):
            state = msgspec.structs.replace(state, traffic=traffic)
        return (Outgoing(TOPICS[MemberState].name, encode(state)),)

    def _state(
        self,
        task: Task,
        sent: Plan,
        alert: str,
        reshaping: Reshaping | None,
        drops: Drops,
        angle: NeighbourAngle | None,
    ) -> MemberState:
        """Return the state now: tactic, motion, and the undisturbed aim, moved from its acting time back to now."""
        situation = task.situation
        x, y, x_rate, y_rate = situation.own.mean[MOTION].tolist()
        aim_x, aim_y = sent.undisturbed_aim_m.tolist()
        rate_x, rate_y = sent.aim_rate_m_s.tolist()
        ahead_s = situation.acting_s - situation.now_s
        return MemberState(
            self._vehicle_id,
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
            self._sightings(situation),
            self.commanded_rings[0] if self._chooser is None and self.commanded_rings else None,
            None if self._chooser is None else RingChoice(self.ring, commanded=self.commanded_rings),
            goal=self.goal,
            goal_s=self.goal_s,
        )

    def _sightings(self, situation: Situation) -> tuple[TargetPackage, ...]:
        sightings = self._own_sensors.due(situation.now_s)
        if not sightings:
            return ()
        recipients = self._team.within(situation.own.mean[POSITION], self._communication_radius_m)
        return tuple(
            [
                target_package(self._vehicle_id, each, recipients, self._targets.get(each.target or ""))
                for each in sightings
            ]
        )


def neighbour_angle(
    vehicle_id: int, situation: Situation, polar: Polar, ring: RingReport, references: int
) -> NeighbourAngle:
    """Return where the vehicle is about the target, its place on the ring, and the ring that it can fly.

    Its rate is that of its reference, which has no noise, or the measured one. `references` is the digest of those that
    its law takes into account.
    """
    reference, needed, now_s = ring.reference, ring.needed, situation.now_s
    return NeighbourAngle(
        vehicle_id,
        now_s,
        polar.bearing_rad,
        polar.angular_rate_rad_s if reference is None else reference.bearing.rate,
        polar.radius_m,
        needed.rate,
        needed.radius,
        None if reference is None else wrap_signed_rad(reference.place_rad(now_s)),
        0.0 if reference is None else reference.place.rate,
        0 if reference is None else references,
    )


def target_package(
    vehicle_id: int, sighting: Sighting, recipients: tuple[int, ...], target: int | None = None
) -> TargetPackage:
    """Return a raw sighting, of the target of this number, as a message to the peers within communication radius."""
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
        target,
    )


def received_sighting(package: TargetPackage, targets: Sequence[str] = ()) -> Sighting:
    """Return the sighting in a peer's package, of one of the mission's targets if it has several.

    Raises ValueError if its numbers are invalid, also that of the target.
    """
    if package.target is not None and package.target >= len(targets):
        raise ValueError(f"a sighting of target {package.target} among {len(targets)}")
    sighting = package.sighting
    if package.target is None:
        return sighting
    return msgspec.structs.replace(sighting, target=targets[package.target])


def command_answer(answer: CommandAnswer) -> Outgoing:
    """Return the message that answers an operator's command."""
    return Outgoing(TOPICS[CommandAnswer].name, encode(answer))
