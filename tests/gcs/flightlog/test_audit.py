"""The audit log: what makes an entry, and that no entry can be changed, moved or removed unseen."""

import hashlib
import json
import shutil
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
from foxglove import Context

from agents.inputs import Bus, Command, Message, Start
from agents.shell.clock import WallClock
from agents.team.messages import OperatorCommand
from estimation.state import Telemetry
from gcs.cli.log import audit
from gcs.errors import Exit
from gcs.flightlog.audit import AuditEntry, chain_fault
from gcs.flightlog.container import LogError
from gcs.flightlog.flight import Recording
from gcs.flightlog.reader import read_log
from gcs.flightlog.run import run_of
from gcs.flightlog.writer import LogWriter
from gcs.mission.file import load_mission
from tests.conftest import CONFIG
from tests.support.wire import until_now

pytestmark = pytest.mark.slow


def command(number: int, verb: str, time_s: float, name: str = "anna") -> OperatorCommand:
    return OperatorCommand(time_s, verb, None, name, number)  # type: ignore[arg-type]


def fly_commanded(recording: Recording) -> None:
    mission = load_mission("case2")
    recording.note_run(run_of(mission, (2,), seed=0, source="flight", speed=1.0, began_s=1.7e9, duration_s=10.0))
    core = recording.core(CONFIG)
    core.take(Start(0.0))
    for tick in range(12):
        now_s = 0.1 * tick
        core.take(Telemetry(now_s, (0.2 * now_s, 0.0, 8.0), (0.2, 0.0, 0.0)))
        if tick in (2, 3):  # repeated until it is answered
            core.take(Message(now_s, command(1, "hold", 0.2)))
        if tick == 5:
            core.take(Command(now_s, command(2, "resume", now_s, "bob")))
        if tick == 6:
            core.take(Message(now_s, command(3, "formation", now_s)))
        if tick == 7:
            core.take(Message(now_s, command(1, "kill", 1e3, "bob")))  # the number of another's command
        if tick == 8:
            for_another = msgspec.structs.replace(command(5, "land", now_s), vehicle=3)
            core.take(Message(now_s, for_another))
        core.take(Bus(alive=True, operated=True, revoked=("operator-anna",) if tick >= 9 else ()))
        core.tick(now_s)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Return the log of a vehicle that was commanded over the bus and by keyboard."""
    path = tmp_path / "log.mcap"
    with Recording(LogWriter(path, Context()), WallClock(1.0)) as recording:
        fly_commanded(recording)
    return path


def entries_of(path: Path) -> list[AuditEntry]:
    return [each.read(AuditEntry) for each in read_log(path).run_records if each.kind is AuditEntry]


def test_every_command_and_what_came_of_it_is_an_entry_once(log: Path) -> None:
    found = [(each.event, each.vehicle, each.source, each.key, each.command, each.did) for each in entries_of(log)]
    assert found == [
        ("received", 2, "bus", "command/hold/anna", 1, ""),
        ("answered", 2, "bus", "command/hold/anna", 1, "holds"),
        ("received", 2, "keyboard", "command/resume/bob", 2, ""),
        ("answered", 2, "keyboard", "command/resume/bob", 2, "resumes its mission"),
        ("received", 2, "bus", "command/formation/anna", 3, ""),
        ("answered", 2, "bus", "command/formation/anna", 3, found[5][5]),
        ("received", 2, "bus", "command/kill/bob", 1, ""),
        ("answered", 2, "bus", "command/kill/bob", 1, found[7][5]),
        ("revoked", 2, "bus", "roster", 0, "accepts nothing from operator-anna"),
        ("closed", 0, "", "", 0, ""),
    ]
    assert found[5][5].startswith("refused")
    assert "ahead of this vehicle's clock" in found[7][5]
    assert [each.operator for each in entries_of(log)] == ["anna"] * 2 + ["bob"] * 2 + ["anna"] * 2 + ["bob"] * 2 + [
        "",
        "",
    ]


def test_the_chain_is_of_plain_hashes_and_whole(log: Path) -> None:
    entries = entries_of(log)
    assert chain_fault(entries) == ""
    previous = ""
    for entry in entries:
        fields = msgspec.to_builtins(entry) | {"digest": ""}
        text = json.dumps(fields, separators=(",", ":"), ensure_ascii=False)
        assert entry.previous == previous
        previous = hashlib.sha256(text.encode()).hexdigest()
        assert entry.digest == previous
    assert audit(log) == Exit.HOLDS


def test_whatever_is_changed_is_found(log: Path, subtests: pytest.Subtests) -> None:
    entries = entries_of(log)
    changed: dict[str, list[AuditEntry]] = {
        f"{field} of entry {k}": [*entries[:k], msgspec.structs.replace(entry, **{field: other}), *entries[k + 1 :]]
        for k, entry in enumerate(entries)
        for field, other in {"time_s": 1.5, "operator": "eve", "did": "lands", "vehicle": 7, "command": 99}.items()
    }
    for k in range(len(entries)):
        changed[f"entry {k} removed"] = [*entries[:k], *entries[k + 1 :]]
        changed[f"cut off before entry {k}"] = entries[:k]
    changed["swapped"] = [entries[1], entries[0], *entries[2:]]
    changed["continued"] = [*entries, entries[-1]]
    for name, chain in changed.items():
        with subtests.test(name=name):
            assert chain_fault(chain) != ""


def test_a_log_that_was_not_closed_does_not_verify(tmp_path: Path) -> None:
    path, cut = tmp_path / "log.mcap", tmp_path / "cut.mcap"
    with Recording(LogWriter(path, Context()), WallClock(1.0)) as recording:
        fly_commanded(recording)

        def holds_entries() -> bool:
            shutil.copyfile(path, cut)
            with suppress(LogError):  # the first records are not written yet
                return len(entries_of(cut)) == 9
            return False

        until_now(holds_entries)  # it is flushed every second
    assert audit(cut) == Exit.VERDICT_FAILED
    assert audit(path) == Exit.HOLDS
