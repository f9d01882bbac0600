"""The examples of sweeps fly as they stand, with fewer runs."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import DOCS
from tests.support.wire import PATIENCE_S

pytestmark = pytest.mark.slow

EXAMPLES = DOCS / "examples"


def printed(program: Path, *arguments: str) -> list[list[str]]:
    """Run a program and return the words of each line that it prints."""
    command = [sys.executable, "-W", "error", str(program), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    return [line.split() for line in done.stdout.splitlines()]


def test_the_study_of_member_loss_has_twenty_lines_at_most(tmp_path: Path) -> None:
    text = (EXAMPLES / "member_loss.py").read_text(encoding="utf-8")
    (described, *_) = ast.parse(text).body
    assert sum(bool(line.strip()) for line in text.splitlines()[described.end_lineno :]) <= 20
    (tmp_path / "few.py").write_text(text.replace("runs=200", "runs=4"), encoding="utf-8")
    head, *rows = printed(tmp_path / "few.py")
    assert head == ["draw.lost", "runs", "pass", "failed", "closest_approach_m", "even_again_s"]
    assert sum(int(row[1]) for row in rows) == 4
    assert [row[3] for row in rows] == len(rows) * ["0"]
    assert all(2.0 < float(row[4]) < 9.0 for row in rows), "closest distance on a ring of 10 m"


def test_tuned_weights_are_compared_with_the_defaults() -> None:
    lines = printed(EXAMPLES / "tune_weights.py", "--trials", "2", "--first", "1", "--plants", "2", "--fresh", "1")
    assert lines[0][:2] == ["2", "trials,"]
    assert [line[0] for line in lines[2:]] == ["defaults", "least", "balanced", "calmest"]
    assert {"rate_weight", "10,", "spacing_weight", "24,"} <= {*lines[2]}
