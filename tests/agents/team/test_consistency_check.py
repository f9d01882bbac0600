"""What one vehicle can have flown, by its states alone: honest ones are never doubted, whatever befalls them."""

import msgspec
import pytest

from agents.team.messages import MemberState
from agents.team.team import Team
from tests.support.team import a_team

SPEED_M_S, PERIOD_S = 2.0, 0.1


def state(time_s: float, x: float | None = None, **changes: object) -> MemberState:
    """Return the state of vehicle 1, which flies along x."""
    x = SPEED_M_S * time_s if x is None else x
    flown = MemberState(1, time_s, "formation", (x, 0.0), (SPEED_M_S, 0.0), (x, 0.0), (SPEED_M_S, 0.0), 8.0, 0.05)
    return msgspec.structs.replace(flown, **changes)


def receive(team: Team, from_s: float, to_s: float, off_m: float = 0.0, **changes: object) -> None:
    for tick in range(round(from_s / PERIOD_S), round(to_s / PERIOD_S)):
        time_s = tick * PERIOD_S
        team.receive(state(time_s, SPEED_M_S * time_s + off_m, **changes))
        team.expire(time_s)


def places_m(team: Team, now_s: float) -> list[float]:
    """Return everywhere where vehicle 1 may be, its state first."""
    return [each.position_m[0] for each in (*team.members(), *team.lost(now_s, 60.0))]


def test_a_vehicle_that_jumps_keeps_its_old_state_for_a_second_and_both_places_count() -> None:
    team = a_team()
    receive(team, 0.0, 5.0)
    receive(team, 5.0, 5.5, 20.0)
    assert places_m(team, 5.4) == pytest.approx([9.8, 30.8])
    receive(team, 5.5, 7.0, 20.0)
    assert places_m(team, 6.9) == pytest.approx([33.8, 9.8])
    assert team.gone_s == {}
    (why,) = (doubt.why for doubt in team.inconsistencies.values())
    assert "20.0 m" in why
    receive(team, 7.0, 12.0, 20.0)
    assert team.inconsistencies == {}
    assert places_m(team, 11.9) == pytest.approx([43.8, 9.8])
    receive(team, 12.0, 66.0, 20.0)
    assert len(places_m(team, 65.9)) == 1


def test_a_second_source_never_replaces_the_first() -> None:
    team = a_team()
    for tick in range(300):
        time_s = tick * PERIOD_S
        team.receive(state(time_s))
        if tick >= 100:
            team.receive(state(time_s + 0.05, SPEED_M_S * time_s - 7.0))
        team.expire(time_s)
    assert places_m(team, 29.9) == pytest.approx([59.8, 52.8])
    assert set(team.inconsistencies) == {1}


def test_one_contradictory_state_is_not_reported_and_forgotten_soon() -> None:
    team = a_team()
    receive(team, 0.0, 5.0)
    team.receive(state(5.0, 40.0))
    receive(team, 5.1, 6.5)
    assert team.inconsistencies == {}
    assert len(places_m(team, 6.4)) == 1


@pytest.mark.parametrize("gap_s", [0.5, 0.9, 3.0, 30.0])
def test_lost_messages_and_a_returning_agent_raise_no_doubt(gap_s: float) -> None:
    team = a_team()
    receive(team, 0.0, 5.0)
    receive(team, 5.0 + gap_s, 10.0 + gap_s)
    assert team.inconsistencies == {}
    assert len(places_m(team, 9.9 + gap_s)) == 1


def test_a_vehicle_that_returns_farther_than_it_can_fly_is_doubted_and_its_last_position_avoided() -> None:
    team = a_team()
    receive(team, 0.0, 5.0)
    receive(team, 7.0, 9.0, 300.0)
    assert set(team.inconsistencies) == {1}
    assert places_m(team, 8.9) == pytest.approx([317.8, 9.8])


def test_late_messages_in_any_order_raise_no_doubt() -> None:
    team = a_team()
    for time_s in (1.0, 1.3, 1.1, 1.2, 1.6, 1.4, 1.5, 1.5):
        team.receive(state(time_s))
    assert not team.lost(1.6, 60.0)
    assert team.inconsistencies == {}


@pytest.mark.parametrize("step_s", [0.4, -0.4])
def test_a_clock_that_steps_a_little_is_not_doubted(step_s: float) -> None:
    team = a_team()
    receive(team, 0.0, 5.0)
    for tick in range(50, 100):
        time_s = tick * PERIOD_S
        team.receive(state(time_s + step_s, SPEED_M_S * time_s))
    assert team.inconsistencies == {}
    assert not team.lost(10.0, 60.0)


@pytest.mark.parametrize(
    "excuse",
    [
        {"alert": "estimator jumped"},
        {"alert": "not following"},
        {"alert": "tilt too large"},
        {"tactic": "pilot override"},
    ],
)
def test_a_jump_that_the_vehicle_announces_is_not_doubted_and_both_places_count(excuse: dict[str, str]) -> None:
    team = a_team()
    receive(team, 0.0, 5.0)
    receive(team, 5.0, 6.0, 20.0, **excuse)
    assert team.inconsistencies == {}
    assert places_m(team, 5.9) == pytest.approx([31.8, 9.8])


def test_hard_manoeuvres_take_off_and_landing_raise_no_doubt() -> None:
    team = a_team()
    x, speed, altitude = 0.0, 0.0, 0.0
    for tick in range(400):
        time_s = tick * PERIOD_S
        # Full acceleration to and fro, and a climb at 3 m/s.
        acceleration = 4.0 if tick // 20 % 2 == 0 else -4.0
        team.receive(state(time_s, x, velocity_m_s=(speed, 0.0), altitude_m=altitude))
        x += speed * PERIOD_S + acceleration * PERIOD_S**2 / 2.0
        speed += acceleration * PERIOD_S
        altitude = 0.3 * min(tick, 400 - tick) / 4.0
    assert team.inconsistencies == {}
    assert not team.lost(40.0, 60.0)


def test_who_jumps_about_fills_no_more_than_a_few_places() -> None:
    team = a_team()
    receive(team, 0.0, 5.0)
    for tick in range(50, 200):
        team.receive(state(tick * PERIOD_S, 37.0 * (tick % 17) - 200.0))
        team.expire(tick * PERIOD_S)
    assert len(places_m(team, 19.9)) <= 4
