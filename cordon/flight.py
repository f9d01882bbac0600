"""A flight, simulated or read from a log: its metrics, its figures and each vehicle's channels."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cordon.channels import VehicleChannels
from gcs.errors import InputError
from gcs.metrics.metrics import evaluated
from gcs.metrics.record import FlightRecord
from gcs.metrics.references import formation_reference, ring_references
from gcs.metrics.result import FlightResult
from gcs.mission.mission import Mission

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, repr=False)
class Flight:
    """A flight of a mission: `record` is its data on one time grid, `vehicles` are the channels by vehicle id."""

    mission: Mission
    record: FlightRecord
    vehicles: Mapping[int, VehicleChannels]

    def __repr__(self) -> str:
        flown_s = float(self.record.time_s[-1]) if self.record.time_s.size else 0.0
        ids = ", ".join(map(str, self.vehicles))
        return f"<Flight of {self.record.mission}: {flown_s:g} s, vehicles {ids}, seed {self.record.seed}>"

    @cached_property
    def metrics(self) -> FlightResult:
        """Metrics and verdicts, as printed by `cordon sim --json` and `cordon report --json` (docs/json.md).

        A metric that does not apply is None. `metrics.to_dict()` returns plain data.
        """
        return evaluated(self.mission, self.record)

    def plot(self, path: str | Path | None = None) -> "Figure":
        """Return the figures of `--plot` as a matplotlib figure; with `path`, also write a .png, .svg or .pdf.

        Raises InputError if the file cannot be written.
        """
        from gcs.report.figure import drawn_figure, save_figure  # noqa: PLC0415 - matplotlib

        of_flight = self.record, self.metrics, ring_references(self.mission, self.record)
        formation = formation_reference(self.mission)
        if path is None:
            return drawn_figure(*of_flight, formation)
        try:
            return save_figure(*of_flight, Path(path), formation)
        except (OSError, ValueError) as error:
            raise InputError([f"plot: {path}: {error}"]) from error

    def frame(self) -> "DataFrame":
        """Return all channels as a pandas data frame: a row for each vehicle and time, a column for each component.

        `vehicle` is the id, `position_m` becomes `position_x_m` and `position_y_m`. Raises ImportError without pandas.
        """
        try:
            from pandas import DataFrame, concat  # noqa: PLC0415
        except ImportError as error:
            raise ImportError("data frames need pandas: pip install 'cordon-gcs[pandas]'") from error
        frames = [
            DataFrame({"vehicle": np.full(each.time_s.size, vehicle_id), **each.columns()})
            for vehicle_id, each in self.vehicles.items()
        ]
        return concat(frames, ignore_index=True)
