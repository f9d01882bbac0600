"""Flights from cordon's logs."""

import warnings
from pathlib import Path

from cordon.channels import channels_of
from cordon.decisions import logged_decisions
from cordon.flight import Flight
from gcs.flightlog.reader import read_log
from gcs.report.evidence.reading import read_flight


def read(log: str | Path, *more: str | Path) -> Flight:
    """Return the flight of a log that cordon recorded, or of several logs, one for each process of the flight.

    A log that ends early or is damaged is read as far as it is intact, with a warning for each fault. Raises InputError
    for files that are not cordon's logs, and for logs of different flights.

    >>> import tempfile, cordon
    >>> path = tempfile.mkdtemp() + "/flight.mcap"
    >>> simulated = cordon.simulate("case2", duration_s=5.0, log=path)
    >>> flight = cordon.read(path)
    >>> bool((flight.vehicles[1].setpoint_m == simulated.vehicles[1].setpoint_m).all())
    True
    """
    logs = [read_log(Path(each)) for each in (log, *more)]
    for each in logs:
        for fault in each.faults:
            warnings.warn(f"{each.path}: {fault}", stacklevel=2)
    flight = read_flight(logs)
    record = flight.evidence.record
    decisions = {each.vehicle_id: logged_decisions(each, record.time_s) for each in flight.evidence.vehicles}
    return Flight(flight.mission, record, channels_of(record, decisions))
