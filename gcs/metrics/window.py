"""The window of the ring metrics as text: its begin, its end and the reason."""

from gcs.metrics.result import FlightResult

SHORT_S = 60.0
"""The text says "only" for a window shorter than this."""


def window_line(result: FlightResult) -> str:
    """Return the part of the flight over which the ring is judged, and the reason; empty without a ring.

    The text reports a ring that settled and left its limits later.
    """
    if result.window_s is None:
        return ""
    (begins_s, ends_s), ring = result.window_s, result.ring
    only = "only " if ends_s - begins_s < SHORT_S else ""
    window = f"ring judged over {only}{ends_s - begins_s:.1f} s, from {begins_s:.1f} to {ends_s:.1f} s"
    if ring.unsettled_at_s is None:
        settles = ring.settling_time_s is not None
        why = "from settling to the end" if settles else "did not settle: last quarter of the flight"
        return f"{window}: {why}"
    settled = f"settled at {ring.first_settled_at_s:.1f} s, left its limits at {ring.unsettled_at_s:.1f} s"
    if ring.settling_time_s is None:
        return f"{window}: {settled}, did not settle again: last quarter of the flight"
    return f"{window}: {settled}, settled again at {begins_s:.1f} s"
