"""Inputs from outside, mutated: none ends in a traceback, hangs, or takes memory without bound."""

from pathlib import Path

from tests.support.fuzzing import MEMORY_MAX_BYTES, Target, fault_of, run, targets

COUNT = 10_000


def test_no_mutated_input_ends_in_a_traceback_or_hangs(tmp_path: Path) -> None:
    findings = run(targets(tmp_path), COUNT, seed=17)
    assert findings.faults == []
    assert sum(findings.counts.values()) == COUNT
    assert findings.memory_bytes < MEMORY_MAX_BYTES


def test_the_harness_notices_what_it_looks_for(tmp_path: Path) -> None:
    def read(data: bytes) -> object:
        if data == b"declared":
            raise ValueError
        return {b"": None}[data]

    target = Target("broken", [b"x"], read, 1.0, (ValueError,))
    assert "KeyError" in fault_of(target, b"x")
    assert fault_of(target, b"declared") == ""
