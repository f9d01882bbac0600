"""Paths of the project that tests read."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
DOCS = ROOT / "docs"
MISSIONS = ROOT / "gcs" / "mission" / "missions"
PROFILES = ROOT / "estimation" / "profile" / "profiles"
