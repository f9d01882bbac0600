"""The window of the ring metrics in words: from when to when, and why."""

from gcs.metrics.result import FlightResult

SHORT_S = 60.0
"""A ring judged over less is said to be."""


def window_line(result: FlightResult) -> str:
    """Return over which part of the flight the ring is judged, and why; empty without a ring.

    A ring that settled and left its limits later is reported as such.
    """
    if result.window_s is None:
        return ""
    (begins_s, ends_s), ring = result.window_s, result.ring
    only = "only " if ends_s - begins_s < SHORT_S else ""
    window = f"ring judged over {only}{ends_s - begins_s:.1f} s, from {begins_s:.1f} to {ends_s:.1f} s"
    if ring.unsettled_at_s is None:
        why = "did not settle: the last quarter" if ring.settling_time_s is None else "from settling to the end"
        return f"{window}: {why}"
    settled = f"settled at {ring.first_settled_at_s:.1f} s and unsettled at {ring.unsettled_at_s:.1f} s"
    again = "not again: the last quarter" if ring.settling_time_s is None else f"settled again at {begins_s:.1f} s"
    return f"{window}: it {settled}, {again}"
