"""Inputs from outside, kept and changed ones: none ends in a traceback, hangs, or takes memory without bound."""

import time
from pathlib import Path

import pytest

from tests.support import fuzzing
from tests.support.fuzz_targets import TARGETS, target_named
from tests.support.fuzzing import CORPUS, Target, fault_of, faults_of

pytestmark = pytest.mark.slow

CORPUS_MAX_BYTES, KEPT_MAX_BYTES = 200_000, 8192


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_ends_in_a_traceback_or_hangs(name: str, tmp_path: Path) -> None:
    assert faults_of(target_named(name, tmp_path)) == []


def test_the_corpus_has_a_folder_for_each_target_and_is_small() -> None:
    assert {path.name for path in CORPUS.iterdir() if path.is_dir()} == set(TARGETS)
    sizes = {path: path.stat().st_size for path in CORPUS.glob("*/*")}
    assert [path for path, size in sizes.items() if size > KEPT_MAX_BYTES] == []
    assert sum(sizes.values()) < CORPUS_MAX_BYTES


def test_the_harness_notices_what_it_looks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzzing, "SECONDS_MAX", 0.2)
    monkeypatch.setattr(fuzzing, "WALL_SECONDS_MAX", 0.5)

    def read(data: bytes) -> object:
        while data == b"loops":
            pass
        if data == b"waits":
            time.sleep(10.0)
        if data == b"declared":
            raise ValueError
        return {b"": None}[data]

    target = Target("broken", [b""], read, (ValueError,), 100)
    assert "KeyError" in fault_of(target, b"x")
    assert fault_of(target, b"declared") == ""
    assert "took longer" in fault_of(target, b"loops")
    assert "took longer" in fault_of(target, b"waits")
    assert any("KeyError" in fault and "input: b" in fault for fault in faults_of(target))
