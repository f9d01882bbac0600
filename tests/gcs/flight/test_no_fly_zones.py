"""Simulated flights among no-fly zones: nobody enters one by the truth, and the missions go on."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from gcs.flight.simulated import fly_simulated
from gcs.flight.simulated_events import Commanded, SimulatedEvents
from gcs.metrics.metrics import evaluated
from gcs.metrics.record import FlightRecord
from gcs.mission.mission import Mission
from tests.conftest import RunHere
from tests.experiments.no_fly_maps import clearances_m, fly
from tests.support.flight_logs import engaging, record_simulation
from tests.support.mission_text import changed, parsed

MAST = {"name": "mast", "center_m": [45.0, -5.0], "radius_m": 1.5}
HOUSE = {"name": "house", "polygon_m": [[10.0, -9.0], [14.0, -9.0], [14.0, 7.0], [10.0, 7.0]]}
Changes = dict[tuple[str | int, ...], object]
AT_REST: Changes = {
    ("target", "velocity_m_s"): [0.0, 0.0],
    ("target", "sensor", "range_m"): 80.0,
    ("encirclement", "angular_rate_rad_s"): 0.1,
}


def flown(mission: Mission, duration_s: float, *events: Commanded) -> FlightRecord:
    return fly_simulated(mission, 1, duration_s, lambda _: None, events=SimulatedEvents(mission, events))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5000, 5282])
def test_missions_on_drawn_maps_complete_and_nobody_enters_a_zone(seed: int) -> None:
    """On the first map two vehicles press a third against a zone, on the second one lies between vehicle and ring."""
    flight = fly(seed)
    assert flight.feasible
    assert flight.complete, str(flight)


def test_a_ring_around_a_mast_is_judged_by_its_bend() -> None:
    """The ring of 10 m is up to 3 m farther in at the mast, and its radius error is that of one without a mast."""
    changes = AT_REST | {("target", "start_m"): [12.0, 0.0], ("decision", "distance_max_m"): 30.0}
    mast = MAST | {"center_m": [12.0, 10.5]}
    mission = parsed(changed(changes | {("safety", "no_fly"): [mast]}))
    record = flown(mission, 70.0)
    assert clearances_m(mission, record).min() > 1.0
    away_m = [np.hypot(*(each.position_m[300:] - (12.0, 0.0)).T).min() for each in record.vehicles]
    assert min(away_m) < 7.5
    result = evaluated(mission, record)
    assert (result.verdicts.c1, result.verdicts.c3) == (True, True)
    assert max(each.radius_error_rms_m or 0.0 for each in result.vehicles) < 0.1


def test_vehicles_fly_around_a_zone_to_their_slots() -> None:
    far: Changes = {("formation", "start_m"): [25.0, 0.0], ("target", "start_m"): [200.0, 0.0]}
    mission = parsed(changed(far | {("formation", "speed_m_s"): 0.0, ("safety", "no_fly"): [HOUSE]}))
    record = flown(mission, 60.0)
    assert clearances_m(mission, record).min() > 0.1
    ends = [each.position_m[-1].tolist() for each in record.vehicles]
    assert ends == [pytest.approx([25.0, y], abs=0.5) for y in (5.0, 0.0, -5.0)]


def test_the_way_home_leads_around_a_zone() -> None:
    engages: Changes = AT_REST | {("decision", "distance_max_m"): 50.0, ("encirclement", "altitude_m"): 8.0}
    home: Changes = {("choreography", "landing"): "return", ("choreography", "layer_m"): 2.0}
    mission = parsed(changed(engages | home | {("safety", "no_fly"): [HOUSE]}))
    record = flown(mission, 110.0, Commanded(45.0, "rtl"))
    assert clearances_m(mission, record).min() > 0.3
    for track, vehicle in zip(record.vehicles, mission.vehicles, strict=True):
        straight = shapely.LineString([track.position_m[450], vehicle.section.start_m])
        assert track.position_m[-1].tolist() == pytest.approx(vehicle.section.start_m, abs=1.0)
        if vehicle.id == 2:
            assert straight.intersects(shapely.Polygon(HOUSE["polygon_m"]))


def test_a_recorded_flight_among_zones_is_replayed_bit_for_bit(tmp_path: Path, run_here: RunHere) -> None:
    mast = MAST | {"center_m": [18.0, -5.0]}
    mission = engaging("case2-field", (("safety", "no_fly"), [mast]), (("target", "velocity_m_s"), [0.0, 0.0]))
    record_simulation(mission, tmp_path / "log.mcap", seed=1, duration_s=25.0)
    code, _, err = run_here("replay", str(tmp_path / "log.mcap"))
    assert code == 0
    assert "bit for bit" in err
