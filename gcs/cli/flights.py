"""`cordon flights`: a flight book from the logs of a folder."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gcs.cli.options import RESULT, Json, only_file
from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from gcs.report.flight_book import BookedFlight, FlightBook


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class FlightsOptions:
    """Options of `cordon flights`."""

    folder: Annotated[Path | None, Parameter(help="Folder of logs, instead of the one where flights are recorded.")] = (
        field(default=None, kw_only=False)
    )
    verdicts: Annotated[
        bool,
        Parameter(negative="", help="Also judge each flight: every log is read as a whole, which takes seconds each."),
    ] = False
    csv: Annotated[
        Path | None,
        Parameter(
            validator=only_file,
            group=RESULT,
            help="Write a table with a row for each vehicle of a flight to this .csv file, which must not exist yet.",
        ),
    ] = None
    json: Json = False


_DEFAULTS = FlightsOptions()


def flights(options: FlightsOptions = _DEFAULTS) -> Exit:
    """List the flights of a folder's logs: date, place, mission, crew, time in the air, and how they ended.

    Exit code 1 if a log is damaged or cannot be read; the others are listed.

    Example: cordon flights --csv flights.csv
    """
    from gcs.cli.output import FolderProgress, print_result
    from gcs.console.terminal import print_line
    from gcs.metrics.json_output import json_output
    from gcs.report.flight_book import read_book

    folder = _folder(options.folder)
    _check_csv(options.csv)
    logs = sorted(each for each in folder.glob("*.mcap") if each.is_file())
    with FolderProgress(folder, len(logs)) as progress:
        book = read_book(logs, progress.update, with_verdicts=options.verdicts)
    if options.csv is not None:
        _write_csv(options.csv, book)
    print_result(json_output({"folder": str(folder), **book.to_dict()}) if options.json else _text(folder, book))
    for each in book.flights:
        for fault in each.faults:
            print_line(f"{each.log}: {fault}", "yellow")
        if each.is_damaged:
            print_line(f"{each.log}: damaged: the book has what was read of it", "red")
    for unread in book.unread:
        print_line(f"{unread.log}: {unread.fault}", "red")
    return Exit.VERDICT_FAILED if book.is_damaged else Exit.HOLDS


def _folder(given: Path | None) -> Path:
    """Return the folder of logs; raises InputError if there is none."""
    from gcs.flight.recording import log_folder

    try:
        folder = given or log_folder()
    except OSError as error:
        raise InputError([f"FOLDER: {error.strerror or error}"]) from error
    if not folder.is_dir():
        raise InputError([f"FOLDER: {str(folder)!r} is no folder; next: name the folder of the logs"])
    return folder


def _check_csv(path: Path | None) -> None:
    """Refuse a table that cannot be written, before anything is read; raises InputError."""
    from gcs.cli.output import check_file

    if path is not None:
        check_file("--csv", path, (".csv",))
        if path.exists():
            raise InputError([f"--csv: {str(path)!r} exists already, and is not overwritten; name another"])


def _write_csv(path: Path, book: "FlightBook") -> None:
    from gcs.cli.output import writing
    from gcs.console.terminal import print_line
    from gcs.keys.private_files import create

    with writing("--csv", path), create(path, "xb") as file:
        file.write(book.to_csv().encode())
    print_line(f"table: {path}")


def _text(folder: Path, book: "FlightBook") -> str:
    """Return a line for each flight, its columns aligned, and the time in the air by source."""
    if not book.flights:
        return f"{folder}: no log of a flight"
    columns = ("began (UTC)", "mission", "source", "place", "crew", "minutes in the air", "ended", "verdicts")
    rows = [columns, *map(_row, book.flights)]
    kept = [at for at in range(len(columns)) if any(row[at] for row in rows[1:])]
    widths = [max(len(row[at]) for row in rows) for at in kept]
    lines = ["  ".join(row[at].ljust(width) for at, width in zip(kept, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([*lines, *_totals(book)])


def _row(flight: "BookedFlight") -> tuple[str, ...]:
    from gcs.report.flight_book import date_text

    place = "local" if flight.place_deg is None else "{:.5f}, {:.5f}".format(*flight.place_deg)
    minutes = [f"{each.id}: {_minutes(each.airborne_s)}" for each in flight.vehicles]
    total = f"{_minutes(flight.airborne_s)} ({', '.join(minutes)})" if len(minutes) > 1 else minutes[0]
    ended = "did not take off" if flight.ended is None else flight.ended.how.value
    ended = f"copy of {flight.copy_of}" if flight.copy_of else ended
    when = date_text(flight.began_s)
    return when, flight.mission, flight.source, place, ", ".join(flight.crew), total, ended, flight.verdict


def _totals(book: "FlightBook") -> Iterator[str]:
    """Return the number of flights and the time in the air of each source of flights."""
    for source in dict.fromkeys(each.source for each in book.flights):
        count = sum(each.source == source and not each.copy_of for each in book.flights)
        total_s = book.airborne_s.get(source)
        flown = f"{count} flight{'s' * (count != 1)}, {_minutes(total_s)} minutes in the air"
        yield f"{source}: {flown}, all vehicles together"


def _minutes(seconds: float | None) -> str:
    return "–" if seconds is None else f"{seconds / 60.0:.1f}"
