"""The keys of what commands print with `--json`, in their order."""

RESULT_KEYS = {
    "": (
        "format mission ended seed source reference duration_s window_s vehicles ring transitions reynolds "
        "closest_approach_m guard_interventions guard_causes loop verdicts wall_time_s realtime_factor events estimate "
        "truth_missing engagement faults kinds"
    ),
    "ended": "how reason vehicles",
    "vehicles": (
        "id engaged_at_s tactic radius_error_rms_m radius_error_max_m angular_rate_mean_rad_s "
        "angular_rate_error_rms_rad_s formation_speed_error_rms_m_s formation_spacing_error_rms_m"
    ),
    "ring": "settling_time_s spacing_error_rms_deg spacing_error_max_deg first_settled_at_s unsettled_at_s",
    "transitions": (
        "begins_at_s members settling_time_s speed_max_m_s forwards_min_m_s acceleration_max_m_s2 "
        "spacing_overshoot_deg spacing_monotonic"
    ),
    "reynolds": "formation ring flight",
    "engagement": "to_engage engaged",
    "loop": "rate_hz ticks missed tick_p50_us tick_p99_us",
    "verdicts": "C1 C2 C3 formation separation engaged",
}
"""The result of a flight, of sim, fly and report: the whole, and its parts by name."""
OUTPUT_KEYS = {
    "missions": "format missions",
    "missions[] of missions": (
        "mission vehicles shape radius_m angular_rate_rad_s target_speed_m_s duration_s description"
    ),
    "check": "format mission grade findings",
    "findings[] of check": "grade subject check found why next_step temporary",
    "sweep": "format mission table runs finished hold do_not_hold failed verdicts errors",
    "sweep plot": "format runs finished hold do_not_hold failed verdicts errors figure worst",
    "worst[] of sweep plot": "reasons command",
    "start": "format mission started vehicles",
    "vehicles[] of start": "vehicle state reason clock_off_s answer",
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
}
"""Other outputs and their lists, by command."""
