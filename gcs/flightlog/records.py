"""What a flight log holds: the record types beside those on tape, and the table of topics.

A record is on the topic `/vehicle/<id>/<name>`, what concerns the whole run on `/run`. Every record of a vehicle has a
number, which puts all that went into its core and came out of it in order, whatever the clocks say.
"""

import msgspec

from agents.drops import Drops
from agents.notes import Note
from agents.outputs import TickOutput
from agents.ports import Setpoint
from agents.tape import (
    Autopilot,
    Bus,
    Command,
    Computer,
    Killed,
    LateTicks,
    Presence,
    Start,
    TacticEvent,
    Tick,
    TimeScale,
)
from agents.team.codec import encode
from estimation.polar import Polar
from estimation.state import OwnEstimate, Sighting, TargetEstimate, Telemetry
from gcs.flightlog.audit.entry import AuditEntry

PROFILE = "cordon"
"""The word by which an MCAP file says whose it is."""
FORMAT = 3
"""Of the log: a reader knows all up to its own. Before 3 each vehicle's records held the messages themselves."""


class PlantText(msgspec.Struct, frozen=True):
    """A profile as it was flown with; an earlier version's plant file."""

    name: str
    text: str


class Version(msgspec.Struct, frozen=True):
    """Something that the outcome of a computation depends on, and its version."""

    name: str
    version: str


class Run(msgspec.Struct, frozen=True):
    """What was flown, by what: all that is needed to build the same cores again.

    `began_s` is Unix time, `speed` how many times as fast as the wall's the clock of all records passes; `source` is
    simulation, sitl, hybrid, bench or flight. `vehicles` are those whose cores are recorded here, out of the mission's.
    `faults` are those that were injected into stub vehicles, as `link-cut@120:2`.
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


class Parameter(msgspec.Struct, frozen=True):
    """A parameter of an autopilot."""

    name: str
    value: float


class Vehicle(msgspec.Struct, frozen=True):
    """What a vehicle's autopilot said of itself before take-off; `kind` is what it is (gcs/link/kind.py)."""

    autopilot: str
    firmware: str
    parameters: tuple[Parameter, ...]
    kind: str = ""


class Carried(msgspec.Struct, frozen=True):
    """A message of the bus that cores of this process took; its number is its place among them, from 1 on."""

    payload: bytes


class Taken(msgspec.Struct, frozen=True):
    """Messages that the core took, one or more in a row: their places among all `Carried`, and when each came."""

    places: tuple[int, ...]
    times_s: tuple[float, ...]


class FormerMessage(msgspec.Struct, frozen=True):
    """A message that the core took, in logs before format 3: when it came, and on which key; the oldest have no key."""

    now_s: float
    payload: bytes
    key: str = ""


class LocalCommand(msgspec.Struct, frozen=True):
    """`on_command`: an operator at this computer said this; the payload is the command's, as it goes over the bus."""

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
    """What the guard did with the planned setpoint, why, and up to which cause its demands had to yield.

    Where velocities are sent beside setpoints, `setpoint_m` is the aim of both.
    """

    setpoint_m: tuple[float, ...]
    status: str
    causes: tuple[str, ...]
    yielded: str | None


class Decision(msgspec.Struct, frozen=True):
    """All that came out of one tick: estimates, decisions and their reasons, and what was sent.

    `peers` are the members that counted, `answers` what peers answered to operators, as it came over the bus.
    `ring_rate_rad_s` is the angular rate of the ring as it is flown, 0 off it; None in logs older than rings that slow.
    `target_altitude_m` is the estimate of the target's altitude, None where the vehicle followed none.
    `turning_rad_s` is the estimated rate at which the vehicle goes around, 0 off the ring; older logs have none.
    `drops` are the messages that were dropped so far by reason, `messages_dropped` in all; older logs have the number
    alone.
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


class Cost(msgspec.Struct, frozen=True):
    """What the tick before took, within the control loop."""

    time_s: float
    tick_us: float


class Truth(msgspec.Struct, frozen=True):
    """Where a simulator knows that a vehicle was; `received` if it sent that in flight, on its vehicle's link."""

    time_s: float
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    received: bool = False


class VehicleEnd(msgspec.Struct, frozen=True):
    """How a vehicle's control loop fared as a whole, when its mission ended and the way down began, how and why.

    `how` is a word of `gcs.metrics.ending.How`, empty in older logs.
    """

    ticks: int
    missed: int
    ended_s: float | None
    how: str = ""
    reason: str = ""


class RunEnd(msgspec.Struct, frozen=True):
    """How a run ended: what was flown of the mission, and what it took on the wall's clock."""

    flown_s: float
    wall_time_s: float


RUN_TOPICS: dict[type, str] = {Run: "run", RunEnd: "end", AuditEntry: "audit", Carried: "carried"}
VEHICLE_TOPICS: dict[type, str] = {
    TimeScale: "time_scale",
    Start: "start",
    TacticEvent: "event",
    Autopilot: "autopilot",
    LateTicks: "late",
    Bus: "bus",
    Drops: "drops",
    Computer: "computer",
    Telemetry: "telemetry",
    Sighting: "sighting",
    Taken: "taken",
    FormerMessage: "message",
    LocalCommand: "command",
    Killed: "killed",
    Presence: "presence",
    Tick: "tick",
    Decision: "decision",
    Cost: "cost",
    Truth: "truth",
    VehicleEnd: "end",
    Vehicle: "vehicle",
}


def recorded(item: object) -> object:
    """Return what stands in a log for an item from a tape."""
    if isinstance(item, TickOutput):
        return decision_of(item)
    if isinstance(item, Command):
        return LocalCommand(item.now_s, encode(item.command))
    return item


def decision_of(output: TickOutput) -> Decision:
    """Return a tick's output as it is recorded."""
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
    )


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
