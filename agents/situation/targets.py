"""The estimates of the mission's targets: of one, or of several of which the vehicle follows that of its ring."""

from collections.abc import Mapping, Sequence

from agents.settings.config import AgentConfig
from estimation.filters.target import TargetFilter
from estimation.filters.target_tracks import TargetTracks
from estimation.state import Sighting, TargetEstimate
from estimation.vectors import Pair

NAMELESS = ""
"""Stands for the only target of a mission, which has no name."""


class TargetEstimates:
    """Estimates all targets of a mission from the sightings of all vehicles; `followed` is that of the vehicle's ring.

    A mission of one target has one filter, one of several a filter for each (`TargetTracks`).
    """

    def __init__(self, config: AgentConfig) -> None:
        self._names = config.targets
        self._tracks = TargetTracks(config.target_filter, config.targets) if config.targets else None
        self._filter = TargetFilter(config.target_filter)
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
        if self._tracks is None:
            self._filter.sight(*sightings)
        else:
            self._tracks.sight(*sightings)

    def estimate(self, now_s: float) -> TargetEstimate | None:
        """Estimate all targets at `now_s`; return the estimate of the followed one, None if it is not known."""
        if self._tracks is None:
            followed = self._filter.estimate(now_s)
            self.estimates = {} if followed is None else {NAMELESS: followed}
            return followed
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
        return self._filter if self._tracks is None else self._tracks.filter(self.followed)
