"""The contents of a flight log: the record types beside the inputs of cores, and the table of topics.

A record is on the topic `/vehicle/<id>/<name>`, the record of the whole run on `/run`. Every record of a vehicle has a
number, which orders all inputs and outputs of its core, independent of clocks.
"""

from typing import Any, get_args

import msgspec

from agents.drops import Drops
from agents.flight_end import LastPosition
from agents.inputs import Command, CoreInput, Message
from agents.notes import Note
from agents.outputs import TickOutput
from agents.ports import Setpoint
from agents.team.codec import encode
from agents.team.messages import Outlook
from estimation.polar import Polar
from estimation.state import OwnEstimate, TargetEstimate
from gcs.flightlog.audit import AuditEntry
from gcs.flightlog.schema import plain_message

PROFILE = "cordon"
"""The profile name in the MCAP file."""
FORMAT = 3
"""The format of the log, that of cordon 0.2."""


class PlantText(msgspec.Struct, frozen=True):
    """A profile of the flight."""

    name: str
    text: str


class Version(msgspec.Struct, frozen=True):
    """A package or tool on which computed numbers depend, and its version."""

    name: str
    version: str


class PlannerRecord(msgspec.Struct, frozen=True):
    """The planner of a flight that is not cordon's: name, distribution with version, and digest of its source file.

    The latter two are empty where they are unknown.
    """

    name: str
    distribution: str
    digest: str


class PlannerValue(msgspec.Struct, frozen=True):
    """A number of a planner that is not cordon's, by the name that it gave it."""

    name: str
    value: float


class Run(msgspec.Struct, frozen=True):
    """The mission that was flown, and all that is needed to build the same cores again.

    `began_s` is Unix time, `speed` how many times as fast as the wall's the clock of all records runs; `source` is
    simulation, sitl, hybrid, bench or flight. `vehicles` are those of the mission whose cores are recorded here.
    `faults` are those injected into stub vehicles, as `link-cut@120:2`. `operator` began it.
    `planner` is None where cordon's own planned. `weather` is what people wrote about it.
    """

    format: int
    mission: str
    mission_text: str
    plants: tuple[PlantText, ...]
    seed: int
    source: str
    speed: float
    began_s: float
    duration_s: float
    vehicles: tuple[int, ...]
    versions: tuple[Version, ...]
    faults: tuple[str, ...] = ()
    operator: str = ""
    planner: PlannerRecord | None = None
    weather: str = ""


class Parameter(msgspec.Struct, frozen=True):
    """A parameter of an autopilot."""

    name: str
    value: float


class Vehicle(msgspec.Struct, frozen=True):
    """The facts that a vehicle's autopilot reported before take-off; `kind` is its kind of `gcs.autopilots`."""

    autopilot: str
    firmware: str
    parameters: tuple[Parameter, ...]
    kind: str = ""


class Carried(msgspec.Struct, frozen=True):
    """A message of the bus that cores of this process received; its number is its place among them, from 1."""

    payload: bytes


class Taken(msgspec.Struct, frozen=True):
    """Consecutive messages that the core received: their places among all `Carried`, and their times of arrival."""

    places: tuple[int, ...]
    times_s: tuple[float, ...]


class LocalCommand(msgspec.Struct, frozen=True):
    """`Command`: a command of an operator at this computer; the payload is that of the bus."""

    now_s: float
    payload: bytes


class Sent(msgspec.Struct, frozen=True):
    """A message to the peers: its topic on the bus, and its bytes."""

    topic: str
    payload: bytes


class OwnState(msgspec.Struct, frozen=True):
    """A vehicle's estimate of its own motion: mean (6,) = [x y x' y' w_x w_y] and covariance (6, 6), row by row."""

    time_s: float
    mean: tuple[float, ...]
    covariance: tuple[float, ...]


class TargetState(msgspec.Struct, frozen=True):
    """A vehicle's estimate of the target's motion: mean (4,) = [x y x' y'] and covariance (4, 4), row by row."""

    time_s: float
    mean: tuple[float, ...]
    covariance: tuple[float, ...]
    sighted_s: float
    importance: float
    threat: float


class PolarMotion(msgspec.Struct, frozen=True):
    """A vehicle's motion about the target."""

    radius_m: float
    bearing_rad: float
    radial_speed_m_s: float
    angular_rate_rad_s: float


class Place(msgspec.Struct, frozen=True):
    """A vehicle's place among the members of the ring; alone it has no neighbours."""

    members: int
    lead_rad: float | None
    lag_rad: float | None


class GuardResult(msgspec.Struct, frozen=True):
    """The guard's change of the planned setpoint, its causes, and the cause up to which constraints were relaxed.

    Where velocities are sent beside setpoints, `setpoint_m` is the aim of both.
    """

    setpoint_m: tuple[float, ...]
    status: str
    causes: tuple[str, ...]
    yielded: str | None


class Decision(msgspec.Struct, frozen=True):
    """All results of one tick: estimates, decisions and their reasons, and what was sent.

    `peers` are the members taken into account, `answers` the peers' answers to operators, as received from the bus.
    `ring_rate_rad_s` is the angular rate of the ring as flown, 0 off the ring.
    `target_altitude_m` is the estimate of the target's altitude, None if the vehicle followed none.
    `turning_rad_s` is the estimated rate at which the vehicle circles, 0 off the ring.
    `drops` are the messages dropped so far by reason, `messages_dropped` their number.
    `outlook` is None while nothing is due. `ring` is the number of the ring that the vehicle is on or flies to, of
    whose target `target` and `polar` are; 0 in missions of one ring. `values` are those of a user's planner.
    """

    time_s: float
    tactic: str
    mixing: float
    setpoint: Setpoint | None
    own: OwnState | None
    target: TargetState | None
    polar: PolarMotion | None
    place: Place | None
    approach: str | None
    qp: str | None
    guard: GuardResult | None
    alert: str
    notes: tuple[Note, ...]
    sent: tuple[Sent, ...]
    peers: tuple[int, ...]
    answers: tuple[bytes, ...]
    messages_dropped: int
    ring_rate_rad_s: float | None = None
    target_altitude_m: float | None = None
    turning_rad_s: float | None = None
    drops: Drops | None = None
    outlook: Outlook | None = None
    ring: int = 0
    values: tuple[PlannerValue, ...] = ()


class Cost(msgspec.Struct, frozen=True):
    """The computing time of the previous tick of the control loop."""

    time_s: float
    tick_us: float


class Truth(msgspec.Struct, frozen=True):
    """A vehicle's true motion from a simulator; `received` if it was sent in flight, on the vehicle's link."""

    time_s: float
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    received: bool = False


class TargetTruth(msgspec.Struct, frozen=True):
    """The true position of a simulated target that reacts, for each tick; any other's follows from the mission."""

    time_s: float
    position_m: tuple[float, float]


class VehicleEnd(msgspec.Struct, frozen=True):
    """The totals of a vehicle's control loop, when its mission ended and the way down began, and how and why.

    `how` is a value of `agents.flight_end.FlightEnd`. `unaccounted` is set if the vehicle is. The last one of a vehicle
    counts; `how` is "in flight" in that of one that flies again.
    """

    ticks: int
    missed: int
    ended_s: float | None
    how: str
    reason: str
    unaccounted: LastPosition | None = None


class RunEnd(msgspec.Struct, frozen=True):
    """The end of a run: the mission time flown, and the wall time."""

    flown_s: float
    wall_time_s: float


RUN_TOPICS: dict[type, str] = {
    Run: "run",
    RunEnd: "end",
    AuditEntry: "audit",
    Carried: "carried",
    TargetTruth: "target",
}
VEHICLE_TOPICS: dict[type, str] = {
    **{each: each.topic for each in get_args(CoreInput) if each not in (Message, Command)},
    Taken: "taken",
    LocalCommand: "command",
    Decision: "decision",
    Cost: "cost",
    Truth: "truth",
    VehicleEnd: "end",
    Vehicle: "vehicle",
}
"""The inputs of cores, but messages and commands, which are recorded as the bytes of the bus; and what else is kept."""


def recorded(item: object) -> object:
    """Return the record of an input or output of a core."""
    if isinstance(item, TickOutput):
        return decision_of(item)
    if isinstance(item, Command):
        return LocalCommand(item.now_s, encode(item.command))
    return item


def decision_of(output: TickOutput) -> Decision:
    """Return the record of a tick's output."""
    status = output.status
    guarded, own, target, polar, place = (
        status.guarded,
        status.own_estimate,
        status.target_estimate,
        status.polar,
        status.place,
    )
    return Decision(
        status.time_s,
        status.tactic.value,
        status.mixing,
        output.setpoint,
        None if own is None else _own_state(own),
        None if target is None else _target_state(target),
        None if polar is None else _polar_motion(polar),
        None if place is None else Place(place.members, place.lead_rad, place.lag_rad),
        None if status.approach is None else status.approach.value,
        None if status.qp is None else status.qp.value,
        None
        if guarded is None
        else GuardResult(
            tuple(guarded.aim_m.tolist()),
            guarded.status.value,
            tuple([cause.words for cause in guarded.causes]),
            None if guarded.yielded is None else guarded.yielded.words,
        ),
        status.alert,
        status.notes,
        tuple([Sent(message.topic, message.payload) for message in output.messages]),
        tuple([peer.sender for peer in status.peers]),
        tuple(map(encode, status.answers)),
        status.drops.total,
        status.ring_rate_rad_s,
        status.target_altitude_m,
        status.turning_rad_s,
        status.drops,
        status.outlook,
        status.ring,
        () if status.plan is None else tuple([PlannerValue(*each) for each in status.plan.values.items()]),
    )


def notes_of(decision: Any) -> list[Note]:
    """Return the notes of a decision that was read as a Protobuf message; in logs of 0.2.0 they have no values."""
    return [msgspec.convert(plain_message(note), Note) for note in decision.notes]


def outlook_of(decision: Any) -> Outlook | None:
    """Return what holds the vehicle and what it does next of a decision that was read as a Protobuf message.

    Logs of 0.2.0 do not hold it.
    """
    known = "outlook" in decision.DESCRIPTOR.fields_by_name and decision.HasField("outlook")
    return msgspec.convert(plain_message(decision.outlook), Outlook) if known else None


def ring_of(decision: Any) -> int:
    """Return the number of the ring of a decision that was read as a Protobuf message, 0 in logs of before rings."""
    return int(getattr(decision, "ring", 0))


def _polar_motion(polar: Polar) -> PolarMotion:
    return PolarMotion(polar.radius_m, polar.bearing_rad, polar.radial_speed_m_s, polar.angular_rate_rad_s)


def _own_state(own: OwnEstimate) -> OwnState:
    return OwnState(own.time_s, tuple(own.mean.tolist()), tuple(own.covariance.ravel().tolist()))


def _target_state(target: TargetEstimate) -> TargetState:
    return TargetState(
        target.time_s,
        tuple(target.mean.tolist()),
        tuple(target.covariance.ravel().tolist()),
        target.sighted_s,
        target.importance,
        target.threat,
    )
