"""Fence and zones drawn on the map of `cordon station --edit`: saved into the mission file, faults shown."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from playwright.sync_api import Page, expect

from gcs.mission.file import load_mission
from tests.station.conftest import OpenPage
from tests.station.test_accessibility import PHONE, WIDE, findings
from tests.support.wire import LOOPBACK, PATIENCE_S, cordon, free_port

pytestmark = pytest.mark.browser
COMMENT = ("[target]\n", "# stays\n[target]\n")


class Editor(NamedTuple):
    """The page of an editor, and its file."""

    page: Page
    file: Path


@pytest.fixture
def editor(open_page: OpenPage, mission_file: Callable[..., str]) -> Iterator[Editor]:
    path = mission_file("case2", COMMENT)
    with cordon("station", "--mission", path, "--edit", "--address", f"{LOOPBACK}:{free_port()}") as process:
        assert process.stderr is not None
        found = re.search(r"http://\S+", process.stderr.readline())
        assert found is not None
        yield Editor(open_page(found[0], viewport=WIDE), Path(path))


def place_m(page: Page, name: str) -> tuple[float, ...]:
    """Return the place of a handle, as its name says it."""
    label = page.get_by_role("button", name=name).first.get_attribute("aria-label") or ""
    return tuple(float(each) for each in re.findall(r"[xy] (-?[\d.]+) m", label))


def test_zones_and_fence_are_drawn_checked_and_saved(editor: Editor, subtests: pytest.Subtests) -> None:
    page, file = editor
    state, faults = page.locator("#editor-state"), page.locator("#editor-faults li")
    before = load_mission(str(file))
    expect(state).to_have_text("as saved")
    with subtests.test("by mouse"):
        box: Any = page.locator("#map").bounding_box()
        page.mouse.click(box["x"] + 500, box["y"] + 400, button="right")
        page.get_by_role("menuitem", name="No-fly zone here", exact=True).click()
        page.get_by_label("Name of the zone").fill("school")
        page.get_by_label("To, m").fill("120")
        expect(state).to_have_text("valid, not saved")
        corner = page.get_by_role("button", name="Corner 3 of school")
        x_m, y_m = place_m(page, "Corner 3 of")
        handle: Any = page.locator(".handle:not(.between)").nth(2).bounding_box()
        at = handle["x"] + 16.0, handle["y"] + 16.0
        page.mouse.move(*at)
        page.mouse.down()
        page.mouse.move(at[0] + 40.0, at[1] - 30.0, steps=4)
        page.mouse.up()
        expect(corner).to_have_count(1)
        moved_m = place_m(page, "Corner 3 of school")
        assert (moved_m[0] - x_m) / (moved_m[1] - y_m) == pytest.approx(40.0 / 30.0, rel=0.1)
        assert moved_m[0] > x_m + 1.0
        assert findings(page) == []
    with subtests.test("by keyboard"):
        corner.focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Shift+ArrowUp")
        assert place_m(page, "Corner 3 of school") == pytest.approx((moved_m[0] + 1.0, moved_m[1] + 10.0))
        page.keyboard.press("Insert")
        expect(page.locator(".handle:not(.between)")).to_have_count(5)
        page.get_by_role("button", name="Corner 4 of school").focus()
        page.keyboard.press("Delete")
        expect(page.locator(".handle:not(.between)")).to_have_count(4)
    with subtests.test("saved"):
        expect(state).to_have_text("valid, not saved")
        page.get_by_role("button", name="Save").click()
        expect(state).to_have_text("✓ saved")
        (zone,) = load_mission(str(file)).safety.no_fly
        assert (zone.name, zone.ceiling_m, zone.floor_m) == ("school", 120.0, None)
        assert zone.polygon_m[2] == pytest.approx((moved_m[0] + 1.0, moved_m[1] + 10.0))
        assert "# stays" in file.read_text(encoding="utf-8")
        page.reload()
        expect(page.get_by_label("Name of the zone")).to_have_value("school")
        expect(page.locator(".zone-name")).to_have_text("✕ school to 120 m")
    with subtests.test("what the mission cannot fly is not saved"):
        page.get_by_role("button", name="Add the fence").click()
        for number, (x_m, y_m) in enumerate(((30.0, -8.0), (40.0, -8.0), (40.0, 0.0), (30.0, 0.0)), start=1):
            move_to(page, f"Corner {number} of the fence", x_m, y_m)
        expect(faults.first).to_contain_text("fence_m")
        page.get_by_role("button", name="Save").click()
        expect(state).to_have_text("not saved: it has faults")
        assert load_mission(str(file)).safety.fence_m == before.safety.fence_m
        page.get_by_role("button", name="Remove the fence").click()
        expect(faults).to_have_count(0)
        page.get_by_role("button", name="Add a circle").click()
        page.get_by_label("Name of the zone").last.fill("school")
        expect(faults.first).to_contain_text("'school'")
        assert findings(page) == []
    with subtests.test("on a phone"):
        page.set_viewport_size(PHONE)
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        assert findings(page) == []


def move_to(page: Page, name: str, x_m: float, y_m: float) -> None:
    """Move a corner by the arrow keys to within a metre of a place."""
    page.get_by_role("button", name=name).focus()
    here = place_m(page, name)
    for off_m, more, less in ((x_m - here[0], "ArrowRight", "ArrowLeft"), (y_m - here[1], "ArrowUp", "ArrowDown")):
        tens, ones = divmod(round(abs(off_m)), 10)
        for key in [f"Shift+{more if off_m > 0 else less}"] * tens + [more if off_m > 0 else less] * ones:
            page.keyboard.press(key)


def test_what_cannot_be_edited_is_bad_input(tmp_path: Path, subtests: pytest.Subtests) -> None:
    for arguments, word in (
        (("--mission", "case2"), "bundled"),
        (("--mission", str(tmp_path / "none.toml")), "none.toml"),
    ):
        with subtests.test(word), cordon("station", "--edit", *arguments) as process:
            _, err = process.communicate(timeout=PATIENCE_S)
            assert process.returncode == 2
            assert word in err
