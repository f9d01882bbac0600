"""Missions as dictionaries with changed values, their TOML text, and their faults."""

import copy
import json
import re
import tomllib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from gcs.mission.file import MissionError, parse_mission
from gcs.mission.mission import Mission
from tests.support.paths import MISSIONS

Content = dict[str, Any]
Place = tuple[str | int, ...]

INSECURE = ("[target]\n", "[network.security]\ninsecure = true\n\n[target]\n")
"""A change of a mission: its bus is without keys, and any process may connect."""
LOW_M = 3.0
LOW = ("endpoint =", f"altitude_m = {LOW_M}\nendpoint =")
"""A change of a mission: all vehicles fly low, for short take-offs and landings."""
CASE2 = (MISSIONS / "case2.toml").read_text(encoding="utf-8")


def content(text: str = CASE2) -> Content:
    return tomllib.loads(text)


def toml(value: object) -> str:
    """Write a value as TOML, tables in line."""
    match value:
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)
        case list():
            return f"[{', '.join(map(toml, value))}]"
        case dict():
            return (
                "{" + ", ".join(f"{json.dumps(key, ensure_ascii=False)} = {toml(v)}" for key, v in value.items()) + "}"
            )
        case _:
            return json.dumps(value, ensure_ascii=False)


def text_of(mission: Content) -> str:
    return "\n".join(f"{json.dumps(key, ensure_ascii=False)} = {toml(value)}" for key, value in mission.items())


def with_first_vehicles(path: str, count: int) -> str:
    """Let a mission's file have its first vehicles only; return its path."""
    file = Path(path)
    mission = tomllib.loads(file.read_text(encoding="utf-8"))
    mission["vehicles"] = mission["vehicles"][:count]
    file.write_text(tomli_w.dumps(mission), encoding="utf-8")
    return path


def drawn_vehicle(random: np.random.Generator, slot: int, start_m: tuple[float, float], most_off: float) -> Content:
    """Draw a vehicle with the noisy stub's profile, whose true plant differs from it by up to a share."""
    a0, a1 = random.uniform(1.0 - most_off, 1.0 + most_off, 2).tolist()
    return {
        "id": slot + 1,
        "url": f"udpin://127.0.0.1:{14540 + slot}",
        "endpoint": f"tcp/127.0.0.1:{7461 + slot}",
        "profile": "stub-noisy",
        "true_scale": {"a0": a0, "a1": a1},
        "start_m": list(start_m),
    }


def put(mission: Content, path: Place, value: object) -> Content:
    """Return the mission with one value set, creating tables and lists on its path."""
    mission = copy.deepcopy(mission)
    node: Any = mission
    for key, following in pairwise(path):
        if isinstance(key, str):
            node = node.setdefault(key, [0.0, 0.0] if isinstance(following, int) else {})
        else:
            node = node[key]
    node[path[-1]] = value
    return mission


def drop(mission: Content, path: Place) -> Content:
    mission = copy.deepcopy(mission)
    node: Any = mission
    for key in path[:-1]:
        node = node[key]
    del node[path[-1]]
    return mission


def changed(changes: Mapping[Place, object]) -> Content:
    """Return case 2 with some values set."""
    mission = content()
    for path, value in changes.items():
        mission = put(mission, path, value)
    return mission


def shown(path: Place) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).removeprefix(".")


def parsed(mission: Content, folder: Path = MISSIONS) -> Mission:
    return parse_mission(text_of(mission), folder)


def faults(mission: Content | str, folder: Path = MISSIONS) -> list[str]:
    """Return the faults, each one line `path: fault` as shown to users."""
    text = mission if isinstance(mission, str) else text_of(mission)
    with pytest.raises(MissionError) as caught:
        parse_mission(text, folder)
    assert caught.value.faults
    for fault in caught.value.faults:
        assert re.fullmatch(r"(not TOML|[\w.\[\]-]+): \S.*", fault), fault
        assert not re.search(r"Section|Settings|dictionary|tuple|pydantic|Error", fault), (
            f"a programmer's words: {fault}"
        )
    return list(caught.value.faults)


def places(mission: Content | str, folder: Path = MISSIONS) -> list[str]:
    return sorted(fault.partition(": ")[0] for fault in faults(mission, folder))
