"""Every command of the command line, run once on what is installed: with `--json` where it has it."""

import json
import os
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from signal import SIGINT

import tomli_w
from cyclopts import App

from gcs.cli import VERBS, app
from gcs.link.ports import free_ports
from tests.support.drawn_field import plan
from tests.support.mission_text import CASE2, LOW, LOW_M
from tests.support.page.map_tiles import mbtiles, png
from tests.support.result_keys import OUTPUT_KEYS, RESULT_KEYS
from tests.support.ring_mission import ring_mission

EXCITATION = {
    "offset_m": [0.0, 6.0],
    "half_width_m": 3.0,
    "steps_s": 8.0,
    "sweep_s": 8.0,
    "sweep_from_hz": 0.15,
    "rest_s": 3.0,
}
LIMIT_S = 180.0


@dataclass(frozen=True)
class VerbRun:
    """A command to run: its arguments, the exit codes that it may have, and the keys of its JSON.

    Commands beside it begin once it has printed `ready`, or made a file of that name. One that `lasts` until Ctrl-C is
    then interrupted.
    """

    command: str
    arguments: str = ""
    codes: tuple[int, ...] = (0,)
    keys: str = ""
    ready: str = ""
    lasts: bool = False


@dataclass(frozen=True)
class Ran:
    """What a run left behind: exit code, time and standard error; `fault` says what is wrong, empty if nothing is."""

    run: VerbRun
    code: int
    took_s: float
    fault: str
    err: str


FLIGHT = VerbRun("fly", "fly.toml --sitl --speed 5 --wait-for-start --log fly.mcap", (4,), RESULT_KEYS[""], "2 waits")
"""The flight that an operator ends, beside which `BESIDE` runs."""
START = VerbRun("start", "fly.toml --wait 60", (0,), OUTPUT_KEYS["start"])
BESIDE = (
    START,
    VerbRun("watch", "--mission fly.toml", ready="#2", lasts=True),
    VerbRun("station", "--mission fly.toml --address 127.0.0.1:{page}", ready="http", lasts=True),
    VerbRun("target", "0 0 --mission fly.toml"),
    VerbRun("ros2", "fly.toml --router tcp/127.0.0.1:9", (3,)),  # there is no router of ROS
    VerbRun("cot", "fly.toml --to tcp://127.0.0.1:9", (3,)),  # there is no server of TAK
    VerbRun("rejoin", "2 --mission fly.toml", (3,)),  # it has not landed
    VerbRun("command", "land --mission fly.toml"),
)
STUBS = VerbRun("sitl", "stubs.toml", ready="Ctrl-C", lasts=True)
AFTER = VerbRun("log audit", "fly.mcap")
BESIDE_STUBS = (
    VerbRun("check", "stubs.toml", keys=OUTPUT_KEYS["check"]),
    VerbRun("recover", "stubs.toml --yes --no-log", (3,), OUTPUT_KEYS["recover"]),  # they are on the ground
    VerbRun("keys issue mavlink", "signed.toml"),
)
ALONE = (
    VerbRun("missions", keys=OUTPUT_KEYS["missions"]),
    VerbRun("new", "new.toml --vehicles 2 --links stub --shape line --radius 10 --rate 0.1 --target rest --fence 20"),
    VerbRun("schema"),
    VerbRun("zones import", "field.plan --mission ring.toml", keys=OUTPUT_KEYS["zones import"]),
    VerbRun("zones export", "new.toml --out ring.plan"),
    VerbRun("tiles", "47,8,48,9 --from world.mbtiles --zoom 0:0 --out field.mbtiles", keys=OUTPUT_KEYS["tiles"]),
    VerbRun("sim", "ring.toml --duration 10 --log sim.mcap", (0, 1), RESULT_KEYS[""]),
    VerbRun("sweep", "ring.toml --seeds 0:2 --duration 5 --workers 1 --out swept", (0, 1), OUTPUT_KEYS["sweep"]),
    VerbRun("sweep plot", "swept", keys=OUTPUT_KEYS["sweep plot"]),
    VerbRun("report", "sim.mcap", (0, 1), RESULT_KEYS[""]),
    VerbRun("replay", "sim.mcap", keys=OUTPUT_KEYS["replay"]),
    VerbRun("flights", ". --csv flights.csv", keys=OUTPUT_KEYS["flights"]),
    VerbRun("log recover", "sim.mcap"),
    VerbRun("log layout"),
    VerbRun("log export", "--ros2 sim.mcap"),
    VerbRun("log export", "--kml sim.mcap"),
    VerbRun("log export", "--gpx sim.mcap"),
    VerbRun("log export", "--geojson sim.mcap"),
    VerbRun("keys init"),
    *(
        VerbRun(f"keys issue {role}", "1" if role == "vehicle" else "hill")
        for role in ("vehicle", "sensor", "positions", "observer")
    ),
    VerbRun("keys issue operator", "anna"),
    VerbRun("keys issue router", "hill"),
    VerbRun("keys revoke", "operator-anna"),
    VerbRun("keys sign"),
    VerbRun("keys passphrase", codes=(2,)),  # it asks on a terminal
    VerbRun("keys approver", "carol", codes=(2,)),  # so does this
    VerbRun("keys approve", "kill-request.json carol", codes=(2,)),  # there is no such file, as for the next
    VerbRun("keys admit", "kill-approval.json", codes=(2,)),
    VerbRun("keys renew"),
    VerbRun("keys show"),
    VerbRun("router", "routed.toml", ready="Ctrl-C", lasts=True),
    VerbRun(
        "relay", "pty:station pty:vehicle --radio latency_ms=5", keys=OUTPUT_KEYS["relay"], ready="vehicle", lasts=True
    ),
)
DRILL = VerbRun("drill", "low.toml --fault frozen-interpreter", keys=OUTPUT_KEYS["drill"])
EXCITE = VerbRun(
    "excite", "ring.toml --sitl --speed max --log excited.mcap", keys=OUTPUT_KEYS["excite --preview"] + " flown"
)
EXCITED = (
    VerbRun("report", "excited.mcap", keys=RESULT_KEYS[""]),
    VerbRun("identify", "excited.mcap", (0, 1), OUTPUT_KEYS["identify"]),
)
"""What reads the log of `EXCITE`."""


def commands() -> Mapping[str, bool]:
    """Return every command of the command line, and whether it has `--json`."""
    app.resolved_commands()
    return dict(pair for verb in VERBS for pair in _commands(app[verb], verb))


def _commands(command: App, name: str) -> Iterator[tuple[str, bool]]:
    if command.default_command is not None:
        arguments = command.assemble_argument_collection().filter_by(show=True)
        yield name, any("--json" in each.names for each in arguments)
    for inner, each in command.resolved_commands().items():
        if not inner.startswith("-"):
            yield from _commands(each, f"{name} {inner}")


def run_all(folder: Path) -> Iterator[Ran]:
    """Run every command in an empty folder."""
    write_missions(folder)
    for run in (*ALONE, DRILL, EXCITE, *EXCITED):
        yield finished(run, folder)
    yield from beside(STUBS, BESIDE_STUBS, folder)
    yield from beside(FLIGHT, BESIDE, folder)
    yield finished(AFTER, folder)


def write_missions(folder: Path) -> None:
    """Write a field of another program, a map, and the missions.

    They are a ring of two, to fly at once and by stubs alone, with signing keys, and with a router. Drills fly case2
    low.
    """
    (folder / "field.plan").write_text(plan(), encoding="utf-8")
    mbtiles(folder / "world.mbtiles", [(0, 0, 0, png((0, 0, 255)))], name="world")
    (folder / "low.toml").write_text(CASE2.replace(*LOW), encoding="utf-8")
    stubs = free_ports(5)
    for name in ("ring", "fly", "stubs", "signed", "routed"):
        ports = stubs if name in ("stubs", "signed") else free_ports(5)
        mission = tomllib.loads(ring_mission(2, 300.0 if name == "fly" else 30.0, ports[:2], ports[2:4]))
        mission["network"]["team"] = f"{name}-{os.getpid()}"
        mission["excitation"] = EXCITATION
        for vehicle in mission["vehicles"]:
            vehicle["altitude_m"] = LOW_M
        if name == "signed":
            mission["link"] = {"signing_key_file": "mavlink.keys"}
        if name == "routed":
            mission["network"] |= {"router": f"tcp/127.0.0.1:{ports[4]}", "security": {"keys": "keys"}}
            for vehicle in mission["vehicles"]:
                del vehicle["endpoint"]
        (folder / f"{name}.toml").write_text(tomli_w.dumps(mission), encoding="utf-8")


def words(run: VerbRun) -> list[str]:
    """Return the words of a command line."""
    arguments = run.arguments.format(page=free_ports(1)[0]).split()
    return [*run.command.split(), *arguments, *(["--json"] if run.keys else [])]


def finished(run: VerbRun, folder: Path) -> Ran:
    """Run a command to its end, or until Ctrl-C."""
    with running(run, folder) as (process, began_s):
        return ended(run, process, began_s, folder)


def beside(run: VerbRun, others: Sequence[VerbRun], folder: Path) -> Iterator[Ran]:
    """Run commands while another one runs, and then let that end."""
    with running(run, folder) as (process, began_s):
        if run.ready:
            _wait_for(run.ready, process, folder / _name(run))
        for each in others:
            yield finished(each, folder)
        yield ended(run, process, began_s, folder)


SCRIPT = """
import sys
from cordon.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
"""
"""A script like the one that pip makes."""
IN_TURN = """
import json, os, sys
from cordon.__main__ import main

if __name__ == "__main__":
    codes = []
    for name, *arguments in json.loads(sys.argv[1]):
        sys.argv = ["cordon", *arguments]
        for output, end in ((sys.stdout, "out"), (sys.stderr, "err")):
            os.dup2(os.open(f"{name}.{end}", os.O_WRONLY | os.O_CREAT, 0o600), output.fileno())
        try:
            main()
        except SystemExit as ended:
            codes.append(int(ended.code or 0))
        sys.stdout.flush(), sys.stderr.flush()
        with open("codes", "w") as file:
            json.dump(codes, file)
"""
"""Commands one after the other in one process, which is faster."""


def script(folder: Path, text: str) -> str:
    """Write a script into a folder of its own, where Python looks for modules; return its path."""
    path = folder / "bin" / ("cordon" if text is SCRIPT else "in-turn")
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return str(path)


def finished_in_turn(runs: Sequence[VerbRun], folder: Path) -> list[Ran]:
    """Run commands to their ends, all in one process."""
    lines = json.dumps([[_name(run), *words(run)] for run in runs])
    subprocess.run(
        [sys.executable, script(folder, IN_TURN), lines],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        env=_environment(),
        check=False,
    )
    codes = json.loads((folder / "codes").read_text(encoding="utf-8"))
    return [_ran(run, code, 0.0, folder) for run, code in zip(runs, codes, strict=True)]


def _environment() -> dict[str, str]:
    environment = {**os.environ, "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "200"}
    for name in ("PYTHONSAFEPATH", "OPENBLAS_NUM_THREADS"):  # the tests set them, users do not
        environment.pop(name, None)
    return environment


@contextmanager
def running(run: VerbRun, folder: Path) -> Iterator[tuple["subprocess.Popen[bytes]", float]]:
    """Run a command in a folder, with its output in files there."""
    command = [sys.executable, script(folder, SCRIPT), *words(run)]
    with ExitStack() as stack:
        out, err = (stack.enter_context((folder / f"{_name(run)}.{end}").open("wb")) for end in ("out", "err"))
        process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=err, env=_environment()
        )
        stack.callback(process.wait)
        stack.callback(process.kill)
        yield process, time.monotonic()


def ended(run: VerbRun, process: "subprocess.Popen[bytes]", began_s: float, folder: Path) -> Ran:
    """Wait for the end of a command, which Ctrl-C ends where it has none, and judge what it left."""
    if run.lasts:
        _wait_for(run.ready, process, folder / _name(run))
        process.send_signal(SIGINT)
    try:
        code = process.wait(LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        code = process.wait()
    return _ran(run, code, time.monotonic() - began_s, folder)


def _ran(run: VerbRun, code: int, took_s: float, folder: Path) -> Ran:
    out, err = ((folder / f"{_name(run)}.{end}").read_text(encoding="utf-8") for end in ("out", "err"))
    return Ran(run, code, took_s, fault(run, code, out, err), err)


def fault(run: VerbRun, code: int, out: str, err: str) -> str:
    """Return what is wrong with a command's end; empty if nothing is."""
    if code not in run.codes:
        return f"exit code {code}, not {' or '.join(map(str, run.codes))}"
    if "Traceback" in err or "Error:" in err:
        return "an exception"
    if not run.keys:
        return ""
    try:
        printed = json.loads(out)
    except ValueError:
        return "no JSON on standard output"
    different = set(printed) ^ set(run.keys.split())
    return f"other keys than documented: {', '.join(sorted(different))}" if different else ""


def _name(run: VerbRun) -> str:
    return run.command.replace(" ", "-")


def _wait_for(words: str, process: "subprocess.Popen[bytes]", output: Path) -> None:
    end_s = time.monotonic() + LIMIT_S
    while process.poll() is None and time.monotonic() < end_s:
        if output.with_name(words).exists():
            return
        if any(words in output.with_name(f"{output.name}.{end}").read_text("utf-8") for end in ("out", "err")):
            return
        time.sleep(0.05)
