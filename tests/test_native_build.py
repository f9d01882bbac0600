"""The compiled floors of the tick, as installations have them, against their sources: flights, bit for bit."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from native_build import no_compiler
from tests.support.installation import compiled, place
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow

FLIGHT = """
import hashlib, sys
from agents.control import encirclement
from estimation.filters import own
from gcs.flight.simulated import INPUTS
from gcs.flight.simulated import simulated_vehicles
from gcs.mission.file import load_mission
from sitl.simulation.simulation import NetworkModel, simulate

assert [module.__file__.endswith(".py") for module in (own, encirclement)] == [sys.argv[1] == "sources"] * 2
for name, duration_s in (("crossing", 20.0), ("case2-wander", 20.0), ("mixed-team", 20.0), ("shaped-trio", 20.0)):
    mission = load_mission(name)
    network = NetworkModel(mission.range_m, mission.network.delay_s, mission.network.loss)
    flown = simulate(
        simulated_vehicles(mission, 0), network, rate_hz=mission.mission.rate_hz, duration_s=duration_s, seed=0,
        inputs=INPUTS,
        observe=lambda *_: None, progress=lambda _: None,
    )
    print(name, hashlib.sha256(flown.motion.tobytes()).hexdigest())
"""

both_builds = pytest.mark.skipif(not compiled(place()), reason="what is tested is not compiled")


@both_builds
def test_compiled_modules_fly_as_their_sources_do() -> None:
    assert run(place(), "-c", FLIGHT, "compiled") == run(ROOT, "-c", FLIGHT, "sources")


@both_builds
def test_the_sources_replay_a_log_of_compiled_modules(tmp_path: Path) -> None:
    assert run(place(), "-m", "gcs", "--version").endswith("(compiled)\n")
    log = str(tmp_path / "log.mcap")
    run(place(), "-m", "gcs", "sim", "crossing", "--duration", "15", "--log", log, exits=(0, 1))
    replayed = json.loads(run(ROOT, "-m", "gcs", "replay", log, "--json"))  # exit code 0: every decision is the same
    assert replayed["tolerance"] is None, "compared bit for bit"


def test_a_compiler_that_is_missing_or_compiles_nothing_is_named(
    monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    for command in ("no-such-compiler", "false", "true -q"):
        with subtests.test(command=command):
            monkeypatch.setenv("CC", command)
            assert command in no_compiler()


def run(packages: Path, *arguments: str, exits: Sequence[int] = (0,)) -> str:
    """Run Python with the packages in a folder, and return what it prints."""
    environment = {**os.environ, "PYTHONPATH": str(packages)}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, env=environment, check=False, capture_output=True, text=True)
    assert done.returncode in exits, done.stderr
    return done.stdout
