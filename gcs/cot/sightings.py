"""Sightings of the target from events of Cursor-on-Target; what cannot be one is refused here and counted."""

from collections import Counter
from dataclasses import dataclass
from enum import Enum

from agents.team.perception import ExternalSighting, Perception, SightingRefusedError, encode_sighting
from gcs.cot.events import CotEvent, MalformedEventError, read_event
from gcs.mission.mission import Mission

RATE_MAX_HZ = 50.0
_AHEAD_MAX_S = 1.0


class EventRefusal(Enum):
    """Why an event is no sighting."""

    MALFORMED = "no event of Cursor-on-Target"
    STALE = "an old event"
    FUTURE = "an event of the future"
    REPEATED = "an event that was sent before"
    RATE = f"more than {RATE_MAX_HZ:g} a second"
    TEAM = "no vehicle flies this mission"
    VALUE = "refused as a sighting"


class EventRefusedError(Exception):
    """An event is refused: the reason, and the value in it."""

    def __init__(self, refusal: EventRefusal, detail: str) -> None:
        super().__init__(f"{refusal.value} ({detail})")
        self.refusal = refusal


@dataclass(frozen=True, slots=True)
class TrackedTarget:
    """Which events are of the target, by their `uid` or callsign, and what they do not state.

    That is the standard deviation [m] without an error, importance, threat, and the name if there are several targets;
    `geoid_m` is the height of the geoid above the ellipsoid, None if it is not known.
    """

    uid: str
    sigma_m: float
    importance: float
    threat: float
    geoid_m: float | None
    name: str | None = None


class EventSightings:
    """Makes sightings of the target's events; `others` counts those of other objects, `refused` the rest by reason."""

    def __init__(self, mission: Mission, target: TrackedTarget) -> None:
        frame = mission.mission_frame()
        assert frame.origin is not None
        self._origin_m = frame.origin.altitude_m
        self._late_max_s = mission.target_filter.late_max_s
        self._target = target
        self._checks = Perception(frame, lambda _reason: None, [each.name for each in mission.targets])
        self._name = mission.mission.name
        self._due_s = 0.0
        self._newest_s = 0.0
        self.refused: Counter[EventRefusal] = Counter()
        self.others = 0
        self.taken = 0

    def take(self, payload: bytes, team_s: float | None, now_s: float) -> bytes | None:
        """Return the sighting in an event for the team's bus, None for events of others; raises EventRefusedError.

        `team_s` is the present time on the team's clock, None without a team; `now_s` is Unix time.
        """
        try:
            event = _event(payload)
            if self._target.uid not in (event.uid, event.callsign):
                self.others += 1
                return None
            if team_s is None:
                raise EventRefusedError(EventRefusal.TEAM, self._name)
            sighting = self._sighting(event, team_s, now_s)
        except EventRefusedError as error:
            self.refused[error.refusal] += 1
            raise
        self._due_s, self._newest_s = now_s + 1.0 / RATE_MAX_HZ, event.time_s
        self.taken += 1
        return sighting

    def _sighting(self, event: CotEvent, team_s: float, now_s: float) -> bytes:
        age_s = now_s - event.time_s
        if age_s > self._late_max_s:
            raise EventRefusedError(EventRefusal.STALE, f"{age_s:.2f} s, at most {self._late_max_s:g}")
        if age_s < -_AHEAD_MAX_S:
            raise EventRefusedError(EventRefusal.FUTURE, f"by {-age_s:.1f} s: set the clocks")
        if event.time_s <= self._newest_s:
            raise EventRefusedError(EventRefusal.REPEATED, event.uid)
        if now_s < self._due_s:
            raise EventRefusedError(EventRefusal.RATE, event.uid)
        encoded = encode_sighting(self._read(event, team_s - max(age_s, 0.0)))
        try:
            self._checks.read(encoded, team_s, 1.0)
        except SightingRefusedError as error:
            raise EventRefusedError(EventRefusal.VALUE, str(error)) from error
        return encoded

    def _read(self, event: CotEvent, time_s: float) -> ExternalSighting:
        # The schema of events: `ce` is one sigma of a zero-mean normal distribution. Some programs send 0 for unknown.
        target, sigma_m = self._target, event.ce_m or self._target.sigma_m
        altitude_m = None
        if target.geoid_m is not None and event.height_m is not None:
            altitude_m = event.height_m - target.geoid_m - self._origin_m
        return ExternalSighting(
            "geodetic",
            (event.latitude_deg, event.longitude_deg),
            (sigma_m**2, 0.0, sigma_m**2),
            target.importance,
            target.threat,
            time_s=time_s,
            altitude_m=altitude_m,
            altitude_sigma_m=target.sigma_m,
            target=target.name,
        )


def _event(payload: bytes) -> CotEvent:
    try:
        return read_event(payload)
    except MalformedEventError as error:
        raise EventRefusedError(EventRefusal.MALFORMED, str(error)) from error
