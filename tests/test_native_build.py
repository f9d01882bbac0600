"""The compiled floors of the tick, as installations have them, against their sources: flights, bit for bit."""

import ast
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from native_build import COMPILED, compiled_copy, native_source, no_compiler
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow

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


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a compiled copy; without optimisation, as that takes a third of the time."""
    if missing := no_compiler():
        pytest.skip(missing)
    directory = tmp_path_factory.mktemp("compiled")
    compiled_copy(ROOT, directory, level=0)
    return directory


@pytest.mark.timeout(900)
def test_compiled_modules_fly_as_their_sources_do(compiled: Path) -> None:
    assert run(compiled, "-c", FLIGHT, "compiled") == run(ROOT, "-c", FLIGHT, "sources")


@pytest.mark.timeout(900)
def test_the_sources_replay_a_log_of_compiled_modules(compiled: Path, tmp_path: Path) -> None:
    assert run(compiled, "-m", "gcs", "--version").endswith("(compiled)\n")
    log = str(tmp_path / "log.mcap")
    run(compiled, "-m", "gcs", "sim", "crossing", "--duration", "30", "--log", log, exits=(0, 1))
    replayed = json.loads(run(ROOT, "-m", "gcs", "replay", log, "--json"))  # exit code 0: every decision is the same
    assert replayed["tolerance"] is None, "compared bit for bit"


def test_a_compiler_that_is_missing_or_compiles_nothing_is_named(
    monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    for command in ("no-such-compiler", "false", "true -q"):
        with subtests.test(command=command):
            monkeypatch.setenv("CC", command)
            assert command in no_compiler()


def run(first: Path, *arguments: str, exits: Sequence[int] = (0,)) -> str:
    """Run Python with the modules that are found first in a folder, and return what it prints."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(first), str(ROOT))), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=ROOT, env=environment, check=False, capture_output=True, text=True)
    assert done.returncode in exits, done.stderr
    return done.stdout
