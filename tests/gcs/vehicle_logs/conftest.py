"""Reading logs that a test makes up."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gcs.vehicle_logs.foreign import read_vehicle_logs
from gcs.vehicle_logs.vehicle_log import VehicleLog


@pytest.fixture
def read(tmp_path: Path) -> Callable[[bytes], VehicleLog]:
    """Return a reader of the log of one vehicle in given bytes."""

    def write_and_read(log: bytes) -> VehicleLog:
        file = tmp_path / "flight.log"
        file.write_bytes(log)
        return read_vehicle_logs(file)[0]

    return write_and_read
