"""Why the errors of an estimate do not fit its covariance, in words, where the table shows that they do not."""

from collections.abc import Sequence

from gcs.metrics.ending import named
from gcs.report.evidence.estimate_errors import NEES_EXPECTED, EstimateError, consistency

_OPTIMISTIC = {
    "own": "Likely causes: an error of the autopilot's position that changes slowly, or more acceleration than the "
    "filter models",
    "target": "Likely causes: errors of the vehicles' own positions, or manoeuvres beyond those that the filter models",
}
_PESSIMISTIC = {
    "own": "Likely cause: the filter models more noise, or more acceleration, than there was",
    "target": "Likely cause: the filter models more noise, or more manoeuvres, than there were",
}
_NO_TRUTH = "The reference has errors of its own, which the bounds do not cover"


def consistency_note(name: str, errors: Sequence[EstimateError], ids: Sequence[int], *, true: bool) -> str:
    """Return for which vehicles the table contradicts a consistent filter, and why; empty where it does not.

    `name` is `own` or `target`; `ids` are the vehicles' by row; `true` is whether the reference is the truth.
    """
    found = [(ids[error.row], each) for error in errors if (each := consistency(error)) is not None]
    optimistic = [(vehicle_id, each) for vehicle_id, each in found if each.is_optimistic]
    pessimistic = [(vehicle_id, each) for vehicle_id, each in found if each.is_pessimistic]
    whose = "position" if name == "own" else "target"
    notes = []
    if optimistic:
        least = min(each.within for _, each in optimistic)
        times = (max(each.nees for _, each in optimistic) / NEES_EXPECTED) ** 0.5
        notes.append(
            f"In this flight, errors of the {whose} estimate of {named(i for i, _ in optimistic)} leave the bounds "
            f"more often: down to {least:.1%} are within, and they are up to {times:.1f} times as "
            "large as the covariance states. "
            f"{_OPTIMISTIC[name] if true else _NO_TRUTH}."
        )
    if pessimistic:
        least = min(each.nees for _, each in pessimistic)
        notes.append(
            f"In this flight, the covariance of the {whose} estimate of {named(i for i, _ in pessimistic)} is too "
            f"large: the NEES is down to {least:.2f}. {_PESSIMISTIC[name]}."
        )
    return " ".join(notes)
