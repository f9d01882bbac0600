"""Sightings from outside the team - a camera on a mast, another vehicle, an operator - as JSON on the team's bus.

docs/target.md describes the message. Invalid sightings are refused here; each reason is counted, and reported once.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from enum import Enum
from math import hypot
from typing import Annotated

import msgspec

from agents.team.text import printable
from estimation.frames import Geodetic, MissionFrame
from estimation.state import Sighting

TOPIC = "perception"
SOURCES_FROM, SOURCES_TO = 1000, 10999
"""The sensor ids of sources 0 to 9999; a vehicle's own sensor has the vehicle's id."""
AHEAD_MAX_S = 1.0
AWAY_MAX_M = 1e6
"""Limit of the distance, as in peers' messages; larger values are refused."""


class Frame(Enum):
    """The frame of a position: metres in the mission frame, or degrees of latitude and longitude."""

    MISSION = "mission"
    GEODETIC = "geodetic"


class Refusal(Enum):
    """Why a sighting from outside was refused."""

    MALFORMED = "malformed message, see docs/target.md"
    FRAME = "unknown frame"
    NOWHERE = "geodetic position in a mission with a local frame"
    AWAY = "position too far away"
    FUTURE = "time in the future"
    COVARIANCE = "covariance not positive definite"
    TARGET = "unknown target"


_Variance = Annotated[float, msgspec.Meta(ge=-1e8, le=1e8)]


class ExternalSighting(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A sighting message: covariance (xx, xy, yy) in the frame's axes, north and east if geodetic.

    `time_s` is on the team's clock (Unix time, except in faster simulations); None is the time of reception.
    `altitude_m` is above the mission's origin, in either frame; None is unknown. `target` is the name of one of several
    targets, None if the sensor does not tell them apart.
    """

    frame: str
    position: tuple[float, float]
    covariance_m2: tuple[_Variance, _Variance, _Variance]
    importance: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
    threat: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
    time_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e12)] | None = None
    source: Annotated[int, msgspec.Meta(ge=0, le=9999)] = 0
    altitude_m: Annotated[float, msgspec.Meta(ge=-1e4, le=1e5)] | None = None
    altitude_sigma_m: Annotated[float, msgspec.Meta(gt=0.0, le=1e3)] = 1.0
    target: str | None = None


_decoder = msgspec.json.Decoder(ExternalSighting)


class SightingRefusedError(Exception):
    """An external sighting is refused: the reason and the offending value."""

    def __init__(self, refusal: Refusal, detail: str) -> None:
        super().__init__(f"{refusal.value} ({detail})")
        self.refusal = refusal


class Perception:
    """Decodes and validates the external sightings of one agent; calls `report` once for each reason of refusal.

    `targets` are the names that sightings may have, empty in a mission of one target.
    """

    def __init__(self, frame: MissionFrame, report: Callable[[str], None], targets: Sequence[str] = ()) -> None:
        self._frame = frame
        self._targets = tuple(targets)
        self._report = report
        self.refused: Counter[Refusal] = Counter()

    def take(self, payload: bytes, now_s: float, time_scale: float) -> Sighting | None:
        """Return the sighting in a payload in the mission frame, None if it is refused.

        `time_scale` is in mission seconds per wall second.
        """
        try:
            return self.read(payload, now_s, time_scale)
        except SightingRefusedError as error:
            self.refused[error.refusal] += 1
            if self.refused[error.refusal] == 1:
                self._report(printable(f"external sighting refused, reported once: {error}"))
        return None

    def read(self, payload: bytes, now_s: float, time_scale: float) -> Sighting:
        """Return the same; raises SightingRefusedError."""
        try:
            message = _decoder.decode(payload)
            time_s = now_s if message.time_s is None else message.time_s
            if time_s > now_s + AHEAD_MAX_S * time_scale:
                raise SightingRefusedError(Refusal.FUTURE, f"by {time_s - now_s:.1f} s")
            return self._sighting(message, self._frame_of(message), time_s)
        except (msgspec.MsgspecError, RecursionError, ValueError) as error:
            raise SightingRefusedError(Refusal.MALFORMED, str(error)) from error

    def _frame_of(self, message: ExternalSighting) -> Frame:
        try:
            frame = Frame(message.frame)
        except ValueError as error:
            known = ", ".join(each.value for each in Frame)
            raise SightingRefusedError(Refusal.FRAME, f"{message.frame[:32]!r}, known: {known}") from error
        if frame is Frame.GEODETIC and self._frame.is_local:
            raise SightingRefusedError(Refusal.NOWHERE, "use the mission frame")
        return frame

    def _require_known(self, target: str | None) -> None:
        """Check the name of a target."""
        if target is None or target in self._targets:
            return
        known = f"known: {', '.join(self._targets)}" if self._targets else "the mission has one target: leave it out"
        raise SightingRefusedError(Refusal.TARGET, f"{target[:32]!r}, {known}")

    def _sighting(self, message: ExternalSighting, frame: Frame, time_s: float) -> Sighting:
        self._require_known(message.target)
        xx, xy, yy = covariance_m2 = message.covariance_m2
        if not (xx > 0.0 and xx * yy - xy**2 > 0.0):
            raise SightingRefusedError(Refusal.COVARIANCE, str(covariance_m2))
        x, y, z = *message.position, 0.0
        if frame is Frame.GEODETIC and self._frame.origin is not None:
            x, y, z = self._frame.mission_from_geodetic(Geodetic(*message.position, self._frame.origin.altitude_m))
            covariance_m2 = self._rotated(covariance_m2)
        if hypot(x, y, z) > AWAY_MAX_M:
            raise SightingRefusedError(Refusal.AWAY, f"{hypot(x, y, z) / 1e3:g} km, at most {AWAY_MAX_M / 1e3:g}")
        return Sighting(
            time_s,
            SOURCES_FROM + message.source,
            (x, y),
            covariance_m2,
            message.importance,
            message.threat,
            message.altitude_m,
            message.altitude_sigma_m,
            target=message.target,
        )

    def _rotated(self, covariance_m2: tuple[float, float, float]) -> tuple[float, float, float]:
        """Rotate a covariance from north and east into the mission's axes."""
        nn, ne, ee = covariance_m2
        (xn, yn, _), (xe, ye, _) = (self._frame.mission_from_ned(axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        return (
            xn * xn * nn + 2.0 * xn * xe * ne + xe * xe * ee,
            xn * yn * nn + (xn * ye + xe * yn) * ne + xe * ye * ee,
            yn * yn * nn + 2.0 * yn * ye * ne + ye * ye * ee,
        )


def encode_sighting(message: ExternalSighting) -> bytes:
    """Return the payload of a sighting."""
    return msgspec.json.encode(message)
