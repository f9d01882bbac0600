"""The target's last place for the operator's page, once no vehicle has an estimate of it any more."""

from math import hypot

from msgspec.structs import replace

from gcs.mission.mission import Mission, TargetSection
from gcs.station.picture import TargetPicture


class SeenTarget:
    """Keeps the newest estimate of a target; times are seconds of one clock."""

    def __init__(self, mission: Mission, target: TargetSection) -> None:
        self._planned_m_s = target.speed_max_m_s
        self._filter = mission.target_filter
        self._last: tuple[TargetPicture, float] | None = None

    def forget(self) -> None:
        """Forget the target: another flight begins."""
        self._last = None

    def picture(self, estimate: TargetPicture | None, now_s: float) -> TargetPicture | None:
        """Return the present estimate, or else the last one after a sighting as that of a lost target; None without.

        A lost target may move as fast as planned or as when it was seen last, and faster by the manoeuvre of the
        target filter.
        """
        if estimate is None:
            return None if self._last is None else self._lost(*self._last, now_s)
        if self._last is None or estimate.sighting_age_s <= self._filter.coast_s:
            self._last = estimate, now_s
        return estimate

    def _lost(self, last: TargetPicture, estimated_s: float, now_s: float) -> TargetPicture:
        age_s = last.sighting_age_s + now_s - estimated_s
        speed_m_s = max(self._planned_m_s, hypot(*last.velocity_m_s)) + self._filter.manoeuvre_speed_m_s
        return replace(last, velocity_m_s=(0.0, 0.0), sighting_age_s=age_s, lost_speed_m_s=speed_m_s)
