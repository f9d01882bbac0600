"""Consistency of a peer's states: whether one vehicle can have flown them in sequence.

Successive states that are consistent form a track; a state that is not begins another track. The first accepted track
is the peer's state as long as it continues, so a second source with the same id does not replace it. When it ends,
another steady track takes its place. The guard keeps clear of the positions of all tracks.
"""

from collections.abc import Container, Mapping
from dataclasses import dataclass
from math import hypot
from typing import Final

from agents.settings.sections import SafetySettings
from agents.settings.tuning import SETPOINTS_FASTER
from agents.tactics import Tactic
from agents.team.clock_watch import ClockWatch
from agents.team.messages import TOPICS, MemberState, Metres2

SIGMAS: Final = 4.0
SIGMA_MAX_M: Final = 1.0
"""The position tolerance in published standard deviations, and the largest standard deviation that is used."""
TIMING_S: Final = 0.5
"""The largest error of a time stamp that clock step detection does not find."""
AGILE: Final = 2.0
"""The largest acceleration in multiples of `safety.acceleration_max_m_s2`: a gust, or an autopilot that brakes.
"""
VELOCITY_OFF_M_S: Final = 2.0
SPEED_OFF_M_S: Final = 1.0
"""Tolerances beyond the limits, for the noise of an estimate."""
CLIMB_MAX_M_S: Final = 6.0
ALTITUDE_OFF_M: Final = 2.0
CONFIRMED: Final = 3
"""The number of contradictions that are reported, and of consistent states that confirm a track: one may be a fault."""
TRACKS_MAX: Final = 4
REPORTED_FOR_S: Final = 5.0
"""A peer is doubtful for this long after its last contradiction."""
_KEPT: Final = 0.98
"""The decay factor, per state, of the accumulated difference between positions and velocities: it fades in seconds."""
_SOON_S: Final = 1.0
_QUITE_M: Final = 0.5
_QUITE_M_S: Final = 1.0
_CRUISE_M_S: Final = 5.0
_CLIMBED_M: Final = 0.3
"""Bounds of the fast check: the time between states, and the changes along each axis."""
_AGE_MAX_S = TOPICS[MemberState].age_max_s
_PILOT = Tactic.PILOT_OVERRIDE.value


@dataclass(frozen=True, slots=True)
class Limits:
    """The flight limits of the team's vehicles, and the largest difference of positions from integrated velocities."""

    safety: SafetySettings
    doubt_m: float


@dataclass(slots=True)
class Inconsistency:
    """A peer whose states contradict each other: first and last time, number, and text of the last contradiction."""

    since_s: float
    last_s: float
    count: int
    why: str


class PeerTrack:
    """Successive states of one peer that one vehicle can have flown.

    It is `accepted` if it is or was used as the peer's state.
    """

    __slots__ = ("_climbed_m", "_limits", "_off_x_m", "_off_y_m", "accepted", "count", "state")

    def __init__(self, state: MemberState, limits: Limits, *, accepted: bool = False) -> None:
        self.state = state
        self.count = 1
        self.accepted = accepted
        self._limits = limits
        self._off_x_m = self._off_y_m = self._climbed_m = 0.0

    def continued(self, state: MemberState) -> bool:
        """Take a state that passes the fast check, as nearly every one does; return whether it has."""
        before, now = self.state.numbers, state.numbers
        step_s = now.time_s - before.time_s
        x, y = now.position_m
        before_x, before_y = before.position_m
        x_rate, y_rate = now.velocity_m_s
        before_x_rate, before_y_rate = before.velocity_m_s
        half_s = step_s / 2.0
        off_x = _KEPT * self._off_x_m + x - before_x - half_s * (x_rate + before_x_rate)
        off_y = _KEPT * self._off_y_m + y - before_y - half_s * (y_rate + before_y_rate)
        if (
            0.0 < step_s < _SOON_S
            and -_QUITE_M < off_x < _QUITE_M
            and -_QUITE_M < off_y < _QUITE_M
            and -_QUITE_M_S < x_rate - before_x_rate < _QUITE_M_S
            and -_QUITE_M_S < y_rate - before_y_rate < _QUITE_M_S
            and -_CRUISE_M_S < x_rate < _CRUISE_M_S
            and -_CRUISE_M_S < y_rate < _CRUISE_M_S
            and -_CLIMBED_M < now.altitude_m - before.altitude_m < _CLIMBED_M
        ):
            self._off_x_m, self._off_y_m, self.state = off_x, off_y, state
            self.count += 1
            return True
        return False

    def misfit(self, state: MemberState, clock_off_s: float) -> str:
        """Take a state unless it contradicts the last one, in either order; return the contradiction, empty if none."""
        before, limits = self.state, self._limits.safety
        step_s = state.time_s - before.time_s
        apart_s = abs(step_s)
        speed_m_s, before_m_s = hypot(*state.velocity_m_s), hypot(*before.velocity_m_s)
        fastest_m_s = SETPOINTS_FASTER * limits.speed_max_m_s + SPEED_OFF_M_S
        if speed_m_s > fastest_m_s and state.tactic != _PILOT:
            return f"reports {speed_m_s:.1f} m/s"
        agile_m_s2 = AGILE * limits.acceleration_max_m_s2
        changed_m_s = hypot(*_less(state.velocity_m_s, before.velocity_m_s))
        if changed_m_s > VELOCITY_OFF_M_S + agile_m_s2 * apart_s:
            return f"reports a velocity change of {changed_m_s:.1f} m/s within {apart_s:.1f} s"
        # After a longer silence the accumulated difference restarts at 0.
        kept = _KEPT if apart_s < _AGE_MAX_S else 0.0
        moved, summed = _less(state.position_m, before.position_m), _sum(state.velocity_m_s, before.velocity_m_s)
        off_x = kept * self._off_x_m + moved[0] - step_s / 2.0 * summed[0]
        off_y = kept * self._off_y_m + moved[1] - step_s / 2.0 * summed[1]
        sigma_m = min(max(state.position_sigma_m, before.position_sigma_m), SIGMA_MAX_M)
        # A small clock error shows along the direction of flight only.
        timing_m = (TIMING_S + clock_off_s) * min(max(speed_m_s, before_m_s), fastest_m_s)
        turned_m = min(agile_m_s2 / 4.0 * apart_s, 2.0 * fastest_m_s) * apart_s
        allowed_m = self._limits.doubt_m + SIGMAS * sigma_m + turned_m
        if _beyond((off_x, off_y), summed, timing_m) > allowed_m:
            return f"reports a position {hypot(off_x, off_y):.1f} m from the one predicted from its states"
        climbed_m = state.altitude_m - before.altitude_m
        able_m = CLIMB_MAX_M_S * apart_s
        climbed_m = kept * self._climbed_m + climbed_m - min(max(climbed_m, -able_m), able_m)
        if abs(climbed_m) > ALTITUDE_OFF_M:
            return f"reports an altitude {climbed_m:+.1f} m beyond its climb limit"
        if step_s > 0.0:
            off_x, off_y = (off_x, off_y) if kept else (0.0, 0.0)
            self._off_x_m, self._off_y_m, self._climbed_m, self.state = off_x, off_y, climbed_m, state
        self.count += 1
        return ""


class ConsistencyCheck:
    """Keeps the tracks about every peer, and selects the one that is the peer's state."""

    def __init__(self, limits: Limits, clocks: ClockWatch, excuses: Container[str]) -> None:
        """Take the limits, the clock steps, and `excuses`: the alerts that explain contradictions."""
        self._limits = limits
        self._clocks = clocks
        self._excuses = excuses
        self._tracks: dict[int, list[PeerTrack]] = {}
        self._inconsistencies: dict[int, Inconsistency] = {}
        self.contested: set[int] = set()
        """The peers with more than one track, now or recently."""

    def accepts(self, state: MemberState, *, known: bool) -> bool:
        """Return whether a state is accepted as its sender's; one that contradicts a `known` peer is not."""
        sender = state.numbers.sender
        tracks = self._tracks.get(sender)
        if tracks is None:
            self._tracks[sender] = [PeerTrack(state, self._limits, accepted=True)]
            return True
        if tracks[0].continued(state):
            return True
        step = self._clocks.off.get(sender)
        clock_off_s = 0.0 if step is None else abs(step.by_s)
        why = tracks[0].misfit(state, clock_off_s)
        return not why or self._contradicted(tracks, state, clock_off_s, why, known=known)

    def _contradicted(
        self, tracks: list[PeerTrack], state: MemberState, clock_off_s: float, why: str, *, known: bool
    ) -> bool:
        track = next((each for each in tracks[1:] if not each.misfit(state, clock_off_s)), None)
        if track is None:
            track = PeerTrack(state, self._limits)
            confirmed = [each for each in tracks[1:] if each.accepted or each.count >= CONFIRMED]
            tracks[1:] = [*confirmed[2 - TRACKS_MAX :], track]
        self.contested.add(state.sender)
        excused = self.explains(state) or state.tactic == _PILOT
        if not excused:
            inconsistency = self._inconsistencies.setdefault(
                state.sender, Inconsistency(state.time_s, state.time_s, 0, why)
            )
            inconsistency.last_s, inconsistency.count, inconsistency.why = state.time_s, inconsistency.count + 1, why
        if not excused and (known or track.count < CONFIRMED):
            return False
        tracks.remove(track)
        tracks.insert(0, track)
        track.accepted = True
        return True

    def expire(self, now_s: float, time_scale: float) -> None:
        """Drop expired tracks and inconsistencies; a track accepted before is kept as long as a silent peer."""
        for sender in tuple(self.contested):
            tracks, inconsistency = self._tracks[sender], self._inconsistencies.get(sender)
            for track in tracks[1:]:
                held_s = self._limits.safety.lost_avoided_s if track.accepted else _AGE_MAX_S * time_scale
                if now_s - track.state.time_s > held_s:
                    tracks.remove(track)
            if inconsistency is not None and now_s - inconsistency.last_s > REPORTED_FOR_S:
                del self._inconsistencies[sender]
            elif inconsistency is None and len(tracks) == 1:
                self.contested.discard(sender)

    def explains(self, state: MemberState) -> bool:
        """Return whether a vehicle's own alert explains why its states contradict each other."""
        return state.alert in self._excuses

    @property
    def inconsistencies(self) -> Mapping[int, Inconsistency]:
        """The peers with enough contradictions to be reported."""
        return {
            sender: inconsistency
            for sender, inconsistency in self._inconsistencies.items()
            if inconsistency.count >= CONFIRMED
        }

    def elsewhere(self) -> tuple[MemberState, ...]:
        """Return the newest state of each track that is not accepted: the peer may be there as well."""
        return tuple(track.state for sender in sorted(self.contested) for track in self._tracks[sender][1:])


def _beyond(off_m: Metres2, way: Metres2, along_m: float) -> float:
    """Return the length of an offset, ignoring up to `along_m` along a direction."""
    length = hypot(*way)
    if length == 0.0:
        return hypot(*off_m)
    x, y = way[0] / length, way[1] / length
    along, across = off_m[0] * x + off_m[1] * y, off_m[1] * x - off_m[0] * y
    return hypot(max(abs(along) - along_m, 0.0), across)


def _less(here: Metres2, there: Metres2) -> Metres2:
    return here[0] - there[0], here[1] - there[1]


def _sum(one: Metres2, other: Metres2) -> Metres2:
    return one[0] + other[0], one[1] + other[1]
