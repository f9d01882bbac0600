"""A report says of how the flight ended what the flight said, before any verdict, and its exit code follows that."""

from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from agents.flight_end import FlightEnd, LastPosition
from estimation.state import Telemetry
from gcs.cli.report import ReportOptions, report
from gcs.console.summary import summary as terminal_summary
from gcs.console.summary import verdict_of
from gcs.errors import Exit
from gcs.flightlog.reader import FlightLog, LogRecord, read_log
from gcs.flightlog.records import VehicleEnd
from gcs.metrics.catalogue import Verdicts
from gcs.metrics.ending import TeamEnding
from gcs.metrics.result import FlightResult
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.evidence.reading import read_flight
from gcs.report.flight_page import report_html
from gcs.report.summary import headline
from tests.support.flight_logs import engaging, record_simulation, rewrite
from tests.support.page.station_pictures import ring_flight
from tests.support.report_evidence import flown

pytestmark = pytest.mark.slow

KILLED = TeamEnding(FlightEnd.KILLED, "Vehicle 2: an operator had its motors cut.", (2,))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> FlightLog:
    path = tmp_path_factory.mktemp("logs") / "flight.mcap"
    record_simulation(engaging(), path, duration_s=10.0)
    return read_log(path)


def ended(log: FlightLog) -> TeamEnding | None:
    return TeamEnding.of(read_flight([log]).evidence.record.endings)


def replaced(how: str, reason: str) -> Callable[[LogRecord], object]:
    """Return a change of a vehicle's records: its flight ended otherwise."""

    def change(record: LogRecord) -> object:
        read = record.read(record.kind)
        return msgspec.structs.replace(read, how=how, reason=reason) if isinstance(read, VehicleEnd) else read

    return change


def without(kind: type[object]) -> Callable[[LogRecord], object]:
    return lambda record: None if record.kind is kind else record.read(record.kind)


def test_what_the_flight_said_of_its_end_is_in_its_log(log: FlightLog, tmp_path: Path) -> None:
    whole = ended(log)
    assert whole is not None
    assert (whole.how, whole.vehicles) == (FlightEnd.SIMULATED, (1, 2, 3))
    killed = ended(rewrite(log, tmp_path / "killed.mcap", 2, replaced("killed", "its motors were cut")))
    assert killed is not None
    assert (killed.how, killed.vehicles) == (FlightEnd.KILLED, (2,))
    assert killed.reason.startswith("Vehicle 2: its motors were cut; vehicles 1 and 3: ")
    assert report([tmp_path / "killed.mcap"], options=ReportOptions()) is Exit.ENDED_IN_FLIGHT


def test_where_a_vehicle_was_last_that_was_unaccounted_for_comes_first(log: FlightLog, tmp_path: Path) -> None:
    """In the terminal and on the page, also of a flight whose verdicts all hold."""

    def change(record: LogRecord) -> object:
        read, last = record.read(record.kind), LastPosition((3.0, -4.0, 8.5), 35.0)
        is_end = isinstance(read, VehicleEnd)
        return msgspec.structs.replace(read, how="lost", unaccounted=last) if is_end else read

    lost = ended(rewrite(log, tmp_path / "lost.mcap", 2, change))
    assert lost is not None
    assert (lost.how, lost.vehicles, lost.unaccounted[0].vehicle) == (FlightEnd.LOST, (2,), 2)
    terminal, page = shown(all_held(lost))
    for text in (terminal, page):
        line = lost.unaccounted[0].line
        assert "height 8.5 m" in line
        assert text.index(line) < text.index(lost.headline)
    assert page.index(lost.headline) < page.index("all verdicts pass")
    assert "All verdicts pass" not in page


def test_a_log_that_does_not_say_how_a_vehicle_ended_ends_in_flight(log: FlightLog, tmp_path: Path) -> None:
    cut = ended(rewrite(log, tmp_path / "cut.mcap", 3, without(VehicleEnd)))
    assert cut is not None
    assert (cut.how, cut.vehicles) == (FlightEnd.IN_FLIGHT, (3,))
    assert cut.headline == "The log ends in flight: vehicle 3"
    assert "10.0 s after the mission's start" in cut.reason
    (lost,) = cut.unaccounted
    *_, last = log.of_kind(3, Telemetry)
    assert (lost.vehicle, lost.position_m) == (3, last.position_m)
    assert lost.age_s == pytest.approx(0.0, abs=0.2)
    assert report([tmp_path / "cut.mcap"], options=ReportOptions()) is Exit.ENDED_IN_FLIGHT


def all_held(ending: TeamEnding | None) -> FlightResult:
    _, result, _ = flown(3, duration_s=60.0, rate_hz=5.0)
    return replace(result, verdicts=Verdicts(True, True, True, True, True, True, True), ended=ending)


def shown(result: FlightResult) -> tuple[str, str]:
    """Return what the terminal and the page show of a result."""
    terminal = StringIO()
    Console(file=terminal, width=200).print(terminal_summary(result))
    evidence, _, criteria = flown(3, duration_s=60.0, rate_hz=5.0)
    undrawn = FlightEvidence(replace(evidence.record, vehicles=()), ())
    return terminal.getvalue(), report_html(undrawn, result, criteria, ring_flight(2.0))


def test_the_verdicts_never_head_a_flight_that_ended_in_a_kill() -> None:
    result = all_held(KILLED)
    assert headline(result) == "Until then: all verdicts pass"
    console = Console(file=StringIO(), width=100)
    console.print(terminal_summary(result))
    assert isinstance(console.file, StringIO)
    lines = console.file.getvalue().splitlines()
    assert lines[0].rstrip() == "✗ Killed by the operator: vehicle 2"
    assert lines[1].rstrip() == KILLED.reason


def test_one_that_joined_and_still_flies_is_named_although_the_flight_ended_as_planned() -> None:
    sentence = "Vehicle 1: landed and disarmed; vehicle 4: joined this flight and still flies."
    result = all_held(TeamEnding(FlightEnd.LANDED, sentence, (1,), still_flying=(4,)))
    for text in shown(result):
        assert sentence in text
    assert verdict_of(result) is Exit.HOLDS


def test_the_exit_code_follows_how_it_ended(subtests: pytest.Subtests) -> None:
    for how in FlightEnd:
        with subtests.test(how=how):
            early = how not in (FlightEnd.LANDED, FlightEnd.SIMULATED, FlightEnd.FLIES_ON)
            held = verdict_of(all_held(TeamEnding(how, "Why.", (1,))))
            assert held is (Exit.ENDED_IN_FLIGHT if early else Exit.HOLDS)
    assert verdict_of(all_held(None)) is Exit.HOLDS
    failed = replace(all_held(None), verdicts=Verdicts(False, None, None, None, None))
    assert verdict_of(failed) is Exit.VERDICT_FAILED
