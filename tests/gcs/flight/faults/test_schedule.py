"""Faults that the command line schedules: what is accepted, and what each refusal names."""

import re

import pytest

from gcs.drill.faults import DRILLS
from gcs.errors import InputError
from gcs.flight.faults.schedule import scheduled_faults
from gcs.mission.file import load_mission

CASE2 = load_mission("case2")
DURATION_S = 60.0


def test_faults_come_by_their_times_with_the_vehicles_that_were_given() -> None:
    faults = scheduled_faults(["Link-Cut@30:2", "target lost@2.5", "gps-jump@40"], CASE2, DURATION_S, CASE2.ids)
    assert [(each.fault.name, each.injected.at_s, each.injected.vehicle) for each in faults] == [
        ("target lost", 2.5, None),
        ("link cut", 30.0, 2),
        ("GPS jump", 40.0, None),
    ]


def test_every_drill_can_be_practised() -> None:
    options = [drill.fault.replace(" ", "-") for drill in DRILLS]
    assert len(options) == len(set(options)) >= 22
    assert len(scheduled_faults([f"{each}@1" for each in options], CASE2, DURATION_S, CASE2.ids)) == len(options)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ("link-cut", ("link-cut", "NAME@SECONDS")),
        ("link-cut@nan", ("link-cut@nan",)),
        ("link-cut@5:x", ("link-cut@5:x",)),
        ("bad-luck@5", ("bad-luck", "link-cut", "frozen-interpreter")),
        ("link-cut@60", ("link-cut@60", "over after 60 s")),
        ("link-cut@5:9", ("no vehicle 9", "1, 2, 3")),
        ("target-lost@5:2", ("whole team", ":2")),
    ],
)
def test_what_does_not_fit_is_refused_by_name_and_value(given: str, named: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as refused:
        scheduled_faults(["latency@1", given], CASE2, DURATION_S, CASE2.ids)
    (problem,) = refused.value.faults
    assert problem.startswith("--fault: ")
    assert [each for each in named if each not in problem] == []


def test_all_that_does_not_fit_is_named_at_once() -> None:
    with pytest.raises(InputError) as refused:
        scheduled_faults(["link-cut", "link-cut@99"], CASE2, DURATION_S, CASE2.ids)
    assert len(refused.value.faults) == 2


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ("link-cut@10:1", "vehicle 1 is not a stub (stubs: 2, 3)"),
        ("link-cut@10", "name one of the stubs (2, 3)"),
        ("target-lost@10", "affects the whole team, and only vehicles 2, 3 are stubs"),
    ],
)
def test_in_a_hybrid_team_stubs_alone_have_faults(given: str, fault: str) -> None:
    with pytest.raises(InputError, match=re.escape(fault)):
        scheduled_faults([given], CASE2, DURATION_S, (2, 3))
    assert len(scheduled_faults(["link-cut@10:2"], CASE2, DURATION_S, (2, 3))) == 1
