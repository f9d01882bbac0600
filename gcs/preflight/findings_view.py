"""The findings of a preflight check as a table, as a JSON object, and as an exit code."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gcs.errors import Exit
from gcs.metrics.json_output import json_output
from gcs.preflight.findings import MISSION, Finding, Grade, Subject, subjects_text
from gcs.preflight.preflight import worst

STYLES = {Grade.REFUSE: "bold red", Grade.WARNING: "yellow", Grade.PASS: "green"}
SUBJECT_WIDTH = 20
HEADLINES = {
    Grade.REFUSE: "not fit to fly",
    Grade.WARNING: "fit to fly, with warnings",
    Grade.PASS: "fit to fly",
}


def findings_view(mission: str, findings: Sequence[Finding], *, passes: bool = False) -> RenderableType:
    """Return the findings as a table, refusals last; a finding of several vehicles is one row with all their ids.

    Without `passes` the passed checks are only counted.
    """
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(max_width=SUBJECT_WIDTH)
    table.add_column()
    alike: dict[Finding, list[Subject]] = {}
    by_grade = [each for grade in reversed(Grade) for each in findings if each.grade is grade]
    for finding in (each for each in by_grade if passes or each.grade is not Grade.PASS):
        alike.setdefault(replace(finding, about=MISSION), []).append(finding.about)
    for finding, subjects in alike.items():
        cell = Text(finding.found)
        if finding.grade is not Grade.PASS:
            cell.append(f"\nwhy: {finding.why}\nnext: {finding.next_step}", style="dim")
        table.add_row(Text(finding.grade.value, style=STYLES[finding.grade]), Text(subjects_text(subjects)), cell)
    grade = worst(findings)
    count = Counter(finding.grade for finding in findings)
    counted = ", ".join(f"{count[each]} {each.value}" for each in Grade)
    return Group(table, Text(f"{mission}: {HEADLINES[grade]} ({counted})", style=STYLES[grade]))


def findings_json(mission: str, findings: Sequence[Finding]) -> str:
    """Return the findings as one JSON object on one line; `grade` at the top is the most severe."""
    listed = [_plain(finding) for finding in findings]
    return json_output({"mission": mission, "grade": worst(findings).value, "findings": listed})


def _plain(finding: Finding) -> dict[str, object]:
    said = {"grade": finding.grade.value, "subject": finding.subject}
    return said | {name: value for name, value in asdict(finding).items() if name not in ("grade", "about")}


def exit_code(findings: Sequence[Finding]) -> Exit:
    """Return the exit code: only a refusal is a failure."""
    return Exit.REFUSED if worst(findings) is Grade.REFUSE else Exit.HOLDS
