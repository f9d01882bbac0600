"""Sightings of the target from poses that a node of ROS 2 publishes; what cannot be one is refused here and counted."""

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from math import isfinite, sqrt
from typing import Any

from agents.team.perception import ExternalSighting, Perception, SightingRefusedError, encode_sighting
from gcs.mission.mission import Mission
from gcs.ros2.enu import covariance_in_mission, mission_from_enu
from gcs.ros2.messages import POSE, POSE_COVARIANCE, MalformedError, Messages
from gcs.ros2.rmw_zenoh import dds_type

PAYLOAD_MAX_BYTES = 1024
"""Of a pose with covariance and a long name of its frame; more is refused before it is decoded."""
RATE_MAX_HZ = 50.0
_KINDS = {dds_type(kind): kind for kind in (POSE, POSE_COVARIANCE)}
_XX, _XY, _YX, _YY, _ZZ = 0, 1, 6, 7, 14
"""The places of the position in a covariance (6, 6), row by row."""
_UNLIKE = 1e-6


class PoseRefusal(Enum):
    """Why a message is no sighting."""

    TYPE = "neither a PoseStamped nor a PoseWithCovarianceStamped of this definition"
    LENGTH = "longer than such a message"
    MALFORMED = "not in CDR"
    NUMBERS = "a number is not finite"
    FRAME = "another frame_id"
    STALE = "an old stamp"
    COVARIANCE = "covariance not positive definite"
    RATE = f"more than {RATE_MAX_HZ:g} a second"
    TEAM = "no vehicle flies this mission"
    VALUE = "refused as a sighting"


class RefusedError(Exception):
    """A message is refused: the reason, and the value in it."""

    def __init__(self, refusal: PoseRefusal, detail: str) -> None:
        super().__init__(f"{refusal.value} ({detail})")
        self.refusal = refusal


@dataclass(frozen=True, slots=True)
class SightingDefaults:
    """What poses do not state: the frame that they are in, their standard deviation [m] without a covariance, and the
    target's importance, threat, and name if there are several.
    """

    frame_id: str
    sigma_m: float
    importance: float
    threat: float
    target: str | None = None


class PoseSightings:
    """Makes sightings of poses in the frame of ROS; `refused` counts the others by reason, `taken` the sightings."""

    def __init__(self, mission: Mission, messages: Messages, defaults: SightingDefaults) -> None:
        self._frame = mission.mission_frame()
        self._late_max_s = mission.target_filter.late_max_s
        self._messages = messages
        self._hashes = {dds_type(kind): messages.type_hash(kind) for kind in (POSE, POSE_COVARIANCE)}
        self._defaults = defaults
        self._checks = Perception(self._frame, lambda _reason: None, [each.name for each in mission.targets])
        self._name = mission.mission.name
        self._due_s = 0.0
        self.refused: Counter[PoseRefusal] = Counter()
        self.taken = 0

    def take(self, key: str, payload: bytes, team_s: float | None, received_s: float) -> bytes:
        """Return the sighting in a message for the team's bus; raises RefusedError.

        `team_s` is the present time on the team's clock, None without a team; `received_s` that of the wall.
        """
        try:
            if team_s is None:
                raise RefusedError(PoseRefusal.TEAM, self._name)
            sighting = self._sighting(key, payload, team_s)
            if received_s < self._due_s:
                raise RefusedError(PoseRefusal.RATE, key)
        except RefusedError as error:
            self.refused[error.refusal] += 1
            raise
        self._due_s = received_s + 1.0 / RATE_MAX_HZ
        self.taken += 1
        return sighting

    def _sighting(self, key: str, payload: bytes, team_s: float) -> bytes:
        kind, stated_hash = key.split("/")[-2:]
        if self._hashes.get(kind) != stated_hash:
            raise RefusedError(PoseRefusal.TYPE, f"{kind}/{stated_hash}"[:160])
        if len(payload) > PAYLOAD_MAX_BYTES:
            raise RefusedError(PoseRefusal.LENGTH, f"{len(payload)} bytes")
        try:
            message = self._messages.decode(_KINDS[kind], payload)
        except MalformedError as error:
            raise RefusedError(PoseRefusal.MALFORMED, str(error)) from error
        sighting = self._read(message, _KINDS[kind], team_s)
        encoded = encode_sighting(sighting)
        try:
            self._checks.read(encoded, team_s, 1.0)
        except SightingRefusedError as error:
            raise RefusedError(PoseRefusal.VALUE, str(error)) from error
        return encoded

    def _read(self, message: Any, kind: str, team_s: float) -> ExternalSighting:
        defaults, stamp = self._defaults, message.header.stamp
        if message.header.frame_id != defaults.frame_id:
            raise RefusedError(PoseRefusal.FRAME, f"{message.header.frame_id[:32]!r}, not {defaults.frame_id!r}")
        pose = message.pose.pose if kind == POSE_COVARIANCE else message.pose
        covariance = [float(each) for each in message.pose.covariance] if kind == POSE_COVARIANCE else [0.0] * 36
        place_m = (pose.position.x, pose.position.y, pose.position.z)
        if not all(map(isfinite, (*place_m, *(covariance[at] for at in (_XX, _XY, _YX, _YY, _ZZ))))):
            raise RefusedError(PoseRefusal.NUMBERS, f"position {place_m}")
        # ROS states the time 0 where it has none, and zeros for a covariance that is unknown.
        time_s = stamp.sec + stamp.nanosec / 1e9 if (stamp.sec, stamp.nanosec) != (0, 0) else None
        if time_s is not None and team_s - time_s > self._late_max_s:
            raise RefusedError(PoseRefusal.STALE, f"{team_s - time_s:.2f} s, at most {self._late_max_s:g}")
        horizontal_m2, sigma_z_m = self._uncertainty(covariance)
        x, y, z = mission_from_enu(self._frame, place_m)
        return ExternalSighting(
            "mission",
            (x, y),
            covariance_in_mission(self._frame, horizontal_m2),
            defaults.importance,
            defaults.threat,
            time_s=time_s,
            altitude_m=z,
            altitude_sigma_m=sigma_z_m,
            target=defaults.target,
        )

    def _uncertainty(self, covariance: list[float]) -> tuple[tuple[float, float, float], float]:
        """Return the covariance (ee, en, nn) [m²] and the standard deviation of the altitude [m]."""
        sigma_m = self._defaults.sigma_m
        if not any(covariance):
            return (sigma_m**2, 0.0, sigma_m**2), sigma_m
        ee, en, ne, nn, uu = (covariance[at] for at in (_XX, _XY, _YX, _YY, _ZZ))
        if not (ee > 0.0 and ee * nn > en * en and abs(en - ne) <= _UNLIKE * (ee + nn) and uu >= 0.0):
            raise RefusedError(PoseRefusal.COVARIANCE, f"{ee:g}, {en:g}, {ne:g}, {nn:g}; up {uu:g}")
        return (ee, en, nn), sqrt(uu) if uu else sigma_m
