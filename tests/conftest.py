"""What several tests share: how hypothesis searches, a configuration to start from, and a batch estimator."""

import gc
import os
import re
import signal
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import settings

from agents.settings.config import AgentConfig
from agents.settings.sections import EncirclementSettings, FormationSettings
from estimation.plant.model import Plant, PlantAxis
from estimation.state import Vector
from gcs.cli import main
from gcs.flight.recording import FOLDER_VARIABLE
from gcs.link.ports import free_ports
from tests.support import installation
from tests.support.paths import MISSIONS

# The same examples on every run, and no stop-watch: a slow machine is no failure.
settings.register_profile("cordon", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("cordon")

STUB = Plant(PlantAxis(0.80, 0.87), PlantAxis(0.80, 0.87))
CONFIG = AgentConfig(
    vehicle_id=2,
    slots=(1, 2, 3),
    line_start_m=(0.0, 0.0),
    altitude_m=8.0,
    rate_hz=10.0,
    communication_radius_m=200.0,
    plant=STUB,
    formation=FormationSettings(spacing_m=5.0, speed_m_s=0.2, leader=2),
    encirclement=EncirclementSettings(radius_m=10.0, angular_rate_rad_s=0.05),
)


TERMINAL_VARIABLES = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
INTERRUPTIONS: dict[int, Any] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGQUIT: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
}


def pytest_configure() -> None:
    """Forget what the user's terminal and shell are like, and refuse to replace methods of compiled classes.

    Output is asserted as it is without a terminal. Workers and the hundreds of processes that tests start would each
    compile what they import, if none of them kept it. What `nohup` and a shell's `&` ignore, a program that a test
    interrupts would ignore as well. Compiled callers go on calling a method that is replaced. Garbage is collected
    rarely from the beginning: what importing the tests makes stays.
    """
    gc.set_threshold(20_000, 20, 50)
    for number, action in INTERRUPTIONS.items():
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, action)
    for name in TERMINAL_VARIABLES:
        os.environ.pop(name, None)
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    replace_attribute = pytest.MonkeyPatch.setattr

    def setattr_of_python(patch: pytest.MonkeyPatch, target: Any, *arguments: Any, **named: Any) -> None:
        replace_attribute(patch, target, *arguments, **named)
        owner = resolve_name(target.rpartition(".")[0]) if isinstance(target, str) else target
        assert not (isinstance(owner, type) and "__mypyc_attrs__" in vars(owner)), f"{owner} is compiled"

    pytest.MonkeyPatch.setattr = setattr_of_python  # type: ignore[method-assign, assignment]


def pytest_sessionstart() -> None:
    """Test nothing where Python finds an installation of other sources."""
    if fault := installation.fault(installation.place()):
        raise pytest.UsageError(fault)


def pytest_collection_finish() -> None:
    """Let no collection of garbage examine the tests and what they have imported, which live as long as the session."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """State what was tested."""
    terminalreporter.write_line(installation.description())


WHOLLY = r"^pytestmark = \[?\s*pytest\.mark\.{}\b"
MARKS = re.compile(r"(not )?\w+( and (not )?\w+)*")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file that `-m wire`, `-m "not wire and not browser"` ... select nothing of: each worker imports all."""
    chosen = config.getoption("markexpr")
    if not (MARKS.fullmatch(chosen) and re.fullmatch(r"test_.*\.py", collection_path.name)):
        return None
    text = collection_path.read_text(encoding="utf-8")
    return any(_excludes_all(term, text) for term in chosen.split(" and ")) or None


def _excludes_all(term: str, text: str) -> bool:
    """Return whether a mark, or `not` and a mark, selects no test of a file."""
    mark = term.removeprefix("not ")
    return (
        f"mark.{mark}" not in text if mark == term else re.search(WHOLLY.format(mark), text, re.MULTILINE) is not None
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes long, so that no worker is left alone with it; each is followed by one of the last.

    A worker is handed two tests to begin with: two long ones in a row would be flown one after the other.
    """
    long = [item for item in items if item.get_closest_marker("long") is not None]
    others = [item for item in items if item.get_closest_marker("long") is None]
    first, last = others[: -len(long) or None], others[::-1][: len(long)]
    items[:] = [item for pair in zip_longest(long, last) for item in pair if item is not None] + first


REQUIRED = "CORDON_REQUIRE_ALL"
FIRMWARE = {"px4", "ardupilot"}
"""Marks of tests that need a simulator of an autopilot, which no package index has."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Where CORDON_REQUIRE_ALL is set, as in CI, fail tests that are skipped for a missing right or tool."""
    report = yield
    if report.skipped and os.environ.get(REQUIRED) and not FIRMWARE & {mark.name for mark in item.iter_markers()}:
        assert isinstance(report.longrepr, tuple)
        report.outcome, report.longrepr = "failed", f"{report.longrepr[2]} ({REQUIRED} is set)"
    return report


@pytest.fixture(autouse=True, scope="session")
def _logs_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """No flight of a test, nor of a process that it starts, leaves its log or anything else in somebody's home."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(tmp_path_factory.mktemp("data")))
        patch.setenv(FOLDER_VARIABLE, str(tmp_path_factory.mktemp("logs")))
        yield


@pytest.fixture(autouse=True, scope="session")
def _keys_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Flights of tests have keys of their own: tests beside these fly teams of the same name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        yield


@pytest.fixture(autouse=True)
def _signals_as_before() -> Iterator[None]:
    """Commands run in this process hold Ctrl-C back: neither the next test nor its processes shall inherit that."""
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    yield
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)


class Ran(NamedTuple):
    """What a command left behind."""

    code: int
    out: str
    err: str


RunHere = Callable[..., Ran]


@pytest.fixture
def run_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> RunHere:
    """Return a runner of commands in this process, which is faster; a process gives users the same."""

    def run(*arguments: str) -> Ran:
        monkeypatch.setattr(sys, "argv", ["cordon", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        return Ran(int(ended.value.code or 0), *capsys.readouterr())

    return run


def own_team(text: str, name: str) -> str:
    """Return a mission's text with the name of a team that no other test flies, unless it names one."""
    if re.search(r"^team = ", text, re.MULTILINE):
        return text
    if "[network]\n" in text:
        return text.replace("[network]\n", f'[network]\nteam = "{name}"\n')
    return f'{text}\n[network]\nteam = "{name}"\n'


@pytest.fixture
def mission_file(tmp_path: Path) -> Callable[..., str]:
    """Return a maker of mission files: a bundled mission as a team of its own, with pieces of its text replaced."""

    def make(name: str, *changes: tuple[str, str]) -> str:
        text = (MISSIONS / f"{name}.toml").read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        ports = sorted(set(re.findall(r"127\.0\.0\.1:(\d+)", text)))
        own = dict(zip(ports, free_ports(len(ports)), strict=True))
        text = re.sub(r"(127\.0\.0\.1):(\d+)", lambda found: f"{found[1]}:{own[found[2]]}", text)
        text = own_team(text, f"test-{min(own.values())}")
        path = tmp_path / "mission.toml"
        path.write_text(text, encoding="utf-8")
        return str(path)

    return make


@pytest.fixture(scope="session")
def make_config() -> Callable[..., AgentConfig]:
    """Return a maker of configurations: fields by name, and a dictionary changes single settings of a section."""

    def make(**changes: Any) -> AgentConfig:
        sections = {
            name: getattr(CONFIG, name).model_copy(update=change) if isinstance(change, dict) else change
            for name, change in changes.items()
        }
        return replace(CONFIG, **sections)

    return make


@pytest.fixture(scope="session")
def batch_mean() -> Callable[..., Vector]:
    """Return a batch estimator: the last of all states that together fit a Gaussian model best, by least squares.

    The states obey `x_{k+1} = F x_k + c + N(0, Q)`, measured as `z = H x + N(0, R)`. A filter has to agree with it.
    """

    def estimate(
        prior: tuple[Vector, Vector],
        steps: Sequence[tuple[Vector, Vector, Vector]],
        measurements: Sequence[tuple[Vector, Vector, Vector]],
    ) -> Vector:
        size = len(prior[0])
        unknowns = size * (len(steps) + 1)
        rows: list[Vector] = []
        values: list[Vector] = []

        def demand(index: int, matrix: Vector, value: Vector, covariance: Vector) -> None:
            whitening = np.linalg.inv(np.linalg.cholesky(covariance))
            row = np.zeros((len(value), unknowns))
            row[:, index * size : index * size + matrix.shape[1]] = matrix
            rows.append(whitening @ row)
            values.append(whitening @ value)

        demand(0, np.eye(size), *prior)
        for index, (transition, forcing, noise) in enumerate(steps):
            demand(index, np.hstack([-transition, np.eye(size)]), forcing, noise)
        for index, (value, observation, noise) in enumerate(measurements, start=1):
            demand(index, observation, value, noise)
        solution = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0]
        return np.asarray(solution[-size:], dtype=np.float64)

    return estimate
