"""The mission of a drill: the given one, with stub vehicles on free ports, and the target in range."""

import os
import socket
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from math import sqrt
from typing import Any

import tomli_w

from estimation.input_file import toml_content
from gcs.errors import InputError
from gcs.mission.file import load_mission, parse_mission
from gcs.mission.mission import Mission

_LOOPBACK = "127.0.0.1"
_Content = dict[str, Any]


def drill_mission(name: str, changes: Sequence[tuple[str, str, object]] = ()) -> str:
    """Return the text of the mission to fly; raises MissionError.

    `changes` are (section, key, value). The target starts near enough for vehicles to encircle it at once, which saves
    the wait for the ring; if the mission forbids that, its start is not changed.
    """
    mission = load_mission(name)
    content = toml_content(mission.text)
    _move_apart(content)
    for section, key, value in changes:
        content.setdefault(section, {})[key] = value
    near = {**content, "target": {**content["target"], "start_m": _near_m(mission)}}
    try:
        parse_mission(tomli_w.dumps(near), None, mission.profile_texts)
    except InputError:
        return tomli_w.dumps(content)
    return tomli_w.dumps(near)


def _near_m(mission: Mission) -> list[float]:
    """Return the farthest position straight ahead at which the whole line engages."""
    leader = mission.vehicle(mission.formation.leader)
    config = mission.agent_config(leader)
    reach_m = min(mission.target.sensor.range_m, *(each.decision.distance_max_m for each in mission.vehicles))
    width_m = max(abs(config.slot_offset_m(each, leader.id)[1]) for each in mission.ids)
    if reach_m <= width_m:
        return list(mission.target.start_m)
    x, y = config.line_start_m
    return [x + sqrt(reach_m**2 - width_m**2), y]


def profiles_of(name: str) -> Mapping[str, str]:
    """Return the texts of a mission's profiles by name; raises MissionError."""
    return load_mission(name).profile_texts


def _move_apart(content: _Content) -> None:
    """Set free ports for every vehicle, and a unique team name."""
    vehicles = content["vehicles"]
    ports = iter(_free_ports(2 * len(vehicles)))
    for vehicle in vehicles:
        vehicle["url"] = f"udpin://{_LOOPBACK}:{next(ports)}"
        vehicle["endpoint"] = f"tcp/{_LOOPBACK}:{next(ports)}"
    network = content.setdefault("network", {})
    network.pop("security", None)  # cordon creates the keys of flights on one computer
    network["team"] = f"drill-{os.getpid()}"


def _free_ports(count: int) -> list[int]:
    """Return ports that are free for both UDP and TCP."""
    ports: list[int] = []
    with ExitStack() as taken:
        while len(ports) < count:
            tcp = taken.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            udp = taken.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            tcp.bind((_LOOPBACK, 0))
            try:
                udp.bind(tcp.getsockname())
            except OSError:
                continue
            ports.append(tcp.getsockname()[1])
    return ports
