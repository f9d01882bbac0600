"""`cordon sweep plot`: the figure of a sweep, and its worst cases."""

import difflib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.options import RESULT, Json
from gcs.errors import Exit, InputError
from gcs.metrics.json_output import json_output

if TYPE_CHECKING:
    from gcs.sweep.columns import Column, Row
    from gcs.sweep.plan import SweepPlan


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class PlotOptions:
    """Options of `cordon sweep plot`."""

    folder: Annotated[Path, Parameter(help="The folder of a sweep, finished or not.")] = field(kw_only=False)
    over: Annotated[
        tuple[str, ...],
        Parameter(negative="", help="Varied key of the axes, at most two; default: the first two."),
    ] = ()
    metric: Annotated[
        tuple[str, ...],
        Parameter(negative="", help="Column of the table to draw; may be repeated. Default: the main metrics."),
    ] = ()
    out: Annotated[
        Path | None, Parameter(group=RESULT, help="Figure, a .png, .svg or .pdf; default: sweep.png in the folder.")
    ] = None
    worst: Annotated[
        int,
        Parameter(group=RESULT, help="How many runs to list that failed or do not hold.", validator=Number(gte=0)),
    ] = 3
    json: Json = False


def plot(options: PlotOptions) -> Exit:
    """Draw a sweep's metrics over one or two of its keys, and list its worst runs with commands to fly them again.

    Example: cordon sweep plot results --over encirclement.radius_m --metric closest_approach_m
    """
    from gcs.cli.output import check_file, print_result, writing
    from gcs.console.terminal import print_line
    from gcs.report.figure import METADATA
    from gcs.sweep.figure import Picture, save_sweep_figure
    from gcs.sweep.folder import SweepFolder
    from gcs.sweep.summary import SweepSummary
    from gcs.sweep.table import full_rows, table_columns
    from gcs.sweep.worst import worst_cases

    path = options.out or options.folder / "sweep.png"
    folder = SweepFolder(options.folder)
    plan, rows = folder.read()
    check_file("--out", path, tuple(METADATA))
    full = full_rows(plan, rows)
    metrics = _metrics(options.metric, table_columns(plan, full), full)
    summary = SweepSummary.of(len(plan.runs), rows.values())
    title = f"{folder.mission()}, {summary.line}"
    with writing("--out", path):
        save_sweep_figure(Picture(title, metrics, _over(options.over, plan), full), path)
    cases = worst_cases(plan, rows, metrics, folder.mission(), options.worst)
    print_line(f"{options.folder}: {summary.line}")
    for case in cases:
        print_line("; ".join(case.reasons))
        print_line(f"    {case.command}")
    print_line(f"figure: {path}")
    if options.json:
        print_result(json_output({**summary.to_dict(), "figure": str(path), "worst": list(map(asdict, cases))}))
    return Exit.HOLDS


def _over(given: Sequence[str], plan: "SweepPlan") -> tuple[str, ...]:
    """Return the keys of the axes: the seed if no key varies. Raises InputError."""
    varied = [each.place for each in plan.variations]
    if len(given) > 2:
        raise InputError([f"--over: at most two keys (given: {', '.join(given)})"])
    if faults := [
        f"--over {key}: the sweep does not vary it (it varies {', '.join(varied) or 'seeds alone'})"
        for key in given
        if key not in varied
    ]:
        raise InputError(faults)
    return tuple(given or varied[:2] or ["seed"])


def _metrics(given: Sequence[str], columns: "Sequence[Column]", rows: "Sequence[Row]") -> "tuple[Column, ...]":
    """Return the columns to draw, by default those of the main metrics that have a value; raises InputError."""
    from gcs.sweep.figure import USUAL

    numbers = {each.name: each for each in columns if each.kind is not str}
    faults = []
    for name in given:
        if name not in numbers:
            near = difflib.get_close_matches(name, numbers, n=3)
            hint = f"did you mean {', '.join(near)}?" if near else "docs/sweeps.md lists them"
            faults.append(f"--metric {name}: the table has no numeric column of this name; {hint}")
    known = [name for name in given or USUAL if any(name in row for row in rows)]
    if not known and not faults:
        faults = ["no finished run has a value of these metrics; nothing to draw"]
    if faults:
        raise InputError(faults)
    return tuple(numbers[name] for name in known)
