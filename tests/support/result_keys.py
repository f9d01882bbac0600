"""The JSON keys of a flight's result, in their order: the whole, and its parts by name."""

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
