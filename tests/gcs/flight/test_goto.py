"""Vehicles sent to places in simulated flights, by their true motion: they arrive, keep apart, and fail to a hold."""

from math import dist
from pathlib import Path

import numpy as np
import pytest

import cordon
from cordon import Commanded, Disturbance
from gcs.flightlog.reader import read_log
from gcs.replay.cores import replay

pytestmark = pytest.mark.slow

SEED = 3
TARGET_M = (14.0, 0.0)
FENCE_M = [[-25.0, -30.0], [45.0, -30.0], [45.0, 30.0], [-25.0, 30.0]]
ACROSS = (2.0, 17.0)
"""A place beyond the ring: the way there crosses the paths of the others."""


@pytest.fixture(scope="module")
def mission() -> cordon.Mission:
    target = {"start_m": list(TARGET_M), "velocity_m_s": [0.0, 0.0]}
    return cordon.load("case2-field").replace(
        target=target, decision={"distance_max_m": 60.0}, safety={"fence_m": FENCE_M, "keep_out_m": 4.0}
    )


def outcomes(flown: cordon.Flight, vehicle: int) -> list[str]:
    """Return the outcomes of goto in a vehicle's events."""
    return [each.text for each in flown.record.events if each.vehicle == vehicle and "goto" in each.text]


def nearest_m(flown: cordon.Flight) -> float:
    """Return the smallest true distance between two vehicles after the take-off."""
    places = [each.position_m[100:] for each in flown.vehicles.values()]
    return min(float(np.hypot(*(a - b).T).min()) for i, a in enumerate(places) for b in places[:i])


def test_a_vehicle_goes_to_a_place_and_holds_and_the_log_has_the_same_flight(
    mission: cordon.Mission, tmp_path: Path
) -> None:
    log = tmp_path / "flight.mcap"
    sent = Commanded(70.0, f"goto 2 x={ACROSS[0]} y={ACROSS[1]}")
    flown = cordon.simulate(mission, seed=SEED, duration_s=130.0, log=log, events=[sent])
    vehicle = flown.vehicles[2]
    assert {*vehicle.tactic[702:1300]} == {"hold"}
    assert dist(vehicle.position_m[690], ACROSS) > 8.0
    assert np.hypot(*(vehicle.position_m[1200:1300] - np.array(ACROSS)).T).max() < 1.0
    assert nearest_m(flown) > mission.safety.separation_m
    assert np.hypot(*(vehicle.position_m[700:1300] - np.array(TARGET_M)).T).min() > mission.safety.keep_out_m - 0.2
    speed_m_s = np.hypot(*vehicle.velocity_m_s[700:1300].T)
    assert speed_m_s.max() < mission.formation.speed_max_m_s + 0.5
    assert any("has arrived" in each for each in outcomes(flown, 2))
    assert all(each.identical == each.ticks > 0 for each in replay(read_log(log)).vehicles)


def test_a_vehicle_lands_where_it_is_sent_to(mission: cordon.Mission) -> None:
    sent = Commanded(70.0, f"goto 2 x={ACROSS[0]} y={ACROSS[1]} land")
    flown = cordon.simulate(mission, seed=SEED, duration_s=130.0, events=[sent])
    vehicle = flown.vehicles[2]
    landing = next(i for i, tactic in enumerate(vehicle.tactic) if tactic == "land")
    assert dist(vehicle.position_m[landing], ACROSS) < 1.2
    assert {*vehicle.tactic[702:landing]} == {"hold"}


@pytest.mark.parametrize(("first", "later", "after_s"), [(3, 2, 0.06), (2, 3, 0.06), (2, 3, 0.0)])
def test_of_two_that_are_sent_to_one_place_at_once_the_later_gives_its_way_up(
    mission: cordon.Mission, first: int, later: int, after_s: float
) -> None:
    """Neither knows where the other goes when it is sent there; of the same time, the smaller id goes on."""
    place = f"x={ACROSS[0]} y={ACROSS[1]}"
    events = [Commanded(70.0, f"goto {first} {place}"), Commanded(70.0 + after_s, f"goto {later} {place}")]
    flown = cordon.simulate(mission, seed=SEED, duration_s=110.0, events=events)
    assert dist(flown.vehicles[first].position_m[-1], ACROSS) < 1.0
    assert any("has arrived" in each for each in outcomes(flown, first))
    assert dist(flown.vehicles[later].position_m[-1], ACROSS) > 4.0
    given_up = [each for each in outcomes(flown, later) if f"vehicle {first}" in each]
    assert len(given_up) == 1, outcomes(flown, later)


def test_hold_stops_a_vehicle_on_its_way(mission: cordon.Mission) -> None:
    events = [Commanded(70.0, f"goto 2 x={ACROSS[0]} y={ACROSS[1]}"), Commanded(73.0, "hold", 2)]
    flown = cordon.simulate(mission, seed=SEED, duration_s=110.0, events=events)
    vehicle = flown.vehicles[2]
    stopped_m = vehicle.position_m[730]
    assert dist(stopped_m, ACROSS) > 5.0
    assert np.hypot(*(vehicle.position_m[800:] - stopped_m).T).max() < 4.0
    assert np.hypot(*vehicle.velocity_m_s[1050:].T).max() < 0.4
    assert not any("has arrived" in each for each in outcomes(flown, 2))


def test_a_vehicle_that_is_blown_off_its_way_holds_where_it_is(mission: cordon.Mission) -> None:
    """The failsafe that would let it hold, *not following*, ends its way, although it holds already."""
    sent = Commanded(70.0, f"goto 2 x={ACROSS[0]} y={ACROSS[1]} land")
    events: list[Commanded | Disturbance] = [sent, Disturbance(72.0, (-4.0, 0.0), 82.0, 2)]
    flown = cordon.simulate(mission, seed=SEED, duration_s=110.0, events=events)
    assert any("stops on its way" in each for each in outcomes(flown, 2))
    assert not any("has arrived" in each for each in outcomes(flown, 2))
    assert dist(flown.vehicles[2].position_m[-1], ACROSS) > 5.0


REFUSED = {
    "outside of the fence": ("goto 2 x=60 y=0", "outside the fence"),
    "near the target": ("goto 2 x=15 y=1", "keep_out_m"),
    "far away": ("goto 2 x=5000 y=0", "m away"),
    "on the ring": ("goto 2 x=25 y=0", "m from the ring of 10 m: 3 m at least are needed"),
    "near another's landing place": ("goto 2 x=0 y=5.5 land", "1.5 m from a landing place of vehicle 1"),
    "where another goes": ("goto 2 x=27 y=20", "2.0 m from where vehicle 3 goes"),
}
"""What is refused of vehicle 2, while vehicle 3 is on its way to (25, 20)."""


def test_places_that_are_not_safe_are_refused(mission: cordon.Mission, subtests: pytest.Subtests) -> None:
    held = [Commanded(60.0, "goto 3 x=25 y=20"), Commanded(95.0, "goto 2 x=26 y=20")]
    told = [Commanded(60.5 + 0.5 * i, text) for i, (text, _) in enumerate(REFUSED.values())]
    flown = cordon.simulate(mission, seed=SEED, duration_s=100.0, events=[*held, *told])
    said = outcomes(flown, 2)
    for name, (_, word) in REFUSED.items():
        with subtests.test(name):
            assert any("refused" in each and word in each for each in said), said
    with subtests.test("where another vehicle holds"):
        assert "m from vehicle 3" in said[-1]
    assert {*flown.vehicles[2].tactic[600:950]} == {"encircle"}


def test_arguments_that_are_wrong_are_bad_input(mission: cordon.Mission, subtests: pytest.Subtests) -> None:
    for text in (
        "goto",
        "goto 2",
        "goto 2 x=1",
        "goto 2 x=1 y=nan",
        "goto 9 x=1 y=1",
        "goto 2 x=1 y=1 hover",
        "goto 2 x=1 y=1e9",
    ):
        with subtests.test(text), pytest.raises(cordon.InputError) as refused:
            cordon.simulate(mission, duration_s=5.0, events=[Commanded(1.0, text)])
        assert text in str(refused.value) or "vehicle 9" in str(refused.value)
