"""`cordon identify`: from flight logs to a profile, and a verdict on whether to fly with it."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gcs.cli.options import RESULT, Json, only_file
from gcs.errors import Exit, InputError
from gcs.metrics.json_output import json_output

if TYPE_CHECKING:
    from estimation.identification.identified import IdentificationResult
    from estimation.plant.model import Plant
    from gcs.vehicle_logs.vehicle_log import VehicleLog


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyOptions:
    """Options of `cordon identify`, without the logs."""

    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"],
            validator=only_file,
            group=RESULT,
            help="The profile to write, which must not exist yet.",
        ),
    ] = None
    vehicle: Annotated[int | None, Parameter(help="The vehicle's system id, if the logs hold several vehicles.")] = None
    against: Annotated[
        tuple[str, ...],
        Parameter(negative="", show_default=False, help="Also show the fit of this profile's plant; may be repeated."),
    ] = ()
    json: Json = False
    html: Annotated[
        Path | None, Parameter(validator=only_file, group=RESULT, help="Write the figures as an HTML page.")
    ] = None
    plot: Annotated[
        Path | None, Parameter(validator=only_file, group=RESULT, help="Draw the fit into a .png, .svg or .pdf.")
    ] = None


_DEFAULTS = IdentifyOptions()


def identify(
    logs: Annotated[
        list[Path], Parameter(validator=only_file, help="Flight logs of one vehicle: .mcap, .ulg, .bin or .tlog.")
    ],
    /,
    *,
    options: IdentifyOptions = _DEFAULTS,
) -> Exit:
    """Identify a vehicle's plant from flight logs, with confidence intervals and a verdict on whether to fly with it.

    Example: cordon identify flight.ulg -o my-vehicle.toml --html my-vehicle.html
    """
    from estimation.identification.identify import identify as identified_from
    from estimation.plant.model import PlantGrade
    from gcs.cli.output import IdentifyProgress, print_result
    from gcs.console.terminal import STDERR
    from gcs.identify.reading import recordings_of
    from gcs.identify.view import identified_dict, identified_view

    _check_files(options)
    others = {name: _plant(name) for name in options.against}
    vehicle_logs = _read(logs, options.vehicle)
    recordings = recordings_of(vehicle_logs)
    with IdentifyProgress(f"vehicle {vehicle_logs[0].system_id}") as progress:
        identified = identified_from(recordings, progress.update, others)
    STDERR.print(identified_view(identified, vehicle_logs), soft_wrap=True)
    _write_files(identified, vehicle_logs, options)
    if options.json:
        print_result(json_output(identified_dict(identified, vehicle_logs)))
    whole = not any(log.is_damaged for log in vehicle_logs)
    return Exit.HOLDS if whole and identified.verdict is not PlantGrade.DO_NOT_FLY else Exit.VERDICT_FAILED


def _read(paths: Sequence[Path], vehicle: int | None) -> "list[VehicleLog]":
    """Return the logs of one vehicle; raises InputError, and LogError with file, topic and time."""
    from gcs.cli.output import print_notes
    from gcs.identify.reading import logs_of_one

    logs = logs_of_one(paths, vehicle)
    print_notes(logs)
    return logs


def _plant(name: str) -> "Plant":
    from estimation.profile.profile import ProfileError, ProfileLibrary

    path = Path(name)
    try:
        return ProfileLibrary(path.parent).load(path.name).plant
    except ProfileError as error:
        raise InputError([f"--against: {fault}" for fault in error.faults]) from error


def _write_files(identified: "IdentificationResult", logs: "Sequence[VehicleLog]", options: IdentifyOptions) -> None:
    from gcs.cli.output import writing
    from gcs.console.terminal import print_line
    from gcs.identify.view import identification_of, profile_text

    found = identified.found
    if found is None:
        for path in filter(None, (options.output, options.plot)):
            print_line(f"{path}: not written: no plant was found")
    if options.output is not None and found is not None:
        identification = identification_of(identified, found, logs, date.today())
        _write("--output", options.output, profile_text(found, identification, logs))
    if options.plot is not None and found is not None:
        from gcs.identify.panels import identified_figure
        from gcs.report.figure import write_figure

        with writing("--plot", options.plot):
            write_figure(identified_figure(found, identified.verdict), options.plot)
        print_line(f"figure: {options.plot}")
    if options.html is not None:
        from gcs.identify.page import identified_html

        _write("--html", options.html, identified_html(identified, logs))


def _write(option: str, path: Path, text: str) -> None:
    from gcs.cli.output import writing
    from gcs.console.terminal import print_line
    from gcs.keys.private_files import create

    with writing(option, path), create(path) as file:
        file.write(text.encode(errors="replace"))  # names of files may hold bytes that are no text
    print_line(f"written: {path}")


def _check_files(options: IdentifyOptions) -> None:
    """Refuse output files that cannot be written, before anything is read."""
    from gcs.cli.output import check_file, check_page, check_plot

    if options.output is not None:
        check_file("--output", options.output, (".toml",))
        if options.output.exists():
            raise InputError([f"--output: {str(options.output)!r} exists already"])
    check_page(options.html)
    check_plot(options.plot)
