"""Speed and acceleration limits from the autopilot's parameters in logs."""

from collections.abc import Sequence

from estimation.profile.profile import Autopilot, LimitsSection
from gcs.preflight.findings import AutopilotKind
from gcs.preflight.mission import ACCELERATION_LIMITS, SPEED_LIMITS
from gcs.vehicle_logs.vehicle_log import VehicleLog

_KINDS: dict[Autopilot, AutopilotKind] = {"px4": AutopilotKind.PX4, "ardupilot": AutopilotKind.ARDUPILOT}


def limits_in(logs: Sequence[VehicleLog], autopilot: Autopilot) -> tuple[LimitsSection, tuple[str, ...]]:
    """Return the limits of speed and acceleration (None if no log has the parameter), and the parameters' names."""
    kind, named = _KINDS[autopilot], list[str]()
    values: list[float | None] = []
    for known in (SPEED_LIMITS[kind], ACCELERATION_LIMITS[kind]):
        held = [(name, unit * log.parameters[name]) for name, unit in known for log in logs if name in log.parameters]
        held = [(name, value) for name, value in held if 0.0 < value <= 100.0]
        named += [held[-1][0]] if held else []
        values.append(held[-1][1] if held else None)
    speed_m_s, acceleration_m_s2 = values
    return LimitsSection(speed_max_m_s=speed_m_s, acceleration_max_m_s2=acceleration_m_s2), tuple(named)
