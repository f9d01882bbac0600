"""The common parts of live and recorded pictures of a vehicle: its surroundings, its alert, its GPS fix as text."""

from collections.abc import Mapping

from agents.safety.failsafe import Condition
from agents.safety.fence import Fence
from gcs.console.advice import Severity, advice, severity
from gcs.mission.geometry import nearest_other
from gcs.station.picture import Pair

SILENT, LINK_CUT = "silent", "link cut"
_ADVISED_AS = {SILENT: Condition.PEER_SILENT.value, LINK_CUT: Condition.TELEMETRY_STALE.value}


class Surroundings:
    """The distances of a vehicle to the others and to its fence."""

    def __init__(self, fence_of: Mapping[int, Fence]) -> None:
        self._fence_of = fence_of

    def nearest(self, vehicle_id: int, places_m: Mapping[int, Pair]) -> tuple[int | None, float | None]:
        """Return the nearest other vehicle and its distance [m], from the positions (x, y) of all; None without one."""
        return nearest_other(vehicle_id, places_m) or (None, None)

    def fence_margin_m(self, vehicle_id: int, places_m: Mapping[int, Pair]) -> float | None:
        """Return the distance to the vehicle's fence, negative outside; None without a fence or a position."""
        fence, place_m = self._fence_of.get(vehicle_id), places_m.get(vehicle_id)
        return None if fence is None or place_m is None else fence.clearance_m(place_m)


def vehicle_alert(alert: str, *, is_lost: bool) -> tuple[str, str, Severity]:
    """Return an alert, the operator's action and the severity; of a vehicle that `is_lost` in flight it is an alarm."""
    how_grave: Severity = "alarm" if alert and is_lost else severity(alert)
    return alert, advice(_ADVISED_AS.get(alert, alert)), how_grave


def fix_words(dimensions: int | None) -> str:
    """Return a GPS fix as text, empty if it is unknown."""
    if dimensions is None:
        return ""
    return f"{dimensions}D" if dimensions else "no fix"
