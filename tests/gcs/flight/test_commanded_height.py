"""A ring that is commanded to the heights of a no-fly zone, by true motion: from then on it bends around the zone."""

import numpy as np
import pytest

import cordon
from cordon import Commanded
from gcs.metrics.references import ring_references

pytestmark = pytest.mark.slow

TARGET_M, ON_RING_M, ZONE_M, FLOOR_M, RATE_RAD_S = (14.0, 0.0), (24.0, 0.0), 1.5, 13.0, 0.08
RAISED_S, JUDGED_S, END_S = 45.0, 70.0, 135.0


def test_a_raised_ring_bends_around_a_zone_at_its_new_heights() -> None:
    mission = cordon.load("case2-field").replace(
        target={"start_m": list(TARGET_M), "velocity_m_s": [0.0, 0.0]},
        decision={"distance_max_m": 60.0},
        encirclement={"angular_rate_rad_s": RATE_RAD_S, "altitude_m": 8.0},
        safety={"no_fly": [{"name": "crane", "center_m": list(ON_RING_M), "radius_m": ZONE_M, "floor_m": FLOOR_M}]},
    )
    flown = cordon.simulate(mission, seed=3, duration_s=END_S, events=[Commanded(RAISED_S, "ring altitude=18")])
    judged = flown.record.time_s > JUDGED_S
    for track in flown.record.vehicles:
        assert track.altitude_m is not None
        off_m = np.hypot(*(track.position_m - np.array(ON_RING_M)).T)
        assert off_m[track.altitude_m > FLOOR_M].min() > ZONE_M
        assert track.altitude_m[-1] > 17.0
        x, y = (track.position_m[judged] - np.array(TARGET_M)).T
        turned_rad = np.unwrap(np.arctan2(y, x))
        assert turned_rad[-1] - turned_rad[0] > 0.9 * RATE_RAD_S * (END_S - JUDGED_S), "it is not stopped at the zone"
    desired_m = ring_references(mission, flown.record)[0].outline_m(360) + np.array(TARGET_M)
    assert np.hypot(*(desired_m - np.array(ON_RING_M)).T).min() > ZONE_M, "metrics judge the bent ring"
    assert min(np.hypot(*(each.position_m - np.array(ON_RING_M)).T).min() for each in flown.record.vehicles) < 0.5, (
        "below the zone the ring is a circle"
    )
