"""A ring of vehicles whose reported positions wander, judged by their true positions."""

from itertools import combinations

import numpy as np
import pytest

from agents.outputs import TickOutput
from estimation.state import POSITION, Vector
from gcs.mission.mission import Mission
from sitl.simulation.simulation import NetworkModel
from tests.gcs.flight.test_missions_simulated import own_filter
from tests.support.flight_logs import engaging
from tests.support.observed_flight import observed

pytestmark = pytest.mark.slow

SETTLED_S, BLIND_FROM_S, BLIND_TO_S, UNTIL_S = 60.0, 100.0, 120.0, 140.0
WANDER_M, RING_M, SEED = 0.25, 10.0, 1
BLIND = 0
"""The vehicle whose sensor is blind for a while."""
STEP_MAX_M = 0.3


class Wandering:
    """What a flight shows: true offsets from the target, and claimed ones (T, V, 2); what was sent; uncertainties."""

    def __init__(self, mission: Mission, until_s: float = UNTIL_S) -> None:
        shape = round(until_s * mission.mission.rate_hz) + 1, 3
        self.claimed_m, self.setpoint_m = np.full((2, *shape, 2), np.nan)
        self.sigma_m, self.boundary_sigma_m = np.full((2, *shape), np.nan)

        def observe(tick: int, vehicle: int, output: TickOutput) -> None:
            situation = output.status.situation
            assert situation is not None
            assert output.setpoint is not None
            self.claimed_m[tick, vehicle] = situation.own.mean[POSITION]
            self.setpoint_m[tick, vehicle] = output.setpoint.position_m[:2]
            self.sigma_m[tick, vehicle] = situation.position_sigma_m
            self.boundary_sigma_m[tick, vehicle] = situation.boundary_sigma_m

        flight = observed(mission, SEED, observe, duration_s=until_s, network=NetworkModel(1000.0))
        self.time_s = flight.time_s
        self.true_m = flight.motion[:, :, POSITION]
        target_m = np.array([mission.target.motion.position_m(time_s) for time_s in flight.time_s.tolist()])
        self.away_m = self.true_m - target_m[:, None]
        blind = (flight.time_s >= BLIND_FROM_S) & (flight.time_s < BLIND_TO_S + 10.0)
        self.blind, self.seeing = blind, (flight.time_s >= SETTLED_S) & ~blind

    @property
    def radius_error_m(self) -> Vector:
        return np.asarray(np.linalg.norm(self.away_m, axis=2) - RING_M)

    @property
    def spacing_error_deg(self) -> Vector:
        bearings = np.sort(np.degrees(np.arctan2(self.away_m[..., 1], self.away_m[..., 0])), axis=1)
        return np.diff(bearings, axis=1, append=bearings[:, :1] + 360.0) - 120.0

    def separations_m(self, positions_m: Vector) -> Vector:
        pairs = combinations(range(3), 2)
        return np.array([np.linalg.norm(positions_m[:, i] - positions_m[:, j], axis=1) for i, j in pairs]).T


def rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def wandering() -> Wandering:
    mission = engaging("case2-wander", (("vehicles", BLIND, "sensor"), {"blind_s": [[BLIND_FROM_S, BLIND_TO_S]]}))
    assert mission.simulation.wander_m == WANDER_M
    assert (mission.target.sensor.rate_hz, mission.target.sensor.noise_m) == (5.0, 0.3)
    return Wandering(mission)


def test_the_true_ring_is_about_the_target_and_evenly_spaced(wandering: Wandering) -> None:
    assert rms(wandering.radius_error_m[wandering.seeing]) <= 0.10
    assert rms(wandering.spacing_error_deg[wandering.seeing]) <= 1.0


def test_the_same_vehicles_that_know_nothing_of_their_wander_fly_a_ring_that_is_off_by_it() -> None:
    flight = Wandering(own_filter(wander_m=0.0)(engaging("case2-wander")), 100.0)
    assert rms(flight.radius_error_m[flight.seeing]) > 0.15


def test_a_blind_sensor_moves_no_setpoint_far_and_leaves_an_error_within_the_wander(wandering: Wandering) -> None:
    steps_m = np.linalg.norm(np.diff(wandering.setpoint_m[:, BLIND], axis=0), axis=1)
    assert steps_m[wandering.blind[1:]].max() <= STEP_MAX_M
    errors_m = np.abs(wandering.radius_error_m[wandering.blind, BLIND])
    assert errors_m.max() <= 3.0 * WANDER_M
    assert rms(errors_m) <= 1.5 * WANDER_M


def test_separations_are_known_far_better_than_positions_are_reported(wandering: Wandering) -> None:
    known_m = wandering.separations_m(wandering.claimed_m) - wandering.separations_m(wandering.true_m)
    assert rms(known_m[wandering.seeing]) <= 0.5 * np.sqrt(2.0) * WANDER_M


def test_the_guard_is_told_how_sure_positions_are(wandering: Wandering) -> None:
    off_m = wandering.claimed_m - wandering.true_m
    apart_m = (off_m[:, 1] - off_m[:, 2])[wandering.seeing]
    assert rms(apart_m) <= 1.5 * np.sqrt(2.0) * rms(wandering.sigma_m[wandering.seeing, 1])
    assert rms(off_m[wandering.seeing]) <= rms(wandering.boundary_sigma_m[wandering.seeing])
    at_end = int(np.flatnonzero(wandering.time_s < BLIND_TO_S)[-1])
    at_begin = int(np.flatnonzero(wandering.time_s < BLIND_FROM_S)[-1])
    assert wandering.sigma_m[at_end, BLIND] > 1.5 * wandering.sigma_m[at_begin, BLIND]
