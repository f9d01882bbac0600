"""The mission's checklist: who has ticked what, until a start uses it up."""

import asyncio
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gcs.checklist import VALID_S, Checklist
from gcs.errors import InputError
from gcs.flight import preparation
from gcs.mission.file import MissionError, parse_mission
from gcs.mission.mission import ChecklistItem
from tests.support.mission_text import CASE2

PROPELLERS, AREA, FLAG = "Propellers tight", "Area clear of people", "Flag up"
ITEMS = tuple(ChecklistItem(text=text, required=text != FLAG) for text in (PROPELLERS, AREA, FLAG))


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "cordon"


async def test_a_wait_says_again_and_again_what_is_open_until_it_is_ticked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preparation, "REMINDED_EVERY_S", 0.8)
    said = list[str]()
    plan, view = SimpleNamespace(wait_s=60.0), SimpleNamespace(print_line=said.append)
    recording, clock = SimpleNamespace(note_run=lambda _entry: None), SimpleNamespace(now_s=lambda: 0.0)
    team: Any = SimpleNamespace(plan=plan, view=view, recording=recording, clock=clock)
    page = Checklist("red", ITEMS)
    wait = asyncio.create_task(preparation.ChecklistWait(team, Checklist("red", ITEMS)).done())
    await asyncio.sleep(2.0)
    assert len(said) >= 2
    assert all("nothing is armed" in each and f"[ ] {AREA}" in each and FLAG not in each for each in said)
    page.tick_all("anna")
    await asyncio.wait_for(wait, 5.0)
    assert said[-1] == f"checklist: {FLAG}: anna"


def test_ticks_are_shared_by_a_team_until_a_start_uses_them_up() -> None:
    before_s = time.time()
    page, flight = Checklist("red", ITEMS), Checklist("red", ITEMS)
    page.tick(1, "anna", ticked=True)
    assert flight.open() == [ITEMS[0]]
    assert Checklist("blue", ITEMS).open() == [ITEMS[0], ITEMS[1]]
    page.tick(1, "anna", ticked=False)
    assert flight.open() == [ITEMS[0], ITEMS[1]]
    page.tick(0, "ben", ticked=True)
    flight.tick_all("anna")
    first, second, third = flight.use()
    assert first is not None
    assert second is not None
    assert third is not None
    assert (first.by, second.by, third.by) == ("ben", "anna", "anna")
    assert before_s <= first.wall_s <= second.wall_s <= time.time()
    assert page.open() == [ITEMS[0], ITEMS[1]]
    assert [tick.used for tick in page.ticks() if tick] == [True, True, True]
    page.tick(0, "ben", ticked=True)
    assert page.open() == [ITEMS[1]]
    assert [each and each.by for each in flight.use()] == ["ben", None, None]


def test_ticks_of_another_text_or_another_day_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    Checklist("red", ITEMS).tick_all("anna")
    changed = (ChecklistItem(text="Propellers new"), *ITEMS[1:])
    assert Checklist("red", changed).open() == [changed[0]]
    now_s = time.time()
    monkeypatch.setattr(time, "time", lambda: now_s + VALID_S + 1.0)
    assert len(Checklist("red", ITEMS).open()) == 2


def test_a_file_that_cannot_be_trusted_is_refused(runtime: Path) -> None:
    Checklist("red", ITEMS).tick_all("anna")
    (file,) = runtime.glob("checklist-red*")
    file.chmod(0o644)
    with pytest.raises(InputError, match="other users may read"):
        Checklist("red", ITEMS).open()
    file.chmod(0o600)
    file.write_text("[1]")
    with pytest.raises(InputError, match=str(file)):
        Checklist("red", ITEMS).open()


def test_a_mission_states_its_items(subtests: pytest.Subtests) -> None:
    given = f'{CASE2}\n[[checklist]]\ntext = "{PROPELLERS}"\n[[checklist]]\ntext = "{FLAG}"\nrequired = false\n'
    mission = parse_mission(given, None)
    assert [(each.text, each.required) for each in mission.checklist] == [(PROPELLERS, True), (FLAG, False)]
    assert mission.identity == parse_mission(CASE2, None).identity, "it concerns people, not the vehicles"
    faults = {
        "checklist[0].text": "[[checklist]]\n",
        "checklist[1].text": '[[checklist]]\ntext = "one"\n[[checklist]]\ntext = "one"\n',
        "checklist[0].must": '[[checklist]]\ntext = "one"\nmust = true\n',
        "checklist": '[checklist]\ntext = "one"\n',
    }
    for place, text in faults.items():
        with subtests.test(place), pytest.raises(MissionError) as refused:
            parse_mission(f"{CASE2}\n{text}", None)
        assert place in str(refused.value)
