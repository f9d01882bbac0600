"""End flights in every way, and print their reported ends: headline, JSON, exit code, and the log's report.

Flights are of stubs in separate processes, as operators start them; those of a target that is not engaged are
simulated. It fails if a flight does not end as expected, or its report differs.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from tests.experiments.arguments import parser
from tests.support.mission_text import CASE2, LOW
from tests.support.wire import free_ports

SPEED = "5"
ALOFT_S = 6.0
"""The time from the first line about formation flight to the end [wall s]."""
ENVIRONMENT = {**os.environ, "COLUMNS": "200", "TERM": "dumb"}
NEAR = ("start_m = [35.0, -5.0]\nvelocity_m_s = [0.1, 0.0]", "start_m = [10.0, -5.0]")
QUICK_BATTERY = ("[target]\n", "[failsafe]\nbattery_low = 0.999\nbattery_s = 1.0\n\n[target]\n")
FIVE = "".join(
    f'\n[[vehicles]]\nid = {each}\nurl = "udpin://127.0.0.1:1{each}"\nendpoint = "tcp/127.0.0.1:2{each}"\n'
    f"start_m = [0.0, {4.0 * (3 - each):.1f}]\n"
    for each in range(1, 6)
)


class Ended(NamedTuple):
    """A flight's reported end, and that of its log's report."""

    code: int
    headline: str
    how: str
    report_code: int
    report_how: str


class Case(NamedTuple):
    """A way to end a flight, given its process and its file; the expected end, and its exit codes."""

    name: str
    text: str
    end: Callable[[subprocess.Popen[str], Path], object] | None
    how: str
    code: int
    report_how: str = ""


def command(verb: str, *more: str) -> Callable[[subprocess.Popen[str], Path], object]:
    def give(_flight: subprocess.Popen[str], mission: Path) -> object:
        words = ("command", verb, "--mission", str(mission), *more)
        return subprocess.run([sys.executable, "-m", "gcs", *words], env=ENVIRONMENT, capture_output=True, check=True)

    return give


def interrupt(flight: subprocess.Popen[str], _mission: Path) -> None:
    flight.send_signal(signal.SIGINT)


def freeze(flight: subprocess.Popen[str], _mission: Path) -> None:
    """Stop the flying process: the supervisor's first child."""
    children = Path(f"/proc/{flight.pid}/task/{flight.pid}/children").read_text().split()
    os.kill(int(children[0]), signal.SIGSTOP)


def changed(*changes: tuple[str, str]) -> str:
    text = CASE2
    for before, after in changes:
        assert before in text, before
        text = text.replace(before, after)
    return text


def five() -> str:
    """Five in a line, of which the first passes the target too far away; the ring has room for all."""
    text = changed(NEAR, ("radius_m = 10.0", "radius_m = 10.0\nspacing_gain_per_s = 0.3"))
    return text[: text.index("[[vehicles]]")].replace("leader = 2", "leader = 3") + FIVE.lstrip()


CASES = (
    Case("to its end", changed(LOW), None, "landed", 0),
    Case("kill", changed(LOW), command("kill", "--vehicle", "2", "--yes"), "killed", 4),
    Case("abort", changed(LOW), command("abort"), "aborted", 4),
    Case("Ctrl-C", changed(LOW), interrupt, "operator", 4),
    Case("battery", changed(LOW, QUICK_BATTERY), None, "battery", 4),
    Case("watchdog", changed(LOW), freeze, "watchdog", 4, "in flight"),
)
SIMULATED = (
    Case(
        "target never seen",
        changed(NEAR, ("range_m = 15.0", "range_m = 15.0\nblind_s = [[0.0, 1000.0]]")),
        None,
        "simulated",
        1,
    ),
    Case("one of five never engages", five(), None, "simulated", 1),
)


def flown(case: Case, folder: Path) -> Ended:
    """Fly a case with stubs, and end it."""
    mission, log = folder / "mission.toml", folder / "flight.mcap"
    mission.write_text(_with_free_ports(case.text))
    arguments = ("fly", str(mission), "--sitl", "--speed", SPEED, "--duration", "60", "--json", "--log", str(log))
    process = subprocess.Popen(
        [sys.executable, "-m", "gcs", *arguments],
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=(folder / "told").open("w"),
        text=True,
    )
    if case.end is not None:
        while "standby -> formation" not in (folder / "told").read_text() and process.poll() is None:
            time.sleep(0.1)
        time.sleep(ALOFT_S)
        case.end(process, mission)
    out, _ = process.communicate(timeout=180.0)
    return _ended(process.returncode, out, (folder / "told").read_text(), log)


def simulated(case: Case, folder: Path) -> Ended:
    """Fly a case in simulation."""
    mission, log = folder / "mission.toml", folder / "flight.mcap"
    mission.write_text(case.text)
    done = _run("sim", str(mission), "--duration", "200", "--json", "--log", str(log))
    return _ended(done.returncode, done.stdout, done.stderr, log)


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gcs", *arguments], env=ENVIRONMENT, capture_output=True, text=True, check=False
    )


def _ended(code: int, out: str, told: str, log: Path) -> Ended:
    report = _run("report", str(log), "--json")
    result, reported = json.loads(out), json.loads(report.stdout)
    lines = [line.removeprefix("✗ ").strip() for line in told.splitlines()]
    words = r"(Landed|Killed|Aborted|Ended|Flown|A pilot took|The log ends)\b"
    headline = next((line for line in lines if re.match(words, line)), "")
    if result.get("verdicts", {}).get("engaged") is False:
        headline += f"; {next(line for line in lines if 'engaged the target' in line)}"
    return Ended(code, " ".join(headline.split()), result["ended"]["how"], report.returncode, reported["ended"]["how"])


def _with_free_ports(text: str) -> str:
    ports = sorted(set(re.findall(r"127\.0\.0\.1:(\d+)", text)))
    own = dict(zip(ports, free_ports(len(ports)), strict=True))
    text = re.sub(r"(127\.0\.0\.1):(\d+)", lambda found: f"{found[1]}:{own[found[2]]}", text)
    return text.replace("[target]\n", f'[network]\nteam = "endings-{os.getpid()}"\n\n[target]\n')


def main() -> int:
    """Print the table; return the number of wrong rows."""
    parser("endings", __doc__ or "").parse_args()
    failed = 0
    print("| flight | headline | `ended.how` | exit code | report | its exit code |\n|---|---|---|---|---|---|")
    for case in (*CASES, *SIMULATED):
        with TemporaryDirectory() as folder:
            ended = (simulated if case in SIMULATED else flown)(case, Path(folder))
        expected = (case.how, case.code, case.report_how or case.how, case.code)
        good = (ended.how, ended.code, ended.report_how, ended.report_code) == expected
        failed += not good
        row = (case.name, ended.headline, ended.how, ended.code, ended.report_how, ended.report_code)
        print(f"| {' | '.join(map(str, row))} |{'' if good else f' expected {expected}'}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
