"""The target's last place for the operator's page, once no vehicle has an estimate of it any more."""

from math import hypot

from msgspec.structs import replace

from gcs.mission.mission import Mission
from gcs.station.picture import TargetPicture


class SeenTarget:
    """Keeps the newest estimate of the target; times are seconds of one clock."""

    def __init__(self, mission: Mission) -> None:
        self._planned_m_s = mission.target.motion.speed_max_m_s
        self._coast_s = mission.target_filter.coast_s
        self.forget()

    def forget(self) -> None:
        """Forget the target: another flight begins."""
        self._last: tuple[TargetPicture, float] | None = None
        self._speed_m_s = self._planned_m_s

    def picture(self, estimate: TargetPicture | None, now_s: float) -> TargetPicture | None:
        """Return the present estimate, or else the last one as that of a lost target; None before the first.

        A lost target moves at most as fast as planned or, if that was faster, as it did when it was seen last.
        """
        if estimate is None:
            return None if self._last is None else self._lost(*self._last, now_s)
        self._last = estimate, now_s
        if estimate.sighting_age_s <= self._coast_s:
            self._speed_m_s = max(self._planned_m_s, hypot(*estimate.velocity_m_s))
        return estimate

    def _lost(self, last: TargetPicture, estimated_s: float, now_s: float) -> TargetPicture:
        age_s = last.sighting_age_s + now_s - estimated_s
        return replace(last, velocity_m_s=(0.0, 0.0), sighting_age_s=age_s, lost_speed_m_s=self._speed_m_s)
