"""In CI no test is skipped for a missing right or tool, but those that fly an autopilot's firmware."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REQUIRED
from tests.support.paths import ROOT

SKIPPED = """
import pytest

@pytest.mark.{mark}
def test_what_needs_a_tool():
    pytest.skip("there is no such tool")
"""


@pytest.mark.parametrize(
    ("mark", "required", "outcome"),
    [
        ("wire", "", "1 skipped"),
        ("wire", "1", "there is no such tool (CORDON_REQUIRE_ALL is set)"),
        ("px4", "1", "1 skipped"),
    ],
)
def test_skipped_tests_fail_where_all_are_required(tmp_path: Path, mark: str, required: str, outcome: str) -> None:
    (tmp_path / "test_tool.py").write_text(SKIPPED.format(mark=mark), encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-p", "tests.conftest", "--rootdir", str(tmp_path), str(tmp_path)]
    environment = {**os.environ, REQUIRED: required, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert outcome in done.stdout
