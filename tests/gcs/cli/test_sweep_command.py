"""`cordon sweep` as processes that are killed, interrupted and started again, here and on a Dask cluster."""

import json
import os
import runpy
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

import psutil
import pytest

import cordon
from agents.control.plan import PlannerFactory
from gcs.errors import Exit
from gcs.link.ports import free_ports
from tests.conftest import RunHere
from tests.support.paths import DOCS, MISSIONS
from tests.support.result_keys import OUTPUT_KEYS
from tests.support.wire import PATIENCE_S, until_now

pytestmark = pytest.mark.slow

RUNS = 12
FLIGHT = ("case2", "--vary", "encirclement.radius_m=8:12:2", "--seeds", "0:6", "--duration", "40")
FLOWN = Exit.VERDICT_FAILED
"""These flights end before a vehicle could engage: they are not judged."""
MIDDLE = 4
PLANNERS = DOCS / "examples" / "planners"
ENVIRONMENT = {**os.environ, "NO_COLOR": "1", "TERM": "dumb", "COLUMNS": "200"}


def environment_of(path: object) -> dict[str, str]:
    """Return the environment of a process that finds planners in a folder."""
    return {**ENVIRONMENT, "PYTHONPATH": os.pathsep.join(filter(None, (str(path), ENVIRONMENT.get("PYTHONPATH"))))}


def start(*arguments: str, path: object = "") -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "gcs", "sweep", *arguments]
    environment = environment_of(path) if path else ENVIRONMENT
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def ended(process: "subprocess.Popen[str]") -> tuple[Exit, str, str]:
    """Return exit code, standard output and standard error of a process, however long a busy computer flies."""
    out, err = process.communicate()
    assert "Traceback" not in err, err
    return Exit(process.returncode), out, err


def finished(folder: Path) -> int:
    journal = folder / "runs.jsonl"
    return journal.read_bytes().count(b"\n") if journal.exists() else 0


@contextmanager
def in_the_middle(folder: Path, *arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """Start the sweep, and yield when it has flown some of its runs; it is not left running."""
    process = start(*FLIGHT, *arguments, "--out", str(folder))
    try:
        until_now(lambda: finished(folder) >= MIDDLE)
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the table of the sweep flown in one go, by one worker."""
    folder = tmp_path_factory.mktemp("one-go")
    code, out, _ = ended(start(*FLIGHT, "--workers", "1", "--json", "--out", str(folder)))
    summary = json.loads(out)
    assert (code, summary["runs"], summary["finished"]) == (FLOWN, RUNS, RUNS)
    assert (summary["hold"], summary["not_judged"]) == (0, RUNS)
    return (folder / "runs.parquet").read_bytes()


def assert_goes_on(folder: Path, table: bytes) -> None:
    """Assert that the same command flies what is missing, and only that, to the same table."""
    before = finished(folder)
    assert ended(start(*FLIGHT, "--out", str(folder)))[0] is FLOWN
    assert (folder / "runs.parquet").read_bytes() == table
    assert before < RUNS == finished(folder)


def test_a_sweep_that_is_killed_goes_on_to_the_same_table(tmp_path: Path, table: bytes) -> None:
    with in_the_middle(tmp_path, "--workers", "2") as process:
        family = psutil.Process(process.pid).children(recursive=True)
        process.kill()
        _, alive = psutil.wait_procs(family, timeout=PATIENCE_S)
        assert len(family) >= 3, "two workers, and what starts them"
        assert alive == [], "workers outlive their sweep"
    with (tmp_path / "runs.jsonl").open("a") as journal:
        journal.write('{"run":11,"row":{"ho')
    assert_goes_on(tmp_path, table)


def test_ctrl_c_ends_it_with_what_goes_on(tmp_path: Path, table: bytes) -> None:
    with in_the_middle(tmp_path, "--json") as process:
        process.send_signal(signal.SIGINT)
        code, out, err = ended(process)
    assert code is Exit.ENDED_IN_FLIGHT
    assert json.loads(out)["finished"] == finished(tmp_path)
    assert shlex.join(["cordon", "sweep", *FLIGHT, "--json", "--out", str(tmp_path)]) in err
    assert not (tmp_path / "runs.parquet").exists()
    assert_goes_on(tmp_path, table)


def holds_ctrl_c_back(process_id: int) -> bool:
    """Return whether a process has started those of multiprocessing, which lets signals pass, and blocks them again."""
    status = Path(f"/proc/{process_id}/status").read_text(encoding="utf-8")
    blocked = int(status.partition("SigBlk:")[2].split()[0], 16)
    return len(psutil.Process(process_id).children()) > 1 and bool(blocked >> signal.SIGINT - 1 & 1)


@pytest.mark.skipif(sys.platform != "linux", reason="it reads /proc")
def test_ctrl_c_ends_it_while_it_checks_its_missions(tmp_path: Path) -> None:
    many = ("--vary", "encirclement.radius_m=8:12:0.01", "--vary", "safety.separation_m=1:3:0.005")
    process = start("case2", *many, "--workers", "1", "--out", str(tmp_path / "swept"))
    try:
        until_now(lambda: holds_ctrl_c_back(process.pid))
        process.send_signal(signal.SIGINT)
        assert ended(process)[0] is Exit.REFUSED
        assert not (tmp_path / "swept").exists()
    finally:
        process.kill()
        process.wait()


def test_a_signal_ends_it_although_a_worker_hangs(tmp_path: Path) -> None:
    with in_the_middle(tmp_path, "--workers", "2") as process:
        workers = [each for each in psutil.Process(process.pid).children(recursive=True) if each.ppid() != process.pid]
        try:
            workers[0].suspend()
            process.send_signal(signal.SIGTERM)
            assert ended(process)[0] is Exit.ENDED_IN_FLIGHT
        finally:
            for each in workers:
                with suppress(psutil.NoSuchProcess):
                    each.kill()


@contextmanager
def dask(*arguments: str, path: str = "") -> Iterator["subprocess.Popen[str]"]:
    """Start a scheduler or a worker; `path` is the folder of a worker's planners."""
    command = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:], "--no-dashboard"]
    environment = environment_of(path) if path else ENVIRONMENT
    process = subprocess.Popen(command, text=True, env=environment, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.wire
@pytest.mark.long
def test_on_a_cluster_a_killed_worker_changes_nothing(tmp_path: Path, table: bytes) -> None:
    pytest.importorskip("distributed")
    scheduler = f"tcp://127.0.0.1:{free_ports(1)[0]}"
    worker = ("worker", scheduler, "--nthreads", "1", "--no-nanny")
    with (
        dask("scheduler", "--host", "127.0.0.1", "--port", scheduler.rpartition(":")[2]),
        dask(*worker) as first,
        dask(*worker),
        in_the_middle(tmp_path, "--scheduler", scheduler) as process,
    ):
        first.kill()
        assert ended(process)[0] is FLOWN
    assert (tmp_path / "runs.parquet").read_bytes() == table
    assert finished(tmp_path) == RUNS


PLANNER = "cyclic_pursuit:CyclicPursuit"
COMPARED = ("case2-field", "--set", "target.start_m=[8.0, -5.0]", "--vary", f"mission.planner=cordon,{PLANNER}")


def test_planners_are_compared_in_a_table_and_a_figure(tmp_path: Path, run_here: RunHere) -> None:
    pandas = pytest.importorskip("pandas")
    folder = tmp_path / "results"
    given = (*COMPARED, "--vary", "encirclement.radius_m=8,10", "--duration", "25", "--out", str(folder))
    assert ended(start(*given, path=PLANNERS))[0] is Exit.BAD_INPUT
    assert not folder.exists()
    assert ended(start(*given, "--allow-plugins", path=PLANNERS))[0] is FLOWN
    table = pandas.read_parquet(folder / "runs.parquet")
    assert [*table["mission.planner"]] == ["cordon", "cordon", PLANNER, PLANNER]
    flown = cordon.simulate(
        cordon.load("case2-field", {"target.start_m": [8.0, -5.0], "encirclement.radius_m": 10}),
        duration_s=25.0,
        planner=class_of(PLANNERS / "cyclic_pursuit.py", "CyclicPursuit"),
    )
    assert table["closest_approach_m"][3] == flown.metrics.closest_approach_m != table["closest_approach_m"][1]
    figure = tmp_path / "sweep.svg"
    assert run_here("sweep", "plot", str(folder), "--out", str(figure)).code == Exit.HOLDS
    for name in ("cordon", PLANNER):
        assert f"<!-- median: {name} -->" in figure.read_text(), "each has a colour of its own"
    assert run_here("sweep", "plot", str(folder), "--over", "mission.planner", "--out", str(figure)).code == Exit.HOLDS
    assert "CyclicPursuit -->" in figure.read_text()
    assert "<!-- median -->" in figure.read_text(), "side by side"


@pytest.mark.wire
@pytest.mark.long
def test_a_worker_of_a_cluster_with_another_source_of_a_planner_ends_the_sweep(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    source, other = (PLANNERS / "cyclic_pursuit.py").read_bytes(), tmp_path / "other"
    other.mkdir()
    (other / "cyclic_pursuit.py").write_bytes(source + b"# changed\n")
    here, there = (sha256(each).hexdigest()[:16] for each in (source, source + b"# changed\n"))
    scheduler = f"tcp://127.0.0.1:{free_ports(1)[0]}"
    worker = ("worker", scheduler, "--nthreads", "1", "--no-nanny")
    given = (*COMPARED, "--allow-plugins", "--duration", "5", "--scheduler", scheduler)
    with dask("scheduler", "--host", "127.0.0.1", "--port", scheduler.rpartition(":")[2]):
        with dask(*worker, path=str(other)):
            code, _, err = ended(start(*given, "--out", str(tmp_path / "unlike"), path=PLANNERS))
        assert code is Exit.ENDED_IN_FLIGHT
        assert f"planner {PLANNER} of source {there} instead of {here}" in err
        with dask(*worker, path=str(PLANNERS)):
            assert ended(start(*given, "--out", str(tmp_path / "like"), path=PLANNERS))[0] is FLOWN
    assert '"error":' not in (tmp_path / "like" / "runs.jsonl").read_text()


def class_of(path: Path, name: str) -> PlannerFactory:
    """Return a class of a file."""
    factory: PlannerFactory = runpy.run_path(str(path))[name]
    return factory


def test_runs_that_fail_are_rows_and_the_worst_fly_again(tmp_path: Path, run_here: RunHere) -> None:
    mission = tmp_path / "mine.toml"
    mission.write_text((MISSIONS / "case2.toml").read_text())
    folder, figure = tmp_path / "results", tmp_path / "sweep.svg"
    arguments = ("--vary", "encirclement.radius_m=-1,9", "--seeds", "3,4", "--duration", "5")
    code, out, err = ended(start(str(mission), *arguments, "--json", "--out", str(folder)))
    summary: dict[str, Any] = json.loads(out)
    assert (code, list(summary)) == (Exit.VERDICT_FAILED, OUTPUT_KEYS["sweep"].split())
    assert (summary["runs"], summary["hold"], summary["not_judged"], summary["failed"]) == (4, 0, 2, 2)
    assert "4 runs: 0 pass, 2 not judged, 2 without a result" in err
    assert list(summary["errors"].values()) == [2]
    assert "encirclement.radius_m: it must be greater than 0 (given: -1)" in err
    mission.write_text("edited")
    plotted = run_here("sweep", "plot", str(folder), "--out", str(figure), "--json")
    drawn = json.loads(plotted.out)
    (failed,) = (each for each in drawn["worst"] if "radius_m=-1 " in each["command"])
    plot_keys = OUTPUT_KEYS["sweep plot"].split(), OUTPUT_KEYS["worst[] of sweep plot"].split()
    assert (list(drawn), list(failed)) == plot_keys
    copy = folder / "mission" / "mine.toml"
    assert failed["command"] == f"cordon sim {copy} --set encirclement.radius_m=-1 --seed 3 --duration 5"
    assert copy.read_text() == (MISSIONS / "case2.toml").read_text()
    assert (plotted.code, b"</svg>" in figure.read_bytes()) == (Exit.HOLDS, True)
