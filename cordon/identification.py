"""Plants from flight logs."""

import warnings
from pathlib import Path

from estimation.identification.identified import Identified
from estimation.identification.identify import identify as identified_from
from gcs.identify.reading import logs_of_one, recordings_of


def identify(log: str | Path, *more: str | Path, vehicle: int | None = None) -> Identified:
    """Identify a vehicle's plant from logs of its flights, as `cordon identify` does.

    Logs are cordon's, PX4's, ArduPilot's or telemetry logs; `vehicle` is the system id if they hold several. `verdict`
    states whether to fly with the plant, `reasons` why. `found` is None if no plant was found. Otherwise `found.plant`
    is the plant; `found.axes` (x, then y: `a0_per_s2`, `a1_per_s`, `frequency_rad_s`, `damping`), `found.delay_s` and
    `found.feedforward` are its parameters, each with `value` and the bounds `low` and `high` of its 95 % interval. See
    docs/identification.md. Raises InputError for logs that cannot be read or are of different vehicles.
    """
    logs = logs_of_one([Path(each) for each in (log, *more)], vehicle, "vehicle")
    for each in logs:
        for note in each.notes:
            warnings.warn(f"{each.path}: {note}", stacklevel=2)
    return identified_from(recordings_of(logs))
