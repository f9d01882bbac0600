"""The pytest plugin: stub vehicles and their flights as fixtures, and what is left of them when a test fails.

pytest loads it by its entry point. It imports nothing of cordon until a test uses it.
"""

import asyncio
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from cordon.stub_team import StubTeam
    from cordon.stub_vehicle import StubVehicle
    from gcs.flight.simulated_events import Commanded
    from gcs.metrics.result import FlightResult
    from gcs.mission.mission import Mission

    CordonStubs = Callable[..., StubTeam]
    CordonFlight = Callable[..., FlightResult]

_FAILED = pytest.StashKey[bool]()
_MARK = "cordon"
_FIXTURES = ("cordon_stubs", "cordon_flight")


def pytest_configure(config: pytest.Config) -> None:
    """Register the mark of tests that fly stub vehicles."""
    config.addinivalue_line("markers", f"{_MARK}: flies stub vehicles (set by {' and '.join(_FIXTURES)})")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that use a fixture, before pytest selects by marks."""
    for item in items:
        if not {*_FIXTURES}.isdisjoint(getattr(item, "fixturenames", ())):
            item.add_marker(_MARK)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note whether a test has failed, for its fixture."""
    report = yield
    item.stash[_FAILED] = item.stash.get(_FAILED, False) or report.failed
    return report


@pytest.fixture
def cordon_stubs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> "Iterator[CordonStubs]":
    """Return a function that starts stub vehicles for this test; its arguments are those of `cordon.stubs`.

    The vehicles of a test have ports that no other test and no other worker of pytest-xdist has, and end with the test.
    When it fails, their true tracks are kept, and the report names the file.
    """
    import cordon  # noqa: PLC0415 - tests without stubs do not pay for it

    teams: list[StubTeam] = []
    with ExitStack() as stack:

        def start(mission: "Mission | str | Path", vehicles: int | None = None, **named: object) -> "StubTeam":
            team = stack.enter_context(cordon.stubs(mission, vehicles, **named))  # type: ignore[arg-type]
            teams.append(team)
            return team

        yield start
        failed = request.node.stash.get(_FAILED, False)
        states = [f"vehicle {each.id}: {_state(each)}" for team in teams for each in team] if failed else []
    if failed:
        folder = tmp_path_factory.mktemp("cordon")
        for number, team in enumerate(teams, start=1):
            team.save_tracks(path := folder / f"tracks-{number}.csv")
            states.append(f"true tracks: {path}")
        request.node.add_report_section("teardown", _MARK, "\n".join(states))


@pytest.fixture
def cordon_flight(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> "Iterator[CordonFlight]":
    """Return a function that flies a mission on stub vehicles to its end, and returns its `FlightResult`.

    Its arguments are those of `cordon.fly`, `speed` 10 at most unless given, and `commands`: `cordon.Commanded` by
    mission time. Team and ports are the test's own. When the test fails, log and report are kept, and named.
    """
    logs: list[Path] = []

    def fly(mission: "Mission | str | Path", commands: "Sequence[Commanded]" = (), **named: object) -> "FlightResult":
        from cordon.live_flight import flown_on_stubs  # noqa: PLC0415 - tests without flights do not pay for it

        logs.append(tmp_path_factory.mktemp("cordon") / "flight.mcap")
        return asyncio.run(flown_on_stubs(mission, commands, log=logs[-1], **{"speed": 10.0, **named}))

    yield fly
    if request.node.stash.get(_FAILED, False):
        request.node.add_report_section("teardown", _MARK, "\n".join(map(_reported, logs)))


def _reported(log: "Path") -> str:
    """Write the report of a log beside it; return a line that names both."""
    page = log.with_suffix(".html")
    command = [sys.executable, "-m", "cordon", "report", str(log), "--html", str(page)]
    subprocess.run(command, capture_output=True, check=False)
    return f"log: {log}" + (f", report: {page}" if page.exists() else "")


def _state(vehicle: "StubVehicle") -> str:
    from cordon import VehicleRefusedError  # noqa: PLC0415

    try:
        return str(vehicle.truth())
    except VehicleRefusedError as error:
        return error.clause
