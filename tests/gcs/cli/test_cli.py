"""The command line as users and scripts meet it: a process, its exit code, standard output and standard error."""

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from gcs.cli import app
from gcs.cli.options import bus_mission, with_stubs
from gcs.errors import Exit
from gcs.flight.faults.catalogue import FAULTS
from gcs.mission.file import bundled_missions
from gcs.mission.sections import mission_schema
from tests.conftest import Ran, RunHere
from tests.support import installation
from tests.support.paths import DATA, MISSIONS
from tests.support.result_keys import OUTPUT_KEYS
from tests.support.several_rings import with_rings
from tests.support.wire import PATIENCE_S, until_now
from tests.support.wording import facts_missing

COMMANDS = [name for name in app if not name.startswith("-")]
CASE1 = (MISSIONS / "case1.toml").read_text(encoding="utf-8")
HEAVY = (
    "numpy",
    "scipy",
    "osqp",
    "filterpy",
    "matplotlib",
    "mavsdk",
    "zenoh",
    "pymavlink",
    "pydantic",
    "foxglove",
    "uvicorn",
)


FLYING_BYTES = 100_000
"""A log of this size holds a flight, not only its beginning."""
TERMINAL = {"COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}


def environment() -> dict[str, str]:
    return {**os.environ, **TERMINAL}


def cordon(*arguments: str, cwd: Path | None = None) -> Ran:
    """Run a command to its end; however it ends, it does not end in a traceback."""
    command = [sys.executable, "-m", "gcs", *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=cwd, env=environment(), check=False, encoding="utf-8"
    )
    assert "Traceback" not in done.stderr, done.stderr
    return Ran(done.returncode, done.stdout, done.stderr)


Refused = Callable[..., list[str]]


@pytest.fixture
def run_here(run_here: RunHere, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunHere:
    monkeypatch.chdir(tmp_path)
    for name, value in TERMINAL.items():
        monkeypatch.setenv(name, value)
    return run_here


@pytest.fixture
def mission(tmp_path: Path) -> Callable[..., str]:
    """Return a maker of mission files: case 1 with pieces of its text replaced."""

    def make(*changes: tuple[str, str]) -> str:
        text = CASE1
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "mission.toml"
        path.write_text(text, encoding="utf-8")
        return str(path)

    return make


# Help


def test_neither_help_nor_the_supervisor_imports_anything_heavy() -> None:
    program = f"""
import contextlib, sys, gcs.cli, gcs.flight.supervisor
for arguments in (["--help"], *([name, "--help"] for name in {COMMANDS})):
    sys.argv = ["cordon", *arguments]
    with contextlib.suppress(SystemExit):
        gcs.cli.main()
    print(*(f"{{arguments}}: {{name}}" for name in {HEAVY} if name in sys.modules), sep="\\n", file=sys.stderr)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment()
    )
    assert done.stderr.split() == []
    assert done.stdout.count("Usage: cordon") == 1 + len(COMMANDS)


def test_the_version_is_the_distributions_and_says_whether_compiled_code_runs(run_here: RunHere) -> None:
    ran, runs = run_here("--version"), "compiled" if installation.compiled(installation.place()) else "pure Python"
    assert (ran.code, ran.out) == (0, f"{version('cordon-gcs')} ({runs})\n")


def test_all_commands_are_listed_with_an_example_to_start_with(run_here: RunHere) -> None:
    ran = run_here("--help")
    assert ran.code == 0
    assert run_here() == ran
    assert {"sim", "fly", "sitl"} <= set(COMMANDS)
    assert all(f" {name} " in ran.out for name in COMMANDS)
    assert "cordon fly case2 --sitl --speed 10" in ran.out


def test_the_help_of_every_command_shows_an_example_that_parses(run_here: RunHere, subtests: pytest.Subtests) -> None:
    named: list[str] = []
    for command in COMMANDS:
        with subtests.test(command=command):
            code, shown, _ = run_here(command, "--help")
            example = (app[command].help or "").partition("Example: ")[2].splitlines()[0].split()
            assert (code, example[:2]) == (0, ["cordon", command])
            assert f"Example: cordon {command}" in shown
            bound = app.parse_args(with_stubs(example[1:]), exit_on_error=False, print_error=False)[1]
            if "mission" in bound.signature.parameters:
                assert bound.arguments["mission"] in bundled_missions()
            named += [word for word in example if word in bundled_missions()]
    assert len(set(named)) > len(named) / 2, "they are different examples"


def test_the_help_lists_every_fault_that_can_be_injected(run_here: RunHere) -> None:
    for command in ("fly", "drill"):
        words = set(re.findall(r"[\w-]+", run_here(command, "--help").out))
        assert {fault.option for fault in FAULTS} <= words


def test_completion_knows_every_command_and_its_options(tmp_path: Path, run_here: RunHere) -> None:
    assert run_here("--install-completion", "--shell", "bash", "--output", "completion").code == 0
    script = (tmp_path / "completion").read_text(encoding="utf-8")
    assert [word for word in (*COMMANDS, "--set", "--fault", "--plot", "wedge") if word not in script] == []


def test_the_bundled_missions_are_listed_with_what_they_are_for(run_here: RunHere) -> None:
    lines = run_here("missions").out.splitlines()[1:]
    told = json.loads(run_here("missions", "--json").out)
    listed = told["missions"]
    keys = OUTPUT_KEYS["missions"].split(), OUTPUT_KEYS["missions[] of missions"].split()
    assert (list(told), list(listed[0])) == keys
    assert [each["mission"] for each in listed] == [line.split()[0] for line in lines] == bundled_missions()
    for each, line in zip(listed, lines, strict=True):
        mission = tomllib.loads((MISSIONS / f"{each['mission']}.toml").read_text(encoding="utf-8"))
        assert each["description"] == mission["mission"]["description"]
        assert line.endswith(each["description"])
        rings = [mission["encirclement"] | ring for ring in mission.get("rings", [{}])]
        assert each["radius_m"] == rings[0]["radius_m"]
        radii = ", ".join(dict.fromkeys(f"{ring['radius_m']:g} m" for ring in rings))
        assert f"  {radii}  " in line
        assert each["vehicles"] == len(mission["vehicles"])


def test_the_schema_is_json_on_standard_output(run_here: RunHere) -> None:
    assert json.loads(run_here("schema").out) == mission_schema()


# Flying in simulation


def test_people_are_told_on_standard_error_only() -> None:
    ran = cordon("sim", "case1", "--duration", "3")
    assert (ran.code, ran.out) == (Exit.VERDICT_FAILED, "")
    assert "closest approach 4.000 m" in ran.err
    assert "not judged" in ran.err
    assert "\x1b" not in ran.err


def test_one_seed_gives_the_same_bytes_in_every_process(tmp_path: Path, run_here: RunHere) -> None:
    field = tmp_path / "field.toml"
    # The target is in sight from the beginning: also the sensors' noise has its seed.
    field.write_text(
        (MISSIONS / "case2-field.toml").read_text(encoding="utf-8").replace("[35.0, -5.0]", "[14.0, -5.0]")
    )
    arguments = ("sim", str(field), "--duration", "10", "--json", "--seed")
    once, again = cordon(*arguments, "7"), run_here(*arguments, "7")
    assert once.out == again.out
    assert json.loads(once.out)["seed"] == 7


def test_the_events_of_a_simulation_are_told_with_their_time_in_the_mission(run_here: RunHere) -> None:
    ran = run_here("sim", "case1", "--duration", "3", "--seed", "1", "--json")
    assert json.loads(ran.out)["events"] == [
        {"time_s": 0.0, "vehicle": vehicle, "kind": "tactic", "text": "standby -> formation: start"}
        for vehicle in (1, 2, 3)
    ]


BLIND = ("--set", "encirclement.radius_m=16", "--set", "encirclement.angular_rate_rad_s=0.1")
"""A ring of case2-field whose target, in its middle, is beyond the 15 m that the sensors see."""


def test_a_ring_from_which_no_sensor_sees_the_target_is_warned_of_before_it_flies(run_here: RunHere) -> None:
    warned = "warning: the shortest sensor range is 15 m, the ring's radius is 16 m"
    assert warned in run_here("sim", "case2-field", "--duration", "1", *BLIND).err
    varied = ("--vary", "encirclement.radius_m=10,16,17", *BLIND[2:])
    swept = run_here("sweep", "case2-field", *varied, "--duration", "1", "--workers", "1", "--out", "out")
    assert warned.replace("warning: ", "warning: 2 of 3 missions, the first: ") in swept.err


@pytest.mark.slow
def test_a_ring_that_its_vehicles_left_fails_the_flight_and_is_named(run_here: RunHere) -> None:
    seen = (*BLIND, "--set", "target.start_m=[14.0,0.0]", "--duration", "70")
    flown = run_here("sim", "case2-field", *seen, "--seed", "0", "--json")
    result = json.loads(flown.out)
    assert (flown.code, result["verdicts"]["kept"]) == (Exit.VERDICT_FAILED, False)
    left = {(each["vehicle"], each["place"], each["cause"]) for each in result["departures"]}
    assert left == {(vehicle, "ring", "target stale") for vehicle in (1, 2, 3)}
    swept = run_here("sweep", "case2-field", *seen, "--seeds", "0:1", "--workers", "1", "--out", "out", "--json")
    assert swept.code == Exit.VERDICT_FAILED
    assert (json.loads(swept.out)["hold"], json.loads(swept.out)["not_judged"]) == (0, 0)
    assert "0 pass, 1 fails (kept 1)" in swept.err


def test_a_vehicle_that_never_comes_near_enough_is_warned_of_before_it_flies(run_here: RunHere) -> None:
    near = ("--set", "vehicles[0].decision.distance_max_m=7.5")
    warned = "warning: vehicle 1: its least distance from the target in formation is "
    told = run_here("sim", "case2", "--duration", "1", *near).err
    assert warned in told
    assert "its decision.distance_max_m is 7.5 m: from its place in formation it will not engage; next: raise" in told
    assert warned not in run_here("sim", "case2", "--duration", "1").err
    varied = ("--vary", "vehicles[0].decision.distance_max_m=7.5,12")
    swept = run_here("sweep", "case2", *varied, "--duration", "1", "--workers", "1", "--out", "out")
    assert warned.replace("warning: ", "warning: 1 of 2 missions, the first: ") in swept.err


def test_wall_times_are_told_or_left_out_as_asked(run_here: RunHere) -> None:
    for option, timed in (("--timing", True), ("--no-timing", False)):
        result = json.loads(run_here("sim", "case1", "--duration", "1", "--seed", "1", option, "--json").out)
        assert (result["wall_time_s"] is not None) is timed
        assert (result["loop"]["tick_p50_us"] is not None) is timed


# Bad input: exit code 2, nothing on standard output, every fault on a line of standard error


def test_bad_input_is_an_exit_code_of_the_process_and_text_on_standard_error(mission: Callable[..., str]) -> None:
    path = mission(("radius_m = 10.0", 'radius_m = "10 m"'), ("spacing_m = 5.0", "spacing_m = nan"))
    ran = cordon("sim", path, "--json")
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.splitlines() == [
        "formation.spacing_m: it must be a finite number (given: nan) [mission.toml, line 14: spacing_m = nan]",
        "encirclement.radius_m: it must be a number, without unit and quotation marks (given: '10 m') "
        '[mission.toml, line 19: radius_m = "10 m"]',
    ]


REFUSED: tuple[tuple[str, ...], ...] = (
    ("sim case9", "case9", "did you mean 'case", ", ".join(bundled_missions())),
    ("sim case1 case2", "case2"),
    ("sim case1 --seed -1", "--seed"),
    *((f"sim case1 --duration {given}", "--duration") for given in ("0", "nan", "1e9")),
    ("sim case1 --plot flight.bmp", "--plot", "'flight.bmp'", ".png, .svg, .pdf"),
    ("fly case1 --plot no/flight.png", "--plot", "'no'", "mkdir -p no"),
    ("fly case1 --speed 0", "--speed"),
    ("fly case1 --only 9", "--only", "9", "1, 2, 3"),
    ("fly case1 --sitl --only 1", "--only", "--sitl", "cordon sitl"),
    ("fly case1 --sitl --no-log --live-address 127.0.0.1:8765", "--live-address", "--live"),
    *(
        (f"fly case1 --sitl --no-log --live --live-address={address}", "--live-address", f"'{address}'", "HOST:PORT")
        for address in ("8765", ":8765", "here:", "here:65536", "::1:8765", "[::1")
    ),
    *(
        (f"{verb} evader", "target.evades: ", "`cordon sim`")
        for verb in ("check", "drill", "excite --vehicle 1", "fly", "fly --sitl", "start", "target 1 2 --mission")
    ),
    ("excite case1 --vehicle 9", "--vehicle", "9", "1, 2, 3"),
    ("recover case1", "--yes"),
    ("recover case1 --leave 9 --take-from-pilot 8", "--yes", "--leave", "9", "--take-from-pilot", "8", "1, 2, 3"),
    ("recover case1 --yes --leave 9", "--leave", "9", "1, 2, 3"),
    ("recover case1 --yes --take-from-pilot 9", "--take-from-pilot", "9", "1, 2, 3"),
    ("recover case1 --yes --leave 1 --take-from-pilot 1", "--leave", "1", "--take-from-pilot"),
    ("recover case1 --yes --leave 1 --leave 2 --leave 3", "--leave"),
    ("recover case1 --yes --speed max", "--speed", "--lockstep"),
    ("recover case1 --yes --only 9", "--only", "9", "1, 2, 3"),
    ("recover case1 --yes --only 1 --leave 2", "--leave", "--only"),
    ("recover case1 --yes --only 1 --take-from-pilot 2", "--take-from-pilot: vehicle 2", "--only"),
    ("recover case1 --yes --add 4", "--start: ", "--url: "),
    ("recover case1 --yes --add 2 --start 0,-9 --url udpin://127.0.0.1:14543", "--add: vehicle 2 is in the mission"),
    ("recover case1 --yes --start 0,-9 --url udpin://127.0.0.1:14543", "--start: it needs --add", "--url: it needs"),
    ("recover case1 --add 4 --start 0,-9", "--url: ", "--yes: "),
    ("recover case1 --yes --add 4 --start 0,-9 --url udpin://127.0.0.1:14543 --only 5", "--only", "5", "1, 2, 3, 4"),
    ("recover case1 --yes --add 4 --start 0,-3 --url udpin://127.0.0.1:14543", "--start: ", "safety.separation_m"),
    ("recover case1 --yes --add 300 --start 0,-9 --url udpin://127.0.0.1:14543", "--add: "),
    ("rejoin 9 --mission case1", "VEHICLE", "9", "1, 2, 3", "--add"),
    ("rejoin 2 --mission case1 --start 0,-9 --sitl --off-bus 3", "--start", "--sitl", "--off-bus", "it needs --add"),
    ("rejoin 2 --mission case1 --no-log", "--no-log: it needs --add"),
    ("rejoin 2 --add --mission case1 --start 0,-9 --sitl", "--add: vehicle 2 is in the mission"),
    ("rejoin 4 --add --mission case1", "--start: ", "--url: "),
    ("rejoin 4 --add --mission case1 --start here --url udpin://127.0.0.1:14543", "--start: 'here'", "X,Y"),
    ("rejoin 4 --add --mission case1 --start 0,-3 --sitl", "--start: ", "vehicles[2]", "safety.separation_m"),
    ("rejoin 4 --add --mission case1 --start 0,-9 --url udpin://127.0.0.1:14541", "--url: 14541", "vehicles[1]"),
    ("rejoin 4 --add --mission case1 --start 0,-9 --url telnet://x:1", "--url: "),
    ("rejoin 4 --add --mission case1 --start 0,-9 --sitl --endpoint tcp/127.0.0.1:7461", "--endpoint: "),
    ("rejoin 4 --add --mission case1 --start 0,-9 --sitl --altitude 20", "--altitude: 20 m", "8 to 8 m"),
    ("rejoin 4 --add --mission case1 --start 0,-9 --sitl --off-bus 9", "--off-bus", "9", "1, 2, 3"),
    ("rejoin 4 --add --mission case1 --start 0,-9 --sitl --off-bus 1 --off-bus 2 --off-bus 3", "--off-bus: no vehicle"),
    ("rejoin 4 --add --mission case1 --start 0,-9 --sitl --profile nowhere", "--profile: "),
    ("rejoin 4 --add --mission case1 --start 0,-9 --sitl --key anna", "--key"),
    ("rejoin 9 --add --mission two-targets --start 0,-99 --sitl", "--add: ", "several rings"),
    ("rejoin 300 --add --mission case1 --start 0,-9 --sitl", "VEHICLE: "),
    ("fly case1 --leave 1", "--leave", "--adopt"),
    ("fly case1 --adopt --yes --sitl", "--adopt", "--sitl"),
    ("fly case1 --adopt", "--yes"),
    ("fly case1 --adopt --leave 9", "--yes", "--leave", "9", "1, 2, 3"),
    ("recover evader --yes", "target.evades: ", "`cordon sim`"),
    ("sitl case1 --speed 1000", "--speed"),
    ("drill nowhere", "nowhere: "),
    ("drill case1 --log 'my logs'", "--log", "mkdir -p 'my logs'"),
    ("drill case2 --fault fire", "--fault", "'fire'", "killed-agent"),
    ("command stop", "stop"),
    ("command kill", "--yes"),
    ("command hold --vehicle 9", "--vehicle"),
    ("command hold wedge", "hold", "wedge"),
    ("command formation", "shape"),
    ("command formation star", "'star'", "line, column, wedge"),
    ("command ring", "radius=15"),
    ("command ring 15", "15: give", "radius=METRES"),
    ("command ring north radius=15", "north: give", "one ring, without a name"),
    ("command assign 2 north", "assign: case2 has one ring"),
    ("command assign 2 north --vehicle 2", "--vehicle: assign names its vehicle"),
    ("command ring radius=nan", "radius=nan: give"),
    ("command ring radius=12 radius=13", "radius=13: give"),
    ("command ring radius=0.1", "encirclement.radius_m", "0.1"),
    ("command ring radius=90", "90.0 m", "speed_max_m_s"),
    ("command ring rate=0.5", "0.5 rad/s", "speed_max_m_s = 3.0 m/s"),
    ("command ring radius=20", "sensor range", "the ring's radius is 20 m"),
    ("command ring radius=12 --vehicle 2", "--vehicle"),
    ("command formation free", "slot_m"),
    ("command formation wedge --vehicle 2", "--vehicle"),
    ("watch --mission no-such-mission", "no-such-mission"),
    ("target 1e400 0", "is not a position"),
    ("target 35", "X Y", "--lat", "--lon"),
    ("target --lat 91 --lon 8", "is not a position on Earth"),
    ("target 1e7 0", "(10000 km, at most 1000)"),
    ("target 35 -5 --sigma 1e-200", "covariance not positive definite"),
    ("report a.mcap --compare", "--compare: ", "at least one"),
    ("report a.mcap --compare b.mcap b.mcap", "--compare: ", "b.mcap"),
    ("report a.mcap --compare b.mcap", "a.mcap: No such file"),
    ("report a.mcap --compare b.mcap --plot a.png", "--plot: ", "--compare"),
    (f"report a.mcap --compare {DATA / 'px4-quad.ulg'}", "--compare: ", "px4-quad.ulg", "not recorded by cordon"),
    ("report a.mcap --animate a.mp4", "--animate: ", "'a.mp4'", ".gif, .webp"),
    ("report a.mcap --animate /dev/full/a.gif", "--animate: ", "'/dev/full'"),
    ("report a.mcap --animate a.gif --compare b.mcap", "--animate: "),
    (f"report {DATA / 'px4-quad.ulg'} --animate a.webp", "--animate: ", "px4-quad.ulg", "not recorded"),
)
"""Command lines, and the facts that their refusals state."""


def test_a_command_line_that_makes_no_sense_is_told_and_refused(refused: Refused, subtests: pytest.Subtests) -> None:
    for line, *facts in REFUSED:
        with subtests.test(line=line):
            assert facts_missing("\n".join(refused(*shlex.split(line))), *facts) == []


OF_SEVERAL_RINGS = (
    ("ring", "radius=15", "north, south, high"),
    ("ring radius=15", "ring: name the ring first", "ring north radius=15", "rings: north, south, high"),
    ("ring nort radius=15", "nort: ", "did you mean 'north'?", "rings: north, south, high"),
    ("ring east radius=15", "east: ", "rings: north, south, high"),
    ("ring north", "ring: give radius=METRES"),
    ("ring north 15", "15: give radius=METRES"),
    ("ring north radius=0.1", "rings[0].radius_m: 2 vehicles on a ring of 0.1 m", "it takes 1.5 m"),
    # 0.8 of 3 m/s, less the 0.1 m/s of the target of north only, whose ring has 10 m; that of south has 14 m.
    ("ring south rate=0.18", "ring south: ", "2.52 m/s along the ring", "lower rings[1].angular_rate_rad_s to 0.17"),
    ("ring north rate=0.24", "ring north: ", "lower rings[0].angular_rate_rad_s to 0.23"),
    ("ring south radius=20", "ring south: the shortest sensor range is 15 m, the ring's radius is 20 m"),
    ("ring high altitude=-20", "rings[2].altitude_m: ", "-20"),
    ("ring south radius=12 --vehicle 2", "--vehicle: ring commands the whole team"),
    ("assign", "assign VEHICLE RING", "assign 1 north", "assign VEHICLE auto", "nothing"),
    ("assign north 2", "assign VEHICLE RING", "north 2"),
    ("assign 2", "assign VEHICLE RING", "given: 2"),
    ("assign 9 north", "assign: the mission has no vehicle 9 (it has 1, 2, 3)"),
    ("assign 2 hihg", "hihg: ", "did you mean 'high'?"),
    ("assign 2 high --vehicle 2", "--vehicle: assign names its vehicle"),
)


def test_a_ring_is_commanded_by_its_name_within_its_own_bounds(
    refused: Refused, subtests: pytest.Subtests, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Case 2 with three rings; no team flies it, so what is not refused finds no vehicle."""
    several = with_rings(bus_mission("case2"))
    monkeypatch.setattr("gcs.cli.command.running_mission", lambda *_: several)
    for line, *facts in OF_SEVERAL_RINGS:
        with subtests.test(line=line):
            assert facts_missing("\n".join(refused("command", *shlex.split(line))), *facts) == []


def test_flights_are_compared(run_here: RunHere) -> None:
    for seed in "12":
        run_here("sim", "case1", "--duration", "1", "--seed", seed, "--log", f"{seed}.mcap")
    ran = run_here("report", "1.mcap", "--compare", "2.mcap", "--html", "all.html", "--json")
    assert ran.code == Exit.VERDICT_FAILED, "too short to be judged"
    told = json.loads(ran.out)
    assert list(told) == OUTPUT_KEYS["report --compare"].split()
    assert (told["names"], told["differences"]) == (["1", "2"], {"seed": [1, 2]})


def test_a_preview_tells_the_space_and_the_time_and_flies_nothing(run_here: RunHere) -> None:
    ran = run_here("excite", "case2", "--vehicle", "3", "--preview", "--json")
    assert ran.code == 0
    told = json.loads(ran.out)
    assert (list(told), told["vehicle"]) == (OUTPUT_KEYS["excite --preview"].split(), 3)
    assert told["box_m"] == [[7.0, -9.0], [17.0, -9.0], [17.0, 1.0], [7.0, 1.0]]
    assert list(told["preview"]) == ["duration_s", "reach_m", "speed_m_s", "acceleration_m_s2", "distance_m"]
    assert 200.0 < told["preview"]["duration_s"] < 300.0
    assert "box" in ran.err
    assert "looking for the vehicles" not in ran.err


def test_a_layout_overwrites_nothing(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "kept.json").write_text("kept")
    assert refused("log", "layout", "-o", "kept.json") == ["--output: kept.json: File exists"]
    assert (tmp_path / "kept.json").read_text() == "kept"


def test_stubs_serve_no_serial_port(mission: Callable[..., str], refused: Refused) -> None:
    path = mission(
        ("udpin://127.0.0.1:14541", "serial:///dev/ttyUSB0:57600"),
        ("udpin://127.0.0.1:14542", "tcpout://127.0.0.1:5760"),
    )
    for verb, *options in (("fly", "--sitl"), ("sitl",)):
        lines = refused(verb, path, *options)
        assert [line.partition(": ")[0] for line in lines] == ["vehicles[1].url", "vehicles[2].url"]


# Over real sockets


@pytest.fixture
def own_ports(mission_file: Callable[..., str]) -> str:
    """A copy of case 1 on ports that nobody else uses."""
    return mission_file("case1")


def ports_of(path: str, key: str) -> list[int]:
    vehicles: list[dict[str, Any]] = tomllib.loads(Path(path).read_text(encoding="utf-8"))["vehicles"]
    return [int(vehicle[key].rpartition(":")[2]) for vehicle in vehicles]


@pytest.fixture
def taken() -> Iterator[Callable[[int, socket.SocketKind], None]]:
    """Return a taker of ports; they are given back in the end."""
    held = []

    def take(port: int, kind: socket.SocketKind) -> None:
        one = socket.socket(socket.AF_INET, kind)
        held.append(one)
        one.bind(("127.0.0.1", port))
        if kind is socket.SOCK_STREAM:
            one.listen()

    yield take
    for one in held:
        one.close()


@pytest.mark.wire
def test_all_vehicles_that_cannot_be_reached_are_named_one_a_line(own_ports: str, taken: Callable[..., None]) -> None:
    ports = ports_of(own_ports, "url")
    taken(ports[1], socket.SOCK_DGRAM)
    ran = cordon("fly", own_ports, "--json")
    assert (ran.code, ran.out) == (3, "")
    first, second, third = ran.err.splitlines()[-3:]
    assert first.startswith(f"vehicle 1: no heartbeat on udpin://127.0.0.1:{ports[0]} within 10 s; next: ")
    assert "cordon sitl" in first
    assert second.startswith(f"vehicle 2: udp port {ports[1]} of udpin://127.0.0.1:{ports[1]} ")
    assert "end the other" in second
    assert third.startswith(f"vehicle 3: no heartbeat on udpin://127.0.0.1:{ports[2]} within 10 s; next: ")


@pytest.mark.wire
def test_ctrl_c_before_take_off_ends_the_search_for_vehicles(own_ports: str) -> None:
    command = [sys.executable, "-m", "gcs", "fly", own_ports, "--only", "1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment()) as process:
        assert process.stderr is not None
        assert "looking for the vehicles" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 3
        told = process.stderr.read()
    assert "Traceback" not in told
    assert "no heartbeat" not in told, "the search ended by itself"
    assert "before take-off" in told


@pytest.mark.parametrize("gone", ["stdout", "stderr"])
def test_a_reader_that_has_gone_ends_nothing(gone: str, mission: Callable[..., str]) -> None:
    command = [sys.executable, "-m", "gcs", "sim", mission(("duration_s = 600.0", "duration_s = 2.0")), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment()) as process:
        streams = {"stdout": process.stdout, "stderr": process.stderr}
        lost = streams.pop(gone)
        (read,) = streams.values()
        assert lost is not None
        assert read is not None
        lost.close()
        told = read.read().decode()
        assert process.wait(PATIENCE_S) == Exit.VERDICT_FAILED, "the flight's own code: too short to be judged"
    assert "Traceback" not in told
    assert "BrokenPipe" not in told
    assert ("metrics and verdicts" if gone == "stdout" else '"mission"') in told


def test_ctrl_c_ends_a_simulation_without_a_traceback(mission: Callable[..., str], tmp_path: Path) -> None:
    endless, log = mission(("duration_s = 600.0", "duration_s = 86400.0")), tmp_path / "flight.mcap"
    command = [sys.executable, "-m", "gcs", "sim", endless, "--log", str(log)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment()) as process:
        until_now(lambda: log.exists() and log.stat().st_size > FLYING_BYTES)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 4
        assert process.stderr is not None
        assert "Traceback" not in process.stderr.read()
