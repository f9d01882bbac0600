"""What a vehicle converts between its autopilot's frame and the team's."""

from collections.abc import Callable

import numpy as np
import pytest

from agents.settings.config import AgentConfig
from agents.situation.team_frame import TeamFrame
from estimation.filters.target import TargetFilter
from estimation.settings import OwnFilterSettings, TargetFilterSettings
from estimation.state import VELOCITY, Sighting, TargetEstimate, Telemetry
from tests.support.estimates import target_spread

Maker = Callable[..., AgentConfig]
WANDERING = OwnFilterSettings(wander_m=0.25)


def sighting(time_s: float, sensor_id: int, x: float, sigma_m: float = 0.25) -> Sighting:
    return Sighting(time_s, sensor_id, (x, 0.0), (0.01, 0.0, 0.01), 0.8, 0.2, None, 1.0, sigma_m, 20.0)


def target(time_s: float) -> dict[str, TargetEstimate]:
    return {"": TargetEstimate(time_s, np.zeros(4), target_spread(0.1), time_s, 0.8, 0.2)}


def watched(frame: TeamFrame, own_m: float, seconds: float = 20.0) -> None:
    """The own sensor sees the target at `own_m` in x, a peer at the same distance on the other side."""
    for tick in range(round(seconds * 10.0)):
        now_s = tick * 0.1
        frame.telemetry(Telemetry(now_s, (5.0, 0.0, 8.0), (0.0, 0.0, 0.0)))
        own = frame.shared(sighting(now_s, 1, own_m, 0.0))
        frame.sightings(now_s, [own, sighting(now_s, 2, -own_m)], target(now_s))
        frame.follow()


def test_without_wander_everything_but_what_others_see_is_passed_on_as_it_is(make_config: Maker) -> None:
    frame = TeamFrame(make_config(vehicle_id=1))
    telemetry = Telemetry(0.0, (5.0, 0.0, 8.0), (0.0, 0.0, 0.0))
    sightings = [sighting(0.0, 1, 0.3, 0.0), sighting(0.0, 2, 0.3, 0.0)]
    assert frame.telemetry(telemetry) is telemetry
    assert frame.shared(sightings[0]) is sightings[0]
    own, other = frame.sightings(0.0, sightings, target(0.0))
    assert own is sightings[0]
    assert other.position_m == sightings[1].position_m
    assert other.covariance_m2[0] > sightings[1].covariance_m2[0]
    assert (frame.follow(), frame.offset_m, frame.variance_m2) == ((0.0, 0.0), (0.0, 0.0), 0.0)


def test_exact_sightings_from_places_that_differ_show_no_target_that_darts_about(make_config: Maker) -> None:
    # Three vehicles whose positions sway by 0.25 m, each in its own time, at 0.2 m/s at most, see a target that stands.
    periods_s, lateness_s = np.array([8.0, 11.0, 13.0]), (0.0, 0.023, 0.05)
    frame, seen = TeamFrame(make_config(vehicle_id=1)), TargetFilter(TargetFilterSettings())
    speeds = []
    for round_s in np.arange(0.0, 120.0, 0.2).tolist():
        off_m = 0.25 * np.sin(2.0 * np.pi * round_s / periods_s)
        for sensor, (late_s, x) in enumerate(zip(lateness_s, off_m.tolist(), strict=True), start=1):
            exact = Sighting(round_s + late_s, sensor, (x, 0.0), (1e-4, 0.0, 1e-4), 0.8, 0.2)
            before = seen.estimate(exact.time_s)
            seen.sight(*frame.sightings(exact.time_s, [exact], {} if before is None else {"": before}))
        estimate = seen.estimate(round_s)
        speeds += [] if estimate is None else [float(np.hypot(*estimate.mean[VELOCITY]))]
    assert max(speeds[50:]) < 0.5
    assert seen.refused == 0


def test_the_own_offset_is_found_and_taken_off_positions_but_not_off_what_peers_get(make_config: Maker) -> None:
    frame = TeamFrame(make_config(vehicle_id=1, own_filter=WANDERING))
    watched(frame, 0.3)
    assert frame.offset_m == pytest.approx((0.3, 0.0), abs=0.05)
    reported = frame.telemetry(Telemetry(20.0, (5.0, 0.0, 8.0), (0.0, 0.0, 0.0)))
    assert reported.position_m[0] == pytest.approx(5.0 - frame.offset_m[0])
    shared = frame.shared(sighting(20.0, 1, 0.3, 0.0))
    assert shared.position_m[0] == pytest.approx(0.3, abs=0.02)
    assert shared.frame_sigma_m == pytest.approx(0.25, rel=0.05)
    own, other = frame.sightings(20.0, [shared, sighting(20.0, 2, -0.3)], target(20.0))
    assert (own.position_m[0], other.position_m[0]) == pytest.approx((0.0, 0.0), abs=0.05)
    assert own.covariance_m2[0] > shared.covariance_m2[0]


def test_the_offset_moves_smoothly_and_is_less_sure_without_sightings(make_config: Maker) -> None:
    frame = TeamFrame(make_config(vehicle_id=1, own_filter=WANDERING))
    assert frame.variance_m2 == pytest.approx(0.25**2)
    watched(frame, 0.3)
    seeing_m2, moves = frame.variance_m2, []
    assert seeing_m2 < 0.5 * 0.25**2
    for tick in range(300):
        now_s = 20.0 + tick * 0.1
        frame.telemetry(Telemetry(now_s, (5.0, 0.0, 8.0), (0.0, 0.0, 0.0)))
        before = frame.offset_m[0]
        frame.sightings(now_s, (), target(now_s))
        frame.follow()
        moves.append(abs(frame.offset_m[0] - before))
    assert max(moves) < 0.02
    assert 0.0 < frame.offset_m[0] < 0.25
    assert seeing_m2 < frame.variance_m2 <= 0.25**2
