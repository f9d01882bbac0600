"""`VehicleCore`: what it decides and asks for, whatever it is told."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from math import cos, hypot, pi, sin, tau

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.control.plan import PlannerFactory
from agents.core import VehicleCore
from agents.drops import Drops
from agents.inputs import Message, Presence, Start, TacticEvent
from agents.outputs import TickOutput
from agents.ring.joining import WAITING
from agents.settings.config import AgentConfig
from agents.settings.sections import ChoreographySettings
from agents.tactics import Event, Tactic
from agents.team.codec import decode, encode
from agents.team.messages import (
    TOPICS,
    BusMessage,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    TargetPackage,
)
from estimation.plant.model import Plant, exact_step
from estimation.state import Sighting, Telemetry, Vector
from tests.conftest import CONFIG

Maker = Callable[..., AgentConfig]

PERIOD_S = 0.1
STILL = np.zeros(2)


def telemetry(time_s: float, motion: Sequence[float] = (0.0, 0.0, 0.0, 0.0)) -> Telemetry:
    x, y, x_rate, y_rate = motion
    return Telemetry(time_s, (x, y, 8.0), (x_rate, y_rate, 0.0))


def sighting(time_s: float, x: float = 5.0, y: float = 0.0, importance: float = 0.8, threat: float = 0.2) -> Sighting:
    return Sighting(time_s, 2, (x, y), (0.01, 0.0, 0.01), importance, threat)


def member(sender: int, time_s: float, x: float, y: float, tactic: str = "formation") -> MemberState:
    return MemberState(sender, time_s, tactic, (x, y), (0.2, 0.0), (x + 0.2175, y), (0.2, 0.0))


def seeing(
    time_s: float,
    importance: float = 0.8,
    recipients: tuple[int, ...] = (2,),
    covariance_m2: tuple[float, float, float] = (0.01, 0.0, 0.01),
) -> MemberState:
    """A peer's state with a sighting."""
    seen = TargetPackage(1, time_s, (5.0, 0.0), covariance_m2, importance, 0.2, recipients)
    return msgspec.structs.replace(member(1, time_s, 0.0, 4.0), sightings=(seen,))


def on_ring(
    sender: int, time_s: float, target_m: tuple[float, float], bearing: float, rate: float, *, radius_m: float = 10.0
) -> MemberState:
    """The state of a peer on a ring."""
    bearing %= tau
    x, y = target_m[0] + radius_m * cos(bearing), target_m[1] + radius_m * sin(bearing)
    angle = NeighbourAngle(sender, time_s, bearing, rate, radius_m, reference_rad=bearing, reference_rate_rad_s=rate)
    return msgspec.structs.replace(member(sender, time_s, x, y, "encircle"), angle=angle)


def setpoint_of(output: TickOutput) -> tuple[float, float]:
    assert output.setpoint is not None
    assert output.setpoint.position_m[2] == 8.0
    return output.setpoint.position_m[:2]


def sent_by(output: TickOutput) -> list[BusMessage]:
    messages = [decode(outgoing.payload) for outgoing in output.messages]
    assert [outgoing.topic for outgoing in output.messages] == [TOPICS[type(message)].name for message in messages]
    return messages


def states_of(output: TickOutput) -> list[MemberState]:
    return [message for message in sent_by(output) if isinstance(message, MemberState)]


class Pilot:
    """Flies a core on its own plant or another one, in the wind if told so, tick by tick."""

    def __init__(
        self,
        config: AgentConfig,
        start_s: float = 0.0,
        motion: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        planner: PlannerFactory | None = None,
        plant: Plant | None = None,
    ) -> None:
        self.core = VehicleCore(config, planner)
        self.core.take(Start(start_s))
        self.plant: Plant = plant or config.plant
        self.motion: Vector = np.array(motion, dtype=np.float64)
        self.ticks = 0

    @property
    def now_s(self) -> float:
        return self.ticks * PERIOD_S

    def fly(self, until_s: float, wind: Vector = STILL) -> list[TickOutput]:
        outputs = []
        while self.now_s < until_s - 1e-9:
            self.core.take(telemetry(self.now_s, self.motion.tolist()))
            outputs.append(self.core.tick(self.now_s))
            self.motion = exact_step(self.plant, PERIOD_S).advance(
                self.motion, np.array(setpoint_of(outputs[-1])), wind
            )
            self.ticks += 1
        return outputs


def test_standby_holds_the_place_where_it_began_until_the_start(make_config: Maker) -> None:
    pilot = Pilot(make_config(), start_s=2.0, motion=(3.0, 4.0, 0.5, 0.0))
    waiting = pilot.fly(1.95)
    assert {setpoint_of(output) for output in waiting} == {(3.0, 4.0)}
    assert {output.status.tactic for output in waiting} == {Tactic.STANDBY}
    assert pilot.fly(2.05)[-1].status.tactic is Tactic.FORMATION


@pytest.mark.parametrize("leader_leaves", ["says so", "falls silent", "is gone"])
def test_a_follower_follows_and_leads_on_from_its_own_slot_once_the_leader_has_left(
    leader_leaves: str, make_config: Maker
) -> None:
    pilot = Pilot(make_config(vehicle_id=3), motion=(0.0, -4.0, 0.0, 0.0))
    for tick in range(400):
        heard_s = max(pilot.now_s - 0.8, 0.0)  # late, as over a poor radio
        pilot.core.take(Message(pilot.now_s, member(2, heard_s, 0.2 * heard_s + 1.0, 0.5)))
        pilot.fly((tick + 1) * PERIOD_S)
    # The leader is a metre ahead of the line and half a metre beside it: a follower keeps to it, not to the line.
    assert pilot.motion == pytest.approx([0.2 * pilot.now_s + 1.0, -4.5, 0.2, 0.0], abs=0.02)
    if leader_leaves == "says so":
        pilot.core.take(Message(pilot.now_s, member(2, pilot.now_s, 9.0, 0.5, "encircle")))
    if leader_leaves == "is gone":
        pilot.core.take(Presence(2, present=False))
        assert pilot.core.tick(pilot.now_s).status.peers == ()
    pilot.fly(80.0)
    assert pilot.motion == pytest.approx([0.2 * pilot.now_s, -5.0, 0.2, 0.0], abs=0.02)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (member(2, 5.0, 0.0, 0.0), "not_a_member"),
        (member(9, 5.0, 0.0, 0.0), "not_a_member"),
        (member(1, 6.2, 0.0, 0.0), "from_future"),
        (member(1, 3.9, 0.0, 0.0), "too_old"),
        (seeing(5.0, covariance_m2=(1.0, 2.0, 1.0)), "malformed"),
    ],
)
def test_what_cannot_be_trusted_is_counted_and_dropped(message: BusMessage, reason: str, make_config: Maker) -> None:
    core = VehicleCore(make_config())
    core.take(telemetry(5.0))
    core.take(Message(5.0, message))
    status = core.tick(5.0).status
    assert status.drops == Drops(**{reason: 1})
    assert [each.sender for each in status.peers] == ([1] if reason == "malformed" else [])
    assert status.target is None


# To the micrometre: two bodies that coincide, do.
near = (st.floats(-30.0, 30.0) | st.floats(-1e6, 1e6)).map(lambda metres: round(metres, 6))
pairs = st.tuples(near, near)
rates = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
peers, moments = st.sampled_from([1, 3]), st.floats(9.0, 10.9)
variances = st.floats(1e-6, 1e8) | st.floats(0.01, 1.0)
angles = st.builds(NeighbourAngle, peers, moments, st.floats(-7.0, 7.0), st.floats(-1e3, 1e3), st.floats(0.0, 1e6))
packages = st.builds(
    TargetPackage,
    peers,
    moments,
    pairs,
    st.tuples(variances, st.floats(-0.1, 0.1), variances),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.just((2,)),
)
plausible = st.builds(
    MemberState, peers, moments, st.sampled_from(["formation", "encircle", "land"]), pairs, rates, pairs, rates,
    angle=st.none() | angles, sightings=st.lists(packages, max_size=3).map(tuple),
).map(encode)  # fmt: skip


def found(config: AgentConfig, motion: Vector) -> Vector:
    """Where a vehicle that was told nothing yet is when its setpoint acts, half a period from now.

    The bound on the lead counts from there: the setpoint acts meanwhile, as far ahead as the vehicle flies in a period.
    """
    half = exact_step(config.plant, PERIOD_S / 2.0)
    flown_m = half.advance(motion, motion[:2], STILL)[2:] * PERIOD_S
    return half.advance(motion, motion[:2] + flown_m, STILL)


@given(payloads=st.lists(plausible | st.binary(max_size=60), max_size=12), smoothing_s=st.sampled_from([0.0, 3.5]))
def test_no_message_makes_a_vehicle_raise_or_fly_off(
    payloads: list[bytes], smoothing_s: float, make_config: Maker
) -> None:
    config = make_config(encirclement={"smoothing_time_s": smoothing_s}, decision={"distance_max_m": 1e4})
    core = VehicleCore(config)
    core.take(Start(0.0))
    motion = np.array([3.0, -2.0, 0.4, 0.1])
    core.take(telemetry(10.0, motion.tolist()))
    for payload in payloads:
        with suppress(ValueError):
            core.take(Message(10.0, decode(payload)))
    x, y = setpoint_of(core.tick(10.0))
    acting = found(config, motion)
    assert hypot(x - acting[0], y - acting[1]) <= config.safety.setpoint_lead_max_m + 1e-6
    core.tick(10.1)


@settings(max_examples=30)
@given(
    motion=st.tuples(near, near, st.floats(-30.0, 30.0), st.floats(-30.0, 30.0)),
    target=pairs,
    tactic=st.sampled_from([Tactic.FORMATION, Tactic.ENCIRCLE]),
)
def test_the_setpoint_never_leads_by_more_than_allowed_whatever_the_estimate(
    motion: tuple[float, float, float, float], target: tuple[float, float], tactic: Tactic, make_config: Maker
) -> None:
    decision = {"distance_max_m": 1e8, "importance_min": 0.0 if tactic is Tactic.ENCIRCLE else 1.0}
    config = make_config(encirclement={"smoothing_time_s": 0.0}, decision=decision)
    core = VehicleCore(config)
    core.take(Start(0.0))
    core.take(telemetry(10.0, motion))
    core.take(sighting(10.0, *target))
    output = core.tick(10.0)
    assert output.status.tactic is tactic
    acting = found(config, np.array(motion))
    x, y = setpoint_of(output)
    assert hypot(x - acting[0], y - acting[1]) <= config.safety.setpoint_lead_max_m + 1e-6


@pytest.mark.parametrize(
    ("message", "tactic"),
    [
        (seeing(0.0), Tactic.ENCIRCLE),
        (seeing(0.0, importance=0.5), Tactic.FORMATION),
        (seeing(0.0, recipients=(1, 3)), Tactic.FORMATION),
    ],
)
def test_a_peers_sighting_is_decided_on_if_it_is_meant_for_the_vehicle(
    message: MemberState, tactic: Tactic, make_config: Maker
) -> None:
    pilot = Pilot(make_config())
    pilot.core.take(Message(0.0, message))
    assert pilot.fly(0.1)[-1].status.tactic is tactic


def test_engaging_moves_the_setpoint_smoothly_onto_the_ring(make_config: Maker) -> None:
    pilot = Pilot(make_config(), motion=(0.0, 0.0, 0.2, 0.0))
    outputs = pilot.fly(5.0)
    for tick in range(50, 700):
        pilot.core.take(sighting(pilot.now_s, x=11.0, y=1.0))
        outputs += pilot.fly((tick + 1) * PERIOD_S)
    setpoints = np.array([setpoint_of(output) for output in outputs])
    assert [output.status.tactic for output in outputs[49:51]] == [Tactic.FORMATION, Tactic.ENCIRCLE]
    assert np.abs(np.diff(setpoints[48:52], axis=0)).max() < 0.05
    assert np.abs(np.diff(setpoints[52:95], axis=0)).max() < 0.1
    assert outputs[50].status.mixing == 0.0
    assert outputs[67].status.mixing == pytest.approx(0.5, abs=0.03)
    assert outputs[85].status.mixing == 1.0
    final = outputs[-1].status.polar
    assert final is not None
    assert final.radius_m == pytest.approx(10.0, abs=0.02)
    assert final.angular_rate_rad_s == pytest.approx(0.05, abs=1e-3)


def test_neighbours_on_the_ring_are_taken_to_where_they_are_when_the_setpoint_acts(make_config: Maker) -> None:
    pilot = Pilot(make_config(encirclement={"angular_rate_rad_s": 0.4}), motion=(0.0, 0.0, 0.0, 0.0))
    pilot.core.take(sighting(0.0, x=10.0))
    pilot.fly(0.55)
    for sender, bearing in ((1, -2.5), (3, 1.5)):
        pilot.core.take(Message(pilot.now_s, on_ring(sender, 0.1, (10.0, 0.0), bearing, 0.4)))
    output = pilot.fly(0.65)[-1]
    place, polar, drift = output.status.place, output.status.polar, 0.4 * (0.6 + PERIOD_S / 2.0 - 0.1)
    assert place is not None
    assert polar is not None
    own = polar.bearing_rad + polar.angular_rate_rad_s * PERIOD_S / 2.0
    assert place.members == 3
    assert place.lead_rad == pytest.approx((-2.5 + drift - own) % tau, abs=0.01)
    assert place.lag_rad == pytest.approx((own - 1.5 - drift) % tau, abs=0.01)


def test_a_vehicle_that_held_resumes_its_formation_and_one_that_lands_stays(make_config: Maker) -> None:
    pilot = Pilot(make_config())
    pilot.fly(5.0)
    pilot.core.take(TacticEvent(Event.HOLD))
    held = setpoint_of(pilot.fly(10.0)[-1])
    assert held[0] == pytest.approx(1.0, abs=0.1)
    pilot.core.take(TacticEvent(Event.RESUME))
    pilot.fly(60.0)
    assert pilot.motion == pytest.approx([12.0, 0.0, 0.2, 0.0], abs=5e-3)
    pilot.core.take(TacticEvent(Event.LAND))
    assert pilot.core.tactic is Tactic.LAND
    assert len({setpoint_of(output) for output in pilot.fly(65.0)}) == 1


def test_what_is_told_to_the_peers(make_config: Maker) -> None:
    pilot = Pilot(make_config(communication_radius_m=20.0))
    for message in (member(1, 0.0, 0.0, 19.9), member(3, 0.0, 0.0, -20.1)):
        pilot.core.take(Message(0.0, message))
    (state,) = sent_by(pilot.fly(0.1)[-1])
    assert isinstance(state, MemberState)
    assert (state.sender, state.time_s, state.tactic) == (2, 0.0, "formation")
    seen = sighting(0.1)
    pilot.core.take(seen)
    (state,) = sent_by(pilot.fly(0.2)[-1])
    assert isinstance(state, MemberState)
    assert state.tactic == "encircle"
    assert state.angle is not None
    assert (state.angle.radius_m, abs(state.angle.bearing_rad)) == pytest.approx((5.0, np.pi), abs=0.05)
    assert state.sightings == (TargetPackage(2, 0.1, seen.position_m, seen.covariance_m2, 0.8, 0.2, (1,)),)
    (state,) = sent_by(pilot.fly(0.3)[-1])
    assert isinstance(state, MemberState)
    assert state.angle is not None
    assert state.sightings == ()


def test_on_its_way_to_the_ring_a_vehicle_sends_at_the_full_rate(make_config: Maker) -> None:
    pilot = Pilot(make_config())
    pilot.core.take(sighting(0.0))
    flown = [(output, output.status.plan) for output in pilot.fly(4.0)]
    rings = [(output, plan.ring) for output, plan in flown if plan is not None]
    joining = [output for output, ring in rings if ring is not None and (ring.mixing < 1.0 or not ring.joined)]
    assert len(joining) > 10
    assert all(output.messages for output in joining)


def test_followers_receive_the_undisturbed_setpoint_at_the_time_of_the_message(make_config: Maker) -> None:
    pilot = Pilot(make_config())
    wind = np.array([0.2, -0.1])
    output = next(each for each in reversed(pilot.fly(40.0, wind=wind)) if each.messages)
    state = sent_by(output)[0]
    assert isinstance(state, MemberState)
    # In steady flight: the mission line's own setpoint, as of the message's time.
    assert state.aim_m == pytest.approx((0.2 * state.time_s + 0.2 * 0.87 / 0.80, 0.0), abs=0.01)
    assert state.aim_rate_m_s == (0.2, 0.0)
    compensated = state.aim_m - wind / 0.80 + np.array([0.2 * PERIOD_S / 2.0, 0.0])
    assert setpoint_of(output) == pytest.approx(compensated, abs=0.01)


def test_peers_receive_the_undisturbed_aim_of_a_vehicle_that_encircles(make_config: Maker) -> None:
    """From the engagement on, also while the formation's aim is mixed in: the plant answers it in the wind as an
    undisturbed one, which is how peers predict the vehicle.
    """
    pilot, wind = Pilot(make_config()), np.array([0.3, -0.2])
    pilot.fly(20.0, wind=wind)
    pilot.core.take(Sighting(pilot.now_s, 2, (12.0, 0.0), (1e-4, 0.0, 1e-4), 0.8, 0.2))
    seen = 0
    for output in pilot.fly(pilot.now_s + 6.0, wind=wind):
        for state in sent_by(output):
            if isinstance(state, MemberState) and state.tactic == "encircle":
                acts_m = np.array(state.aim_m) + np.array(state.aim_rate_m_s) * PERIOD_S / 2.0
                assert acts_m == pytest.approx(np.array(setpoint_of(output)) + wind / 0.80, abs=0.02)
                seen += 1
    assert seen > 20


def test_a_vehicle_sent_back_beside_the_ring_does_not_cut_across_it(make_config: Maker) -> None:
    # Its place in line is at the target by now: mixing that in would pull it through the ring.
    pilot = Pilot(make_config(line_start_m=(0.0, 0.0)), motion=(10.0, 10.5, 0.0, 0.0))
    pilot.core.take(TacticEvent(Event.START))
    pilot.core.take(TacticEvent(Event.HANDED_OVER))
    radii = []
    for tick in range(200):
        now_s = tick * PERIOD_S
        if tick == 10:
            pilot.core.take(TacticEvent(Event.RESUME))
        pilot.core.take(Sighting(now_s, 2, (10.0, 0.0), (1e-4, 0.0, 1e-4), 0.8, 0.2))
        pilot.core.take(telemetry(now_s, pilot.motion.tolist()))
        output = pilot.core.tick(now_s)
        wanted = output.setpoint.position_m[:2] if output.setpoint is not None else pilot.motion[:2]
        pilot.motion = exact_step(pilot.plant, PERIOD_S).advance(pilot.motion, np.array(wanted), STILL)
        radii.append(float(np.hypot(*(pilot.motion[:2] - [10.0, 0.0]))))
    assert pilot.core.tactic is Tactic.ENCIRCLE
    assert min(radii) > 9.0
    assert radii[-1] == pytest.approx(10.0, abs=0.05)


def test_who_comes_back_to_the_formation_is_followed_only_once_it_is_there(make_config: Maker) -> None:
    pilot = Pilot(make_config(vehicle_id=3), motion=(0.0, -5.0, 0.0, 0.0))
    way = [(-9.0, -6.0), *((-9.0 + 0.2 * tick, 0.0) for tick in range(45)), *[(0.0, 0.0)] * 200]
    for tick, (off_x, y) in enumerate(way):
        moving = 1 <= tick < 45
        x = 0.2 * pilot.now_s + off_x + (0.5 if tick > 45 else 0.0)  # its place in the end: half a metre ahead
        speed = (2.2, 0.0) if moving else (0.2, 0.0)
        leader = MemberState(2, pilot.now_s, "formation", (x, y), speed, (x + 0.2175, y), speed)
        pilot.core.take(Message(pilot.now_s, leader))
        pilot.fly((tick + 1) * PERIOD_S)
        off = pilot.motion[:2] - [0.2 * pilot.now_s, -5.0]
        if tick <= 45:
            assert np.abs(off).max() < 0.1, tick
    assert off == pytest.approx([0.5, 0.0], abs=0.05)


def test_in_another_shape_it_flies_to_its_new_slot(make_config: Maker) -> None:
    pilot = Pilot(make_config(vehicle_id=3), motion=(0.0, -5.0, 0.0, 0.0))
    pilot.fly(20.0)
    pilot.core.take(Message(20.0, OperatorCommand(20.0, "formation", None, "pat", 1, "wedge")))
    outputs = pilot.fly(50.0)
    assert pilot.motion == pytest.approx([0.2 * 50.0 - 3.5355, -3.5355, 0.2, 0.0], abs=0.02)
    steps = np.diff([setpoint_of(output) for output in outputs], axis=0)
    assert np.abs(steps).max() < 3.0  # as far as the bound on the speed lets it lead
    assert "the formation's shape is 'wedge'" in [note.text for output in outputs for note in output.status.notes]


@pytest.mark.parametrize(("peers", "has_room"), [(9, True), (10, False)])
def test_off_a_full_ring_it_waits_outside_and_does_not_publish_its_bearing(
    peers: int, has_room: bool, make_config: Maker
) -> None:
    config = make_config(
        slots=tuple(range(1, 13)),
        encirclement={"radius_m": 5.0},  # eleven would be 2.8 m apart
        safety={"separation_m": 3.0, "guard": False},
        decision={"distance_max_m": 50.0},
    )
    pilot, outputs = Pilot(config, motion=(20.0, 0.0, 0.0, 0.0)), []
    for tick in range(200):
        now_s = pilot.now_s
        pilot.core.take(sighting(now_s, 0.0, 0.0))
        for place in range(peers):
            bearing = tau * (place + 0.5) / peers + 0.05 * now_s
            pilot.core.take(Message(now_s, on_ring(place + 3, now_s, (0.0, 0.0), bearing, 0.05, radius_m=5.0)))
        outputs += pilot.fly((tick + 1) * PERIOD_S)
    told = [state.angle is not None for output in outputs for state in states_of(output)]
    assert sum(told) == (len(told) - told.index(True) if has_room else 0)
    assert (outputs[20].status.place is not None) is has_room
    if not has_room:
        assert hypot(*pilot.motion[:2]) == pytest.approx(5.0 + WAITING * 3.0, abs=0.1)


def test_it_publishes_its_bearing_and_its_place_from_the_engagement_on(make_config: Maker) -> None:
    """The others make room while it is still far away, and while its motion is still the formation's.

    Its place is where the ring has to be now to have it at the vehicle's bearing when that comes to the waiting circle.
    """
    config = make_config(safety={"separation_m": 3.0, "guard": False}, decision={"distance_max_m": 50.0})
    ring, pilot = config.encirclement, Pilot(config)
    pilot.core.take(sighting(0.0, 30.0, 0.0))
    outputs = []
    for tick in range(50):
        pilot.core.take(sighting(pilot.now_s, 30.0, 0.0))
        outputs += pilot.fly((tick + 1) * PERIOD_S)
    engaged = next(n for n, output in enumerate(outputs) if output.status.tactic is Tactic.ENCIRCLE)
    assert any(0.0 < (output.status.mixing or 0.0) < 1.0 for output in outputs[engaged:])
    for output in outputs[engaged:]:
        for angle in (state.angle for state in states_of(output)):
            assert angle is not None
            assert angle.radius_m == pytest.approx(hypot(*(pilot.motion[:2] - (30.0, 0.0))), abs=6.0)
            assert angle.reference_rad is not None
            arrives_s = (angle.radius_m - ring.radius_m - WAITING * 3.0) / ring.speed_max_m_s
            assert angle.reference_rad % tau == pytest.approx(pi - ring.angular_rate_rad_s * arrives_s, abs=0.1)


def test_what_others_saw_is_believed_and_not_passed_on(make_config: Maker) -> None:
    pilot = Pilot(make_config())
    pilot.core.take(Message(0.0, member(1, 0.0, 0.0, 4.0)))
    pilot.core.take(msgspec.structs.replace(sighting(0.0), sensor_id=1007))
    output = pilot.fly(0.05)[-1]
    assert output.status.target is not None
    assert not any(state.sightings for state in states_of(output))


def test_a_target_too_fast_for_the_ring_slows_it_and_this_is_published(make_config: Maker) -> None:
    ring = {"radius_m": 10.0, "angular_rate_rad_s": 0.15, "speed_max_m_s": 3.0, "acceleration_max_m_s2": 4.0}
    pilot, outputs = Pilot(make_config(encirclement=ring)), []
    for tick in range(90):
        time_s = tick * PERIOD_S
        pilot.core.take(sighting(time_s, 8.0 + 2.0 * time_s))
        outputs += pilot.fly(time_s + PERIOD_S / 2.0)
    last = outputs[-1]
    assert last.status.tactic is Tactic.ENCIRCLE
    assert last.status.slowed == "ring at 50% of its rate: the target moves at 2.0 m/s"
    assert [note.text for output in outputs for note in output.status.notes if note.kind == "ring"][-1] == (
        last.status.slowed
    )
    (angle,) = [state.angle for state in states_of(last)]
    assert angle is not None
    assert (angle.rate_share, angle.radius_share) == (0.5, 1.0)
    rates = [output.status.ring_rate_rad_s for output in outputs]
    assert rates[0] == 0.15
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] == pytest.approx(0.075)
    assert -np.diff(rates).min() <= 0.015 * PERIOD_S + 1e-9


def test_a_vehicle_that_is_pushed_out_of_its_hold_tells_by_whom(make_config: Maker) -> None:
    pilot = Pilot(make_config(safety={"separation_m": 3.0}))
    pilot.core.take(TacticEvent(Event.HOLD))
    pilot.fly(2.0)
    assert pilot.core.tactic is Tactic.HOLD
    outputs = []
    for tick in range(150):
        # It passes through the place that is held, and lands: it does not evade.
        x = 8.0 - 0.1 * tick
        passing = MemberState(3, pilot.now_s, "land", (x, 0.0), (-1.0, 0.0), (x, 0.0), (-1.0, 0.0), 8.0)
        pilot.core.take(Message(pilot.now_s, passing))
        outputs += pilot.fly(pilot.now_s + PERIOD_S)
    pushed = [hypot(*each.status.motion[:2]) > 1.0 for each in outputs if each.status.motion is not None]
    assert sum(pushed) > 20
    outlooks = [each.status.outlook for each in outputs]
    told = [each is not None and (each.guard, each.evaded) == (("separation",), (3,)) for each in outlooks]
    assert told.index(True) < pushed.index(True), "from the beginning"
    assert (outlooks[0], outlooks[-1]) == (None, None)
    (note,) = [each for output in outputs for each in output.status.notes if each.kind == "guard"]
    assert note.guard is not None
    assert (note.guard.evaded, note.text) == ((3,), "evading 3")


@pytest.mark.parametrize("ring_m", [None, 15.0])
def test_an_adopted_vehicle_holds_at_its_height_and_returns_in_its_layer(ring_m: float | None) -> None:
    choreography = ChoreographySettings(layer_m=3.0, landing="return")
    config = replace(CONFIG.with_ring(altitude_m=ring_m), choreography=choreography, home_m=(0.0, 0.0))
    core = VehicleCore(config)
    core.tick(0.0)
    core.take(TacticEvent(Event.ADOPT))
    heights_m = dict[float, float]()
    for tick in range(1, 600):
        now_s = tick * PERIOD_S
        core.take(Telemetry(now_s, (30.0, 5.0, 21.0), (0.0, 0.0, 0.0)))
        if tick == 50:
            core.take(TacticEvent(Event.END))
        output = core.tick(now_s)
        assert output.setpoint is not None
        assert output.setpoint.position_m[:2] == pytest.approx((30.0, 5.0), abs=1e-6)  # it rises in place
        heights_m[now_s] = output.setpoint.position_m[2]
    assert {height_m for now_s, height_m in heights_m.items() if now_s < 4.95} == {21.0}
    assert heights_m[599 * PERIOD_S] == pytest.approx(8.0 + 2 * 3.0)  # the second to land, above all flying heights
