"""A team of stubs before it runs: bad input names the argument, the value and what may be given."""

from math import inf, nan
from typing import Any

import pytest

import cordon


def test_bad_arguments_name_the_value(subtests: pytest.Subtests) -> None:
    faults: list[tuple[dict[str, Any], str]] = [
        ({"mission": "case4"}, "case4"),
        ({"mission": 3}, "mission: 3"),
        ({"vehicles": 0}, r"vehicles: .*from 1 to 3.*given: 0"),
        ({"vehicles": 4}, r"vehicles: .*given: 4"),
        ({"vehicles": 1.0}, r"vehicles: .*given: 1\.0"),
        ({"vehicles": True}, r"vehicles: .*given: True"),
        ({"speed": 0.0}, r"speed: .*given: 0\.0"),
        ({"speed": nan}, r"speed: .*given: nan"),
        ({"speed": "max"}, r"speed: .*given: 'max'"),
        ({"seed": -1}, r"seed: .*given: -1"),
        ({"seed": "3"}, r"seed: .*given: '3'"),
    ]
    for arguments, fault in faults:
        with subtests.test(**arguments), pytest.raises(cordon.InputError, match=fault):
            cordon.stubs(**{"mission": "case2", **arguments})
    with pytest.raises(cordon.InputError, match=r"(?s)vehicles: .*\nspeed: .*\nseed: "):
        cordon.stubs("case2", 9, speed=-1.0, seed=-1)


def test_a_team_has_the_missions_first_vehicles_and_no_port_twice() -> None:
    mission = cordon.load("ardupilot-trio")
    teams = [cordon.stubs(mission, number, speed=inf) for number in (None, 1, 2)]
    assert [team.ids for team in teams] == [(1, 2, 3), (1,), (1, 2)]
    assert [len(team) for team in teams] == [3, 1, 2]
    ports = [config.client_port for team in teams for config in team._configs]
    assert len({*ports}) == 6
    assert not {*ports} & {*range(14_540, 14_601)}
    assert max(ports) < 32_768, "an ephemeral port may be taken by any connection"


def test_a_team_that_does_not_run_says_how_to_run_it() -> None:
    team = cordon.stubs("case2")
    with pytest.raises(cordon.InputError, match=r"vehicle 1: .*`with`"):
        team[1]
    with pytest.raises(cordon.VehicleRefusedError, match="`with`"):
        team.wait_until(lambda: True)
    for within_s in (0.0, -1.0, nan, "3"):
        with pytest.raises(cordon.InputError, match=f"within_s: .*given: {within_s!r}"):
            team.wait_until(lambda: True, within_s=within_s)  # type: ignore[arg-type]
