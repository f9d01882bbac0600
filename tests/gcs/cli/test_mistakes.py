"""Typical mistakes: each message names the thing and the next step, and the line of the file that it is about."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import RunHere
from tests.support.mission_text import CASE2
from tests.support.wording import facts_missing

SIM = "sim my.toml"
ONE_VEHICLE = CASE2[: CASE2.index("\n[[vehicles]]\nid = 2")].replace("leader = 2", "leader = 1")


@dataclass(frozen=True)
class Mistake:
    """What a user does: a change of case 2, and a command; what the message says, and which line it shows."""

    name: str
    change: tuple[str, str]
    command: str
    says: tuple[str, ...]
    line: str = ""
    text: str = CASE2


RADIUS = "radius_m = 10.0"
START = "start_m = [0.0, 4.0]"
NOTHING = ("", "")
MISTAKES = (
    Mistake("typo in a key", ("spacing_m", "spacin_m"), SIM, ("formation.spacin_m", "'spacing_m'"), "spacin_m = 5.0"),
    Mistake("a unit behind a number", (RADIUS, f"{RADIUS} m"), SIM, ("line 19", "without a unit"), "radius_m = 10.0 m"),
    Mistake("degrees", ("rad_s = 0.05", "rad_s = 15"), SIM, ("rate_rad_s", "0.262 radians"), "angular_rate_rad_s = 15"),
    Mistake("a key without its unit", (RADIUS, "radius = 10.0"), SIM, ("radius:", "'radius_m'"), "radius = 10.0"),
    Mistake(
        "[vehicles] for one",
        ("[[vehicles]]", "[vehicles]"),
        SIM,
        ("vehicles", "[[vehicles]]"),
        "[vehicles]",
        ONE_VEHICLE,
    ),
    Mistake("[vehicles] for all", ("[[vehicles]]", "[vehicles]"), SIM, ("line 47", "[[vehicles]]"), "[vehicles]"),
    Mistake("decimal comma", (RADIUS, "radius_m = 10,0"), SIM, ("line 19", "10.5"), "radius_m = 10,0"),
    Mistake("no quotation marks", ('"case2"', "case2"), SIM, ("line 2", "quotation marks"), "name = case2"),
    Mistake("colon", (RADIUS, "radius_m: 10.0"), SIM, ("line 19", "KEY = VALUE"), "radius_m: 10.0"),
    Mistake("open bracket", ("[target]", "[target"), SIM, ("line 30", "close the bracket"), "[target"),
    Mistake("True", ("[target]\n", "[frame.x]\nlocal = True\n[target]\n"), SIM, ("true or false",), "local = True"),
    Mistake("a key twice", (RADIUS, f"{RADIUS}\nradius_m = 12.0"), SIM, ("line 20", "leave one"), "radius_m = 12.0"),
    Mistake("no key", (f"{START}\n", ""), SIM, ("vehicles[0].start_m", "missing"), "[[vehicles]]"),
    Mistake("no section", ("[frame]", "[link]"), SIM, ("frame: this section is missing", "`cordon new`")),
    Mistake(
        "one port for two", ("14541", "14540"), SIM, ("[1].url: 14540", "vehicles[0]", "own"), "udpin://127.0.0.1:14540"
    ),
    Mistake("a small ring", (RADIUS, "radius_m = 1.5"), SIM, ("3 vehicles", "3.0 m", "1.74 m"), "radius_m = 1.5"),
    Mistake(
        "a target that is not there",
        NOTHING,
        "target 35 -5 --target nort --mission two-targets",
        ("'nort'", "north, south"),
    ),
    Mistake(
        "a name for the only target", NOTHING, "target 35 -5 --target it --mission case2", ("'it'", "leave it out")
    ),
    Mistake("no mission", NOTHING, "sim", ("--mission", "next: cordon sim --help")),
    Mistake("no such command", NOTHING, "simulate case2", ('"simulate"', "next: cordon --help")),
    Mistake("typo in an option", NOTHING, "sim case2 --sede 3", ("--sede", "--seed", "next: cordon sim --help")),
    Mistake("an option without value", NOTHING, "sim case2 --seed", ("--seed", "next: cordon sim --help")),
    Mistake("a word for a number", NOTHING, "sim case2 --seed one", ("--seed", '"one"', "next: cordon sim --help")),
    Mistake(
        "typo in --set",
        NOTHING,
        "sim case2 --set encirclement.radius=9",
        ("radius", "'radius_m'", "[set, not in the file]"),
    ),
    Mistake("a command for a verb", NOTHING, "command rejoin --vehicle 2", ("next: cordon rejoin --help",)),
    Mistake("a key of a key", NOTHING, "keys isue", ("isue", "next: cordon keys --help")),
)


def test_a_mistake_is_named_with_its_line_and_the_next_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_here: RunHere, subtests: pytest.Subtests
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    for mistake in MISTAKES:
        with subtests.test(mistake.name):
            old, new = mistake.change
            assert old in mistake.text
            Path("my.toml").write_text(mistake.text.replace(old, new) if old else mistake.text, encoding="utf-8")
            code, out, err = run_here(*mistake.command.split())
            assert (code, out) == (2, "")
            assert facts_missing(err, *mistake.says) == [], err
            if mistake.line:
                sources = [f"[my.toml, line {number}: {line.strip()}]" for number, line in _lines_with(mistake.line)]
                assert any(source in err for source in sources), err


def _lines_with(text: str) -> list[tuple[int, str]]:
    """Return the lines of the file that hold a text, with their numbers."""
    lines = Path("my.toml").read_text(encoding="utf-8").split("\n")
    return [(number, line) for number, line in enumerate(lines, start=1) if text in line]
