"""The codec of the messages on the bus, and the compact form of a vehicle's state.

Every vehicle sends its state several times a second. The numbers of a state are encoded as integer multiples of units
far below the resolution of sensors, which takes a third of the bytes. Parts of a state omit its sender, the place on
the ring also its time. Reports to operators and observers are encoded in the same way.
"""

from typing import Annotated

import msgspec

from agents.drops import DropCounter, Drops, Reason
from agents.settings.shapes import Shape
from agents.tactics import Tactic
from agents.team.messages import (
    ENDED_LIMIT,
    LACKS_LIMIT,
    BusMessage,
    CommandAnswer,
    MemberState,
    NeighbourAngle,
    OperatorCommand,
    StartProposal,
    TargetPackage,
    TargetReport,
    TimeS,
    VehicleId,
    VehicleReport,
    key_of,
)
from agents.team.text import PRINTABLE

_NAMES = tuple(each.value for each in Tactic)
_CODES = {name: code for code, name in enumerate(_NAMES)}

_Millimetres = Annotated[int, msgspec.Meta(ge=-(10**9), le=10**9)]
_Lead = Annotated[int, msgspec.Meta(ge=-(2 * 10**9), le=2 * 10**9)]
_Positive = Annotated[int, msgspec.Meta(ge=0, le=10**9)]
_Speed = Annotated[int, msgspec.Meta(ge=-(10**6), le=10**6)]
_Angle = Annotated[int, msgspec.Meta(ge=-700_000, le=700_000)]
_AngularRate = Annotated[int, msgspec.Meta(ge=-(10**9), le=10**9)]
_Share = Annotated[int, msgspec.Meta(ge=0, le=10**4)]
_Variance = Annotated[int, msgspec.Meta(ge=-(10**14), le=10**14)]
_Count = Annotated[int, msgspec.Meta(ge=0, le=255)]
_Text = Annotated[str, msgspec.Meta(max_length=32, pattern=PRINTABLE)]
_MM, _ANGLES, _RATES, _SHARES, _MM2 = 1e3, 1e5, 1e6, 1e4, 1e6
"""The number of units in a metre or second, a radian, a radian per second, one, and a square metre."""


class _Place(msgspec.Struct, frozen=True, array_like=True):
    """A `NeighbourAngle`: angles in 1e-5 rad, rates in 1e-6 rad/s, the radius in mm, shares in 1e-4."""

    bearing: _Angle
    rate: _AngularRate
    radius_mm: _Positive
    rate_share: _Share
    radius_share: Annotated[int, msgspec.Meta(ge=10**4, le=10**5)]
    reference: _Angle | None
    reference_rate: _AngularRate


class _Seen(msgspec.Struct, frozen=True, array_like=True):
    """A `TargetPackage`: its age in ms, positions in mm, the covariance in mm2, importance and threat in 1e-4.

    The altitude and the frame's error, with standard deviation and correlation time in mm and ms, are None if unknown.
    """

    age_ms: Annotated[int, msgspec.Meta(ge=-(10**6), le=10**6)]
    x_mm: _Millimetres
    y_mm: _Millimetres
    xx_mm2: _Variance
    xy_mm2: _Variance
    yy_mm2: _Variance
    importance: _Share
    threat: _Share
    recipients: tuple[VehicleId, ...]
    altitude_mm: tuple[_Millimetres, Annotated[int, msgspec.Meta(ge=1, le=10**6)]] | None
    frame_mm_ms: tuple[Annotated[int, msgspec.Meta(ge=0, le=10**5)], _Positive] | None


class _State(msgspec.Struct, frozen=True, array_like=True, tag="s"):
    """A `MemberState`: positions in mm, the setpoint's relative to the vehicle's, velocities in mm/s.

    The tactic is its index in `Tactic`; the shape comes with the time of its command.
    """

    sender: VehicleId
    time_s: TimeS
    tactic: Annotated[int, msgspec.Meta(ge=0, lt=len(_NAMES))]
    x_mm: _Millimetres
    y_mm: _Millimetres
    x_mm_s: _Speed
    y_mm_s: _Speed
    lead_x_mm: _Lead
    lead_y_mm: _Lead
    setpoint_x_mm_s: _Speed
    setpoint_y_mm_s: _Speed
    altitude_mm: _Millimetres
    sigma_mm: Annotated[int, msgspec.Meta(ge=0, le=10**6)]
    alert: _Text
    shaped: tuple[Shape, TimeS] | None
    drops: Drops
    place: _Place | None
    seen: tuple[_Seen, ...]


class _Estimate(msgspec.Struct, frozen=True, array_like=True):
    """A `TargetReport`: positions in mm, velocities in mm/s, the covariance in mm2, the sighting's age in ms."""

    x_mm: _Millimetres
    y_mm: _Millimetres
    x_mm_s: _Speed
    y_mm_s: _Speed
    xx_mm2: _Variance
    xy_mm2: _Variance
    yy_mm2: _Variance
    age_ms: _Positive


class _Report(msgspec.Struct, frozen=True, array_like=True, tag="r"):
    """A `VehicleReport`: ages, duration and clocks in ms, the yaw in mrad, the battery in 1e-4, the endurance in s."""

    sender: VehicleId
    time_s: TimeS
    mode: _Text
    armed: bool
    in_air: bool
    link_age_ms: _Positive | None
    yaw_mrad: Annotated[int, msgspec.Meta(ge=-7000, le=7000)] | None
    battery: _Share | None
    endurance_s: Annotated[int, msgspec.Meta(ge=0, le=10**6)] | None
    gps_dimensions: _Count | None
    satellites: _Count | None
    estimator: _Text
    start_s: TimeS | None
    duration_ms: _Positive
    ended: Annotated[str, msgspec.Meta(max_length=ENDED_LIMIT, pattern=PRINTABLE)]
    target: _Estimate | None
    lacks: Annotated[str, msgspec.Meta(max_length=LACKS_LIMIT, pattern=PRINTABLE)] | None = None
    clock_off_ms: _Positive | None = None


_encoder = msgspec.msgpack.Encoder()
_Packed = _State | StartProposal | OperatorCommand | CommandAnswer | _Report
_decoder: msgspec.msgpack.Decoder[_Packed] = msgspec.msgpack.Decoder(_Packed)


def encode(message: BusMessage) -> bytes:
    """Return the payload of a message."""
    match message:
        case MemberState():
            return _encoder.encode(_packed(message))
        case VehicleReport():
            return _encoder.encode(_packed_report(message))
    return _encoder.encode(message)


def decode(payload: bytes) -> BusMessage:
    """Return the message in a payload; raises ValueError if it has no known type or a number is out of bounds."""
    try:
        message = _decoder.decode(payload)
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    match message:
        case _State():
            return _unpacked(message)
        case _Report():
            return _unpacked_report(message)
    return message


def _packed(state: MemberState) -> _State:
    (x, y), (x_rate, y_rate) = state.position_m, state.velocity_m_s
    (aim_x, aim_y), (aim_x_rate, aim_y_rate) = state.setpoint_m, state.setpoint_rate_m_s
    x_mm, y_mm = round(x * _MM), round(y * _MM)
    return _State(
        state.sender,
        state.time_s,
        _CODES[state.tactic],
        x_mm,
        y_mm,
        round(x_rate * _MM),
        round(y_rate * _MM),
        round(aim_x * _MM) - x_mm,
        round(aim_y * _MM) - y_mm,
        round(aim_x_rate * _MM),
        round(aim_y_rate * _MM),
        round(state.altitude_m * _MM),
        _above(state.position_sigma_m, _MM),
        state.alert,
        None if state.shape is None else (state.shape, state.shaped_s),
        state.drops,
        None if state.angle is None else _packed_angle(state.angle),
        tuple([_packed_sighting(each, state.time_s) for each in state.sightings]),
    )


def _packed_angle(angle: NeighbourAngle) -> _Place:
    return _Place(
        round(angle.bearing_rad * _ANGLES),
        round(angle.angular_rate_rad_s * _RATES),
        round(angle.radius_m * _MM),
        round(angle.rate_share * _SHARES),
        round(angle.radius_share * _SHARES),
        None if angle.reference_rad is None else round(angle.reference_rad * _ANGLES),
        round(angle.reference_rate_rad_s * _RATES),
    )


def _packed_sighting(seen: TargetPackage, now_s: float) -> _Seen:
    (x, y), (xx, xy, yy) = seen.position_m, seen.covariance_m2
    # Variances are rounded up, the covariance towards zero, which keeps the matrix positive definite.
    return _Seen(
        round((now_s - seen.time_s) * _MM),
        round(x * _MM),
        round(y * _MM),
        _above(xx, _MM2),
        _towards_zero(xy, _MM2),
        _above(yy, _MM2),
        round(seen.importance * _SHARES),
        round(seen.threat * _SHARES),
        seen.recipients,
        None if seen.altitude_m is None else (round(seen.altitude_m * _MM), _above(seen.altitude_sigma_m, _MM)),
        (_above(seen.frame_sigma_m, _MM), round(seen.frame_correlation_s * _MM)) if seen.frame_sigma_m else None,
    )


def _above(value: float, units: float) -> int:
    """Return the value in units, rounded up; a whole number of units is not changed by rounding errors."""
    count = round(value * units)
    return count if count / units >= value else count + 1


def _towards_zero(value: float, units: float) -> int:
    """Return the value in units, rounded towards zero."""
    return -_above(-value, units) if value > 0.0 else _above(value, units)


def _unpacked(state: _State) -> MemberState:
    shape, shaped_s = (None, 0.0) if state.shaped is None else state.shaped
    x_mm, y_mm = state.x_mm, state.y_mm
    return MemberState(
        state.sender,
        state.time_s,
        _NAMES[state.tactic],
        (x_mm / _MM, y_mm / _MM),
        (state.x_mm_s / _MM, state.y_mm_s / _MM),
        ((x_mm + state.lead_x_mm) / _MM, (y_mm + state.lead_y_mm) / _MM),
        (state.setpoint_x_mm_s / _MM, state.setpoint_y_mm_s / _MM),
        state.altitude_mm / _MM,
        state.sigma_mm / _MM,
        state.alert,
        shape,
        shaped_s,
        state.drops,
        None if state.place is None else _unpacked_angle(state.place, state),
        tuple([_unpacked_sighting(each, state) for each in state.seen]),
    )


def _unpacked_angle(place: _Place, state: _State) -> NeighbourAngle:
    return NeighbourAngle(
        state.sender,
        state.time_s,
        place.bearing / _ANGLES,
        place.rate / _RATES,
        place.radius_mm / _MM,
        place.rate_share / _SHARES,
        place.radius_share / _SHARES,
        None if place.reference is None else place.reference / _ANGLES,
        place.reference_rate / _RATES,
    )


def _unpacked_sighting(seen: _Seen, state: _State) -> TargetPackage:
    altitude_mm, altitude_sigma_mm = (None, _MM) if seen.altitude_mm is None else seen.altitude_mm
    frame_mm, frame_ms = seen.frame_mm_ms or (0, 0)
    return TargetPackage(
        state.sender,
        state.time_s - seen.age_ms / _MM,
        (seen.x_mm / _MM, seen.y_mm / _MM),
        (seen.xx_mm2 / _MM2, seen.xy_mm2 / _MM2, seen.yy_mm2 / _MM2),
        seen.importance / _SHARES,
        seen.threat / _SHARES,
        seen.recipients,
        None if altitude_mm is None else altitude_mm / _MM,
        altitude_sigma_mm / _MM,
        frame_mm / _MM,
        frame_ms / _MM,
    )


def _packed_report(report: VehicleReport) -> _Report:
    return _Report(
        report.sender,
        report.time_s,
        report.mode,
        report.armed,
        report.in_air,
        _scaled(report.link_age_s, _MM),
        _scaled(report.yaw_rad, _MM),
        _scaled(report.battery, _SHARES),
        _scaled(report.endurance_s, 1.0),
        report.gps_dimensions,
        report.satellites,
        report.estimator,
        report.start_s,
        round(report.duration_s * _MM),
        report.ended,
        None if report.target is None else _packed_estimate(report.target),
        report.lacks,
        _scaled(report.clock_off_s, _MM),
    )


def _packed_estimate(target: TargetReport) -> _Estimate:
    (x, y), (x_rate, y_rate), (xx, xy, yy) = target.position_m, target.velocity_m_s, target.covariance_m2
    return _Estimate(
        round(x * _MM),
        round(y * _MM),
        round(x_rate * _MM),
        round(y_rate * _MM),
        _above(xx, _MM2),
        _towards_zero(xy, _MM2),
        _above(yy, _MM2),
        round(target.sighting_age_s * _MM),
    )


def _scaled(value: float | None, units: float) -> int | None:
    return None if value is None else round(value * units)


def _unpacked_report(report: _Report) -> VehicleReport:
    return VehicleReport(
        report.sender,
        report.time_s,
        report.mode,
        report.armed,
        report.in_air,
        None if report.link_age_ms is None else report.link_age_ms / _MM,
        None if report.yaw_mrad is None else report.yaw_mrad / _MM,
        None if report.battery is None else report.battery / _SHARES,
        report.endurance_s,
        report.gps_dimensions,
        report.satellites,
        report.estimator,
        report.start_s,
        report.duration_ms / _MM,
        report.ended,
        None if report.target is None else _unpacked_estimate(report.target),
        report.lacks,
        None if report.clock_off_ms is None else report.clock_off_ms / _MM,
    )


def _unpacked_estimate(target: _Estimate) -> TargetReport:
    return TargetReport(
        (target.x_mm / _MM, target.y_mm / _MM),
        (target.x_mm_s / _MM, target.y_mm_s / _MM),
        (target.xx_mm2 / _MM2, target.xy_mm2 / _MM2, target.yy_mm2 / _MM2),
        target.age_ms / _MM,
    )


class Admission:
    """Decodes payloads from the bus once for all receivers; `drops` counts those not admitted."""

    def __init__(self) -> None:
        self._dropped = DropCounter()

    @property
    def drops(self) -> Drops:
        """The counts of payloads not admitted so far."""
        return self._dropped.drops

    def admitted(self, key: str, payload: bytes) -> BusMessage | None:
        """Return the message in a payload on a key below the team's, None if it is malformed or on a wrong key."""
        try:
            message = decode(payload)
        except ValueError:
            self._dropped.add(Reason.MALFORMED)
            return None
        reason = refusal(key, message)
        if reason is not None:
            self._dropped.add(reason)
            return None
        return message


def refusal(key: str, message: BusMessage) -> Reason | None:
    """Return why a message on a key below the team's is not admitted, None if it is.

    The topic has to match its type, the name in the key its sender; for a command these are verb and operator.
    """
    expected = key_of(message)
    if key == expected:
        return None
    return Reason.WRONG_SENDER if key.partition("/")[0] == expected.partition("/")[0] else Reason.WRONG_TOPIC
