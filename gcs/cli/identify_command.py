"""`cordon identify`: from the logs of flights to a plant file, and whether to fly by it."""

import json as json_text
import os
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from estimation.identification.identified import Identified
from estimation.identification.identify import identify
from estimation.plant.file import PlantFileError, load_plant
from estimation.plant.model import Plant
from estimation.plant.provenance import Verdict
from gcs.cli.output import STDERR, IdentifyProgress, print_result
from gcs.errors import Exit, InputError
from gcs.identify.reading import check_one_kind, chosen, recording_of
from gcs.identify.view import (
    identification_of,
    identified_dict,
    identified_view,
    plant_text,
)
from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import VehicleLog


def identify_plant(
    paths: Sequence[Path],
    *,
    output: Path | None,
    vehicle: int | None,
    against: Sequence[str],
    json: bool,
    html: Path | None,
) -> Exit:
    """Identify one vehicle from logs; raises InputError, and LogError that names file, topic and time."""
    _check_files(output, html, paths)
    others = {name: _plant(name) for name in against}
    logs = chosen([log for path in paths for log in read_vehicle_logs(path)], vehicle)
    _check_same(logs)
    for log in logs:
        for note in log.notes:
            STDERR.print(f"{log.path}: {note}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    recordings = [recording_of(log) for log in logs]
    check_one_kind(logs, recordings)
    with IdentifyProgress(f"vehicle {logs[0].system_id}") as progress:
        identified = identify(recordings, progress.update, others)
    STDERR.print(identified_view(identified, logs), soft_wrap=True)
    if output is not None:
        _write_plant(identified, logs, output)
    if html is not None:
        from gcs.identify.page import identified_html  # noqa: PLC0415

        _write(html, identified_html(identified, logs), "--html")
    if json:
        print_result(json_text.dumps(identified_dict(identified, logs), allow_nan=False))
    return Exit.VERDICT_FAILED if identified.verdict is Verdict.DO_NOT_FLY else Exit.HOLDS


def _plant(name: str) -> Plant:
    try:
        return load_plant(name, Path())
    except PlantFileError as error:
        raise InputError([f"--against: {fault}" for fault in error.faults]) from error


def _write_plant(identified: Identified, logs: Sequence[VehicleLog], output: Path) -> None:
    found = identified.found
    if found is None:
        STDERR.print(f"{output}: not written, for there is no plant", markup=False, highlight=False, soft_wrap=True)
        return
    _write(output, plant_text(found, identification_of(identified, found, logs, date.today())), "--output")


def _write(path: Path, text: str, option: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError([f"{option}: {path}: {error.strerror or error}"]) from error
    STDERR.print(f"written: {path}", markup=False, highlight=False, soft_wrap=True)


def _check_files(output: Path | None, html: Path | None, logs: Sequence[Path]) -> None:
    """Refuse, before anything is read, what could not be written."""
    if len(set(logs)) < len(logs):
        raise InputError([f"{path}: given more than once" for path in sorted(set(logs)) if logs.count(path) > 1])
    for option, path, suffixes in (("--output", output, (".toml",)), ("--html", html, (".html", ".htm"))):
        if path is None:
            continue
        if path.suffix.lower() not in suffixes:
            raise InputError([f"{option}: {path.name!r} must end in {suffixes[0]}"])
        if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
            raise InputError([f"{option}: no folder {str(path.parent)!r} to write into"])
        if path.is_dir() or (option == "--output" and path.exists()):
            raise InputError([f"{option}: {str(path)!r} exists already"])


def _check_same(logs: Sequence[VehicleLog]) -> None:
    """Refuse logs of different vehicles, as far as they tell."""
    for what, values in (
        ("autopilots", {log.autopilot for log in logs}),
        ("firmwares", {log.firmware for log in logs if log.firmware}),
    ):
        if len(values) > 1:
            told = "; ".join(f"{log.path}: {log.autopilot} {log.firmware}".rstrip() for log in logs)
            raise InputError([f"the logs are of different {what}, and one plant cannot be both: {told}"])
