"""Plants from flight logs."""

import warnings
from pathlib import Path

from estimation.identification.identified import Identified
from estimation.identification.identify import identify as identified_from
from gcs.identify.reading import logs_of_one, recordings_of


def identify(log: str | Path, *more: str | Path, vehicle: int | None = None) -> Identified:
    """Return what the logs of one vehicle's flights tell of its plant, as `cordon identify` does.

    Logs are cordon's own, PX4's, ArduPilot's or telemetry logs; `vehicle` is the system id where they hold several.
    `verdict` says whether to fly by the plant, `reasons` why. `found` is None where no plant was found; else
    `found.plant` is the plant, and `found.axes` (x, then y: `a0_per_s2`, `a1_per_s`, `frequency_rad_s`, `damping`),
    `found.delay_s` and `found.feedforward` are its numbers, each with `value` and the bounds `low` and `high` of its
    95 % interval. docs/identification.md has the rest. Raises InputError for what cannot be read or does not belong
    together.
    """
    logs = logs_of_one([Path(each) for each in (log, *more)], vehicle, "vehicle")
    for each in logs:
        for note in each.notes:
            warnings.warn(f"{each.path}: {note}", stacklevel=2)
    return identified_from(recordings_of(logs))
