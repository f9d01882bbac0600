"""Texts of missions, logs, key folders and file names from elsewhere: none of them reaches the terminal unescaped."""

import json
import os
import pty
import re
import sys
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
import tomli_w
from foxglove import Context

from agents.team.text import CONTROL
from gcs.flightlog.audit import AuditEntry, sealed
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Vehicle
from gcs.flightlog.writer import LogWriter
from tests.conftest import RunHere
from tests.gcs.cli.conftest import FlyingHere
from tests.support.flight_logs import engaging, record_simulation
from tests.support.mission_text import content
from tests.support.paths import MISSIONS
from tests.support.verb_runs import VerbRun
from tests.wire.test_verbs import ALL

EVIL = "\x1b[2J\x1b]0;mine\x07\x9b31m\u202e\u2066\rover\x08\x7f[link=x]"
MARKUP = f"{EVIL}[/b]"
"""Also an end of what never began in the markup of terminals; it cannot be in a file's name."""
NAME = f"{EVIL}\udc9b"
"""Names of files may hold bytes that are no text, such as the CSI of eight bits."""
HARMFUL = re.compile(rf"(?![\n\t])[{CONTROL}]")
OWN_STYLE = re.compile(r"\x1b\[[\d;]*[mAK]|\x1b\[\?25[hl]|\r")
"""Colours, and what moves the cursor to draw a progress bar again."""


def evil(value: object) -> object:
    """Return plain data with a hostile text in each of its texts that is free."""
    match value:
        case str():
            return f"{MARKUP}{value}"
        case dict():
            return {key: each if key in KEPT else evil(each) for key, each in value.items()}
        case list() | tuple():
            return [evil(each) for each in value]
    return value


KEPT = ("event", "source", "tactic", "mission_text", "plants", "previous", "digest", "how", "qp", "approach", "kind")
"""Texts of which the reader knows all values, and those that it parses."""


def write_log(path: Path) -> None:
    """Record a flight, and write its log again with hostile texts."""
    flown = path.with_name("flown.mcap")
    record_simulation(engaging(), flown, duration_s=5.0)
    log, writer = read_log(flown), LogWriter(path, Context())
    for vehicle_id, records in {0: log.run_records, **log.vehicles}.items():
        for record in records:
            read = record.read(record.kind)
            with suppress(msgspec.ValidationError):
                read = msgspec.convert(evil(msgspec.to_builtins(read)), record.kind)
            writer.write(vehicle_id, record.plain()["number"], record.time_ns, read)
        if vehicle_id:
            writer.write(vehicle_id, 10**6, records[-1].time_ns, Vehicle(MARKUP, MARKUP, (), "px4"))
    entry = AuditEntry(1.0, "answered", 1, "bus", MARKUP, f"command/{MARKUP}", 1, f"lands{MARKUP}\n" * 3, "", "")
    writer.write(0, 10**6, 10**9, sealed(entry, ""))
    writer.close()
    flown.unlink()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a mission that is wrong, one that flies, a log, keys and a sweep, all with hostile texts."""
    made = tmp_path_factory.mktemp("hostile") / f"{EVIL}\n"
    made.mkdir()
    mission = content((MISSIONS / "case2.toml").read_text(encoding="utf-8"))
    mission["mission"] |= {"name": MARKUP[:60], "description": MARKUP}
    (made / f"flies{NAME}.toml").write_text(tomli_w.dumps(mission), encoding="utf-8")
    mission["vehicles"][0] |= {"profile": f"{EVIL}.toml", EVIL: EVIL}
    mission["vehicles"][1]["url"] = f"udpin://{EVIL}"
    mission["network"] = {"team": EVIL, "router": EVIL, "security": {"keys": EVIL}}
    mission["safety"]["separation_m"] = EVIL
    (made / f"wrong{NAME}.toml").write_text(tomli_w.dumps(mission | {EVIL: {EVIL: EVIL}}), encoding="utf-8")
    write_log(made / f"flight{NAME}.mcap")
    keys = made / "keys"
    keys.mkdir(mode=0o700)
    (keys / "authority").mkdir(mode=0o700)
    holder = {"role": "operator", "name": EVIL, "expires_s": 2e9, "may": [EVIL]}
    (keys / "roster.json").write_text(json.dumps({"authority": EVIL, "holders": [holder]}), encoding="utf-8")
    return made


def hostile_words(run: VerbRun) -> list[str]:
    """Return the words of a command with hostile texts in place of files, names and values."""

    def word(given: str) -> str:
        if given.startswith("-") or given.replace(".", "").isdecimal():
            return given
        return {".toml": f"wrong{NAME}.toml", ".mcap": f"flight{NAME}.mcap"}.get(Path(given).suffix, EVIL)

    return [*run.command.split(), *map(word, run.arguments.split())]


def escaped(text: str) -> str:
    return text.encode("unicode_escape", "surrogateescape").decode()


def test_no_command_prints_control_characters_of_files_and_names(
    folder: Path,
    run_here: RunHere,
    flying_here: FlyingHere,
    monkeypatch: pytest.MonkeyPatch,
    subtests: pytest.Subtests,
) -> None:
    monkeypatch.chdir(folder)
    for run in ALL:
        hostile = [*hostile_words(run), *(["--json"] if run.keys else [])]
        for words in (hostile, [*run.command.split(), EVIL, f"--{EVIL}"]):
            with subtests.test(words=escaped(" ".join(words))):
                with flying_here():
                    code, out, err = run_here(*words)
                assert not HARMFUL.findall(out + err), escaped(out + err)
                assert out + err or words == ["log", "layout"], "another process printed it"
                assert code in (0, 1, 2, 3)


@pytest.mark.parametrize(
    "arguments",
    [
        "sim {mission} --duration 1 --json",
        "excite {mission} --preview --json",
        "report {log} --html flight.html --json",
        "report {log} --compare {other} --html compared.html",
        "replay {log} --explain 1 --json",
        "log audit {log}",
    ],
)
def test_none_is_printed_by_a_command_that_reads_them(
    folder: Path, arguments: str, run_here: RunHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    other = folder / f"other{NAME}.mcap"
    if not other.exists():
        other.write_bytes((folder / f"flight{NAME}.mcap").read_bytes())
    places = {"{mission}": f"flies{NAME}.toml", "{log}": f"flight{NAME}.mcap", "{other}": other.name}
    code, out, err = run_here(*(places.get(word, word) for word in arguments.split()))
    assert code in (0, 1), err
    assert not HARMFUL.findall(out + err), escaped(out + err)
    assert "mine" in out + err, "it has to show them"


def on_terminal(words: list[str], folder: Path) -> str:
    """Run a command there on a terminal; return what that receives."""
    process, terminal = pty.fork()
    if process == 0:
        os.chdir(folder)
        os.execve(
            sys.executable, [sys.executable, "-m", "gcs", *words], {**os.environ, "TERM": "xterm", "COLUMNS": "500"}
        )
    received = b"".join(iter(lambda: _read(terminal), b""))
    os.waitpid(process, 0)
    os.close(terminal)
    return received.decode("utf-8", "surrogateescape")


def _read(terminal: int) -> bytes:
    with suppress(OSError):  # it has ended
        return os.read(terminal, 65536)
    return b""


@pytest.mark.parametrize("command", ["replay {log}", "identify {log} --vehicle 1"])
def test_a_terminal_receives_the_program_s_own_style_only(folder: Path, command: str) -> None:
    received = on_terminal([word.replace("{log}", f"flight{NAME}.mcap") for word in command.split()], folder)
    assert "mine" in received, "it has to show them"
    assert not HARMFUL.findall(OWN_STYLE.sub("", received)), escaped(received)
