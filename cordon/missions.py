"""Missions: from a name or a file to what can be flown."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from gcs.mission.file import load_mission
from gcs.mission.mission import Mission


def load(mission: str | Path, overrides: Mapping[str, object] = MappingProxyType({})) -> Mission:
    """Return a mission: a bundled one by its name, or a file.

    `overrides` are values in place of those in the file, by their places. `Mission.replace` does the same section by
    section afterwards. Keys stand in docs/missions.md; each has its unit at the end of its name. Raises InputError with
    every fault: what cannot be read, and values that do not hold.

    >>> mission = load("case2", {"encirclement.radius_m": 12.0, "vehicles[0].altitude_m": 9.0})
    >>> mission.encirclement.radius_m, mission.vehicle(1).section.altitude_m
    (12.0, 9.0)
    >>> mission.replace(target={"velocity_m_s": (0.0, 0.2)}, vehicles={2: {"altitude_m": 7.0}}).target.velocity_m_s
    (0.0, 0.2)
    >>> load("case2", {"encirclement.radius": 12.0})
    Traceback (most recent call last):
    ...
    gcs.mission.file.MissionError: encirclement.radius: unknown key; did you mean 'radius_m'? [set, not in the file]
    """
    loaded = load_mission(str(mission), overrides)
    for words in loaded.warnings:
        warnings.warn(words, FutureWarning, stacklevel=2)
    return loaded
