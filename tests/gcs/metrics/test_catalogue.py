"""The catalogue names what exists: a verdict that a row misspells would never be judged."""

from dataclasses import fields

from gcs.metrics.catalogue import FLIGHT, FLOCKING, VEHICLE, VERDICTS, Verdicts
from gcs.metrics.references import DesiredRing, VerdictTolerances

JUDGED = [metric.judged for metric in (*FLIGHT, *VEHICLE) if metric.judged is not None]


def test_every_verdict_has_a_field_and_what_it_judges() -> None:
    assert [each.name for each in fields(Verdicts)] == [each.name.lower() for each in VERDICTS]
    assert {each.verdict for each in JUDGED} == {each.name for each in VERDICTS} - {"engaged", "kept"}


def test_every_tolerance_judges_metrics_of_one_verdict() -> None:
    judges = {(each.tolerance, each.verdict) for each in JUDGED if each.tolerance}
    assert sorted(tolerance for tolerance, _ in judges) == sorted(VerdictTolerances.model_fields)
    assert {each.desired for each in JUDGED} - {""} <= {each.name for each in fields(DesiredRing)}


def test_a_metric_in_a_table_of_the_terminal_has_a_label_for_it() -> None:
    assert all(bool(each.label) == bool(each.narrow) for each in (*FLOCKING, *VEHICLE))
