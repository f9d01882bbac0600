"""Plants from flight logs."""

import warnings
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from estimation.identification.identified import IdentificationResult
from estimation.identification.identify import identify as identified_from
from gcs.errors import InputError
from gcs.identify.reading import logs_of_one, recordings_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Identified(IdentificationResult):
    """The `verdict` and its `reasons`, the data used (`duration_s` in `excerpts` parts), and what was `found`."""

    def plot(self, path: str | Path | None = None) -> "Figure":
        """Return validation, step responses and errors as a matplotlib figure, as `cordon identify --plot` draws it.

        With `path`, also write a .png, .svg or .pdf. Raises InputError if no plant was found, or if the file cannot be
        written.
        """
        from gcs.identify.panels import identified_figure  # noqa: PLC0415 - matplotlib
        from gcs.report.figure import write_figure  # noqa: PLC0415

        if self.found is None:
            raise InputError([f"plot: there is nothing to draw, no plant was found: {'; '.join(self.reasons)}"])
        figure = identified_figure(self.found, self.verdict)
        if path is not None:
            try:
                write_figure(figure, Path(path))
            except (OSError, ValueError) as error:
                raise InputError([f"plot: {path}: {error}"]) from error
        return figure


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
    result = identified_from(recordings_of(logs))
    return Identified(**{each.name: getattr(result, each.name) for each in fields(result)})
