"""Options that name files: what is no file is refused at once, and what is written is the user's own."""

import os
import signal
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any, get_args

import pytest
from cyclopts import App

from gcs.cli import VERBS, app, main
from gcs.flight.recording import default_path
from gcs.keys.private_files import create
from tests.support.flight_logs import engaging, record_simulation
from tests.support.verb_runs import VerbRun
from tests.wire.test_verbs import ALL

LIMIT_S = 60
SUFFIXES = {"--plot": ".png", "--html": ".html", "--animate": ".gif", "--out": ".png", "--output": ".toml"}
FOLDERS = {"--keys", "--tiles", "--station-tiles", "FOLDER", "--log of drill", "--out of sweep"}
"""Where a folder may be given."""
RUNS = {run.command: run for run in reversed(ALL)}


def path_arguments() -> list[tuple[str, str]]:
    """Return each command with each of its arguments that names a file."""
    app.resolved_commands()
    return [pair for verb in VERBS for pair in _path_arguments(app[verb], verb)]


def _path_arguments(command: App, name: str) -> Iterator[tuple[str, str]]:
    if command.default_command is not None:
        for argument in command.assemble_argument_collection():
            if Path in _kinds(argument.hint):
                yield name, argument.names[0] if argument.index is None else argument.names[0].lstrip("-").upper()
    for inner, each in command.resolved_commands().items():
        if not inner.startswith("-"):
            yield from _path_arguments(each, f"{name} {inner}")


def _kinds(hint: Any) -> Iterator[Any]:
    yield hint
    for each in get_args(hint):
        yield from _kinds(each)


@contextmanager
def limited() -> Iterator[None]:
    """Interrupt a command that waits."""

    def interrupt(*_: object) -> None:
        raise TimeoutError("it waits for the file")

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.alarm(LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def words(run: VerbRun, argument: str, given: str) -> list[str]:
    """Return the words of a command with a value for one of its arguments."""
    place, values = run.command.split(), run.arguments.format(page=1).split()
    if argument in values:
        del values[values.index(argument) : values.index(argument) + 2]
    if argument.startswith("-"):
        return [*place, *values, argument, given, *([given] if argument == "--tls" else [])]
    return [*place, given, *(values if not values or values[0].startswith("-") else values[1:])]


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_what_is_no_file_is_refused_at_once(
    tmp_path: Path,
    kind: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    subtests: pytest.Subtests,
) -> None:
    assert ("report", "--html") in path_arguments()
    monkeypatch.chdir(tmp_path)
    for number, (command, argument) in enumerate(path_arguments()):
        if kind == "folder" and {argument, f"{argument} of {command}"} & FOLDERS:
            continue
        path = Path(f"{number}{SUFFIXES.get(argument, '.mcap')}")
        match kind:
            case "pipe":
                os.mkfifo(path)
            case "device":
                path.symlink_to("/dev/zero")
            case "folder":
                path.mkdir()
        given = words(RUNS[command], argument, str(path))
        monkeypatch.setattr(sys, "argv", ["cordon", *given])
        monkeypatch.setattr(sys, "orig_argv", [sys.executable, "-m", "gcs", *given])
        with subtests.test(command=command, argument=argument):
            with limited(), pytest.raises(SystemExit) as ended:
                main()
            out, err = capsys.readouterr()
            assert (ended.value.code, out) == (2, ""), err
            assert argument in err
            assert str(path) in err


@pytest.mark.parametrize("argument", ["LOGS", "--html"])
def test_a_name_that_is_too_long_is_refused(
    argument: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "x" * 300 + SUFFIXES.get(argument, ".mcap")
    monkeypatch.chdir(tmp_path)
    record_simulation(engaging(), tmp_path / "sim.mcap", duration_s=1.0)
    monkeypatch.setattr(sys, "argv", ["cordon", *words(RUNS["report"], argument, name)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert name[:50] in capsys.readouterr().err


def test_what_is_written_is_the_user_s_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CORDON_LOGS", str(tmp_path / "logs"))
    monkeypatch.chdir(tmp_path)
    record_simulation(engaging(), tmp_path / "flight.mcap", duration_s=15.0)
    record_simulation(engaging(), tmp_path / "other.mcap", duration_s=2.0)
    before = os.umask(0o022)
    whole = (tmp_path / "flight.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: -len(whole) // 4])
    (tmp_path / "cut.mcap").chmod(0o600)
    try:
        for command in (
            "sim case2 --duration 2 --log sim.mcap --plot sim.png",
            "report other.mcap --animate other.webp",
            "report flight.mcap --compare other.mcap --html compared.html",
            "log recover cut.mcap",
            "identify flight.mcap --vehicle 1 -o found.toml --html found.html",
            "sweep case2 --seeds 0:1 --duration 2 --workers 1 --out swept",
            "sweep plot swept",
            "new new.toml --vehicles 2 --links stub --shape line --radius 10 --rate 0.1 --target rest --fence 20",
        ):
            monkeypatch.setattr(sys, "argv", ["cordon", *command.split()])
            with pytest.raises(SystemExit) as ended:
                main()
            assert ended.value.code in (0, 1), capsys.readouterr().err
        create(default_path("case2", None, datetime.now())).close()  # the log of a flight without --log
    finally:
        os.umask(before)
    written = [*tmp_path.rglob("*")]
    assert tmp_path / "logs" in written
    made = {path.suffix for path in written}
    assert made >= {".mcap", ".png", ".webp", ".html", ".toml", ".jsonl", ".parquet"}
    open_to_others = [str(path) for path in written if stat.S_IMODE(path.stat().st_mode) & 0o077]
    assert not open_to_others
