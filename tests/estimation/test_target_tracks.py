"""Tracks of several targets: gates, confirmation, identities, and independence of the order of arrival."""

from collections.abc import Sequence
from math import exp, inf, isfinite, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, norm

from estimation.filters.assignment import Assignment
from estimation.filters.target import TargetFilter
from estimation.filters.target_tracks import RESOLVED_SIGMA, TargetTrack, TargetTracks
from estimation.settings import TargetFilterSettings
from estimation.state import Sighting, Vector
from tests.experiments.association import CLOSEST_M, Crossing, crossing, sightings

pytestmark = pytest.mark.filterwarnings("error")

SETTINGS = TargetFilterSettings()
NOISE_M2 = 0.09
Pair = tuple[float, float]


def sighting(time_s: float, position_m: Pair, sensor_id: int = 1, target: str | None = None) -> Sighting:
    covariance_m2 = NOISE_M2, 0.0, NOISE_M2
    return Sighting(time_s, sensor_id, position_m, covariance_m2, 0.8, 0.2, target=target)


def batch(time_s: float, *positions_m: Sequence[float], sensor_id: int = 1) -> list[Sighting]:
    return [sighting(time_s, (float(x), float(y)), sensor_id) for x, y in positions_m]


def tracked(seen: Sequence[Sighting], names: Sequence[str] = ()) -> TargetTracks:
    tracks = TargetTracks(SETTINGS, names)
    tracks.sight(*seen)
    return tracks


def resting(places: Sequence[Pair], until_s: float = 2.0, sensor_id: int = 1) -> list[Sighting]:
    """Exact sightings of targets at rest, five times a second."""
    times_s = np.arange(0.0, until_s + 0.01, 0.2).round(3).tolist()
    return [each for time_s in times_s for each in batch(time_s, *places, sensor_id=sensor_id)]


def contents(tracks: Sequence[TargetTrack]) -> list[tuple[object, ...]]:
    return [
        (one.track_id, one.named, one.confirmed_s, one.exchanges, one.estimate.sighted_s, one.estimate.mean.tolist())
        for one in tracks
    ]


def places_of(tracks: Sequence[TargetTrack]) -> dict[str, list[float]]:
    return {one.track_id: one.estimate.mean[:2].tolist() for one in tracks}


def test_the_gate_refuses_as_many_sound_sightings_as_chi_squared_states() -> None:
    """The target does not move, so that a second sighting differs from the first by both noises."""
    random, draws, gate_sigma = np.random.default_rng(1), 4000, 1.2
    still = TargetFilterSettings(gate_sigma=gate_sigma, velocity_prior_m_s=1e-6, acceleration_noise_m_s2=1e-6)
    noise = np.array([[0.3, 0.1], [0.1, 0.2]])
    covariance_m2 = 0.3, 0.1, 0.2
    target = TargetFilter(still)
    target.sight(Sighting(0.0, 1, (5.0, -3.0), covariance_m2, 0.8, 0.2))
    places = random.multivariate_normal([5.0, -3.0], 2.0 * noise, draws).tolist()
    fits = [target.fit(Sighting(0.1, 1, (x, y), covariance_m2, 0.8, 0.2)) for x, y in places]
    share = chi2.sf(2.0 * gate_sigma**2, 2)
    assert exp(-(gate_sigma**2)) == pytest.approx(share)
    refused = sum(fit is None for fit in fits) / draws
    assert refused == pytest.approx(share, abs=4.0 * sqrt(share * (1.0 - share) / draws))
    for place, fit in zip(places, fits, strict=True):
        if fit is not None:
            off = np.array(place) - (5.0, -3.0)
            assert fit.squared == pytest.approx(off @ np.linalg.solve(2.0 * noise, off), rel=1e-6)
            assert fit.log_volume == pytest.approx(np.linalg.slogdet(2.0 * noise)[1], rel=1e-6)


def test_tracks_at_the_limit_of_resolution_exchange_sightings_as_often_as_stated() -> None:
    random, draws = np.random.default_rng(2), 4000
    still = TargetFilterSettings(velocity_prior_m_s=1e-6, acceleration_noise_m_s2=1e-6)
    # Prior and sighting have the same noise: the difference of two sightings has four times its variance.
    apart_m = RESOLVED_SIGMA * sqrt(4.0 * NOISE_M2)
    places: list[Pair] = [(0.0, 0.0), (apart_m, 0.0)]
    targets = [TargetFilter(still), TargetFilter(still)]
    for target, place in zip(targets, places, strict=True):
        target.sight(sighting(0.0, place))
    assignment, wrong = Assignment(), 0
    for noise in random.normal(0.0, sqrt(2.0 * NOISE_M2), (draws, 2, 2)):
        seen = batch(0.1, *(np.array(places) + noise))
        fits = [[target.fit(each) for each in seen] for target in targets]
        costs = [[inf if fit is None else fit.squared + fit.log_volume for fit in row] for row in fits]
        wrong += assignment.columns(costs, 100.0) == [1, 0]
    share = norm.cdf(-RESOLVED_SIGMA)
    assert share == pytest.approx(0.023, abs=5e-4)
    assert wrong / draws == pytest.approx(share, abs=4.0 * sqrt(share / draws))


@pytest.mark.parametrize(
    ("times_s", "confirmed_s"),
    [
        ((0.0, 0.7), None),
        ((0.0, 0.7, 1.4), 1.4),
        ((0.0, 0.5, 1.5), 1.5),
        ((0.7, 1.5, 2.2), 2.2),  # 2.2 - 0.7 is more than 1.5 in floating point
        ((0.0, 0.8, 1.6), None),
        ((0.0, 0.8, 1.6, 2.3), 2.3),
        ((0.0, 0.1, 1.7, 1.8), None),  # dropped at 1.6: the third begins another
    ],
)
def test_three_sightings_within_a_second_and_a_half_confirm_a_track(
    times_s: tuple[float, ...], confirmed_s: float | None
) -> None:
    found = tracked([sighting(time_s, (3.0, 4.0)) for time_s in times_s]).tracks(times_s[-1])
    assert [each.confirmed_s for each in found] == ([] if confirmed_s is None else [confirmed_s])


@pytest.mark.parametrize(("third_m", "count"), [(0.8, 1), (2.0, 0)])
def test_a_tentative_track_takes_no_sighting_beyond_three_sigma(third_m: float, count: int) -> None:
    """By hand: variances 0.045 of the position, up to 0.04 of the way in 0.2 s, 0.04 of the reach, 0.09 of the noise.

    Three standard deviations are 1.2 to 1.4 m, the gate of confirmed tracks is 2.3 to 2.6 m.
    """
    seen = [sighting(0.0, (0.0, 0.0)), sighting(0.2, (0.0, 0.0)), sighting(0.4, (third_m, 0.0))]
    assert len(tracked(seen).tracks(0.4)) == count


@pytest.mark.parametrize(("sighted_s", "kept_s"), [(0.4, 1.5), (4.0, 4.0), (30.0, SETTINGS.stale_after_s)])
def test_a_track_lasts_without_sightings_as_long_as_it_was_sighted(sighted_s: float, kept_s: float) -> None:
    tracks = tracked([])
    for each in resting([(0.0, 0.0)], sighted_s):
        tracks.sight(each)
    (before,) = tracks.tracks(sighted_s + kept_s - 0.01)
    assert tracks.tracks(sighted_s + kept_s + 0.01) == ()
    again_s = sighted_s + kept_s + 0.1
    tracks.sight(*(sighting(again_s + 0.2 * tick, (0.0, 0.0)) for tick in range(3)))
    (after,) = tracks.tracks(again_s + 0.4)
    assert after.track_id != before.track_id


def test_a_batch_is_assigned_jointly() -> None:
    """Both sightings are nearest to the second track; one of them has to be of the first."""
    tracks = tracked([*resting([(0.0, 0.0), (1.5, 0.0)]), *batch(2.2, (0.8, 0.0), (2.3, 0.0))])
    assert [one.estimate.sighted_s for one in tracks.tracks(2.2)] == [2.2, 2.2]
    (first_x, _), (second_x, _) = places_of(tracks.tracks(2.2)).values()
    assert 0.0 < first_x < 0.5
    assert 1.5 < second_x < 2.0


def test_outliers_change_no_track() -> None:
    random = np.random.default_rng(3)
    sound = resting([(0.0, 0.0), (10.0, 0.0)], 10.0)
    wild = [
        sighting(each.time_s, (float(x), float(y)))
        for each, (x, y) in zip(sound[::2], random.uniform(20.0, 2000.0, (len(sound) // 2, 2)), strict=True)
    ]
    with_outliers = tracked([])
    for each in sorted([*sound, *wild], key=lambda one: one.time_s):
        with_outliers.sight(each)
    alone = tracked([])
    alone.sight(*sound)
    assert contents(with_outliers.tracks(10.0)) == contents(alone.tracks(10.0))
    assert len(alone.tracks(10.0)) == 2


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_neither_order_nor_calls_matter(seed: int) -> None:
    random = np.random.default_rng(seed)
    seen = [each for each in sightings(crossing(random, 0.2), random) if 7.0 < each.time_s < 13.0]
    in_order = tracked([])
    for each in seen:
        in_order.sight(each)
    late_s = random.uniform(0.0, 0.45, len(seen))
    arrival = [seen[index] for index in np.argsort([one.time_s for one in seen] + late_s)]
    mixed = tracked([])
    while arrival:
        count = int(random.integers(1, 9))
        mixed.sight(*random.permutation(np.array(arrival[:count], dtype=object)))
        del arrival[:count]
    assert in_order.refused == mixed.refused == 0
    assert len(in_order.tracks(13.0)) >= 2
    assert contents(mixed.tracks(13.0)) == contents(in_order.tracks(13.0))


def test_repeats_and_sightings_that_are_too_late_are_refused() -> None:
    seen = resting([(0.0, 0.0)], 4.0)
    tracks = tracked(seen)
    before = contents(tracks.tracks(4.0))
    tracks.sight(seen[-1], sighting(4.0 - SETTINGS.late_max_s - 0.1, (0.2, 0.0), 2))
    assert (tracks.refused, tracks.late) == (2, 0)
    assert contents(tracks.tracks(4.0)) == before
    tracks.sight(sighting(3.5, (0.2, 0.0), 2))
    assert (tracks.refused, tracks.late) == (2, 1)
    assert contents(tracks.tracks(4.0)) != before


def test_named_sightings_are_those_of_one_target_filter() -> None:
    """The second target's sightings are much nearer to the first one's track than its own."""
    random = np.random.default_rng(4)
    names, tracks = ("near", "far"), tracked([], ("near", "far"))
    alone = {name: TargetFilter(SETTINGS) for name in names}
    for tick in range(40):
        for name, x_m in zip(names, (0.0, 0.5), strict=True):
            x, y = random.normal((x_m, 0.0), 0.3).tolist()
            seen = sighting(0.1 * tick, (x, y), 1, name)
            tracks.sight(seen)
            alone[name].sight(seen)
        if tick == 0:
            assert [one.track_id for one in tracks.tracks(0.0)] == ["far", "near"]
    for one in tracks.tracks(3.9):
        estimate = alone[one.track_id].estimate(3.9)
        assert estimate is not None
        assert one.estimate.mean.tolist() == estimate.mean.tolist()
        assert one.exchanges == ()
    tracks.sight(sighting(4.0, (0.0, 0.0), 1, "unknown"))
    assert tracks.refused == 1


def test_what_a_sensor_sees_beside_a_named_target_is_another() -> None:
    tracks = tracked([], ["alpha"])
    for tick in range(3):
        tracks.sight(sighting(0.2 * tick, (0.0, 0.0), 1, "alpha"), sighting(0.2 * tick, (0.5, 0.0)))
    found = places_of(tracks.tracks(0.4))
    assert found.pop("alpha") == pytest.approx([0.0, 0.0], abs=1e-9)
    assert list(found.values()) == [pytest.approx([0.5, 0.0], abs=1e-9)]


def test_a_name_is_not_empty() -> None:
    with pytest.raises(ValueError, match="name"):
        sighting(0.0, (0.0, 0.0), target="")


def test_a_name_is_given_to_the_track_that_its_first_sighting_fits() -> None:
    tracks = tracked(resting([(0.0, 0.0), (10.0, 0.0)]), ["alpha"])
    (first, second) = tracks.tracks(2.0)
    tracks.sight(sighting(2.1, (10.2, 0.1), 7, "alpha"))
    found = tracks.tracks(2.1)
    assert [one.track_id for one in found] == [first.track_id, "alpha"]
    assert found[1].confirmed_s == second.confirmed_s
    assert found[1].estimate.mean[0] == pytest.approx(10.05, abs=0.05)  # between the old track and the sighting


def separation(tracks: Sequence[TargetTrack]) -> float:
    """Two tracks' distance in standard deviations of the difference of two sightings."""
    one, other = (each.estimate for each in tracks)
    off = one.mean[:2] - other.mean[:2]
    covariance = one.covariance[:2, :2] + other.covariance[:2, :2] + 2.0 * NOISE_M2 * np.eye(2)
    return sqrt(float(off @ np.linalg.solve(covariance, off)))


def meeting(places: Vector, tracks: TargetTracks, from_s: float, to_s: float) -> float | None:
    """Let a sensor see targets that start at places (2, 2) and move towards each other at 1 m/s each along x, exactly;
    return when they were closer than resolved first.
    """
    unresolved_s = None
    for time_s in np.arange(from_s, to_s, 0.2).round(3).tolist():
        if unresolved_s is None and len(before := tracks.tracks(time_s)) == 2:
            unresolved_s = time_s if separation(before) < RESOLVED_SIGMA else None
        tracks.sight(*batch(time_s, *(places + time_s * np.array([[1.0, 0.0], [-1.0, 0.0]]))))
    return unresolved_s


@pytest.mark.parametrize("apart_m", [0.3, 3.0])
def test_tracks_that_come_closer_than_the_sensors_resolve_are_marked(apart_m: float) -> None:
    tracks = tracked([])
    unresolved_s = meeting(np.array([[-6.0, 0.0], [6.0, apart_m]]), tracks, 0.0, 9.0)
    assert (unresolved_s is None) == (apart_m > 1.0)
    found = tracks.tracks(9.0)
    assert [one.uncertain_since_s for one in found] == [unresolved_s, unresolved_s]
    if unresolved_s is not None:
        assert [[each.other_id for each in one.exchanges] for one in found] == [
            [found[1].track_id],
            [found[0].track_id],
        ]
    # Exact sightings: nothing was exchanged.
    assert [one.estimate.mean[0] for one in found] == pytest.approx([3.0, -3.0], abs=0.1)


@pytest.mark.parametrize("mirrored", [False, True])
def test_possible_exchanges_follow_chains(mirrored: bool) -> None:
    """The third target meets the second after the second has met the first; the first is far away by then.

    In the mirror image the identifiers, which follow the places, have the reverse order.
    """
    side = -1.0 if mirrored else 1.0
    tracks = tracked([])
    for time_s in np.arange(0.0, 20.0, 0.2).round(3).tolist():
        tracks.sight(*batch(time_s, (0.0, 0.0), (side * (time_s - 5.0), 0.3), (side * 10.0, 0.0)))
    found = {round(side * one.estimate.mean[0]): one for one in tracks.tracks(20.0)}
    first, second, third = found[0], found[15], found[10]
    for one, other in ((first, third), (third, first)):
        since_s = {each.other_id: each.since_s for each in one.exchanges}
        assert set(since_s) == {second.track_id, other.track_id}
        assert since_s[other.track_id] == pytest.approx(15.0, abs=1.5)
    since_s = {each.other_id: each.since_s for each in second.exchanges}
    assert since_s[first.track_id] == pytest.approx(5.0, abs=1.5)


def bounced(names: Sequence[str]) -> TargetTracks:
    """Two named targets that turn back where they meet, which looks like a crossing to a sensor that names none."""
    tracks = tracked([], names)
    for time_s in np.arange(0.0, 9.0, 0.2).round(3).tolist():
        left, right = (-abs(time_s - 6.0), 0.0), (abs(time_s - 6.0), 0.1)
        if time_s < 3.0:
            tracks.sight(sighting(time_s, left, 2, names[0]), sighting(time_s, right, 2, names[1]))
        else:
            tracks.sight(*batch(time_s, left, right))
    return tracks


def test_a_sighting_with_a_name_corrects_exchanged_identities() -> None:
    tracks = bounced(("left", "right"))
    assert places_of(tracks.tracks(8.8))["left"][0] > 2.0
    tracks.sight(sighting(9.0, (-3.0, 0.0), 2, "left"))
    found = tracks.tracks(9.0)
    assert places_of(found)["left"][0] == pytest.approx(-3.0, abs=0.2)
    assert places_of(found)["right"][0] == pytest.approx(3.0, abs=0.2)
    # One sighting could be an outlier; the next one agrees, and ends the uncertainty of both.
    assert all(one.exchanges for one in found)
    tracks.sight(sighting(9.2, (-3.2, 0.0), 2, "left"))
    assert [one.exchanges for one in tracks.tracks(9.2)] == [(), ()]


@pytest.mark.parametrize("seed", range(4))
def test_the_tracks_follow_crossing_targets(seed: int) -> None:
    random = np.random.default_rng([seed, 11])
    targets: Crossing = crossing(random, CLOSEST_M)
    tracks = tracked(sightings(targets, random))
    found = places_of(tracks.tracks(20.0))
    off = [min(np.hypot(*(np.array(place) - truth)) for place in found.values()) for truth in targets.at(20.0)]
    assert max(off) < 0.5


HUGE = st.one_of(st.floats(-100.0, 100.0), st.sampled_from([1e200, -1e308, 1e308]))
VARIANCE = st.sampled_from([1e-150, 1e-12, 0.09, 1e5, 1e150, 1e308])


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.integers(1, 2), HUGE, HUGE, VARIANCE), max_size=20))
def test_any_sightings_give_finite_tracks(rows: list[tuple[float, int, float, float, float]]) -> None:
    tracks = tracked([])
    for time_s, sensor_id, x, y, variance in rows:
        tracks.sight(Sighting(time_s, sensor_id, (x, y), (variance, 0.0, max(variance, 1e-150)), 0.8, 0.2))
        for one in tracks.tracks(3.0):
            assert isfinite(one.estimate.mean[0] + one.estimate.mean[1])
