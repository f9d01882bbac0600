"""The compiled floors of the tick against their sources: one flight, bit for bit."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from native_build import COMPILED, compiled_copy, native_source
from tests.support.paths import ROOT

FLIGHT = """
import hashlib, sys
from agents.control import encirclement
from estimation.filters import own
from gcs.flight.simulated import simulated_vehicles
from gcs.mission.file import load_mission
from sitl.simulation.simulation import NetworkModel, simulate

assert [module.__file__.endswith(".py") for module in (own, encirclement)] == [sys.argv[1] == "sources"] * 2
for name, duration_s in (("crossing", 30.0), ("case2-wander", 60.0), ("mixed-team", 60.0)):
    mission = load_mission(f"gcs/mission/missions/{name}.toml")
    network = NetworkModel(mission.network.range_m, mission.network.delay_s, mission.network.loss)
    flown = simulate(
        simulated_vehicles(mission, 0), network, rate_hz=mission.mission.rate_hz, duration_s=duration_s, seed=0,
        observe=lambda *_: None, progress=lambda _: None,
    )
    print(name, hashlib.sha256(flown.motion.tobytes()).hexdigest())
"""
STRUCT = '''class Place(msgspec.Struct, frozen=True):
    """A place."""

    x_m: float
    near: bool = False

    @property
    def doubled_m(self) -> float:
        return 2.0 * self.x_m
'''


def test_a_plain_class_in_place_of_a_struct_has_its_members_and_lines() -> None:
    native = native_source(STRUCT)
    names: dict[str, type] = {}
    exec(native, names)
    place = names["Place"]
    assert place(3.0).doubled_m == 6.0
    assert place(3.0) == place(x_m=3.0, near=False) != place(4.0)
    assert repr(place(3.0)) == "Place(x_m=3.0, near=False)"
    assert native.splitlines()[6:] == STRUCT.splitlines()[6:]


def test_no_struct_is_left_but_those_that_are_to_stay() -> None:
    left = []
    for name in COMPILED:
        path = ROOT / name
        for file in [path] if path.is_file() else path.glob("*.py"):
            native = ast.parse(native_source(file.read_text()))
            left += [
                node.name for node in native.body if isinstance(node, ast.ClassDef) and "Struct" in ast.unparse(node)
            ]
    assert left == ["_Track"]


@pytest.mark.skipif(not os.environ.get("CORDON_COMPILE"), reason="compiles where CORDON_COMPILE is set")
@pytest.mark.timeout(900)
def test_compiled_modules_fly_as_their_sources_do(tmp_path: Path) -> None:
    compiled_copy(ROOT, tmp_path, level=0)
    assert flown("compiled", tmp_path) == flown("sources", ROOT)


def flown(what: str, first: Path) -> str:
    """Return the digests of flights with the modules that are found first in a folder."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(first), str(ROOT))), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-c", FLIGHT, what]
    return subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True).stdout
