"""Velocity feed-forward: setpoint and velocity against the plant's equation, circles against its transfer function, and
teams in closed loop on plants that are not their files."""

from collections.abc import Callable
from math import hypot, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.control.plan import Plan
from agents.core import VehicleCore
from agents.inputs import Start, TacticEvent
from agents.outputs import TickOutput
from agents.ports import Setpoint
from agents.safety.guard import Guarded, GuardStatus
from agents.setpoint import FeedForward
from agents.settings.config import AgentConfig
from agents.situation.situation import Situation
from agents.tactics import Event
from estimation.plant.model import Plant, PlantAxis, exact_step
from estimation.state import OwnEstimate, Telemetry, Vector
from gcs.flight.simulated import fly_simulated
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Decision
from gcs.mission.mission import Mission
from gcs.replay.cores import replay
from tests.support.estimates import own_spread
from tests.support.flight_logs import engaging, record_simulation
from tests.support.mission_text import Place

Maker = Callable[..., AgentConfig]
PLANT = Plant(PlantAxis(0.8, 0.87), PlantAxis(1.1, 0.7), 0.1, 0.9)
SPEED_MAX_M_S = 2.0
Pair = tuple[float, float]
STILL = (0.0, 0.0)
metres, speeds = st.floats(-20.0, 20.0), st.floats(-4.0, 4.0)
pairs, rates = st.tuples(metres, metres), st.tuples(speeds, speeds)


def seen(place: Pair = STILL, speed: Pair = STILL, wind: Pair = STILL) -> Situation:
    mean = np.array([*place, *speed, *wind])
    return Situation(1.0, 1.1, OwnEstimate(1.0, mean, own_spread(1.0)), mean[:4], mean[4:], None, None, None)


def split(
    guarded_m: Pair,
    situation: Situation | None = None,
    status: GuardStatus = GuardStatus.CHANGED,
    *,
    velocity: Pair | None = None,
    plant: Plant = PLANT,
) -> tuple[Pair, tuple[float, ...]]:
    plan = Plan(np.array(guarded_m), np.array(guarded_m), np.zeros(2), velocity_m_s=velocity)
    feed = FeedForward(plant, SPEED_MAX_M_S)
    return feed.split(situation or seen(), plan, Guarded(np.array(guarded_m), status))


@given(pairs, pairs, rates, rates)
def test_what_is_sent_accelerates_the_plant_as_the_guard_allowed(
    guarded_m: Pair, place: Pair, speed: Pair, wind: Pair
) -> None:
    setpoint_m, velocity = split(guarded_m, seen(place, speed, wind))
    for axis, each in enumerate((PLANT.x, PLANT.y)):
        sent = each.a0_per_s2 * (setpoint_m[axis] - place[axis])
        sent += each.a1_per_s * (PLANT.feedforward * velocity[axis] - speed[axis])
        allowed = each.a0_per_s2 * (guarded_m[axis] - place[axis]) - each.a1_per_s * speed[axis]
        assert sent == pytest.approx(allowed, abs=1e-9)
    assert hypot(*velocity) <= SPEED_MAX_M_S + 1e-9
    assert velocity[2] == 0.0


@given(pairs, rates)
def test_the_velocity_is_the_one_the_plant_reaches_half_a_time_constant_later(aim_m: Pair, wind: Pair) -> None:
    """As the acceleration that the exact step begins with has it; slow enough for the bound."""
    aim, speed, still = (0.2 * aim_m[0], 0.2 * aim_m[1]), (0.3, -0.2), (0.1 * wind[0], 0.1 * wind[1])
    soon = exact_step(PLANT, 1e-5).advance(np.array([0.0, 0.0, *speed]), np.array(aim), np.array(still))
    push = (soon[2:] - speed) / 1e-5
    expected = speed + push / (2.0 * PLANT.a1_per_s)
    _, (x_rate, y_rate, _) = split(aim, seen(speed=speed, wind=still))
    length = max(1.0, float(np.hypot(*expected)) / SPEED_MAX_M_S)
    assert (x_rate, y_rate) == pytest.approx(expected / length, abs=1e-3)


@pytest.mark.parametrize(("status", "velocity"), [(GuardStatus.BRAKED, None), (GuardStatus.PASSED, STILL)])
def test_who_brakes_or_stays_is_sent_no_velocity(status: GuardStatus, velocity: Pair | None) -> None:
    sent = split((5.0, 1.0), seen(speed=(1.0, 1.0)), status, velocity=velocity)
    assert sent == ((5.0, 1.0), (0.0, 0.0, 0.0))


def test_a_plant_that_takes_no_velocity_is_sent_none() -> None:
    plain = Plant(PLANT.x, PLANT.y)
    assert split((5.0, 1.0), plant=plain) == ((5.0, 1.0), ())


@pytest.mark.parametrize("velocity", [(1.0, 2.0), (nan, 0.0, 0.0)])
def test_a_velocity_has_three_numbers(velocity: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="setpoint"):
        Setpoint((0.0, 0.0, 8.0), velocity_m_s=velocity)


@pytest.mark.parametrize(("gain", "rate_rad_s"), [(0.0, 0.15), (0.8, 0.5)])
def test_a_circle_is_followed_with_the_lag_of_the_transfer_function(gain: float, rate_rad_s: float) -> None:
    """Setpoints on a circle with their velocity: (a0 + g a1 s) / (s2 + a1 s + a0) at s = i rate."""
    axis, step_s = PLANT.x, 0.01
    plant = Plant(axis, axis, 0.0, gain)
    state, step, turn = np.array([10.0, 0.0, 0.0, 0.0]), exact_step(plant, step_s), 0.0
    places: list[Vector] = []
    for tick in range(6000):
        turn = rate_rad_s * tick * step_s
        around = np.array([np.cos(turn), np.sin(turn)])
        velocity = 10.0 * rate_rad_s * np.array([-around[1], around[0]])
        state = step.advance(state, plant.aim_m((10.0 * around).tolist(), velocity.tolist()), np.zeros(2))
        places.append(state[:2])
    s = 1j * rate_rad_s
    expected = (axis.a0_per_s2 + gain * axis.a1_per_s * s) / (s**2 + axis.a1_per_s * s + axis.a0_per_s2)
    held = np.exp(s * step_s / 2.0)  # a step later, of which the setpoint was held the whole
    x, y = places[-1]
    found = complex(x, y) / (10.0 * np.exp(1j * turn))
    assert abs(found) == pytest.approx(abs(expected * held), abs=1e-4)
    assert np.angle(found) == pytest.approx(np.angle(expected * held), abs=1e-4)


# In closed loop


def feeding(name: str, plant: str, true_a0: float, true_a1: float, *changes: tuple[Place, object]) -> Mission:
    """Return a mission that engages at once, whose vehicles' plants are off their files."""
    told: dict[str, object] = {"profile": plant, "true_scale": {"a0": true_a0, "a1": true_a1}}
    off = ((("vehicles", i, key), value) for i in range(3) for key, value in told.items())
    return engaging(name, *off, *changes)


def test_a_ring_keeps_radius_and_rate_on_plants_30_percent_off_even_without_an_estimate_of_that() -> None:
    errors_m, slow = {}, {}
    unestimated = (("own_filter",), {"disturbance_max_m_s2": 0.0})
    for plant in ("stub", "stub-feedforward"):
        record = fly_simulated(feeding("case2", plant, 0.7, 1.3, unestimated), 1, 45.0, lambda _: None)
        late = (record.time_s > 35.0) & (record.time_s < 45.0)
        x, y = np.array([(each.position_m - record.target_position_m)[late].T for each in record.vehicles]).swapaxes(
            0, 1
        )
        errors_m[plant] = float(np.sqrt(np.mean((np.hypot(x, y) - 10.0) ** 2)))
        turned_rad = np.diff(np.unwrap(np.arctan2(y, x))[:, [0, -1]])
        slow[plant] = float(1.0 - np.mean(turned_rad) / np.ptp(record.time_s[late]) / 0.05)
    assert errors_m["stub"] > 0.03, "the plants are off by enough to matter"
    assert errors_m["stub-feedforward"] < 0.001
    assert max(map(abs, slow.values())) < 0.01, "the reference turns at the ring's rate whatever the plant"


def test_the_log_holds_the_velocities_and_is_replayed_bit_by_bit(tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    noisy = ("own_filter",), {"position_noise_m": 0.1, "velocity_noise_m_s": 0.05}
    record_simulation(feeding("case2-field", "stub-feedforward", 1.2, 0.8, noisy), path, duration_s=50.0)
    log = read_log(path)
    sent = [each.setpoint.velocity_m_s for each in log.of_kind(1, Decision) if each.setpoint is not None]
    assert {len(each) for each in sent} == {3}
    late = np.array(sent[-20:])[:, :2]  # on the ring: 10 m at 0.05 rad/s, and the target's 0.1 m/s
    assert np.hypot(*late.T).mean() == pytest.approx(0.5, abs=0.15)
    found = replay(log)
    assert [each.compared == each.identical == 501 for each in found.vehicles] == [True] * 3


def flown(core: VehicleCore, ticks: int, begin: int = 0) -> TickOutput:
    output = None
    for tick in range(begin, begin + ticks):
        now_s = tick * 0.1
        core.take(Telemetry(now_s, (0.2 * now_s, 0.0, 8.0), (0.2, 0.0, 0.0)))
        output = core.tick(now_s)
    assert output is not None
    return output


def test_on_the_line_the_planned_velocity_is_sent_and_in_a_hold_none(make_config: Maker) -> None:
    core = VehicleCore(make_config(plant=Plant(PlantAxis(0.8, 0.87), PlantAxis(0.8, 0.87), 0.0, 1.0)))
    core.take(Start(0.0))
    setpoint = flown(core, 20).setpoint
    assert setpoint is not None
    assert setpoint.velocity_m_s == pytest.approx((0.2, 0.0, 0.0), abs=1e-3)
    core.take(TacticEvent(Event.HOLD))
    setpoint = flown(core, 2, 20).setpoint
    assert setpoint is not None
    assert setpoint.velocity_m_s == (0.0, 0.0, 0.0)
