"""Tracks of several targets: one target filter per track, sightings assigned by global nearest neighbour.

A *batch* is what one sensor sees at one time, each target at most once. A batch is assigned jointly: the assignment has
the greatest likelihood of all that give a track at most one sighting and a sighting to at most one track
(assignment.py). A sighting outside the gates of all tracks starts a tentative track, so outliers do not disturb.
Sightings that name their target are not assigned. Blackman and Popoli, *Design and Analysis of Modern Tracking
Systems*, 1999, chapter 6.

As in the target filter, the tracks depend on the sightings in order of time: after a late batch, those since then are
assigned again. The same sightings give the same tracks, in whatever order and in however many calls they arrive.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from math import inf, sqrt
from typing import Final

import msgspec

from estimation.filters.assignment import Assignment
from estimation.filters.planar import LEAST_M2, Motion
from estimation.filters.target import HISTORY_MAX, TargetFilter, TrackFit
from estimation.settings import TargetFilterSettings
from estimation.state import STEP_DIGITS, Sighting, TargetEstimate
from estimation.vectors import rounded

CONFIRM_SIGHTINGS: Final = 3
CONFIRM_WITHIN_S: Final = 1.5
"""A tentative track is confirmed by this many sightings within this time, and dropped when none comes for as long."""
TENTATIVE_GATE: Final = 9.0
"""The gate of tentative tracks, chi-squared with two degrees of freedom: 99 % of the sound sightings pass it. A wider
one confirms tracks of outliers."""
RESOLVED_SIGMA: Final = 2.0
"""Tracks closer than this, in standard deviations of the difference of two sightings, may exchange their targets: the
sightings of two targets at exactly this distance are assigned the wrong way round with a probability of 2.3 %."""
_CHECKPOINT_S: Final = 0.05


class PossibleExchange(msgspec.Struct, frozen=True):
    """Two tracks that came closer than the sensors resolve, and may follow each other's target since then.

    Claimed is: until `since_s` the two were apart by `RESOLVED_SIGMA` whenever a sighting could have been of either.
    At `since_s` they were not. Not claimed is that an exchange is likely: it needs more than one wrong assignment.
    Only sightings that name one of the targets end it. Tracks exchange along chains: what may exchange with a track
    may also exchange with all that this track may exchange with.
    """

    other_id: str
    since_s: float


class TargetTrack(msgspec.Struct, frozen=True):
    """A confirmed track: its identifier, estimate, and the tracks with which it may have exchanged its target.

    The identifier is the target's name, or sensor and time of the track's first sighting.
    """

    track_id: str
    named: bool
    confirmed_s: float
    estimate: TargetEstimate
    exchanges: tuple[PossibleExchange, ...] = ()

    @property
    def uncertain_since_s(self) -> float | None:
        """Since when the track's identity is uncertain [s], None if it is certain."""
        return min((each.since_s for each in self.exchanges), default=None)


class TargetTracks:
    """Tracks several targets by the sightings of all sensors.

    `names` are the targets that sightings may name; a sighting that names another is refused. A named target has a
    track from its first named sighting on, as with one target filter. Tracks without a name are confirmed by three
    sightings within `CONFIRM_WITHIN_S`. They are dropped without a sighting for as long as they had been sighted
    before, but not before `CONFIRM_WITHIN_S` and not after `stale_after_s`: a track of few outliers does not stay.

    `refused` counts sightings that were repeats, too late or of unknown names, `late` those processed after later ones.
    """

    def __init__(self, settings: TargetFilterSettings, names: Iterable[str] = ()) -> None:
        self._settings = settings
        self._names = frozenset(names)
        self._state = _TrackSet(settings, Assignment())
        self._batches: list[_Batch] = []
        self._checkpoints = [_Checkpoint((-inf, 0), self._state.copy())]
        self.refused = 0
        self.late = 0

    def sight(self, *sightings: Sighting) -> None:
        """Process sightings of any sensors, in any order; one call for several costs less than one for each."""
        newest = self._batches[-1].key if self._batches else (-inf, 0)
        changed = [key for each in sightings if (key := self._put(each, newest)) is not None]
        if not changed:
            return
        first = min(changed)
        if first <= newest:
            place = bisect_right(self._checkpoints, first, key=_checkpoint_key) - 1
            first, self._state = self._checkpoints[place].key, self._checkpoints[place].state.copy()
            del self._checkpoints[place + 1 :]
        for batch in self._batches[bisect_left(self._batches, first, key=_batch_key) :]:
            if batch.key[0] - self._checkpoints[-1].key[0] >= _CHECKPOINT_S:
                self._checkpoints.append(_Checkpoint(batch.key, self._state.copy()))
            self._state.take(batch)
        self._drop_old()

    def tracks(self, now_s: float) -> tuple[TargetTrack, ...]:
        """Return the confirmed tracks at `now_s`, in the order of their identifiers."""
        return self._state.confirmed(now_s)

    def filter(self, name: str) -> TargetFilter | None:
        """Return the filter of a named target, which is not to be changed; None before its first sighting."""
        return self._state.filter(name)

    def _put(self, sighting: Sighting, newest: "_Key") -> "_Key | None":
        """Put a sighting into its batch; return the batch's key, None if the sighting is refused."""
        key = sighting.time_s, sighting.sensor_id
        too_late = sighting.time_s < newest[0] - self._settings.late_max_s or key < self._checkpoints[0].key
        if too_late or not (sighting.target is None or sighting.target in self._names):
            self.refused += 1
            return None
        place = bisect_left(self._batches, key, key=_batch_key)
        if place == len(self._batches) or self._batches[place].key != key:
            self._batches.insert(place, _Batch(key))
        batch = self._batches[place]
        if sighting in batch.sightings:
            self.refused += 1
            return None
        self.late += key < newest
        batch.sightings.append(sighting)
        return key

    def _drop_old(self) -> None:
        # One checkpoint older than the window is kept, to restart from.
        before_s, checkpoints = self._batches[-1].key[0] - self._settings.late_max_s, self._checkpoints
        kept = sum(len(each.sightings) for each in self._batches)
        while len(checkpoints) > 1 and (checkpoints[1].key[0] < before_s or kept > HISTORY_MAX):
            del checkpoints[0]
            old = bisect_left(self._batches, checkpoints[0].key, key=_batch_key)
            kept -= sum(len(each.sightings) for each in self._batches[:old])
            del self._batches[:old]


_Key = tuple[float, int]
"""Time and sensor of a batch: batches are processed in this order."""


class _Batch:
    """What one sensor sees at one time."""

    def __init__(self, key: _Key) -> None:
        self.key: Final = key
        self.sightings: list[Sighting] = []


class _Checkpoint:
    """The tracks before the first batch that is not before `key`."""

    def __init__(self, key: _Key, state: "_TrackSet") -> None:
        self.key: Final = key
        self.state: Final = state


def _batch_key(batch: _Batch) -> _Key:
    return batch.key


def _checkpoint_key(checkpoint: _Checkpoint) -> _Key:
    return checkpoint.key


class _KeptTrack:
    """One track: its filter, when it began, and the times of its latest sightings."""

    def __init__(self, track_id: str, named: bool, target: TargetFilter) -> None:
        self.track_id: Final = track_id
        self.named: Final = named
        self.target = target
        self.began_s = inf
        self.confirmed_s = inf
        self.seen_s: list[float] = []

    def copy(self) -> "_KeptTrack":
        other = _KeptTrack(self.track_id, self.named, self.target.copy())
        other.began_s, other.confirmed_s, other.seen_s = self.began_s, self.confirmed_s, self.seen_s.copy()
        return other

    def take(self, sighting: Sighting) -> None:
        """Process a sighting of this target."""
        self.target.sight(sighting)
        self.began_s = min(self.began_s, sighting.time_s)
        self.seen_s = [*self.seen_s[1 - CONFIRM_SIGHTINGS :], sighting.time_s]
        enough = self.named or (
            len(self.seen_s) == CONFIRM_SIGHTINGS and _between(self.seen_s[0], sighting.time_s) <= CONFIRM_WITHIN_S
        )
        if enough:
            self.confirmed_s = min(self.confirmed_s, sighting.time_s)

    def exchange(self, other: "_KeptTrack") -> None:
        """Exchange the targets of two tracks, which keep their identifiers."""
        self.target, other.target = other.target, self.target
        self.began_s, other.began_s = other.began_s, self.began_s
        self.confirmed_s, other.confirmed_s = other.confirmed_s, self.confirmed_s
        self.seen_s, other.seen_s = other.seen_s, self.seen_s

    def lasts(self, now_s: float, stale_after_s: float) -> bool:
        """Return whether the track is not dropped at `now_s`."""
        if not self.seen_s:
            return False
        last_s = self.seen_s[-1]
        if self.named:
            keep_s = stale_after_s
        elif self.confirmed_s == inf:
            keep_s = CONFIRM_WITHIN_S
        else:
            keep_s = min(max(last_s - self.began_s, CONFIRM_WITHIN_S), stale_after_s)
        return _between(last_s, now_s) <= keep_s


class _TrackSet:
    """All tracks after a batch, and which pairs of them may have exchanged their targets since when."""

    def __init__(self, settings: TargetFilterSettings, assignment: Assignment) -> None:
        self._settings = settings
        self._assignment = assignment
        self._tracks: dict[str, _KeptTrack] = {}
        self._exchanges: dict[tuple[str, str], float] = {}

    def copy(self) -> "_TrackSet":
        other = _TrackSet(self._settings, self._assignment)
        other._tracks = {name: track.copy() for name, track in self._tracks.items()}
        other._exchanges = self._exchanges.copy()
        return other

    def take(self, batch: _Batch) -> None:
        """Process a batch, the newest so far."""
        now_s = batch.key[0]
        self._drop(now_s)
        sightings = sorted(batch.sightings, key=_canonical)
        named = set()
        for sighting in sightings:
            if sighting.target is not None:
                named.add(sighting.target)
                self._take_named(sighting.target, sighting)
        others = [each for each in sightings if each.target is None]
        seen = [track for name, track in self._tracks.items() if name not in named]
        confirmed = [track for track in seen if track.confirmed_s <= now_s]
        # Confirmed tracks come first, so that an outlier's track takes no sighting from them.
        gate = 2.0 * self._settings.gate_sigma**2
        left = self._assign(others, [track for track in confirmed if track.lasts(now_s, self._stale_after_s)], gate)
        left = self._assign(left, [track for track in seen if track.confirmed_s == inf], min(TENTATIVE_GATE, gate))
        for number, sighting in enumerate(left):
            track_id = f"{sighting.sensor_id}@{now_s:.3f}" + (f"#{number}" if number else "")
            self._tracks[track_id] = track = _KeptTrack(track_id, False, TargetFilter(self._settings))
            track.take(sighting)

    def filter(self, name: str) -> TargetFilter | None:
        """Return the filter of a named target, None before its first sighting."""
        track = self._tracks.get(name)
        return None if track is None else track.target

    def confirmed(self, now_s: float) -> tuple[TargetTrack, ...]:
        """Return the confirmed tracks at `now_s`."""
        found = []
        for track_id, track in sorted(self._tracks.items()):
            estimate = track.target.estimate(now_s)
            if estimate is None or track.confirmed_s == inf or not track.lasts(now_s, self._stale_after_s):
                continue
            exchanges = [PossibleExchange(other, since_s) for other, since_s in self._partners(track_id).items()]
            found.append(TargetTrack(track_id, track.named, track.confirmed_s, estimate, tuple(exchanges)))
        return tuple(found)

    @property
    def _stale_after_s(self) -> float:
        return self._settings.stale_after_s

    def _drop(self, now_s: float) -> None:
        """Drop the tracks without a name that have not been sighted for too long."""
        for track_id, track in list(self._tracks.items()):
            if not track.named and not track.lasts(now_s, self._stale_after_s):
                del self._tracks[track_id]
        gone = [pair for pair in self._exchanges if pair[0] not in self._tracks and pair[1] not in self._tracks]
        for pair in gone:
            del self._exchanges[pair]

    def _take_named(self, name: str, sighting: Sighting) -> None:
        """Process a sighting that names its target, and correct the track's identity by it."""
        if name not in self._tracks:
            self._tracks[name] = _KeptTrack(name, True, TargetFilter(self._settings))
        track = self._tracks[name]
        if not track.lasts(sighting.time_s, self._stale_after_s):
            self._take_over(track, sighting)
        elif partners := [self._tracks[each] for each in self._partners(name) if each in self._tracks]:
            fits = [(fit.squared, other.track_id) for other in partners if (fit := other.target.fit(sighting))]
            own = track.target.fit(sighting)
            if own is None and fits:
                track.exchange(self._tracks[min(fits)[1]])
            elif own is not None and not fits:
                self._settle(name)
        track.take(sighting)

    def _take_over(self, track: _KeptTrack, sighting: Sighting) -> None:
        """Give a name, that has no track, to the confirmed track without a name that its sighting fits best."""
        unnamed = [each for each in self._tracks.values() if not each.named and each.confirmed_s < inf]
        fits = [(fit.squared, each.track_id) for each in unnamed if (fit := each.target.fit(sighting))]
        if not fits:
            return
        _, other_id = min(fits)
        track.exchange(self._tracks.pop(other_id))
        for pair, since_s in list(self._exchanges.items()):
            if other_id in pair:
                del self._exchanges[pair]
                partner = pair[0] if pair[1] == other_id else pair[1]
                self._exchanges[_pair(track.track_id, partner)] = since_s

    def _assign(self, sightings: list[Sighting], tracks: list[_KeptTrack], gate: float) -> list[Sighting]:
        """Assign sightings to tracks jointly, and return those that no track has."""
        fits = [[_gated(track.target.fit(sighting), gate) for sighting in sightings] for track in tracks]
        tracks = [track for track, row in zip(tracks, fits, strict=True) if any(row)]
        fits = [row for row in fits if any(row)]
        if not fits:
            return sightings
        largest = max(fit.log_volume for row in fits for fit in row if fit is not None)
        costs = [[inf if fit is None else fit.squared + fit.log_volume for fit in row] for row in fits]
        # Not less than any cost within the gates: the gates alone decide whether a sighting can be of a track.
        chosen = self._assignment.columns(costs, gate + largest)
        self._note_exchanges(sightings, tracks, fits, chosen)
        for track, column in zip(tracks, chosen, strict=True):
            if column >= 0:
                track.take(sightings[column])
        return [sighting for column, sighting in enumerate(sightings) if column not in chosen]

    def _note_exchanges(
        self, sightings: list[Sighting], tracks: list[_KeptTrack], fits: list[list[TrackFit | None]], chosen: list[int]
    ) -> None:
        """Note the pairs of tracks that could both have an assigned sighting, and are not resolved by it."""
        for track, row, column in zip(tracks, fits, chosen, strict=True):
            one = row[column] if column >= 0 else None
            if one is None or track.confirmed_s == inf:
                continue
            for other, other_row in zip(tracks, fits, strict=True):
                fit = other_row[column]
                if other is track or fit is None:
                    continue
                if _squared_separation(one.prior, fit.prior, sightings[column]) < RESOLVED_SIGMA**2:
                    self._unite(track.track_id, other.track_id, sightings[column].time_s)

    def _unite(self, one: str, other: str, since_s: float) -> None:
        """Note that two tracks may exchange their targets, and with them all that may exchange with either."""
        if _pair(one, other) in self._exchanges:
            return
        for first in (one, *self._partners(one)):
            for second in (other, *self._partners(other)):
                if first != second:
                    self._exchanges.setdefault(_pair(first, second), since_s)

    def _settle(self, track_id: str) -> None:
        for pair in [pair for pair in self._exchanges if track_id in pair]:
            del self._exchanges[pair]

    def _partners(self, track_id: str) -> dict[str, float]:
        """Return the tracks that may have exchanged targets with a track, each with the time since when."""
        pairs = sorted(self._exchanges.items())
        return {(b if a == track_id else a): since_s for (a, b), since_s in pairs if track_id in (a, b)}


def _gated(fit: TrackFit | None, gate: float) -> TrackFit | None:
    return fit if fit is None or fit.squared <= gate else None


def _canonical(sighting: Sighting) -> tuple[tuple[float, float], tuple[float, float, float], float, float, str]:
    """Return a key that does not depend on the order in which a batch arrived."""
    return sighting.position_m, sighting.covariance_m2, sighting.importance, sighting.threat, sighting.target or ""


def _pair(one: str, other: str) -> tuple[str, str]:
    return (one, other) if one < other else (other, one)


def _between(from_s: float, to_s: float) -> float:
    """Return a difference of times in whole milliseconds: rounding must not decide about a limit."""
    return rounded(to_s - from_s, STEP_DIGITS)


def _squared_separation(one: Motion, other: Motion, sighting: Sighting) -> float:
    """Return the squared distance of two tracks, relative to the covariance of the difference of their sightings."""
    (xx, xy, _, _, yy, *_), (other_xx, other_xy, _, _, other_yy, *_) = one.spread.upper, other.spread.upper
    noise_xx, noise_xy, noise_yy = sighting.covariance_m2
    xx, xy, yy = xx + other_xx + 2.0 * noise_xx, xy + other_xy + 2.0 * noise_xy, yy + other_yy + 2.0 * noise_yy
    x, y = one.x - other.x, one.y - other.y
    # By the Cholesky factors, as in planar.py: products of variances may overflow or vanish.
    first = sqrt(xx)
    across, e = xy / first, x / first
    f = (y - across * e) / sqrt(max(yy - across * across, LEAST_M2))
    return e * e + f * f
