"""Sightings from outside the team - a camera on a mast, another vehicle, an operator - as JSON on the team's bus.

docs/target.md describes the message. This is the edge: what no sighting can be is refused here, with the reason, which
is counted, and told the first time.
"""

from collections import Counter
from collections.abc import Callable
from enum import Enum
from math import hypot
from typing import Annotated

import msgspec

from estimation.frames import Geodetic, MissionFrame
from estimation.state import Sighting

TOPIC = "perception"
SOURCES_FROM = 1000
"""The sensor id of source 0: vehicles' own sensors have the vehicles' ids."""
AHEAD_MAX_S = 1.0
AWAY_MAX_M = 1e6
"""No farther than peers can tell of: numbers beyond are no places, and would spoil what is computed from them."""
_FIRST_BYTE = b"{"


class Frame(Enum):
    """In which frame a position is told: metres in the mission's, or degrees of latitude and longitude."""

    MISSION = "mission"
    GEODETIC = "geodetic"


class Refusal(Enum):
    """Why a sighting from outside was refused."""

    MALFORMED = "it is not what docs/target.md describes"
    FRAME = "its frame is not known"
    NOWHERE = "it is geodetic, and the mission's frame lies nowhere on Earth"
    AWAY = "it is too far away"
    FUTURE = "it is from the future"
    COVARIANCE = "its covariance is not positive definite"


_Variance = Annotated[float, msgspec.Meta(ge=-1e8, le=1e8)]


class Seen(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A sighting as it is told: covariance (xx, xy, yy) in the frame's axes, which are north and east if geodetic.

    `time_s` is when, on the team's clock (Unix time, but in faster simulations); None is on arrival. `altitude_m` is
    above the mission's origin, in either frame; None is not known.
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


_decoder = msgspec.json.Decoder(Seen)


def is_told_from_outside(payload: bytes) -> bool:
    """Return whether a payload on the bus is meant to be a sighting from outside: no peer's message begins like it."""
    return payload.startswith(_FIRST_BYTE)


class SightingRefusedError(Exception):
    """A sighting from outside is refused: why, and by which of its values."""

    def __init__(self, refusal: Refusal, detail: str) -> None:
        super().__init__(f"{refusal.value} ({detail})")
        self.refusal = refusal


class Perception:
    """Takes what one agent hears of sightings from outside; `tell` is told each reason for a refusal once."""

    def __init__(self, frame: MissionFrame, tell: Callable[[str], None]) -> None:
        self._frame = frame
        self._tell = tell
        self.refused: Counter[Refusal] = Counter()

    def take(self, payload: bytes, now_s: float, time_scale: float) -> Sighting | None:
        """Return the sighting in a payload in the mission frame, None if it is refused.

        `patience` is how many times as fast as the wall's clock the team's passes.
        """
        try:
            return self.read(payload, now_s, time_scale)
        except SightingRefusedError as error:
            self.refused[error.refusal] += 1
            if self.refused[error.refusal] == 1:
                self._tell(f"a sighting from outside is refused, and so will be others: {error}")
        return None

    def read(self, payload: bytes, now_s: float, time_scale: float) -> Sighting:
        """Return the same; raises SightingRefusedError."""
        try:
            seen = _decoder.decode(payload)
            time_s = now_s if seen.time_s is None else seen.time_s
            if time_s > now_s + AHEAD_MAX_S * time_scale:
                raise SightingRefusedError(Refusal.FUTURE, f"by {time_s - now_s:.1f} s")
            return self._sighting(seen, self._frame_of(seen), time_s)
        except (msgspec.MsgspecError, RecursionError, ValueError) as error:
            raise SightingRefusedError(Refusal.MALFORMED, str(error)) from error

    def _frame_of(self, seen: Seen) -> Frame:
        try:
            frame = Frame(seen.frame)
        except ValueError as error:
            known = ", ".join(each.value for each in Frame)
            raise SightingRefusedError(Refusal.FRAME, f"{seen.frame[:32]!r} is none of {known}") from error
        if frame is Frame.GEODETIC and self._frame.is_local:
            raise SightingRefusedError(Refusal.NOWHERE, "tell it in the mission's frame")
        return frame

    def _sighting(self, seen: Seen, frame: Frame, time_s: float) -> Sighting:
        xx, xy, yy = covariance_m2 = seen.covariance_m2
        if not (xx > 0.0 and xx * yy - xy**2 > 0.0):
            raise SightingRefusedError(Refusal.COVARIANCE, str(covariance_m2))
        x, y, z = *seen.position, 0.0
        if frame is Frame.GEODETIC and self._frame.origin is not None:
            x, y, z = self._frame.mission_from_geodetic(Geodetic(*seen.position, self._frame.origin.altitude_m))
            covariance_m2 = self._turned(covariance_m2)
        if hypot(x, y, z) > AWAY_MAX_M:
            raise SightingRefusedError(Refusal.AWAY, f"{hypot(x, y, z) / 1e3:g} km, at most {AWAY_MAX_M / 1e3:g}")
        return Sighting(
            time_s,
            SOURCES_FROM + seen.source,
            (x, y),
            covariance_m2,
            seen.importance,
            seen.threat,
            seen.altitude_m,
            seen.altitude_sigma_m,
        )

    def _turned(self, covariance_m2: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return a covariance of north and east in the mission's axes."""
        nn, ne, ee = covariance_m2
        (xn, yn, _), (xe, ye, _) = (self._frame.mission_from_ned(axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        return (
            xn * xn * nn + 2.0 * xn * xe * ne + xe * xe * ee,
            xn * yn * nn + (xn * ye + xe * yn) * ne + xe * ye * ee,
            yn * yn * nn + 2.0 * yn * ye * ne + ye * ye * ee,
        )


def encode_seen(seen: Seen) -> bytes:
    """Return a sighting as it goes over the bus."""
    return msgspec.json.encode(seen)
