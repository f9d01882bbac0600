"""The estimates of the mission's targets: of one, or of several of which the vehicle follows that of its ring."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Final

from agents.settings.config import AgentConfig
from estimation.filters.target import TargetFilter
from estimation.filters.target_tracks import TargetTracks
from estimation.state import Sighting, TargetEstimate
from estimation.vectors import Pair

NAMELESS = ""
"""Stands for the only target of a mission, which has no name."""
_KEPT: Final = 500
"""The number of sightings that are kept: more than come in the time that an estimate depends on."""


class TargetEstimates:
    """Estimates all targets of a mission from the sightings of all vehicles; `followed` is that of the vehicle's ring.

    Each target has a filter. Sightings that do not name one of several targets have to be associated: from the first of
    them on, tracks take the place of the filters (`TargetTracks`), which takes several times the computing time.
    """

    def __init__(self, config: AgentConfig) -> None:
        self._settings = config.target_filter
        self._filters = {name: TargetFilter(config.target_filter) for name in config.targets or (NAMELESS,)}
        self._tracks: TargetTracks | None = None
        self._kept: deque[Sighting] = deque(maxlen=_KEPT)
        self._resets_before = 0
        self.followed = config.target or NAMELESS
        self.estimates: Mapping[str, TargetEstimate] = {}
        """The newest estimates by name, without those of targets that are not known."""

    def follow(self, name: str | None) -> None:
        """Follow another target."""
        before = self.resets
        self.followed = name or NAMELESS
        self._resets_before += before - self.resets

    def sight(self, sightings: Sequence[Sighting]) -> None:
        """Take sightings of any sensors, in any order."""
        if self._tracks is not None:
            self._tracks.sight(*sightings)
        elif len(self._filters) == 1 and NAMELESS in self._filters:
            self._filters[NAMELESS].sight(*sightings)
        elif all(each.target is not None for each in sightings):
            self._kept.extend(sightings)
            for name, target in self._filters.items():
                target.sight(*[each for each in sightings if each.target == name])
        else:
            before = self.resets
            self._tracks = TargetTracks(self._settings, self._filters)
            self._tracks.sight(*self._kept, *sightings)
            self._kept.clear()
            self._resets_before += before - self.resets

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Estimate all targets at `now_s`; return the estimate of the followed one, None if it is not known."""
        if self._tracks is None:
            known = {name: target.estimate(now_s) for name, target in self._filters.items()}
            self.estimates = {name: each for name, each in known.items() if each is not None}
        else:
            self.estimates = {each.track_id: each.estimate for each in self._tracks.tracks(now_s) if each.named}
        return self.estimates.get(self.followed)

    def position_m(self, name: str | None) -> Pair | None:
        """Return the newest position of a target, None if it is not known."""
        target = self.estimates.get(name or NAMELESS)
        return None if target is None else (target.mean.item(0), target.mean.item(1))

    @property
    def sighted_s(self) -> float:
        """The time of the newest sighting of the followed target that was used [s], 0 before any."""
        followed = self._followed
        return 0.0 if followed is None else followed.sighted_s

    @property
    def resets(self) -> int:
        """How often the estimate of a target that was followed then has restarted."""
        followed = self._followed
        return self._resets_before + (0 if followed is None else followed.resets)

    @property
    def _followed(self) -> TargetFilter | None:
        return self._filters.get(self.followed) if self._tracks is None else self._tracks.filter(self.followed)
