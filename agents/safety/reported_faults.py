"""The conditions of the failsafe table that an autopilot and its link report."""

from collections.abc import Iterator

from agents.ports import Connection, GpsThreat, VehicleStatus
from agents.safety.failsafe import Condition

RATIO_MAX, RATIO_RESERVE = 1.0, 0.5
"""An estimator rejects a sensor at a test ratio above 1; 0.5 is the former arming limit of PX4."""
COMPASS = "compass"
"""A rejected compass is no reason to land: estimators use the others, and compasses are disturbed near steel."""
SATELLITES_MIN = 6
"""The minimum of PX4 (EKF2_REQ_NSATS) and of ArduPilot."""
FIX_DIMENSIONS = 3
LOST = {
    Connection.REMOTE_CONTROL: Condition.REMOTE_CONTROL_LOST,
    Connection.GROUND_STATION: Condition.GROUND_STATION_LOST,
}


def reported_faults(status: VehicleStatus, tilt_max_deg: float, wind_max_m_s: float) -> dict[Condition, str]:
    """Return the conditions in an autopilot's report, with the detail shown to people."""
    faults: dict[Condition, str] = {}
    if status.tilt_deg >= tilt_max_deg:
        faults[Condition.TILTED] = f"by {status.tilt_deg} degrees"
    if status.wind_m_s is not None and status.wind_m_s > wind_max_m_s:
        faults[Condition.WINDY] = f"{status.wind_m_s:.1f} m/s"
    if failing := ", ".join(_failing(status)):
        faults[Condition.ESTIMATOR_FAILING] = failing
    if degraded := ", ".join(_degraded(status)):
        faults[Condition.ESTIMATOR_DEGRADED] = degraded
    if status.link_fault:
        faults[Condition.LINK_DEGRADED] = status.link_fault
    return faults


def _failing(status: VehicleStatus) -> Iterator[str]:
    ratio = status.estimator_ratio
    if ratio is not None and ratio > RATIO_MAX and status.estimator_sensor != COMPASS:
        yield f"{status.estimator_sensor} rejected (test ratio {ratio:.1f})"
    if status.estimator_fault:
        yield status.estimator_fault
    if status.gps_threat is GpsThreat.SPOOFED:
        yield "GPS spoofed"


def _degraded(status: VehicleStatus) -> Iterator[str]:
    ratio, dimensions, satellites = status.estimator_ratio, status.gps_dimensions, status.satellites
    if ratio is not None and ratio > RATIO_RESERVE:
        yield f"{status.estimator_sensor} test ratio {ratio:.1f}"
    if dimensions is not None and dimensions < FIX_DIMENSIONS:
        yield f"GPS fix of {dimensions} dimensions" if dimensions else "no GPS fix"
    if satellites is not None and satellites < SATELLITES_MIN:
        yield f"{satellites} satellites"
    if status.gps_threat is GpsThreat.JAMMED:
        yield "GPS jammed"
