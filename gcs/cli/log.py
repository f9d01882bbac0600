"""`cordon log`: operations on log files."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from gcs.cli.options import file_or_folder, only_file
from gcs.errors import Exit, InputError

log = App(
    name="log",
    help="Repair or export a flight log, verify its audit log, or write the layout for its viewers.\n\n"
    "Example: cordon log layout -o cordon-layout.json",
)


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RecoverOptions:
    """Options of `cordon log recover`."""

    log: Annotated[
        Path, Parameter(validator=only_file, help="A log that was not closed, or is damaged. It is not changed.")
    ] = field(kw_only=False)
    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"],
            validator=only_file,
            help="The file to write instead of LOG-recovered.mcap; must not exist yet.",
        ),
    ] = None


@log.command
def recover(options: RecoverOptions) -> Exit:
    """Make an unclosed or damaged log readable: copy the intact records to a new log, and report what is missing.

    Exit code 1 if records are lost, other than those at the end of a log that was never closed.

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
    return Exit.VERDICT_FAILED if recovered.is_damaged else Exit.HOLDS


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Options of `cordon log export`."""

    log: Annotated[Path, Parameter(validator=only_file, help="A flight log. It is not changed.")] = field(kw_only=False)
    ros2: Annotated[
        bool,
        Parameter(negative="", help="As a bag of ROS 2: poses, velocities, transforms and markers."),
    ] = False
    kml: Annotated[
        bool, Parameter(negative="", help="As KML: tracks, rings, fences, starts and events, for Google Earth.")
    ] = False
    gpx: Annotated[bool, Parameter(negative="", help="As GPX 1.1: the same as tracks, routes and waypoints.")] = False
    geojson: Annotated[bool, Parameter(negative="", help="As GeoJSON: the same as features, for QGIS.")] = False
    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"],
            help="The folder to write instead of LOG-ros2, or the file instead of LOG.kml, LOG.gpx or LOG.geojson; "
            "must not exist yet.",
        ),
    ] = None


@log.command
def export(options: ExportOptions) -> Exit:
    """Write a flight log in the format of another program.

    Exit code 1 if the log is damaged: what is readable is exported.

    Example: cordon log export --kml flight.mcap
    """
    given = [name for name in ("ros2", "kml", "gpx", "geojson") if getattr(options, name)]
    if not given:
        hint = "next: cordon log export --kml LOG"
        raise InputError([f"--ros2, --kml, --gpx or --geojson: name the format to export to; {hint}"])
    if len(given) > 1:
        raise InputError([f"--{given[0]} and --{given[1]}: name one format for each export"])
    return _export_bag(options) if options.ros2 else _export_map(options, given[0])


def _export_bag(options: ExportOptions) -> Exit:
    """Write a bag of ROS 2; raises InputError."""
    from gcs.cli.output import ExportProgress, check_folder, print_log_faults
    from gcs.console.terminal import print_line
    from gcs.flightlog.reader import read_log
    from gcs.keys.private_files import require_absent
    from gcs.ros2.bag import bag_path
    from gcs.ros2.bag import export as write_bag
    from gcs.ros2.messages import require_rosbags

    require_rosbags()
    target = options.output or bag_path(options.log)
    require_absent(target)
    check_folder("--output", target.parent)
    flight = read_log(options.log)
    print_log_faults(flight)
    with ExportProgress(options.log) as progress:
        exported = write_bag(flight, target, progress.update)
    print_line(f"{target}: {exported.messages} messages of {exported.seconds:.1f} s; next: ros2 bag play {target}")
    return Exit.VERDICT_FAILED if flight.is_damaged else Exit.HOLDS


def _export_map(options: ExportOptions, name: str) -> Exit:
    """Write a file for maps; raises InputError."""
    from gcs.cli.output import ExportProgress, check_folder, print_log_faults
    from gcs.console.terminal import print_line
    from gcs.flightlog.reader import read_log
    from gcs.keys.private_files import require_absent, write
    from gcs.report.maps.formats import FORMATS
    from gcs.report.maps.mapped_flight import mapped_flight

    target = options.output or options.log.with_suffix(f".{name}")
    require_absent(target)
    check_folder("--output", target.parent)
    flight = read_log(options.log)
    print_log_faults(flight)
    with ExportProgress(options.log) as progress:
        mapped = mapped_flight(flight, progress.update)
    write(target, FORMATS[name](mapped))
    shown = f"{len(mapped.vehicles)} vehicles, {len(mapped.events)} events"
    print_line(f"{target}: {shown} ({target.stat().st_size / 1e6:.1f} MB)")
    return Exit.VERDICT_FAILED if flight.is_damaged else Exit.HOLDS


@log.command
def audit(
    logs: Annotated[list[Path], Parameter(validator=only_file, help="The logs of one flight.")],
    /,
    *,
    keys: Annotated[
        Path | None, Parameter(validator=file_or_folder, help="The keys by which to verify the heads' signatures.")
    ] = None,
) -> Exit:
    """List the operators' commands and the vehicles' responses, and verify that no entry was changed or removed.

    Exit code 1 if their hash chain is broken, or contradicts a head in another of the logs.

    Example: cordon log audit vehicle1.mcap vehicle2.mcap vehicle3.mcap
    """
    from gcs.cli.output import print_result
    from gcs.console.terminal import print_line, print_problem
    from gcs.flightlog.audit import (
        AuditedLog,
        AuditEntry,
        audit_line,
        chain_fault,
        is_signed_head,
        rewritten,
        unwitnessed,
    )
    from gcs.flightlog.reader import read_log
    from gcs.keys.key_folder import KeyFolder

    authority_pem = None if keys is None else KeyFolder(keys).authority_pem
    audited, is_whole = list[AuditedLog](), True
    for path in logs:
        flight = read_log(path)
        entries = [each.read(AuditEntry) for each in flight.run_records if each.kind is AuditEntry]
        heads = [each for each in entries if each.event == "head"]
        signed = [each for each in heads if authority_pem is None or is_signed_head(each, authority_pem)]
        audited.append(AuditedLog(str(path), flight.run.vehicles, entries, signed))
        for entry in entries:
            if entry.event not in ("closed", "head"):
                print_result(audit_line(entry))
        if fault := chain_fault(entries):
            print_problem(f"{path}: the audit log is broken: {fault}")
            is_whole = False
        else:
            print_line(f"{path}: {len(entries)} entries, none changed or removed; last digest {entries[-1].digest}")
        if unsigned := len(heads) - len(signed):
            print_problem(f"{path}: heads of other logs that their vehicles have not signed: {unsigned}")
            is_whole = False
    for fault in rewritten(audited):
        print_problem(fault)
        is_whole = False
    for vehicle in unwitnessed(audited):
        print_line(f"vehicle {vehicle}: these logs hold heads of its log, which is not among them", "yellow")
    return Exit.HOLDS if is_whole else Exit.VERDICT_FAILED


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class LayoutOptions:
    """Options of `cordon log layout`."""

    output: Annotated[
        Path,
        Parameter(name=["--output", "-o"], validator=only_file, help="The file to write, which must not exist yet."),
    ] = Path("cordon-layout.json")


_LAYOUT_DEFAULTS = LayoutOptions()


@log.command
def layout(*, options: LayoutOptions = _LAYOUT_DEFAULTS) -> Exit:
    """Write a layout for Foxglove and Lichtblick, which show a flight in 3-D, on a map and in plots.

    Example: cordon log layout -o cordon-layout.json
    """
    from importlib.resources import files

    from gcs.cli.output import writing
    from gcs.keys.private_files import create

    text = files("gcs.viewer").joinpath("cordon-layout.json").read_text(encoding="utf-8")
    with writing("--output", options.output), create(options.output, "xb") as file:
        file.write(text.encode())
    return Exit.HOLDS
