"""Altitudes: the layers, or the target's from noisy sightings, and what the vehicles make of it together."""

from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from agents.broadcast import received_sighting, target_package
from agents.setpoint import Altitude
from agents.settings.config import AgentConfig
from agents.tactics import Tactic
from agents.team.codec import decode, encode
from agents.team.messages import MemberState
from estimation.filters.target_altitude import RANDOM_WALK_M, TargetAltitude
from estimation.settings import TargetFilterSettings
from estimation.state import Sighting
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Decision, Truth
from gcs.mission.file import load_mission
from gcs.preflight.mission import highest_m
from gcs.replay.cores import replay
from tests.support.flight_logs import engaging, record_simulation
from tests.support.mission_text import Content, content, faults, parsed, put

Maker = Callable[..., AgentConfig]

SETTINGS = TargetFilterSettings()
BAND = {"altitude_min_m": 3.0, "altitude_max_m": 30.0}
ABOVE = {"altitude": "target", "altitude_offset_m": 6.0}
FLIES_M, LOWEST_M, HIGHEST_M = 9.0, 8.0, 12.0
"""One of several vehicles: the heights of its mission's."""


def told(altitude_m: float | None, time_s: float = 1.0, sigma_m: float = 0.5) -> Sighting:
    return Sighting(time_s, 1, (9.0, 0.0), (0.1, 0.0, 0.1), 0.8, 0.2, altitude_m, sigma_m)


def believed(sightings: Iterable[Sighting]) -> float | None:
    altitude = TargetAltitude(SETTINGS)
    for sighting in sightings:
        altitude.sight(sighting)
    return altitude.mean_m


# The filter


def test_it_is_the_random_walk_that_fits_all_sightings_best(batch_mean: Callable[..., np.ndarray]) -> None:
    random = np.random.default_rng(4)
    times_s = np.cumsum(random.uniform(0.05, 0.6, 12))
    heights_m, one = 7.0 + random.normal(0.0, 0.5, 12), np.eye(1)
    steps = [(one, np.zeros(1), one * RANDOM_WALK_M**2 * step_s) for step_s in np.diff(times_s)]
    measured = [(np.array([height_m]), one, one * 0.25) for height_m in heights_m[1:]]
    best = batch_mean((heights_m[:1], one * 0.25), steps, measured)
    assert believed(map(told, heights_m, times_s)) == pytest.approx(best[-1])


def test_a_climb_is_followed_half_a_second_late_and_noise_is_smoothed() -> None:
    random, times_s = np.random.default_rng(1), np.arange(600) / 15.0
    altitude, errors_m = TargetAltitude(SETTINGS), []
    for time_s in times_s.tolist():
        altitude.sight(told(time_s + random.normal(0.0, 1.0), time_s, 1.0))
        assert altitude.mean_m is not None
        errors_m.append(time_s - altitude.mean_m)
    assert np.mean(errors_m[100:]) == pytest.approx(0.5, abs=0.2)
    assert np.std(errors_m[100:]) < 0.4


def test_an_outlier_is_refused_and_persistent_agreement_is_not() -> None:
    steady = [told(5.0, each / 5.0) for each in range(20)]
    assert believed([*steady, told(25.0, 4.0)]) == pytest.approx(5.0)
    raised = [told(25.0, 4.0 + each / 5.0) for each in range(15)]
    assert believed([*steady, *raised]) == pytest.approx(25.0)


def test_what_comes_too_late_or_after_a_long_silence() -> None:
    steady = [told(5.0, 20.0 + each / 5.0) for each in range(20)]
    assert believed([*steady, told(6.0, 20.0)]) == pytest.approx(5.0)
    assert believed([*steady, told(6.0, 23.5)]) > 5.0  # type: ignore[operator]  # not None
    assert believed([*steady, told(40.0, 24.0 + SETTINGS.stale_after_s)]) == 40.0


def test_a_sighting_with_an_altitude_that_is_none_is_refused() -> None:
    for altitude_m, sigma_m, words in ((float("nan"), 1.0, "not finite"), (3.0, 0.0, "altitude_sigma_m 0.0")):
        with pytest.raises(ValueError, match=words):
            told(altitude_m, sigma_m=sigma_m)


@pytest.mark.parametrize("altitude_m", [None, 4.25])
def test_peers_receive_it(altitude_m: float | None) -> None:
    sighting, here = told(altitude_m), (0.0, 0.0)
    package = target_package(1, sighting, (2, 3))
    state = MemberState(1, sighting.time_s, "encircle", here, here, here, here, sightings=(package,))
    again = decode(encode(state))
    assert isinstance(again, MemberState)
    (received,) = again.sightings
    known_sigma = sighting.altitude_sigma_m if altitude_m is not None else 1.0
    assert received_sighting(received) == replace(sighting, altitude_sigma_m=known_sigma)


# One vehicle


def following(make_config: Maker, **changes: object) -> Altitude:
    team = {"altitude_m": FLIES_M, "altitude_lowest_m": LOWEST_M, "layers_from_m": HIGHEST_M}
    between_m = BAND["altitude_min_m"], BAND["altitude_max_m"] - (HIGHEST_M - LOWEST_M)
    return Altitude(make_config(**team, encirclement=ABOVE, lowest_between_m=between_m, **changes))


def settled(altitude: Altitude, tactic: Tactic, layer_m: float = FLIES_M) -> float:
    heights_m = [altitude.next(tactic, layer_m)[0] for _ in range(600)]
    assert max(abs(after_m - before_m) for before_m, after_m in pairwise(heights_m)) <= 0.1 + 1e-9
    return heights_m[-1]


def test_in_layers_the_target_changes_nothing(make_config: Maker) -> None:
    altitude = Altitude(make_config())
    altitude.sight(told(20.0))
    assert [altitude.next(tactic, 11.5)[0] for tactic in Tactic] == [11.5] * len(Tactic)
    assert altitude.target_m is None


def test_on_the_ring_it_flies_above_the_target_by_offset_and_its_own_height(make_config: Maker) -> None:
    altitude = following(make_config)
    assert settled(altitude, Tactic.ENCIRCLE) == pytest.approx(FLIES_M), "nobody told how high the target is"
    altitude.sight(told(4.0))
    assert settled(altitude, Tactic.ENCIRCLE) == pytest.approx(4.0 + 6.0 + (FLIES_M - LOWEST_M))
    assert settled(altitude, Tactic.HOLD) == pytest.approx(11.0)
    assert settled(altitude, Tactic.ASIDE) == pytest.approx(11.0)
    assert settled(altitude, Tactic.FORMATION) == pytest.approx(FLIES_M)
    assert settled(altitude, Tactic.RETURN_AND_LAND, 15.0) == pytest.approx(15.0)


def test_it_leaves_its_layer_of_take_off_only_when_all_are_in_their_places(make_config: Maker) -> None:
    altitude = following(make_config)
    altitude.sight(told(4.0))
    assert settled(altitude, Tactic.ENCIRCLE, layer_m=16.0) == pytest.approx(16.0)


@pytest.mark.parametrize(("target_m", "lowest_m"), [(-50.0, 3.0), (2.0, 8.0), (19.0, 25.0), (400.0, 26.0)])
def test_the_band_stops_the_team_as_a_whole(make_config: Maker, target_m: float, lowest_m: float) -> None:
    """The highest vehicle is 4 m above the lowest: so they keep their heights among each other."""
    altitude = following(make_config)
    altitude.sight(told(target_m))
    assert settled(altitude, Tactic.ENCIRCLE) == pytest.approx(lowest_m + FLIES_M - LOWEST_M)


# A team


def test_a_team_follows_the_targets_altitude_and_its_flight_is_replayed_to_the_bit(tmp_path: Path) -> None:
    """Vehicles at 8, 10 and 12 m; with the target at 9.5 m and an offset of 2 m they climb by 3.5 m, at 0.5 m/s."""
    heights_m = (8.0, 10.0, 12.0)
    changes = [(("vehicles", index, "altitude_m"), height_m) for index, height_m in enumerate(heights_m)]
    rules = {"altitude": "target", "altitude_offset_m": 2.0, "climb_max_m_s": 0.5}
    asked = [*((("encirclement", key), value) for key, value in rules.items()), (("target", "altitude_m"), 9.5)]
    mission = engaging("case2-field", *changes, *asked, *((("safety", key), value) for key, value in BAND.items()))
    path = tmp_path / "flight.mcap"
    record_simulation(mission, path, duration_s=28.0)
    log = read_log(path)
    for vehicle_id, height_m in zip(mission.ids, heights_m, strict=True):
        records = log.vehicles[vehicle_id]
        truth_m = [each.message().position_m[2] for each in records if each.kind is Truth]
        decisions = [each.message() for each in records if each.kind is Decision]
        asked_m = [each.setpoint.position_m[2] for each in decisions]
        assert truth_m[0] == height_m
        assert asked_m[-1] == pytest.approx(height_m + 3.5, abs=0.4)  # seen with noise of half a metre
        assert truth_m[-1] == pytest.approx(asked_m[-1], abs=0.3)
        assert decisions[-1].target_altitude_m == pytest.approx(9.5, abs=0.4)
        assert np.abs(np.diff(asked_m)).max() <= 0.5 / mission.mission.rate_hz + 1e-9
    again = replay(log)
    assert again.same
    assert [each.identical for each in again.vehicles] == [each.ticks for each in again.vehicles]


# In the mission file


def above(mission: Content | None = None, **changes: object) -> Content:
    mission = content() if mission is None else mission
    for section, keys in (("encirclement", ABOVE), ("safety", BAND)):
        for key, value in keys.items():
            mission = put(mission, (section, key), changes.get(key, value))
    return mission


def test_what_a_ring_above_the_target_needs_is_asked_for() -> None:
    assert faults(put(content(), ("encirclement", "altitude"), "target")) == [
        f'{key}: this key is missing; encirclement.altitude = "target" needs it'
        for key in ("encirclement.altitude_offset_m", "safety.altitude_min_m", "safety.altitude_max_m")
    ]
    (offset,) = faults(put(content(), ("encirclement", "altitude_offset_m"), 5.0))
    assert offset.startswith("encirclement.altitude_offset_m: 5.0 m")
    assert 'encirclement.altitude = "target"' in offset
    assert faults(above(altitude="ground")) == [
        "encirclement.altitude: it must be 'layers' or 'target' (given: 'ground')"
    ]
    assert faults(put(above(), ("target", "altitude_m"), 30.0)) == [
        "encirclement.altitude_offset_m: 6.0 m above target.altitude_m = 30.0 m vehicles fly at 36 to 36 m, not "
        "between safety.altitude_min_m = 3.0 m and altitude_max_m = 30.0 m"
    ]
    mission = parsed(put(above(), ("target", "altitude_m"), 2.0))
    assert highest_m(mission, mission.vehicles[0]) == 30.0
    assert highest_m(load_mission("case2"), load_mission("case2").vehicles[0]) == 8.0
