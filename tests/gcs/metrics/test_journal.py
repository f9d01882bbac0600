"""The journal: the record made of notes is the flight that was noted, and says so where it does not know."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from msgspec import structs

from agents.flight_end import FlightEnd
from agents.outputs import CoreStatus
from agents.situation.situation import Situation
from agents.tactics import Tactic
from agents.team.messages import AddedVehicle, CommandAnswer, MemberState, NeighbourAngle
from estimation.state import OwnEstimate, TargetEstimate, Vector
from gcs.metrics.journal import Journal, RunTotals
from gcs.metrics.record import FlightRecord, VehicleTrack
from gcs.mission.file import joined_mission, load_mission
from gcs.mission.mission import Mission
from sitl.server.record import TruthTrack
from tests.support.estimates import own_spread, target_spread

START_S = 1_700_000_000.0  # a mission starts somewhere on the Unix clock
Motion = Callable[[float], tuple[float, float, float, float]]


@pytest.fixture
def mission() -> Mission:
    """Case 1, with a system id of its own for vehicle 1."""
    case1 = load_mission("case1")
    first, *others = case1.vehicles
    first = replace(first, section=first.section.model_copy(update={"system_id": 101}))
    return replace(case1, vehicles=(first, *others))


def straight(time_s: float) -> tuple[float, float, float, float]:
    """A flight that straight lines between samples give back exactly."""
    return 3.0 + 0.2 * time_s, 4.0 - 0.1 * time_s, 0.2, -0.1


def parallel(time_s: float) -> tuple[float, float, float, float]:
    return 0.2 * time_s, -5.0, 0.2, 0.0


def status(
    vehicle_id: int,
    time_s: float,
    motion: Motion | None = straight,
    *,
    tactic: Tactic = Tactic.FORMATION,
    peers: Iterable[MemberState] = (),
    target: TargetEstimate | None = None,
) -> CoreStatus:
    return CoreStatus(
        vehicle_id=vehicle_id,
        time_s=START_S + time_s,
        tactic=tactic,
        situation=None
        if motion is None
        else situation(START_S + time_s, np.array([*motion(time_s), 0.0, 0.0]), target),
        peers=tuple(peers),
    )


def situation(time_s: float, mean: Vector, target: TargetEstimate | None = None) -> Situation:
    own = OwnEstimate(time_s, mean, own_spread(1.0))
    return Situation(time_s, time_s, own, mean[:4], mean[4:], target, None, None)


def peer(vehicle_id: int, time_s: float, motion: Motion = parallel, tactic: str = "formation") -> MemberState:
    x, y, x_rate, y_rate = motion(time_s)
    return MemberState(vehicle_id, START_S + time_s, tactic, (x, y), (x_rate, y_rate), (x, y), (x_rate, y_rate))


def record(journal: Journal, *truth: TruthTrack, duration_s: float = 10.0, source: str = "flight") -> FlightRecord:
    return journal.record(START_S, duration_s, RunTotals(source, 100, 3, 1.5, truth))


def track(flight: FlightRecord, vehicle_id: int) -> VehicleTrack:
    return next(track for track in flight.vehicles if track.vehicle_id == vehicle_id)


def motions(time_s: Vector, motion: Motion) -> Vector:
    return np.array([motion(at_s) for at_s in time_s.tolist()])


def assert_flies(flown: VehicleTrack, time_s: Vector, motion: Motion) -> None:
    expected = motions(time_s, motion)
    # The Unix clock leaves a grain of 0.2 us.
    np.testing.assert_allclose(flown.position_m, expected[:, :2], atol=1e-6)
    np.testing.assert_allclose(flown.velocity_m_s, expected[:, 2:], atol=1e-6)


def noted(mission: Mission, times_s: Iterable[float], tactic: Callable[[float], Tactic] | None = None) -> Journal:
    journal = Journal(mission)
    for time_s in times_s:
        journal.note(status(1, time_s, tactic=Tactic.FORMATION if tactic is None else tactic(time_s)), 80.0)
    return journal


def test_the_grid_runs_from_the_start_at_the_missions_rate(mission: Mission) -> None:
    flight = record(noted(mission, np.arange(0.0, 10.05, 0.1)))
    np.testing.assert_allclose(flight.time_s, np.arange(101) / 10.0)
    assert (flight.mission, flight.seed, flight.source, flight.reference) == ("case1", 0, "flight", "estimate")
    assert [each.vehicle_id for each in flight.vehicles] == [1], "the only one that was heard of"
    assert (flight.loop.rate_hz, flight.loop.ticks, flight.loop.missed, flight.wall_time_s) == (10.0, 100, 3, 1.5)
    assert flight.loop.tick_us.tolist() == [80.0] * 101


@pytest.mark.parametrize("period_s", [0.07, 0.9])
def test_a_straight_flight_is_given_back_whatever_the_rate_it_was_noted_at(period_s: float, mission: Mission) -> None:
    flight = record(noted(mission, np.arange(-1.0, 11.0, period_s)))
    assert_flies(track(flight, 1), flight.time_s, straight)
    assert set(track(flight, 1).tactic) == {"formation"}


def test_a_tactic_holds_from_its_note_to_the_next(mission: Mission) -> None:
    flight = record(
        noted(mission, np.arange(0.0, 11.0, 0.5), lambda t: Tactic.ENCIRCLE if t >= 4.0 else Tactic.FORMATION)
    )
    tactic = track(flight, 1).tactic
    assert set(tactic[flight.time_s < 3.99]) == {"formation"}
    assert set(tactic[flight.time_s > 4.01]) == {"encircle"}


def test_before_the_first_and_after_the_last_note_and_in_a_gap_all_is_unknown(mission: Mission) -> None:
    flight = record(noted(mission, [*np.arange(2.0, 3.05, 0.1), *np.arange(7.0, 8.05, 0.1)]))
    flown, time_s = track(flight, 1), flight.time_s
    outside = (time_s < 0.99) | ((time_s > 4.01) & (time_s < 5.99)) | (time_s > 9.01)
    assert np.isnan(flown.position_m[outside]).all()
    assert set(flown.tactic[outside]) == {"unknown"}
    inside = ((time_s > 1.99) & (time_s < 3.01)) | ((time_s > 6.99) & (time_s < 8.01))
    np.testing.assert_allclose(flown.position_m[inside], motions(time_s[inside], straight)[:, :2], atol=1e-6)
    np.testing.assert_array_equal(np.isnan(flown.position_m).any(axis=1), flown.tactic == "unknown")


def test_peers_elsewhere_are_tracked_by_what_they_tell(mission: Mission) -> None:
    journal = Journal(mission)
    for time_s in np.arange(0.0, 10.05, 0.1).tolist():
        # Heard a tick later than it was sent, and twice: the second time it is no news.
        told = peer(3, time_s - 0.1, tactic="formation" if time_s < 5.0 else "encircle")
        journal.note(status(1, time_s, peers=[told]), 80.0)
        journal.note(status(2, time_s, peers=[told]), 80.0)
    flight = record(journal, duration_s=9.9)
    assert [flown.vehicle_id for flown in flight.vehicles] == [1, 2, 3]
    assert_flies(track(flight, 3), flight.time_s, parallel)
    assert set(track(flight, 3).tactic[flight.time_s < 4.85]) == {"formation"}
    assert set(track(flight, 3).tactic[flight.time_s > 5.0]) == {"encircle"}


def test_older_news_of_a_peer_do_not_turn_time_back(mission: Mission) -> None:
    journal = Journal(mission)
    for time_s in np.arange(0.0, 10.05, 0.1).tolist():
        journal.note(status(1, time_s, peers=[peer(3, time_s)]), 80.0)
        journal.note(status(2, time_s, peers=[peer(3, time_s - 0.5, lambda _: (99.0, 99.0, 9.0, 9.0))]), 80.0)
    flight = record(journal)
    assert_flies(track(flight, 3), flight.time_s, parallel)


# A vehicle that joined the flight from a process of its own

LANDS_M = 0.2


def joined(*told: tuple[float, str, float], until_s: float = 60.0) -> Journal:
    """Three vehicles fly for a minute; vehicle 4, which has joined, sends tactics and heights from times on."""
    journal = Journal(load_mission("case2"))
    for vehicle_id in (2, 3):
        journal.note(status(vehicle_id, 0.0), 80.0)
    for time_s in np.arange(0.0, 60.05, 0.5).tolist():
        newest = [each for each in told if each[0] <= time_s][-1:] if time_s <= until_s else []
        states = [structs.replace(peer(4, time_s, tactic=tactic), altitude_m=z) for _, tactic, z in newest]
        journal.note(structs.replace(status(1, time_s, peers=states), added=4), 80.0)
    journal.enlarge(joined_mission(load_mission("case2"), 4, AddedVehicle((0.0, -8.0), 8.0)))
    return journal


AIR, RING, HOME = (10.0, "formation", 8.0), (20.0, "encircle", 8.0), (30.0, "return and land", 8.0)


@pytest.mark.parametrize(
    ("told", "until_s", "how"),
    [
        ((AIR, RING), 60.0, FlightEnd.FLIES_ON),
        ((AIR, RING), 56.0, FlightEnd.FLIES_ON),
        ((AIR, RING), 50.0, FlightEnd.LOST),
        (((10.0, "standby", 8.0),), 12.0, FlightEnd.LOST),
        ((AIR, RING, HOME), 50.0, FlightEnd.LOST),
        ((AIR, RING, HOME, (40.0, "land", 8.0), (45.0, "land", LANDS_M)), 50.0, FlightEnd.LANDED),
        ((AIR, RING, HOME, (40.0, "land", 8.0)), 41.0, FlightEnd.LOST),
        ((AIR, RING, HOME, (40.0, "land", 8.0)), 60.0, FlightEnd.FLIES_ON),
        ((AIR, RING, (30.0, "pilot override", 8.0)), 31.0, FlightEnd.PILOT),
    ],
)
def test_one_that_joined_ended_as_far_as_it_was_received(
    told: tuple[tuple[float, str, float], ...], until_s: float, how: FlightEnd
) -> None:
    [ending] = record(joined(*told, until_s=until_s), duration_s=60.0).endings
    assert (ending.vehicle, ending.how, ending.joined) == (4, how, True)
    assert ending.heard_s == pytest.approx(until_s)
    lost = ending.unaccounted
    assert (lost is not None) is (how is FlightEnd.LOST)
    if lost is not None:
        assert lost.position_m == pytest.approx((*parallel(until_s)[:2], 8.0))
        assert lost.age_s == pytest.approx(60.0 - until_s)


def answered(journal: Journal, at_s: float, did: str, outcome: Literal["begun", "obeyed", "refused"]) -> None:
    answer = CommandAnswer(4, START_S + at_s, 7, did, "rejoin", "pat", outcome)
    journal.note(structs.replace(status(1, at_s), answers=(answer,)), None)


def test_one_that_took_off_and_was_never_received_in_the_air_fell_silent_after_a_while() -> None:
    """It is where it started, as far as the others know; one that answers that it stays on the ground does not fly."""
    for at_s, how in ((-10.0, FlightEnd.LOST), (20.0, FlightEnd.FLIES_ON)):
        journal = joined()
        answered(journal, at_s - 1.0, "is checked", "begun")
        assert record(journal, duration_s=60.0).endings == ()
        answered(journal, at_s, "takes off and joins the others", "obeyed")
        [ending] = record(journal, duration_s=60.0).endings
        assert (ending.vehicle, ending.how) == (4, how)
        assert ending.heard_s == pytest.approx(at_s)
        if how is FlightEnd.LOST:
            assert ending.unaccounted is not None
            assert ending.unaccounted.position_m == (0.0, -8.0, 0.0)
        answered(journal, at_s + 2.0, "arming was denied", "refused")
        assert record(journal, duration_s=60.0).endings == ()


def test_one_of_the_file_and_one_that_was_never_received_have_no_such_ending() -> None:
    journal = Journal(load_mission("case2"))
    journal.note(status(1, 1.0, peers=[peer(3, 1.0)]), 80.0)
    assert record(journal).endings == ()
    assert record(joined()).endings == ()


# The truth, where a simulator tells it


def truth_of(system_id: int, motion: Motion) -> TruthTrack:
    time_s = np.arange(-2.0, 12.0, 0.1)
    flown = motions(time_s, motion)
    height, still = np.full((time_s.size, 1), 8.0), np.zeros((time_s.size, 1))
    return TruthTrack(system_id, START_S + time_s, np.hstack([flown[:, :2], height]), np.hstack([flown[:, 2:], still]))


def off_by(off_m: float) -> Motion:
    def flown(time_s: float) -> tuple[float, float, float, float]:
        x, y, x_rate, y_rate = straight(time_s)
        return x + off_m, y + off_m, x_rate, y_rate

    return flown


def test_truth_of_all_vehicles_is_the_reference_with_the_estimates_beside_it(mission: Mission) -> None:
    times_s = np.arange(0.0, 10.05, 0.1)
    journal = noted(mission, times_s)
    for time_s in times_s.tolist():
        journal.note(status(2, time_s), 80.0)
    true = (truth_of(101, off_by(0.5)), truth_of(2, off_by(0.5)))

    flight = record(journal, *true)
    assert (flight.reference, flight.truth_missing) == ("truth", "")
    assert [each.vehicle_id for each in flight.estimates] == [1, 2]
    for estimate, track_ in zip(flight.estimates, flight.vehicles, strict=True):
        assert_flies(estimate, flight.time_s, straight)
        assert_flies(track_, flight.time_s, off_by(0.5))
        np.testing.assert_array_equal(track_.tactic, estimate.tactic)
    assert record(journal, *true, source="simulation").estimates == ()


def test_without_the_truth_of_one_vehicle_or_for_a_second_no_figure_is_by_truth(
    subtests: pytest.Subtests, mission: Mission
) -> None:
    times_s = np.arange(0.0, 10.05, 0.1)
    journal = noted(mission, times_s)
    for time_s in times_s.tolist():
        # Of vehicle 3, of another process, is known what it sends; its truth is not.
        journal.note(status(2, time_s, peers=[peer(3, time_s)] if time_s > 6.0 else []), 80.0)
    first, second, third = truth_of(101, off_by(0.5)), truth_of(2, off_by(0.5)), truth_of(3, off_by(0.5))
    heard = (second.time_s < START_S + 3.0) | (second.time_s > START_S + 4.5)
    gap = TruthTrack(2, second.time_s[heard], second.position_m[heard], second.velocity_m_s[heard])
    for known, missing in (
        ((first, gap, third), "vehicle 2 from"),
        ((first, second), "vehicle 3"),
        ((truth_of(77, straight),), ""),  # of no vehicle of the mission
    ):
        with subtests.test(missing=missing):
            flight = record(journal, *known)
            assert flight.reference == "estimate"
            assert flight.estimates == ()
            assert_flies(flight.vehicles[0], flight.time_s, straight)
            assert missing in flight.truth_missing
            assert bool(missing) == bool(flight.truth_missing)
    assert record(journal, first, second, third).reference == "truth"


def test_where_the_target_is_not_simulated_there_is_no_truth_of_the_ring(mission: Mission) -> None:
    real = replace(mission, target=mission.target.model_copy(update={"source": "external"}))
    journal = noted(real, np.arange(0.0, 10.05, 0.1))
    flight = record(journal, truth_of(101, straight))
    assert flight.reference == "estimate"
    assert "target" in flight.truth_missing
    assert np.isnan(flight.target_position_m).all()
    assert record(journal, truth_of(101, straight), source="simulation").reference == "truth"


# The target as each vehicle sees it


def seen(time_s: float) -> Vector:
    return np.array([30.0 + 0.1 * time_s, -2.0, 0.1, 0.0])


def test_each_track_has_the_target_as_its_vehicle_estimates_it(mission: Mission) -> None:
    journal = Journal(mission)
    for time_s in np.arange(0.0, 10.05, 0.1).tolist():
        target = TargetEstimate(START_S + time_s, seen(time_s), target_spread(1.0), START_S + time_s, 1.0, 0.0)
        journal.note(status(1, time_s, target=target if time_s > 3.95 else None), 80.0)
        journal.note(status(2, time_s), 80.0)
    flight = record(journal)
    of_target = track(flight, 1).target
    assert of_target is not None
    later = flight.time_s > 3.95
    np.testing.assert_allclose(
        of_target[later], np.array([seen(at_s) for at_s in flight.time_s[later].tolist()]), atol=1e-6
    )
    assert np.isnan(of_target[flight.time_s < 2.95]).all()
    blind = track(flight, 2).target
    assert blind is not None
    assert np.isnan(blind).all()


def test_the_target_of_a_peer_elsewhere_is_where_its_place_on_the_ring_is_about(mission: Mission) -> None:
    """Vehicle 3 flies 6 m right and 8 m above of what it takes for the target: that is the 10 m that it publishes."""
    journal, own = Journal(mission), np.array([0.0, 0.0, 0.1, -0.3])
    for time_s in np.arange(0.0, 10.05, 0.1).tolist():
        told = peer(3, time_s, tactic="encircle")
        angle = NeighbourAngle(3, told.time_s, float(np.arctan2(8.0, 6.0)), 0.05, 10.0)
        of_before = NeighbourAngle(3, told.time_s - 0.05, 0.0, 0.05, 10.0)
        told = structs.replace(told, angle=angle if time_s > 3.95 else of_before)
        journal.add_peers([told], own)
        journal.add_peers([told], None)
    flight = record(journal)
    flown, later = track(flight, 3), flight.time_s > 3.95
    assert flown.target is not None
    np.testing.assert_allclose((flown.position_m - flown.target[:, :2])[later], [[6.0, 8.0]] * later.sum(), atol=1e-6)
    np.testing.assert_allclose(flown.target[later, 2:], [[0.1, -0.3]] * later.sum())
    assert np.isnan(flown.target[flight.time_s < 2.95]).all()


def test_a_vehicle_of_this_process_is_known_by_itself_whatever_is_read_first(mission: Mission) -> None:
    journal = Journal(mission)
    for time_s in np.arange(0.0, 10.05, 0.1).tolist():
        journal.add_peers([peer(1, time_s)], None)
    for time_s in np.arange(0.0, 10.05, 0.1).tolist():
        journal.add_sample(1, START_S + time_s, np.array(straight(time_s)), 6.0, "formation", seen(time_s))
    flight = record(journal)
    assert_flies(track(flight, 1), flight.time_s, straight)
    target = track(flight, 1).target
    assert target is not None
    assert np.isfinite(target).all()
