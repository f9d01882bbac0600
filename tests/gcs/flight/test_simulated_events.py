"""What happens in simulated flights at given times, against the motion that it must cause."""

import re
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cordon
from agents.flight_end import FlightEnd
from cordon import Absent, Commanded, Disturbance, Link, MessageLoss
from gcs.flightlog.reader import read_log
from gcs.replay.cores import replay

pytestmark = pytest.mark.slow

AHEAD = {"start_m": [14.0, 0.0], "velocity_m_s": [0.0, 0.0]}
SEED = 3


@pytest.fixture(scope="module")
def mission() -> cordon.Mission:
    return cordon.load("case2-field").replace(target=AHEAD, decision={"distance_max_m": 60.0})


def spacing_deg(flight: cordon.Flight, vehicles: list[int], since_s: float) -> np.ndarray:
    """Return the angles between neighbours about the target from a time on, by truth (T, N)."""
    rows = flight.record.time_s >= since_s
    off_m = np.stack([flight.vehicles[each].position_m[rows] - np.array(AHEAD["start_m"]) for each in vehicles])
    bearings = np.sort(np.degrees(np.arctan2(off_m[..., 1], off_m[..., 0])), axis=0)
    return np.asarray(np.diff(np.vstack((bearings, bearings[:1] + 360.0)), axis=0))


def test_the_ring_closes_where_a_vehicle_leaves_and_the_log_has_the_same_flight(
    mission: cordon.Mission, tmp_path: Path
) -> None:
    log = tmp_path / "flight.mcap"
    flown = cordon.simulate(mission, seed=SEED, duration_s=130.0, log=log, events=[Absent(2, 60.0)])
    assert spacing_deg(flown, [1, 2, 3], 59.0)[:, 0] == pytest.approx(120.0, abs=6.0)
    assert np.abs(spacing_deg(flown, [1, 3], 120.0) - 180.0).max() < 6.0
    (departure,) = flown.metrics.departures or ()
    assert (departure.vehicle, departure.place) == (2, "ring")
    assert {each.vehicle: each.how for each in flown.record.endings}[2] is FlightEnd.WATCHDOG
    assert cordon.read(log).metrics.untimed() == flown.metrics.untimed()
    assert all(each.identical == each.ticks > 0 for each in replay(read_log(log)).vehicles)


def test_a_vehicle_joins_at_its_time_and_place(mission: cordon.Mission) -> None:
    flown = cordon.simulate(mission, seed=SEED, duration_s=110.0, events=[Absent(2, until_s=40.0, at_m=(-20.0, 5.0))])
    late = flown.vehicles[2]
    assert {*late.tactic[:400]} == {"unknown"}
    assert late.tactic[400] != "unknown"
    np.testing.assert_allclose(late.position_m[400], (-20.0, 5.0), atol=0.2)
    assert np.abs(spacing_deg(flown, [1, 3], 39.0)[:, :5] - 180.0).max() < 10.0
    assert np.abs(spacing_deg(flown, [1, 2, 3], 105.0) - 120.0).max() < 6.0


def test_a_disturbance_pushes_as_the_plant_says(mission: cordon.Mission) -> None:
    """Until the estimate of a tick later, two flights differ only by the acceleration on the plant."""
    push_m_s2, step_s = 0.6, 0.1
    still = cordon.simulate(mission, seed=SEED, duration_s=6.0)
    pushed = cordon.simulate(mission, seed=SEED, duration_s=6.0, events=[Disturbance(5.0, (0.0, push_m_s2), 5.05, 3)])
    faster_m_s = pushed.vehicles[3].velocity_m_s[51] - still.vehicles[3].velocity_m_s[51]
    damping_per_s = mission.vehicle(3).true_plant.y.a1_per_s
    # x'' = w - a1 x' from rest, and the stiffness acts on millimetres.
    assert faster_m_s[1] == pytest.approx(push_m_s2 * (1.0 - exp(-damping_per_s * step_s)) / damping_per_s, rel=0.01)
    assert faster_m_s[0] == 0.0
    for vehicle in (1, 2):
        np.testing.assert_array_equal(pushed.vehicles[vehicle].position_m[:52], still.vehicles[vehicle].position_m[:52])
    np.testing.assert_array_equal(pushed.vehicles[3].position_m[:51], still.vehicles[3].position_m[:51])


def test_drawn_values_may_be_numpys(mission: cordon.Mission) -> None:
    plain: list[Any] = [Absent(2, 3.0), Disturbance(1.0, (1.0, 0.5), 2.0, 3), MessageLoss(2.0, 0.5, 3.0, 1)]
    one, two, three = [*np.array([1, 2, 3])]
    drawn: list[Any] = [
        Absent(two, np.float64(3.0)),
        Disturbance(one, np.array([1.0, 0.5]), two, three),  # type: ignore[arg-type]
        MessageLoss(two, np.float64(0.5), np.float64(3.0), one),
    ]
    flown, other = (cordon.simulate(mission, seed=SEED, duration_s=5.0, events=each) for each in (plain, drawn))
    for vehicle in flown.vehicles:
        np.testing.assert_array_equal(flown.vehicles[vehicle].position_m, other.vehicles[vehicle].position_m)


def test_commands_are_carried_out_at_their_times(mission: cordon.Mission) -> None:
    events = [Commanded(75.0, "resume", 2), Commanded(70.0, "hold", 2), Commanded(90.0, "ring radius=13 rate=-0.05")]
    flown = cordon.simulate(mission, seed=SEED, duration_s=150.0, events=events)
    tactic = flown.vehicles[2].tactic
    assert (tactic[699], tactic[701], tactic[749], tactic[751]) == ("encircle", "hold", "hold", "encircle")
    for channels in flown.vehicles.values():
        off_m = channels.position_m[-100:] - np.array(AHEAD["start_m"])
        assert np.hypot(*off_m.T).mean() == pytest.approx(13.0, abs=0.3)
        turned_rad = np.unwrap(np.arctan2(off_m[:, 1], off_m[:, 0]))
        assert (turned_rad[-1] - turned_rad[0]) / 9.9 == pytest.approx(-0.05, abs=0.005)


def test_without_messages_vehicles_fly_by_what_they_know_of_themselves(mission: cordon.Mission) -> None:
    """Up to the loss the flight is the same; after it vehicle 3 does not see that the others keep away from it."""
    whole = cordon.simulate(mission, seed=SEED, duration_s=45.0)
    lost = cordon.simulate(mission, seed=SEED, duration_s=45.0, events=[MessageLoss(25.0, 1.0, 27.0, 3)])
    for vehicle in mission.ids:
        before, after = (each.vehicles[vehicle].setpoint_m for each in (whole, lost))
        np.testing.assert_array_equal(after[:251], before[:251])
        assert not np.array_equal(after[251:], before[251:])


def test_a_team_without_links_keeps_no_ring_together(mission: cordon.Mission) -> None:
    """A line of links is a connected graph, but the ends of it do not see each other: no rule spaces them."""
    spread_deg = [
        float(
            np.abs(
                spacing_deg(cordon.simulate(mission, seed=SEED, duration_s=100.0, links=links), [1, 2, 3], 90.0) - 120.0
            ).max()
        )
        for links in (None, {(1, 2): Link(), (2, 3): Link(), (1, 3): Link()}, {(1, 2): Link()})
    ]
    assert max(spread_deg[:2]) < 6.0
    assert spread_deg[2] > 20.0


FAULTS = {
    "no vehicle": (Absent(9, 1.0), "no vehicle 9 (it has 1, 2, 3)"),
    "neither leaves nor joins": (Absent(2), "give from_s"),
    "after the end": (Absent(2, 70.0), "from 0 to 60 s"),
    "not a time": (Disturbance(float("nan"), (0.0, 0.1)), "from 0 to 60 s"),
    "ends first": (MessageLoss(10.0, 0.5, 5.0), "until_s must be later"),
    "no share": (MessageLoss(10.0, 1.5), "loss must be from 0 to 1"),
    "not two numbers": (Disturbance(1.0, (0.1,)), "(x, y)"),  # type: ignore[arg-type]
    "no verb": (Commanded(1.0, "dance"), "hold, resume, land"),
    "no ring of that name": (Commanded(1.0, "ring left radius=12"), "left"),
    "not in a ring of one": (Commanded(1.0, "assign 2 left"), "one ring"),
    "too small a ring": (Commanded(1.0, "ring radius=1.1"), "radius"),
    "no event": ("hold", "cordon.Absent, cordon.Commanded"),
}


@pytest.mark.parametrize(("event", "fact"), FAULTS.values(), ids=FAULTS)
def test_bad_events_are_named(mission: cordon.Mission, event: object, fact: str) -> None:
    with pytest.raises(cordon.InputError, match=re.escape(fact)) as raised:
        cordon.simulate(mission, duration_s=60.0, events=[event])  # type: ignore[list-item]
    assert "events: " in str(raised.value)


@pytest.mark.parametrize(
    ("links", "fact"),
    [
        ({(1, 9): Link()}, "(1, 9)"),
        ({(1, 1): Link()}, "(1, 1)"),
        ({(1, 2): Link(), (2, 1): Link()}, "leave (2, 1) out"),
        ({(1, 2): 0.1}, "cordon.Link"),
        ({(1, 2): Link(2.0)}, "loss must be from 0 to 1"),
    ],
)
def test_bad_links_are_named(mission: cordon.Mission, links: dict[tuple[int, int], Link], fact: str) -> None:
    with pytest.raises(cordon.InputError, match=re.escape(fact)):
        cordon.simulate(mission, duration_s=60.0, links=links)


def test_one_vehicle_is_not_absent_twice_at_once_and_no_log_holds_two_of_its_agents(
    mission: cordon.Mission, tmp_path: Path
) -> None:
    with pytest.raises(cordon.InputError, match="absent already"):
        cordon.simulate(mission, duration_s=60.0, events=[Absent(2, 10.0, 30.0), Absent(2, 20.0)])
    with pytest.raises(cordon.InputError, match="vehicle 2 comes back"):
        cordon.simulate(mission, duration_s=60.0, events=[Absent(2, 10.0, 30.0)], log=tmp_path / "a.mcap")
