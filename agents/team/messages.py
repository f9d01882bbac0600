"""Peer messages, and the table of topics with rate and maximum age.

Every number is bounded on decoding (`agents/team/codec.py`): NaN, infinity and absurd values never reach an estimator.
Text with control characters is refused there.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import count
from math import ceil
from typing import Annotated, Final, Literal, NamedTuple

import msgspec

from agents.drops import NO_DROPS, Drops
from agents.notes import GuardCause
from agents.settings.shapes import Shape
from agents.tactics import DOES_NOT_EVADE, OFF_THE_RING, Tactic
from agents.team.numbers import PlaceNumbers, StateNumbers
from agents.team.packing import FLAT, PAIRED, SHARED, Added, Age, AheadOf, OneOf, Unit, Within
from agents.team.text import PRINTABLE
from agents.team.verbs import TARGET, VERBS, Verb
from estimation.state import Sighting

VehicleId = Annotated[int, msgspec.Meta(ge=1, le=254)]
TIME_MAX_S = 1e12
TimeS = Annotated[float, msgspec.Meta(ge=0.0, le=TIME_MAX_S)]
_Metres = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6), Unit(1e3)]
_Radius = Annotated[float, msgspec.Meta(ge=0.0, le=1e6), Unit(1e3)]
_Speed = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3), Unit(1e3)]
_Angle = Annotated[float, msgspec.Meta(ge=-7.0, le=7.0), Unit(1e5)]
_AngularRate = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3), Unit(1e6)]
# Variances are rounded up, covariances towards zero, which keeps the matrix positive definite.
_Variance = Annotated[float, msgspec.Meta(ge=-1e8, le=1e8), Unit(1e6, "above")]
_Covariance = Annotated[float, msgspec.Meta(ge=-1e8, le=1e8), Unit(1e6, "towards_zero")]
_Tilt = Annotated[float, msgspec.Meta(ge=-60.0, le=60.0), Unit(1e2)]  # as a mission's tilt_deg
_Fraction = Annotated[float, msgspec.Meta(ge=0.0, le=1.0), Unit(1e4)]
_Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e6), Unit(1e3)]
_Name = Annotated[str, msgspec.Meta(max_length=32, pattern=PRINTABLE)]
_Number = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]

RINGS_MAX = 8
"""The largest number of a mission's rings."""
BIDS_LIMIT = 2500
"""More than the largest message of the auction: 254 members bid for eight rings (`agents/ring/auction.py`)."""
RingNumber = Annotated[int, msgspec.Meta(ge=0, lt=RINGS_MAX)]
TARGETS_MAX = 8
TRAFFIC_MAX = 8
"""The largest number of aircraft that are taken from one autopilot's receiver: the nearest ones."""
DID_LIMIT = ENDED_LIMIT = START_BLOCKERS_LIMIT = 120
CONDITIONS_LIMIT = 16
LINK_SILENT_S = 0.8
"""Operators and observers consider a link cut without a sample of the vehicle's motion for this long [wall s]."""
RESUMES = "resumes"
_DOES = {
    Tactic.FORMATION.value: RESUMES,
    Tactic.ASIDE.value: "steps aside",
    Tactic.HOLD.value: "holds",
    Tactic.RETURN_AND_LAND.value: "returns and lands",
    Tactic.LAND.value: "lands",
}
Metres2 = tuple[_Metres, _Metres]
Outcome = Literal["begun", "obeyed", "refused", "misdated"]


class NeighbourAngle(msgspec.Struct, frozen=True, array_like=True, dict=True):
    """The bearing, its rate and the radius of a vehicle on the ring about the target, at `time_s`.

    Bearings are those of the vehicle from the target, counter-clockwise from x of the mission frame, and rates positive
    counter-clockwise. It is a part of its sender's state. The shares are the ring that the sender can fly, of rate and
    radius of the mission's (`agents/ring/feasibility.py`), the reference is its place, which it has not reached while
    it comes in, None without one, and `references` a digest of the vehicles whose references its law takes into
    account, 0 if that is not known.
    """

    sender: Annotated[VehicleId, SHARED]
    time_s: Annotated[TimeS, SHARED]
    bearing_rad: _Angle
    angular_rate_rad_s: _AngularRate
    radius_m: _Radius
    rate_share: _Fraction = 1.0
    radius_share: Annotated[float, msgspec.Meta(ge=1.0, le=10.0), Unit(1e4)] = 1.0
    reference_rad: _Angle | None = None
    reference_rate_rad_s: _AngularRate = 0.0
    references: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF), Added(1)] = 0

    @cached_property
    def numbers(self) -> PlaceNumbers:
        """The place as machine numbers, for cordon's own use."""
        return PlaceNumbers(
            self.sender,
            self.time_s,
            self.bearing_rad,
            self.angular_rate_rad_s,
            self.radius_m,
            (self.rate_share, self.radius_share),
            self.reference_rad,
            self.reference_rate_rad_s,
            self.references,
        )


class TargetPackage(msgspec.Struct, frozen=True, array_like=True, dict=True):
    """One raw sighting of the target, and its recipients: the members within the sender's communication radius.

    It is a part of its sender's state. The covariance holds (xx, xy, yy); the altitude is above the mission's origin,
    None if not measured. The position includes the error of the sender's own position: standard
    deviation per axis (0: none) and correlation time. `target` is the number of the target among the mission's, None if
    the mission has one or the sensor does not tell its targets apart.
    """

    sender: Annotated[VehicleId, SHARED]
    time_s: Annotated[TimeS, Age(1e3)]
    position_m: Metres2
    covariance_m2: tuple[_Variance, _Covariance, _Variance]
    importance: _Fraction
    threat: _Fraction
    recipients: tuple[VehicleId, ...]
    altitude_m: _Metres | None = None
    altitude_sigma_m: Annotated[float, msgspec.Meta(gt=0.0, le=1e3), Unit(1e3, "above"), PAIRED] = 1.0
    frame_sigma_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0), Unit(1e3, "above")] = 0.0
    frame_correlation_s: Annotated[_Seconds, PAIRED] = 0.0
    target: Annotated[Annotated[int, msgspec.Meta(ge=0, lt=TARGETS_MAX)] | None, Added(1)] = None

    @cached_property
    def sighting(self) -> Sighting:
        """The sighting, without the name of its target; raises ValueError if its numbers are invalid."""
        return Sighting(
            self.time_s,
            self.sender,
            self.position_m,
            self.covariance_m2,
            self.importance,
            self.threat,
            self.altitude_m,
            self.altitude_sigma_m,
            self.frame_sigma_m,
            self.frame_correlation_s,
        )


class RingValues(msgspec.Struct, frozen=True, array_like=True):
    """The values of the ring that the verb ring commands, None for one that stays."""

    radius_m: _Radius | None = None
    angular_rate_rad_s: _AngularRate | None = None
    altitude_m: _Metres | None = None
    tilt_deg: _Tilt | None = None

    @property
    def text(self) -> str:
        """The values as text: "15 m, -0.1 rad/s, 12 m high"."""
        forms = ("{:g} m", "{:g} rad/s", "{:g} m high", "tilted by {:g}°")
        values = (self.radius_m, self.angular_rate_rad_s, self.altitude_m, self.tilt_deg)
        return ", ".join(form.format(value) for form, value in zip(forms, values, strict=True) if value is not None)


class Goal(msgspec.Struct, frozen=True, array_like=True):
    """A place in the mission frame, for the verbs goto and look, and whether a vehicle lands there; else it holds."""

    x_m: _Metres
    y_m: _Metres
    lands: bool = False

    @property
    def text(self) -> str:
        """The place as text."""
        return f"x {self.x_m:.1f} m, y {self.y_m:.1f} m"


_Dated = tuple[float | None, float]


class CommandedRing(msgspec.Struct, frozen=True, array_like=True):
    """The values of the ring that operators commanded last, each with the time of its command; None is the mission's.

    Each value has its own time: a vehicle that did not receive the command of one takes it from a peer, also if it
    received a later command of the other.
    """

    radius_m: _Radius | None = None
    radius_s: Annotated[TimeS, PAIRED] = 0.0
    angular_rate_rad_s: _AngularRate | None = None
    rate_s: Annotated[TimeS, PAIRED] = 0.0
    altitude_m: Annotated[_Metres | None, Added(1)] = None
    altitude_s: Annotated[TimeS, PAIRED] = 0.0
    tilt_deg: Annotated[_Tilt | None, Added(2)] = None
    tilt_s: Annotated[TimeS, PAIRED] = 0.0

    @property
    def dated(self) -> tuple[_Dated, ...]:
        """The values in the order of `RingValues`, each with its time."""
        return (
            (self.radius_m, self.radius_s),
            (self.angular_rate_rad_s, self.rate_s),
            (self.altitude_m, self.altitude_s),
            (self.tilt_deg, self.tilt_s),
        )

    def commanded(self, values: RingValues, time_s: float) -> "CommandedRing":
        """Return the ring after a command at a time, in the units in which states have it: all fly the same values."""
        rounded = zip(msgspec.structs.astuple(values), (3, 6, 3, 2), strict=True)
        return self.with_(
            _ring([(None, 0.0) if value is None else (round(value, digits), time_s) for value, digits in rounded])
        )

    def is_dated_by(self, time_s: float) -> bool:
        """Return whether no value is newer than this: one dated ahead would keep all later commands from a vehicle."""
        return all(dated_s <= time_s for _, dated_s in self.dated)

    def is_newer_than(self, values: RingValues, time_s: float) -> bool:
        """Return whether all values of a command of this time have been replaced by those of newer commands."""
        given = zip(msgspec.structs.astuple(values), self.dated, strict=True)
        times_s = [dated_s for value, (_, dated_s) in given if value is not None]
        return bool(times_s) and min(times_s) > time_s

    def in_order(self) -> list["CommandedRing"]:
        """Return the commands that it consists of, each alone, in the order of their times."""
        times_s = sorted({dated_s for value, dated_s in self.dated if value is not None})
        return [_ring([each if each[1] == at_s else (None, 0.0) for each in self.dated]) for at_s in times_s]

    def with_(self, other: "CommandedRing") -> "CommandedRing":
        """Return the newest values of two; of two of the same time the larger one, so that all vehicles agree."""
        return _ring(list(map(_newest, self.dated, other.dated)))


def _ring(dated: list[_Dated]) -> CommandedRing:
    (radius_m, radius_s), (rate_rad_s, rate_s), (altitude_m, altitude_s), (tilt_deg, tilt_s) = dated
    return CommandedRing(radius_m, radius_s, rate_rad_s, rate_s, altitude_m, altitude_s, tilt_deg, tilt_s)


def _newest(one: _Dated, other: _Dated) -> _Dated:
    if one[0] is None or other[0] is None:
        return one if other[0] is None else other
    return max(one, other, key=lambda each: (each[1], each[0]))


MISSION_RING: Final = CommandedRing()
"""The ring of the mission: no value was commanded."""


def newest_ring(rings: Iterable[CommandedRing | None]) -> CommandedRing:
    """Return the newest values among the rings in the states of a team: a vehicle may have missed a command."""
    return reduce(CommandedRing.with_, (each for each in rings if each is not None), MISSION_RING)


class RingChoice(msgspec.Struct, frozen=True, array_like=True):
    """What a vehicle in a mission of several rings publishes about them.

    `ring` is the number of the ring that it is on or flies to, None for none; `bids` is its message of the auction of
    the places (`agents/ring/auction.py`); `commanded` are the values that operators commanded of all rings, in their
    order, empty if they commanded none.
    """

    ring: Annotated[Annotated[RingNumber, Unit(1.0)] | None, Unit(1.0)]
    bids: Annotated[bytes, msgspec.Meta(max_length=BIDS_LIMIT)] = b""
    commanded: Annotated[tuple[CommandedRing, ...], msgspec.Meta(max_length=RINGS_MAX)] = ()


class Aircraft(msgspec.Struct, frozen=True):
    """An aircraft outside the team at `time_s`, as it reports itself by ADS-B or Remote ID.

    `label` is its call sign, address or serial number, `altitude_m` is above the mission's origin, None if unknown.
    """

    label: _Name
    time_s: Annotated[TimeS, Age(1e6)]
    position_m: Metres2
    velocity_m_s: tuple[_Speed, _Speed]
    altitude_m: _Metres | None = None


class MemberState(msgspec.Struct, frozen=True, array_like=True, dict=True):
    """A vehicle's state at `time_s`: tactic, motion, and the undisturbed aim with its rate, for followers and guards.

    It includes the vehicle's place on the ring, None off it, and the new sightings of its own sensor.

    `sender` is the vehicle's id, `tactic` the value of a `Tactic`. Motion and aim are along x and y of the mission
    frame, `altitude_m` is above its origin. Times are seconds on the team's clock. `position_sigma_m` is the standard
    deviation of the position, `alert` the active failsafe condition, empty if none; `shape` is the formation's shape
    that operators commanded last, at `shaped_s`; None is the mission's. `drops` are the messages that it has dropped so
    far. `ring` is the ring that operators commanded. In a mission of several rings `choice` has it, and more.
    `traffic` are aircraft that its autopilot receives, once a second, and `goal` is the place that it is on its way to,
    None without one, and `goal_s` when an operator sent it there. These five, drops and sightings are for cordon's own
    use.
    """

    sender: VehicleId
    time_s: TimeS
    tactic: Annotated[_Name, OneOf(tuple(each.value for each in Tactic))]
    position_m: Metres2
    velocity_m_s: tuple[_Speed, _Speed]
    aim_m: Annotated[Metres2, AheadOf("position_m")]
    aim_rate_m_s: tuple[_Speed, _Speed]
    altitude_m: _Metres = 0.0
    position_sigma_m: Annotated[float, msgspec.Meta(ge=0.0, le=1e3), Unit(1e3, "above")] = 0.0
    alert: _Name = ""
    shape: Shape | None = None
    shaped_s: Annotated[TimeS, PAIRED] = 0.0
    drops: Drops = NO_DROPS
    angle: NeighbourAngle | None = None
    sightings: tuple[TargetPackage, ...] = ()
    ring: Annotated[CommandedRing | None, Added(1)] = None
    choice: Annotated[RingChoice | None, Added(2)] = None
    traffic: Annotated[Annotated[tuple[Aircraft, ...], msgspec.Meta(max_length=TRAFFIC_MAX)] | None, Added(3)] = None
    goal: Annotated[Goal | None, Added(4)] = None
    goal_s: Annotated[TimeS | None, Added(5)] = None

    @cached_property
    def numbers(self) -> StateNumbers:
        """The state's numbers as machine numbers, for cordon's own use."""
        return StateNumbers(
            next(_STATE_IDS),
            self.sender,
            self.time_s,
            self.position_m,
            self.velocity_m_s,
            self.aim_m,
            self.altitude_m,
            self.position_sigma_m,
            self.ring_number if self.tactic == _ENCIRCLES else -1,
            None if self.angle is None else self.angle.numbers,
            evades=self.tactic not in DOES_NOT_EVADE,
            is_off_ring=self.tactic in OFF_THE_RING,
            has_sightings=len(self.sightings) > 0,
            is_bare=self.shape is None and self.ring is None and self.choice is None and not self.traffic,
        )

    @property
    def ring_number(self) -> int:
        """The number of the vehicle's ring, 0 in a mission of one."""
        return 0 if self.choice is None or self.choice.ring is None else self.choice.ring


_STATE_IDS: Final = count(1)
_ENCIRCLES: Final = Tactic.ENCIRCLE.value


class MissionIdentity(msgspec.Struct, frozen=True, array_like=True):
    """The identity of a mission: its name, and a digest of what must be equal for all members and operators."""

    name: Annotated[str, msgspec.Meta(max_length=60, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]
    digest: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{16}$")]


class AddedVehicle(msgspec.Struct, frozen=True):
    """What a team has to know of a vehicle that joins it in flight and is not in its mission file.

    It takes off and lands at `start_m`, flies at `altitude_m`, and has `slot_m` in a free formation, else none: ().
    """

    start_m: Metres2
    altitude_m: _Metres
    slot_m: Annotated[tuple[_Metres, ...], msgspec.Meta(max_length=2)] = ()


class AddedAnswer(msgspec.Struct, frozen=True, array_like=True):
    """What a vehicle answers to an added one, `about` its announcement: why it must not join, empty if it may.

    The mission that it joins lasts `duration_s` from its start on.
    """

    vehicle: VehicleId
    about: AddedVehicle
    refusal: Annotated[str, msgspec.Meta(max_length=DID_LIMIT, pattern=PRINTABLE)] = ""
    duration_s: _Seconds = 0.0


class StartProposal(msgspec.Struct, frozen=True, array_like=True, tag="start"):
    """A vehicle's presence, its mission, and the start that it proposes (None: not all members are ready yet).

    A vehicle is `ready` once it hovers; on the ground the message serves to compare clocks. It is also sent in flight,
    so that operators can check which mission the team flies. A vehicle that is not in the mission file announces itself
    by `adds`, and the others send `answer`.
    """

    sender: VehicleId
    time_s: TimeS
    start_s: TimeS | None
    ready: bool = True
    mission: MissionIdentity | None = None
    adds: AddedVehicle | None = None
    answer: AddedAnswer | None = None


class CommandKey(NamedTuple):
    """What identifies a command: no operator can answer, repeat or withhold another's by its number."""

    origin: str
    verb: Verb | None
    number: int


class OperatorCommand(msgspec.Struct, frozen=True, array_like=True, tag="command"):
    """An operator's command to one vehicle, or to all (None), dated by the team's clock; `origin` is the operator.

    It is repeated, with a new date, until it is answered: `origin`, `verb` and `number` identify it. `shape` is the
    argument of the verb formation, `place` that of the verbs goto and look (None: cameras look at the target), `ring`
    that of the verb ring, of the ring of number `ring_number` among the mission's, which the verb assign has alone.
    `times_s` holds the date by each vehicle's own clock that the operator has received: a team's clocks may differ, and
    what one vehicle tells must not make the command too old for another.
    """

    time_s: TimeS
    verb: Verb
    vehicle: VehicleId | None
    origin: _Name
    number: _Number
    shape: Shape | None = None
    times_s: tuple[tuple[VehicleId, TimeS], ...] = ()
    ring: RingValues | None = None
    ring_number: RingNumber | None = None
    place: Goal | None = None

    @property
    def key(self) -> "CommandKey":
        """What identifies it."""
        return CommandKey(self.origin, self.verb, self.number)

    @property
    def argument(self) -> str:
        """The shape, the values or the place that it has, as text; empty without one."""
        given = self.ring or self.place
        if given is not None:
            return given.text
        return TARGET if VERBS[self.verb].takes == "view" else self.shape or ""

    def sent_s(self, vehicle_id: int) -> float:
        """Return its date by the clock of a vehicle, by the team's where the operator has not received that."""
        return dict(self.times_s).get(vehicle_id, self.time_s)


class CommandAnswer(msgspec.Struct, frozen=True, array_like=True, tag="answer"):
    """A vehicle's answer to an operator's command, and its time.

    Observers receive commands by their answers only: operators connect to vehicles, not to each other. `did` is for
    people. A command that has `begun` is answered again once it is `obeyed` or `refused`. One that is `misdated` was
    not carried out, and is once it is repeated with a date by the vehicle's clock, which the answer has.
    """

    sender: VehicleId
    time_s: TimeS
    number: _Number
    did: Annotated[str, msgspec.Meta(max_length=DID_LIMIT, pattern=PRINTABLE)]
    verb: Verb | None = None
    origin: _Name = ""
    outcome: Outcome | None = None

    @property
    def key(self) -> CommandKey:
        """What identifies the command."""
        return CommandKey(self.origin, self.verb, self.number)

    @property
    def is_obeyed(self) -> bool:
        """Whether the vehicle carries out the command, or did so before."""
        return self.outcome in ("begun", "obeyed")

    @property
    def is_refused(self) -> bool:
        """Whether the vehicle does not carry it out."""
        return self.outcome in ("refused", "misdated")

    @property
    def is_final(self) -> bool:
        """Whether no other answer follows."""
        return self.outcome not in ("begun", "misdated")


class TargetReport(msgspec.Struct, frozen=True):
    """A vehicle's estimate of the target: the covariance of its position (xx, xy, yy), and the newest sighting's age.

    It is a part of its sender's report, with the same time.
    """

    position_m: Metres2
    velocity_m_s: tuple[_Speed, _Speed]
    covariance_m2: tuple[_Variance, _Covariance, _Variance]
    sighting_age_s: _Seconds


class CameraView(msgspec.Struct, frozen=True):
    """Where a vehicle's camera looked at `time_s`, as its gimbal reports it, and its angle of view.

    It looks from the vehicle's position at an elevation above the horizontal, negative downwards, and at a bearing
    counter-clockwise from x of the mission frame.
    """

    time_s: Annotated[TimeS, Age(1e6)]
    position_m: tuple[_Metres, _Metres, _Metres]
    elevation_rad: _Angle
    bearing_rad: _Angle
    view_rad: _Angle


class AutopilotReport(msgspec.Struct, frozen=True, omit_defaults=True):
    """What operators and observers see of an autopilot's own report: a part of its status, sent and shown as it is.

    `battery` is a fraction, `endurance_s` its estimate of the flight time until the battery is empty, `gps_dimensions`
    the type of the fix (0 without one, 2 or 3), with the number of `satellites`, `wind_m_s` the estimated horizontal
    wind, `camera` where a camera looks that the mission points. None is unknown, and left out of pages. A new field has
    to be `Added` to the report.
    """

    battery: Annotated[float, Within(0.0, 1.0), Unit(1e4)] | None = None
    endurance_s: Annotated[float, Within(0.0, 1e6)] | None = None
    gps_dimensions: Annotated[int, Within(0, 255)] | None = None
    satellites: Annotated[int, Within(0, 255)] | None = None
    wind_m_s: Annotated[Annotated[float, Within(0.0, 200.0), Unit(10.0)] | None, Added(6)] = None
    camera: Annotated[CameraView | None, Added(8)] = None


class NextChange(msgspec.Struct, frozen=True):
    """The change that a vehicle makes by itself next, unless its `cause` ends before."""

    tactic: Annotated[_Name, OneOf(tuple(each.value for each in Tactic))]
    at_s: Annotated[TimeS, Age(1e6)]
    cause: _Name

    @property
    def does(self) -> str:
        """What the vehicle does then, as text."""
        return _DOES.get(self.tactic, self.tactic)

    def text(self, now_s: float) -> str:
        """It as text: "lands in 18 s"."""
        return f"{self.does} in {max(ceil(self.at_s - now_s), 0)} s"


class Outlook(msgspec.Struct, frozen=True):
    """What a vehicle does next, and what holds it beside its alert.

    `blocks` is the condition that refuses a resume; it `waits_for_resume` if it stopped by itself and none does. `also`
    are its other conditions, and peers' alerts that explain their states. `guard` is why its aim is bent, `evaded`
    whom it keeps apart from.
    """

    next: NextChange | None = None
    blocks: _Name = ""
    waits_for_resume: bool = False
    also: Annotated[tuple[_Name, ...], msgspec.Meta(max_length=CONDITIONS_LIMIT)] = ()
    guard: tuple[GuardCause, ...] = ()
    evaded: tuple[VehicleId, ...] = ()


class VehicleReport(msgspec.Struct, frozen=True):
    """A vehicle's report to operators and observers, in addition to its state; vehicles do not receive it.

    `link_age_s` is the age of the newest sample of its motion [wall s], `yaw_rad` the yaw of the last setpoint,
    `estimator` the state of the autopilot's estimator as text. The mission began at `start_s` and lasts `duration_s`.
    `ended` is how the vehicle's flight ended, empty during the flight, and `is_completed` whether it was over as
    planned, which earlier versions do not send. `unaccounted_m` is the newest position of a vehicle whose flight has
    ended without a report that it is down, or that fell; None for all others. `position_m` is sent before the first
    state: on the ground and in take-off. While it waits on the ground for an operator's start, `start_blockers` forbid
    the start, empty if nothing does, and `clock_off_s` is the largest offset of a peer's computer's clock from its own
    [wall s]. `outlook` is None while nothing is due. A vehicle `in_reserve` stays on the ground: it has `ended`,
    and its flight has not begun; earlier versions do not send that. Unknown values are None, or empty.
    """

    sender: VehicleId
    time_s: TimeS
    mode: _Name
    armed: bool = False
    in_air: bool = False
    link_age_s: _Seconds | None = None
    yaw_rad: Annotated[float, msgspec.Meta(ge=-7.0, le=7.0), Unit(1e3)] | None = None
    autopilot: Annotated[AutopilotReport, FLAT] = AutopilotReport()
    estimator: _Name = ""
    start_s: TimeS | None = None
    duration_s: _Seconds = 0.0
    ended: Annotated[str, msgspec.Meta(max_length=ENDED_LIMIT, pattern=PRINTABLE)] = ""
    target: TargetReport | None = None
    start_blockers: Annotated[
        Annotated[str, msgspec.Meta(max_length=START_BLOCKERS_LIMIT, pattern=PRINTABLE)] | None, Added(1)
    ] = None
    clock_off_s: Annotated[_Seconds | None, Added(2)] = None
    is_completed: Annotated[bool | None, Added(3)] = None
    outlook: Annotated[Outlook | None, Added(4)] = None
    unaccounted_m: Annotated[tuple[_Metres, _Metres, _Metres] | None, Added(5)] = None
    position_m: Annotated[tuple[_Metres, _Metres, _Metres] | None, Added(7)] = None
    in_reserve: Annotated[bool | None, Added(9)] = None

    @property
    def is_link_cut(self) -> bool:
        """Whether the vehicle's link is considered cut."""
        return self.link_age_s is not None and self.link_age_s > LINK_SILENT_S


PeerMessage = MemberState | StartProposal | CommandAnswer | VehicleReport
BusMessage = PeerMessage | OperatorCommand


@dataclass(frozen=True, slots=True)
class Topic:
    """One kind of message: its name on the bus, its largest rate, and its maximum age."""

    name: str
    period_s: float
    age_max_s: float


TOPICS: dict[type[BusMessage], Topic] = {
    MemberState: Topic("member", 0.1, 1.0),
    StartProposal: Topic("start", 0.2, 1.0),
    OperatorCommand: Topic("command", 0.1, 2.0),
    CommandAnswer: Topic("answer", 0.1, 2.0),
    # Zenoh's `**` does not match parts of a key that begin with "@", so subscribers to all other keys do not receive
    # these.
    VehicleReport: Topic("@report", 0.2, 3.0),
}

OPERATOR_TOPIC = TOPICS[OperatorCommand].name
ROSTER_TOPIC = "roster"
"""The topic of signed rosters of keys, which revoke keys in flight (`agents/shell/bus_security.py`)."""
HEAD_TOPIC = "head"
"""The topic of the signed heads of the vehicles' audit logs (`gcs/flight/audit_exchange.py`)."""
PRESENCE_TOPIC, OPERATORS_TOPIC = "alive", "operator"
"""The topics of the liveliness tokens of vehicles and of operators; no messages are sent on them."""
REPORT_TOPIC = TOPICS[VehicleReport].name
PEER_TOPICS = frozenset(TOPICS[kind].name for kind in (MemberState, StartProposal, CommandAnswer, VehicleReport))
"""Topics on which vehicles send, with one key per vehicle; commands have one key per verb and operator."""


def topic_of(message: BusMessage) -> str:
    """Return the part of a message's key before the sender: its topic, for a command with the verb."""
    name = TOPICS[type(message)].name
    return f"{name}/{message.verb}" if isinstance(message, OperatorCommand) else name


def key_of(message: BusMessage) -> str:
    """Return the only key, below the team's, on which a message is admitted: it names its type and its sender."""
    sender = message.origin if isinstance(message, OperatorCommand) else message.sender
    return f"{topic_of(message)}/{sender}"
