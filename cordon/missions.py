"""Missions, loaded by name or from a file."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from gcs.mission.file import load_mission
from gcs.mission.mission import Mission


def load(mission: str | Path, overrides: Mapping[str, object] = MappingProxyType({})) -> Mission:
    """Return a bundled mission by its name, or a mission from a file.

    `overrides` replace values of the file, by their paths. `Mission.replace` does the same for a loaded mission. Keys
    are described in docs/mission-keys.md; their names end with the unit. Raises InputError with every fault.

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
