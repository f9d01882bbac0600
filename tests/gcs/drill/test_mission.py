"""The mission that a drill flies: on ports of its own, with the target in reach, otherwise as it was given."""

from collections.abc import Callable
from dataclasses import replace
from math import hypot
from pathlib import Path

import pytest

from gcs.drill.faults import DRILLS, Roles, chosen
from gcs.drill.run import drill_mission
from gcs.errors import InputError
from gcs.mission.file import load_mission, parse_mission
from gcs.mission.mission import Mission
from tests.support.paths import PROFILES


def drilled(name: str, *changes: tuple[str, str, object]) -> Mission:
    return parse_mission(drill_mission(name, changes), None, load_mission(name).profile_texts)


@pytest.mark.parametrize("name", ["case1", "case2-field", "mixed-team", "crossing"])
def test_everything_but_ports_team_and_target_is_kept(name: str) -> None:
    given, flown = load_mission(name), drilled(name)
    kept = replace(flown, vehicles=(), network=given.network, target=given.target, formation=given.formation)
    assert kept == replace(given, vehicles=())
    moves_on = {"speed_m_s": given.formation.speed_m_s}
    assert flown.formation.model_copy(update=moves_on) == given.formation
    for before, after in zip(given.vehicles, flown.vehicles, strict=True):
        section = after.section.model_copy(update={"url": before.section.url, "endpoint": before.section.endpoint})
        assert replace(after, section=section) == before
    ports = [each.section.url for each in flown.vehicles] + [each.section.endpoint for each in flown.vehicles]
    assert len({port.rpartition(":")[2] for port in ports}) == 2 * len(flown.vehicles)
    assert not {*ports} & {each.section.url for each in given.vehicles}
    assert flown.network.team != given.network.team
    assert flown.target.model_copy(update={"start_m": given.target.start_m}) == given.target


def test_the_target_is_in_reach_of_those_who_want_it() -> None:
    case1, case2 = drilled("case1"), drilled("case2")
    assert [Roles(case2).tactic(i) for i in case2.ids] == ["encircle"] * 3
    assert [Roles(case1).tactic(i) for i in case1.ids] == ["encircle", "formation", "formation"]


@pytest.mark.parametrize("shape", ["line", "column", "wedge"])
def test_every_slot_of_the_formation_is_in_reach_of_the_target_and_not_much_nearer(
    shape: str, mission_file: Callable[..., str]
) -> None:
    name = mission_file("case2", ("[formation]", f'[formation]\nshape = "{shape}"'))
    flown, leader = drilled(name), load_mission(name).formation.leader
    config = flown.agent_config(flown.vehicle(leader))
    slots_m = [config.slot_offset_m(each, leader) for each in flown.ids]
    line_m, target_m = config.line_start_m, flown.target.start_m
    away_m = [hypot(target_m[0] - line_m[0] - x, target_m[1] - line_m[1] - y) for x, y in slots_m]
    assert 11.0 < max(away_m) < 12.0


def test_a_line_that_all_leave_for_the_ring_moves_on_with_the_target() -> None:
    """Else it overtakes the target, and who was moved out of its reach does not come back."""
    assert (load_mission("case2").formation.speed_m_s, drilled("case2").formation.speed_m_s) == (0.2, 0.1)
    assert drilled("case1").formation == load_mission("case1").formation, "two vehicles stay in line"
    crossing, given = drilled("crossing"), load_mission("crossing")
    assert (crossing.formation, crossing.target) == (given.formation, given.target), "no vehicle engages"
    assert {Roles(crossing).tactic(i) for i in crossing.ids} == {"formation"}


def test_a_mission_that_forbids_it_keeps_its_target(mission_file: Callable[..., str]) -> None:
    fence = "fence_m = [[-5.0, -30.0], [120.0, -30.0], [120.0, 8.0], [-5.0, 8.0]]"
    name = mission_file("case2", ("separation_m = 3.0", f"separation_m = 3.0\n{fence}"))
    assert drilled(name).target.start_m == (35.0, -5.0)


def test_a_plant_file_beside_the_mission_is_found(mission_file: Callable[..., str]) -> None:
    name = mission_file("case2", ("endpoint =", 'profile = "own.toml"\nendpoint ='))
    text = (PROFILES / "px4.toml").read_text(encoding="utf-8")
    (Path(name).parent / "own.toml").write_text(text, encoding="utf-8")
    assert [each.plant for each in drilled(name).vehicles] == [each.plant for each in load_mission("px4-trio").vehicles]


def test_who_things_happen_to_is_the_last_in_line_and_the_leader_at_the_end() -> None:
    roles = Roles(drilled("case2"))
    assert (roles.subject, roles.others) == (3, (1, 2))
    roles.landed.add(3)
    assert (roles.subject, roles.others, roles.airborne) == (1, (2,), (1, 2))
    roles.landed.add(1)
    assert roles.subject == 2


def test_grace_times_are_the_missions() -> None:
    usual, receiver = (
        Roles(
            drilled(
                "case2",
                ("tuning", "failsafe", {"battery_s": battery_s}),
                ("safety", "telemetry_timeout_s", telemetry_s),
            )
        )
        for battery_s, telemetry_s in ((5.0, 1.0), (25.0, 11.0))
    )
    by_name = {drill.fault: drill for drill in DRILLS}

    def limit_s(roles: Roles, fault: str) -> float:
        return by_name[fault].expect(roles).limit_s or 0.0

    assert limit_s(receiver, "battery low") - limit_s(usual, "battery low") == pytest.approx(20.0)
    assert limit_s(receiver, "telemetry frozen") - limit_s(usual, "telemetry frozen") == pytest.approx(10.0)


def test_drills_are_chosen_by_name() -> None:
    assert chosen([]) == DRILLS
    assert [drill.fault for drill in chosen(["killed-agent", "gps jump"])] == ["GPS jump", "killed agent"]
    with pytest.raises(InputError, match=r"--fault: there is no fault 'fire'; the faults are .*killed-agent"):
        chosen(["fire"])


def test_a_mission_of_several_rings_is_refused() -> None:
    with pytest.raises(InputError, match="one ring, and the mission has 3"):
        drill_mission("stack", ())
