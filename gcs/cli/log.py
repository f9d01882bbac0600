"""`cordon log`: what can be done with log files."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from gcs.errors import Exit

log = App(
    name="log",
    help="Repair a flight log, or write the layout for its viewers.\n\n"
    "Example: cordon log layout -o cordon-layout.json",
)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RecoverOptions:
    """What `cordon log recover` is given."""

    log: Annotated[Path, Parameter(help="A log that was not closed, or that is damaged. It is not changed.")] = field(
        kw_only=False
    )
    output: Annotated[
        Path | None,
        Parameter(name=["--output", "-o"], help="Write here, in place of LOG-recovered.mcap; nothing is overwritten."),
    ] = None


@log.command
def recover(options: RecoverOptions) -> Exit:
    """Make an unclosed or damaged log readable: copy the records that are intact, and report what is missing.

    Example: cordon log recover 2026-05-04_10-00-00-case2.mcap
    """
    from gcs.cli.output import ReadingProgress
    from gcs.console.terminal import print_line
    from gcs.flightlog.recover import examine, recovered_path
    from gcs.flightlog.recover import recover as copy_intact

    path = options.log
    target = options.output or recovered_path(path)
    with ReadingProgress(path) as progress:
        found = examine(path, progress.update)
    if not found.faults:
        print_line(f"{path}: it is complete: {found.records} records of {found.seconds:.1f} s; nothing to recover")
        return Exit.HOLDS
    with ReadingProgress(path) as progress:
        recovered = copy_intact(path, target, progress.update)
    print_line(f"{target}: {recovered.records} records of {recovered.seconds:.1f} s recovered; {path} is unchanged")
    for fault in recovered.faults:
        print_line(f"incomplete: {fault}", "yellow")
    return Exit.HOLDS


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class LayoutOptions:
    """What `cordon log layout` is given."""

    output: Annotated[Path, Parameter(name=["--output", "-o"], help="The file to write, which must not exist yet.")] = (
        Path("cordon-layout.json")
    )


_LAYOUT_DEFAULTS = LayoutOptions()


@log.command
def layout(*, options: LayoutOptions = _LAYOUT_DEFAULTS) -> Exit:
    """Write the layout with which Foxglove and Lichtblick show a flight: in 3-D, on a map, and in plots.

    Example: cordon log layout -o cordon-layout.json
    """
    from importlib.resources import files

    from gcs.cli.output import writing

    text = files("gcs.viewer").joinpath("cordon-layout.json").read_text(encoding="utf-8")
    with writing("--output", options.output), options.output.open("x", encoding="utf-8") as file:
        file.write(text)
    return Exit.HOLDS
