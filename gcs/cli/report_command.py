"""`cordon report`: from logs to metrics, for people, machines and browsers."""

import json as json_text
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from gcs.cli.output import (
    STDERR,
    check_plot,
    present,
    print_result,
)
from gcs.errors import Exit, InputError
from gcs.flightlog.reader import read_log
from gcs.metrics.metrics import evaluate
from gcs.metrics.references import ring_reference
from gcs.metrics.result import FlightResult
from gcs.report.evidence.asked import asked_of
from gcs.report.evidence.plants import plant_facts
from gcs.report.evidence.reading import LoggedFlight, read_flight
from gcs.vehicle_logs.foreign import is_foreign


def report_flight(paths: Sequence[Path], *, json: bool, html: Path | None, plot: Path | None) -> Exit:
    """Show what the logs of a flight's processes hold, or what another program's logs do; raises InputError."""
    check_plot(plot)
    _check_page(html, paths)
    if is_foreign(paths[0]):
        return _report_others(paths, json=json, html=html, plot=plot)
    flight = _read(paths)
    plants = plant_facts(flight.mission, flight.evidence)
    if html is not None:
        from gcs.report.page import write_report  # noqa: PLC0415

        evidence = replace(flight.evidence, facts={**flight.evidence.facts, **plants})
        _write(html, lambda: write_report(evidence, _result(flight), asked_of(flight.mission), html))
    verdict = present(flight.mission, flight.evidence.record, json=json, plot=plot)
    for name, words in plants.items():
        STDERR.print(f"{name}: {words}", style="dim", markup=False, highlight=False, soft_wrap=True)
    return verdict


def compare_flights(first: Sequence[Path], second: Path, *, json: bool, html: Path | None) -> Exit:
    """Show two flights side by side; raises LogError and InputError."""
    from gcs.report.compare import ComparedFlight, comparison_table, write_comparison  # noqa: PLC0415

    _check_page(html, [*first, second])
    flights = [_read(first), _read([second])]
    results = [_result(flight) for flight in flights]
    one, other = (
        ComparedFlight(name, result, flight.evidence.record, ring_reference(flight.mission))
        for name, flight, result in zip(_names(first[0], second), flights, results, strict=True)
    )
    STDERR.print(comparison_table(one, other))
    if html is not None:
        _write(html, lambda: write_comparison(one, other, html))
    if json:
        print_result(json_text.dumps({"flights": [result.to_dict() for result in results]}, allow_nan=False))
    return Exit.HOLDS if all(result.all_hold for result in results) else Exit.VERDICT_FAILED


def _report_others(paths: Sequence[Path], *, json: bool, html: Path | None, plot: Path | None) -> Exit:
    """Show what logs of autopilots or ground stations hold: they know no mission, and so no verdict."""
    from gcs.report.vehicle_page import summarised, write_vehicle_report  # noqa: PLC0415
    from gcs.vehicle_logs.foreign import read_vehicle_logs  # noqa: PLC0415
    from gcs.vehicle_logs.vehicle_log import describe  # noqa: PLC0415

    if plot is not None:
        raise InputError([f"--plot: {paths[0]} is no log of cordon's: --html shows what it holds"])
    logs = [log for path in paths for log in read_vehicle_logs(path)]
    for log in logs:
        for line in describe(log):
            STDERR.print(line, markup=False, highlight=False, soft_wrap=True)
    if html is not None:
        _write(html, lambda: write_vehicle_report(logs, html))
    if json:
        print_result(json_text.dumps({"logs": [summarised(log) for log in logs]}, allow_nan=False))
    return Exit.HOLDS


def _read(paths: Sequence[Path]) -> LoggedFlight:
    logs = [read_log(path) for path in paths]
    for log in logs:
        for fault in log.faults:
            STDERR.print(f"{log.path}: {fault}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    return read_flight(logs)


def _result(flight: LoggedFlight) -> FlightResult:
    asked = asked_of(flight.mission)
    return evaluate(flight.evidence.record, asked.ring, asked.formation, asked.tolerances)


def _names(first: Path, second: Path) -> tuple[str, str]:
    """Return what the two flights are called: their files' names, or whole paths where those are the same."""
    return (first.stem, second.stem) if first.stem != second.stem else (str(first), f"{second} (second)")


def _check_page(html: Path | None, logs: Sequence[Path]) -> None:
    """Refuse, before anything is read, a page that could not be written, or would replace a log."""
    if html is None:
        return
    if html.suffix.lower() not in (".html", ".htm"):
        raise InputError([f"--html: {html.name!r} must end in .html"])
    if html.is_dir() or html in logs:
        raise InputError([f"--html: {str(html)!r} is a {'folder' if html.is_dir() else 'log'}"])
    if not html.parent.is_dir() or not os.access(html.parent, os.W_OK):
        raise InputError([f"--html: no folder {str(html.parent)!r} to write into"])


def _write(html: Path, write: Callable[[], None]) -> None:
    try:
        write()
    except OSError as error:
        raise InputError([f"--html: {html}: {error.strerror or error}"]) from error
    size = f"{html.stat().st_size / 1e6:.1f} MB"
    STDERR.print(f"report: {html} ({size})", markup=False, highlight=False, soft_wrap=True)
