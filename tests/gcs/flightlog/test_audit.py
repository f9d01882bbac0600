"""The audit log: what makes an entry, and that no entry can be changed, moved or removed unseen."""

import hashlib
import json
import shutil
from collections.abc import Sequence
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
from gcs.flightlog.audit import AuditedLog, AuditEntry, AuditHead, chain_fault, rewritten, sealed, unwitnessed
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
    assert audit([log]) == Exit.HOLDS


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
    assert audit([cut]) == Exit.VERDICT_FAILED
    assert audit([path]) == Exit.HOLDS


def chain(*texts: str, heads: tuple[AuditEntry, ...] = ()) -> tuple[AuditEntry, ...]:
    """Return a closed chain of entries."""
    answers = [AuditEntry(1.0, "answered", 1, "bus", "anna", "command/hold/anna", 1, each, "", "") for each in texts]
    entries, previous = list[AuditEntry](), ""
    for each in (*answers, *heads, AuditEntry(9.0, "closed", 0, "", "", "", 0, "", "", "")):
        entries.append(sealed(each, previous))
        previous = entries[-1].digest
    return tuple(entries)


def head_of(vehicle: int, entries: Sequence[AuditEntry], length: int) -> AuditEntry:
    digest = entries[length - 1].digest
    return AuditEntry(5.0, "head", vehicle, "bus", f"vehicle-{vehicle}", f"head/{vehicle}", length, digest, "", "")


def audited(name: str, vehicles: list[int], entries: Sequence[AuditEntry]) -> AuditedLog:
    return AuditedLog(name, vehicles, entries, [each for each in entries if each.event == "head"])


def test_a_log_that_was_rewritten_as_a_whole_is_not_the_one_whose_heads_others_hold(subtests: pytest.Subtests) -> None:
    first = chain("holds", "refused: not allowed", "lands")
    witness = audited("b.mcap", [2], chain("holds", heads=(head_of(1, first, 1), head_of(1, first, 3))))
    altered = {
        "an entry changed": (chain("holds", "obeyed", "lands"), "1"),
        "the first entry changed": (chain("lands", "refused: not allowed", "lands"), "0"),
        "an entry removed": (chain("holds", "refused: not allowed"), "1"),
        "all entries removed": (chain(), "0"),
    }
    assert not list(rewritten([audited("a.mcap", [1], first), witness]))
    for name, (entries, fits) in altered.items():
        with subtests.test(name=name):
            assert chain_fault(entries) == ""
            (fault,) = rewritten([audited("a.mcap", [1], entries), witness])
            assert fault.startswith(
                f"a.mcap: rewritten after its entry {fits}: b.mcap holds the head that vehicle 1 sent"
            )
    with subtests.test(name="the witness rewritten"):
        witnessed = (head_of(2, witness.entries, 3),)
        third = audited("c.mcap", [3], chain(heads=witnessed))
        accusing = audited("b.mcap", [2], chain("holds", heads=(head_of(1, chain("forged"), 1),)))
        faults = list(rewritten([audited("a.mcap", [1], first), accusing, third]))
        assert [each.partition(":")[0] for each in faults] == ["a.mcap", "b.mcap"]


def test_heads_of_a_process_that_was_started_again_are_in_one_of_its_logs() -> None:
    before, after = chain("holds"), chain("resumes", "lands")
    witness = audited("b.mcap", [2], chain(heads=(head_of(1, before, 1), head_of(1, after, 2))))
    logs = [audited("a1.mcap", [1], before), audited("a2.mcap", [1], after), witness]
    assert not list(rewritten(logs))
    assert len(list(rewritten(logs[1:]))) == 1
    assert not unwitnessed(logs)
    assert unwitnessed([witness]) == [1]


def test_the_command_compares_logs_with_the_heads_in_others(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries, witness, forged = entries_of(log), tmp_path / "b.mcap", tmp_path / "forged.mcap"
    mission = load_mission("case2")
    with Recording(LogWriter(witness, Context()), WallClock(1.0)) as recording:
        recording.note_run(run_of(mission, (3,), seed=0, source="flight", speed=1.0, began_s=1.7e9, duration_s=10.0))
        recording.note_run(head_of(2, entries, 4))
    with Recording(LogWriter(forged, Context()), WallClock(1.0)) as recording:
        recording.note_run(run_of(mission, (2,), seed=0, source="flight", speed=1.0, began_s=1.7e9, duration_s=10.0))
        for entry in entries[2:-1]:
            recording.note_run(entry)
    assert audit([forged]) == Exit.HOLDS, "by itself it is whole"
    assert audit([log, witness]) == Exit.HOLDS
    capsys.readouterr()
    assert audit([forged, witness]) == Exit.VERDICT_FAILED
    told = capsys.readouterr().err
    assert f"{forged}: rewritten after its entry 0: {witness} holds the head that vehicle 2 sent of 4 entries" in told
    assert audit([witness]) == Exit.HOLDS


def test_the_head_is_that_of_the_entries_on_disk(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with Recording(LogWriter(path, Context()), WallClock(1.0)) as recording:
        fly_commanded(recording)
        until_now(lambda: recording.head is not None and recording.head.entries == 9)
        head = recording.head
    assert head is not None
    assert head == AuditHead(0, head.time_s, 9, entries_of(path)[8].digest)
