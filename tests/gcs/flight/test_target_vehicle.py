"""What a vehicle that is the target says of itself, as sightings."""

import numpy as np
import pytest

from estimation.state import Sighting, Telemetry
from gcs.flight.target_vehicle import TARGET_VEHICLE, sightings_of
from gcs.mission.file import load_mission


@pytest.mark.parametrize(("telemetry_hz", "seen_hz"), [(20.0, 5.0), (7.0, 3.5)])
def test_telemetry_becomes_sightings_at_the_sensors_rate(telemetry_hz: float, seen_hz: float) -> None:
    seen: list[Sighting] = []
    take = sightings_of(load_mission("case3-turns").target, seen.append)
    for tick in range(round(20.0 * telemetry_hz)):
        time_s = 1000.0 + tick / telemetry_hz + 0.01 * (-1) ** tick
        take(Telemetry(time_s, (3.0, time_s, 7.0), (0.0, 1.0, 0.0)))
    assert len(seen) == pytest.approx(20.0 * seen_hz, abs=3)
    assert all(one.position_m == (3.0, one.time_s) for one in seen)
    assert {(one.altitude_m, one.altitude_sigma_m) for one in seen} == {(7.0, 0.5)}
    assert {one.sensor_id for one in seen} == {TARGET_VEHICLE}
    assert {one.covariance_m2 for one in seen} == {(0.25, 0.0, 0.25)}
    assert {(one.importance, one.threat) for one in seen} == {(0.8, 0.2)}
    assert np.diff([one.time_s for one in seen]).min() > 0.1


def test_sightings_of_one_of_several_targets_have_its_name() -> None:
    seen: list[Sighting] = []
    sightings_of(load_mission("two-targets").targets[1], seen.append, "south")(
        Telemetry(0.0, (3.0, 4.0, 7.0), (0.0, 1.0, 0.0))
    )
    assert [one.target for one in seen] == ["south"]
