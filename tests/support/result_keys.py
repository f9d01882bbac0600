"""The keys of what commands print with `--json`, in their order."""

from dataclasses import fields

from gcs.flight.recovery_record import RecoveredVehicle, RecoveryResult
from gcs.metrics.catalogue import VERDICTS
from gcs.metrics.departures import Departure
from gcs.metrics.ending import TeamEnding
from gcs.metrics.references import EngagementResult
from gcs.metrics.result import FlightResult, LoopResult
from gcs.metrics.reynolds import ReynoldsResult
from gcs.metrics.ring import RingResult
from gcs.metrics.transitions import TransitionResult
from gcs.metrics.vehicles import VehicleResult

_PARTS = {
    "ended": TeamEnding,
    "vehicles": VehicleResult,
    "ring": RingResult,
    "transitions": TransitionResult,
    "reynolds": ReynoldsResult,
    "engagement": EngagementResult,
    "departures": Departure,
    "loop": LoopResult,
}


def _keys(part: type) -> list[str]:
    return [each.name for each in fields(part) if each.name != "rings"]


RESULT_KEYS = {
    "": " ".join(dict.fromkeys(["format", "mission", "ended", *_keys(FlightResult)])),
    **{name: " ".join(_keys(part)) for name, part in _PARTS.items()},
    "verdicts": " ".join(each.name for each in VERDICTS),
}
"""The result of a flight, of sim, fly and report: the whole, and its parts by name."""
RING_KEYS = {
    "rings[]": "name target window_s vehicles ring transitions estimate verdicts not_judged",
    "vehicles of rings[]": " ".join(
        each for each in _keys(VehicleResult) if each != "tactic" and not each.startswith("formation")
    ),
}
"""What a result of several rings has beside these: each ring, and the vehicles on it."""
OUTPUT_KEYS = {
    "missions": "format missions",
    "missions[] of missions": (
        "mission vehicles shape radius_m angular_rate_rad_s target_speed_m_s duration_s description"
    ),
    "zones import": "format file file_format fence no_fly rally not_taken written",
    "fence of zones import": "name area_m2 corners_m center_m radius_m",
    "no_fly[] of zones import": "name area_m2 corners_m center_m radius_m floor_m ceiling_m",
    "rally[] of zones import": "name place_m",
    "tiles": "format out source tiles stored missing bounds_deg level_min level_max problem",
    "check": "format mission grade findings",
    "findings[] of check": "grade subject check found why next_step temporary",
    "sweep": "format mission table runs finished hold do_not_hold not_judged failed verdicts errors",
    "sweep plot": "format runs finished hold do_not_hold not_judged failed verdicts errors figure worst",
    "worst[] of sweep plot": "reasons command",
    "start": "format mission started vehicles",
    "vehicles[] of start": "vehicle state reason clock_off_s answer",
    "recover": " ".join(["format", *_keys(RecoveryResult)]),
    "vehicles[] of recover": " ".join(_keys(RecoveredVehicle)),
    "drill": "format mission holds drills",
    "drills[] of drill": "fault expected limit_s measured_s holds detail",
    "excite --preview": "format mission vehicle profile box_m altitude_m speed_max_m_s preview",
    "relay": "format duration_s up down",
    "report --compare": "format names flights engaged_at_s differences",
    "report of a log of another program": "format logs",
    "logs[] of report": (
        "path format sha256 vehicle autopilot firmware duration_s series modes setpoint_distance_rms_m missing notes "
        "damaged"
    ),
    "replay": "format log mission same other_versions tolerance vehicles",
    "identify": "format verdict reasons method vehicle autopilot firmware logs duration_s parts plant",
    "flights": "format folder flights unread airborne_s",
    "flights[] of flights": (
        "log began mission source latitude_deg longitude_deg crew vehicles airborne_s ended verdicts faults damaged "
        "copy_of"
    ),
    "vehicles[] of flights": "id kind airborne_s",
    "unread[] of flights": "log fault",
}
"""Other outputs and their lists, by command."""
