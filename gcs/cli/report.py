"""`cordon report`: from logs to metrics, for people, scripts and browsers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gcs.cli.options import RESULT, FigureNumber, Json, Plot, only_file
from gcs.errors import Exit, InputError
from gcs.metrics.json_output import json_output

if TYPE_CHECKING:
    from gcs.flightlog.reader import FlightLog
    from gcs.metrics.result import FlightResult
    from gcs.report.compare import ComparedFlight
    from gcs.report.evidence.reading import LoggedFlight


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions:
    """Options of `cordon report`, without the logs."""

    html: Annotated[
        Path | None, Parameter(validator=only_file, group=RESULT, help="Write the report as an HTML page.")
    ] = None
    compare: Annotated[
        tuple[Path, ...] | None,
        Parameter(
            validator=only_file,
            group=RESULT,
            consume_multiple=True,
            negative="",
            show_default=False,
            help="Compare the flight with those of these logs: metrics side by side, and differences.",
        ),
    ] = None
    animate: Annotated[
        Path | None,
        Parameter(
            validator=only_file, group=RESULT, help="Draw the flight from above as an animation into a .gif or .webp."
        ),
    ] = None
    json: Json = False
    plot: Plot = None
    figure: FigureNumber = None


_DEFAULTS = ReportOptions()


def report(
    logs: Annotated[
        list[Path],
        Parameter(validator=only_file, help="A flight's log, or several: one from each process of the flight."),
    ],
    /,
    *,
    options: ReportOptions = _DEFAULTS,
) -> Exit:
    """Evaluate a flight from its log: the metrics and verdicts, the paper's figures, and the events.

    Example: cordon report flight.mcap --html flight.html
    """
    from gcs.vehicle_logs.foreign import is_foreign

    if options.compare is not None:
        return _compare_flights(logs, options.compare, options)
    _check_outputs(options, logs)
    return _report_vehicle_logs(logs, options) if is_foreign(logs[0]) else _report_flight(logs, options)


def _report_flight(logs: Sequence[Path], options: ReportOptions) -> Exit:
    """Show a flight from the logs of its processes; raises InputError."""
    from gcs.cli.output import present
    from gcs.console.terminal import print_line
    from gcs.report.evidence.criteria import criteria_of, plant_results
    from gcs.report.evidence.reading import read_flight

    read = _logs(logs)
    flight = read_flight(read)
    plants = plant_results(flight.mission, flight.evidence)
    if options.html is not None:
        from gcs.report.flight_page import replay_flight, write_report

        html, shown = options.html, replay_flight(*read)
        evidence = replace(flight.evidence, plants=plants)
        _write(
            html,
            lambda: write_report(evidence, _result(flight), criteria_of(flight.mission, evidence.record), shown, html),
        )
    if options.animate is not None:
        _animate(flight, options.animate)
    verdict = present(
        flight.mission,
        flight.evidence.record,
        json=options.json,
        plot=options.plot,
        figure=options.figure,
        plants=plants,
    )
    if weather := read[0].run.weather:
        print_line(f"weather: {weather}")
    for plant in plants:
        print_line(f"plant of vehicle {plant.id}: {plant.text}", "yellow" if plant.differs else "dim")
        print_line(f"latency of vehicle {plant.id}: {plant.latency}", "dim")
    return Exit.VERDICT_FAILED if flight.is_damaged and verdict is Exit.HOLDS else verdict


def _animate(flight: "LoggedFlight", path: Path) -> None:
    """Draw a flight from above; raises InputError."""
    from gcs.cli.output import AnimationProgress, writing
    from gcs.console.terminal import print_line
    from gcs.metrics.references import ring_references
    from gcs.report.animation import save_animation
    from gcs.report.charts.panels import sheet_of

    record = flight.evidence.record
    if not (record.time_s.size > 1 and record.vehicles):
        raise InputError([f"--animate: {path}: the log holds no motion to draw"])
    sheet = sheet_of(record, _result(flight), ring_references(flight.mission, record))
    with writing("--animate", path), AnimationProgress(path) as progress:
        save_animation(sheet, path, progress.update)
    print_line(f"animation: {path} ({path.stat().st_size / 1e6:.1f} MB)")


def _compare_flights(first: Sequence[Path], others: Sequence[Path], options: ReportOptions) -> Exit:
    """Show flights side by side; raises LogError and InputError."""
    from gcs.cli.output import print_result
    from gcs.console.terminal import STDERR, print_line
    from gcs.report import compare
    from gcs.report.evidence.reading import read_flight

    if not others:
        raise InputError(["--compare: give the log of at least one other flight after it"])
    _check_compared([*first, *others], options)
    logged = [read_flight(_logs(logs)) for logs in (first, *([path] for path in others))]
    names = _names([first[0], *others])
    flights = [_compared(name, flight) for name, flight in zip(names, logged, strict=True)]
    if compare.differences(flights):
        STDERR.print(compare.difference_table(flights))
    STDERR.print(compare.comparison_table(flights))
    for remark in compare.remarks(flights):
        print_line(remark, "yellow")
    html = options.html
    if html is not None:
        _write(html, lambda: compare.write_comparison(flights, html))
    if options.json:
        print_result(json_output(compare.comparison_dict(flights)))
    whole = not any(flight.is_damaged for flight in logged)
    if any(flight.result.ended_early for flight in flights):
        return Exit.ENDED_IN_FLIGHT
    return Exit.HOLDS if whole and all(flight.result.all_hold for flight in flights) else Exit.VERDICT_FAILED


def _check_compared(paths: Sequence[Path], options: ReportOptions) -> None:
    """Refuse logs that cannot be compared, before anything is read; raises InputError."""
    from gcs.vehicle_logs.foreign import is_foreign

    _check_outputs(options, paths)
    if options.plot is not None:
        raise InputError(["--plot: with --compare the figures are in the page: use --html"])
    if options.animate is not None:
        raise InputError(["--animate: it draws one flight: leave out --compare"])
    faults = [f"--compare: {path} is given twice" for path in dict.fromkeys(paths) if paths.count(path) > 1]
    foreign = (path for path in paths if is_foreign(path))
    faults += [f"--compare: {path} was not recorded by cordon; only cordon's logs can be compared" for path in foreign]
    if faults:
        raise InputError(faults)


def _compared(name: str, flight: "LoggedFlight") -> "ComparedFlight":
    from gcs.metrics.references import ring_references
    from gcs.report.charts.panels import sheet_of
    from gcs.report.compare import POINTS_MAX, ComparedFlight

    record = flight.evidence.record
    rings = ring_references(flight.mission, record)
    sheet = sheet_of(record, _result(flight), rings, points_max=POINTS_MAX)
    return ComparedFlight(name, flight.mission, sheet)


def _report_vehicle_logs(paths: Sequence[Path], options: ReportOptions) -> Exit:
    """Show logs of autopilots or ground stations, without verdicts: these logs hold no mission."""
    from gcs.cli.output import print_damage, print_result
    from gcs.console.terminal import print_line
    from gcs.report.vehicle_page import summarised, write_vehicle_report
    from gcs.vehicle_logs.foreign import read_vehicle_logs
    from gcs.vehicle_logs.vehicle_log import describe

    if options.animate is not None:
        raise InputError([f"--animate: {paths[0]} was not recorded by cordon: use --html for its figures"])
    if options.plot is not None:
        raise InputError([f"--plot: {paths[0]} was not recorded by cordon: use --html for its figures"])
    logs = [log for path in paths for log in read_vehicle_logs(path)]
    for log in logs:
        for name, content in describe(log):
            print_line(f"{name}: {content}" if content else name)
    print_damage(logs)
    html = options.html
    if html is not None:
        _write(html, lambda: write_vehicle_report(logs, html))
    if options.json:
        print_result(json_output({"logs": [summarised(log) for log in logs]}))
    return Exit.VERDICT_FAILED if any(log.is_damaged for log in logs) else Exit.HOLDS


def _check_outputs(options: ReportOptions, logs: Sequence[Path]) -> None:
    """Refuse output files that cannot be written or would replace a log, before anything is read."""
    from gcs.cli.output import check_animation, check_page, check_plot

    check_plot(options.plot, options.figure)
    check_page(options.html)
    check_animation(options.animate)
    if options.html in logs:
        raise InputError([f"--html: {str(options.html)!r} is a log"])


def _logs(paths: Sequence[Path]) -> "list[FlightLog]":
    from gcs.cli.output import print_log_faults
    from gcs.flightlog.reader import read_log

    logs = [read_log(path) for path in paths]
    for log in logs:
        print_log_faults(log)
    return logs


def _result(flight: "LoggedFlight") -> "FlightResult":
    from gcs.metrics.metrics import evaluated

    return evaluated(flight.mission, flight.evidence.record)


def _names(paths: Sequence[Path]) -> list[str]:
    """Return a name for each flight: its file name, or the whole path if file names are equal."""
    stems = [path.stem for path in paths]
    return [stem if stems.count(stem) == 1 else str(path) for stem, path in zip(stems, paths, strict=True)]


def _write(html: Path, write: Callable[[], None]) -> None:
    from gcs.cli.output import writing
    from gcs.console.terminal import print_line

    with writing("--html", html):
        write()
    print_line(f"report: {html} ({html.stat().st_size / 1e6:.1f} MB)")
