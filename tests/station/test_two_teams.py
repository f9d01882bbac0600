"""Two teams on one page: each has its own commands, and vehicles of the same number are not confused."""

import asyncio
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from gcs.mission.file import load_mission
from tests.station.conftest import OpenPage
from tests.station.test_accessibility import PHONE, WIDE, findings
from tests.support.mission_text import INSECURE
from tests.support.page.station import AnsweringTeam, answering_team
from tests.support.wire import LOOPBACK, PATIENCE_S, cordon, free_port, until_now

pytestmark = pytest.mark.browser
NAMES = ("red", "blue")


@contextmanager
def answering(files: list[str]) -> Iterator[list[AnsweringTeam]]:
    """Run the vehicles of missions beside the test."""
    teams: list[AnsweringTeam] = []
    ready, stop = threading.Event(), threading.Event()

    async def run() -> None:
        async with AsyncExitStack() as stack:
            teams.extend([await stack.enter_async_context(answering_team(load_mission(file))) for file in files])
            ready.set()
            await asyncio.to_thread(stop.wait)

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    try:
        assert ready.wait(PATIENCE_S)
        yield teams
    finally:
        stop.set()
        thread.join()


def test_a_command_goes_to_the_team_that_is_chosen(
    open_page: OpenPage, mission_file: Callable[..., str], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    files = []
    for name in NAMES:
        made = Path(mission_file("case2", INSECURE, ('name = "case2"', f'name = "{name}"')))
        files.append(str(made.rename(tmp_path / f"{name}.toml")))
    missions = [part for file in files for part in ("--mission", file)]
    with (
        answering(files) as (red, blue),
        cordon("station", *missions, "--address", f"{LOOPBACK}:{free_port()}") as served,
    ):
        assert served.stderr is not None
        found: Any = re.search(r"http://\S+", _url(served.stderr))
        page = open_page(found[0], viewport=WIDE)
        chosen = {name: page.locator("#teams").get_by_role("button", name=name) for name in NAMES}
        expect(page.locator("#mission")).to_have_text("red")
        expect(chosen["blue"]).to_be_visible()
        expect(page.locator(".card .tactic").first).to_have_text("encircle")
        with subtests.test("the first"):
            expect(page.locator("#target-text")).to_have_text("To all 3 vehicles of red")
            page.locator("#verbs [data-verb='hold']").click()
            until_now(lambda: {vehicle for vehicle, _ in red.received} == {1, 2, 3})
            assert not blue.received
            expect(page.locator("#answers > li").first).to_contain_text("Hold, all 3 vehicles (red)")
        with subtests.test("the other's places"):
            expect(page.locator(".other")).to_have_text(["blue 1", "blue 2", "blue 3"])
            assert findings(page) == []
        with subtests.test("a selection is not taken over"):
            red.received.clear()
            page.get_by_label("Select vehicle 2").check()
            chosen["blue"].click()
            expect(page.locator("#mission")).to_have_text("blue")
            expect(page.locator("#target-text")).to_have_text("To all 3 vehicles of blue")
            expect(page.get_by_label("Select vehicle 2")).not_to_be_checked()
            expect(page.locator(".other")).to_have_text(["red 1", "red 2", "red 3"])
        with subtests.test("one vehicle of the other"):
            page.get_by_label("Select vehicle 2").check()
            page.keyboard.press("h")
            until_now(lambda: [vehicle for vehicle, _ in blue.received] != [])
            expect(page.locator("#answers > li").first).to_contain_text("Hold, vehicle 2 (blue)")
            expect(page.locator("#answers > li").first).to_contain_text("✓ Vehicle 2: holds")
            assert {vehicle for vehicle, _ in blue.received} == {2}
            assert not red.received
        with subtests.test("a dialog is not taken over"):
            page.locator("#verbs [data-verb='kill']").click()
            page.evaluate("document.querySelector('#teams button').click()")
            expect(page.get_by_role("dialog")).to_be_hidden()
            expect(page.locator("#mission")).to_have_text("red")
        with subtests.test("on a phone"):
            page.set_viewport_size(PHONE)
            assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
            assert findings(page) == []


def _url(lines: Iterable[str]) -> str:
    return next(line for line in lines if "http://" in line)


def test_two_missions_of_one_team_are_bad_input(mission_file: Callable[..., str]) -> None:
    file = mission_file("case2")
    with cordon("station", "--mission", file, "--mission", file) as process:
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert "--mission" in err
