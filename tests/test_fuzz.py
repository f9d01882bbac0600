"""Inputs from outside, mutated: none ends in a traceback, hangs, or takes memory without bound."""

import time
from pathlib import Path

import pytest

from tests.support import fuzzing
from tests.support.fuzzing import MEMORY_MAX_BYTES, Target, fault_of, run, targets

pytestmark = pytest.mark.slow

COUNT = 4_000


def test_no_mutated_input_ends_in_a_traceback_or_hangs(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    fuzzed = targets(tmp_path)
    capfd.readouterr()
    findings = run(fuzzed, COUNT, seed=17)
    assert findings.faults == []
    assert capfd.readouterr() == ("", ""), "nothing is printed either, be it by the libraries' C code"
    assert sum(findings.counts.values()) == COUNT
    assert findings.memory_bytes < MEMORY_MAX_BYTES


def test_the_harness_notices_what_it_looks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzzing, "LIMIT_S", 0.2)
    monkeypatch.setattr(fuzzing, "WALL_LIMIT_S", 0.5)

    def read(data: bytes) -> object:
        while data == b"loops":
            pass
        if data == b"waits":
            time.sleep(10.0)
        if data == b"declared":
            raise ValueError
        return {b"": None}[data]

    target = Target("broken", [b"x"], read, 1.0, (ValueError,))
    assert "KeyError" in fault_of(target, b"x")
    assert fault_of(target, b"declared") == ""
    assert "took longer" in fault_of(target, b"loops")
    assert "took longer" in fault_of(target, b"waits")
