"""Paths of the project that tests read, and how programs beside the tests are started."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
DOCS = ROOT / "docs"
MISSIONS = ROOT / "gcs" / "mission" / "missions"
PROFILES = ROOT / "estimation" / "profile" / "profiles"


def finds_tests() -> dict[str, str]:
    """Return the environment of `python -m tests...` in `ROOT`, where Python finds the tests."""
    return {**os.environ, "PYTHONSAFEPATH": ""}
