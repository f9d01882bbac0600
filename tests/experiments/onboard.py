"""Disconnect the operator's laptop while agents on three computers fly a ring, once for each policy of the mission.

Five network namespaces: three companion computers with an agent and a stub vehicle each, the laptop, and the computer
of the router. All have issued keys. The links of companions and laptop are emulated in user space (80 ms and 5 % of
packets lost each way), as not every kernel has netem. A row fails if its policy is not kept.
"""

import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Sequence
from contextlib import ExitStack
from itertools import combinations
from math import inf, nan
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import psutil
import tomli_w

from agents.inputs import Start
from agents.safety.failsafe import Condition
from agents.tactics import Tactic
from gcs.flightlog.reader import read_log
from gcs.keys.authority_folder import AuthorityFolder
from gcs.metrics.record import FlightRecord
from gcs.report.evidence.reading import read_flight
from tests.experiments.arguments import parser
from tests.support.computers import Computer
from tests.support.lossy_network import LossyNetwork, Wireless, lossy_network
from tests.support.mission_text import CASE2

POLICIES = {"go_on": Tactic.ENCIRCLE, "hold": Tactic.HOLD, "return": Tactic.RETURN_AND_LAND}
"""The policies of a mission, with their tactics."""
NO_OPERATOR_S = 5.0
REACTS_WITHIN_S = NO_OPERATOR_S + 3.0 + 1.5
"""The grace time, Zenoh's lease on the router's side, and the transport time over two links, including one loss."""
RADIUS_M = 6.0
RING_S, BEFORE_S, CUT_S, BACK_S = 65.0, 15.0, 25.0, 25.0
"""The time from the last engagement to the cut, and the part of it that is measured; the duration of the cut, and the
flight time after it [s]. If the vehicle furthest from the target engages after the others, it waits outside for 30 s
until its gap is wide enough, and is on the ring 15 s later.
"""
RADIUS_ERROR_MAX_M = 0.25
READY_S, ALOFT_S = 120.0, 120.0
SEPARATION_M = tomllib.loads(CASE2)["safety"]["separation_m"]
HEAD = (
    "| policy | vehicles | after the cut | noted after the return | radius error before | and after | closest | "
    "an agent's memory | of a core | |\n|---|---|---|---|---|---|---|---|---|---|"
)


class Flown(NamedTuple):
    """The effects of the cut in the logs of a flight, by the true motions.

    For each vehicle: the time from the cut to the change of its tactic [s] (infinity: none), its tactics before the
    laptop's return and at the end, and the time from that return to its note. The rms radius error before the cut, and
    after it while on the ring, and the closest approach [m].
    """

    reacted_s: list[float]
    cut_tactics: list[str]
    last_tactics: list[str]
    noted_s: list[float]
    error_before_m: float
    error_after_m: float
    closest_m: float


class Load(NamedTuple):
    """The usage of one agent, over all its processes."""

    memory_mb: float
    core_share: float


class Site:
    """The five computers with their files and processes."""

    def __init__(self, network: LossyNetwork, folder: Path, policy: str, stack: ExitStack) -> None:
        self.network, self.folder, self._stack = network, folder, stack
        self.router, *self.companions, self.laptop = network.computers
        self._issue(mission_text(policy, self.router))

    def _issue(self, mission: str) -> None:
        keys = AuthorityFolder(self.folder / "keys")
        keys.init(10.0)
        keys.issue("router", "hill", 1.0)
        keys.issue("operator", "anna", 1.0)
        holders = {self.router: "router-hill", self.laptop: "operator-anna"}
        for vehicle, computer in enumerate(self.companions, start=1):
            keys.issue("vehicle", str(vehicle), 1.0)
            holders[computer] = f"vehicle-{vehicle}"
        for computer, holder in holders.items():
            copytree(keys.path / holder, self._files(computer) / "keys" / holder)
            (self._files(computer) / "mission.toml").write_text(mission)

    def run(self, computer: Computer, *arguments: str) -> "subprocess.Popen[bytes]":
        """Start a command of cordon on a computer; its output goes to a file there."""
        environment = {**os.environ, "TERM": "dumb", "COLUMNS": "200"}
        process = subprocess.Popen(
            computer.command(sys.executable, "-m", "gcs", *arguments),
            cwd=self._files(computer),
            stdout=(self._files(computer) / f"{arguments[0]}.out").open("ab"),
            stderr=(self._files(computer) / f"{arguments[0]}.err").open("ab"),
            env=environment,
        )
        self._stack.callback(_end, process)
        return process

    def said(self, computer: Computer, verb: str, stream: str = "err") -> str:
        """Return the output of a command on a computer."""
        return (self._files(computer) / f"{verb}.{stream}").read_text()

    def log(self, vehicle: int) -> Path:
        """Return the path of the log of a vehicle's agent."""
        return self._files(self.companions[vehicle - 1]) / "flight.mcap"

    def _files(self, computer: Computer) -> Path:
        folder = self.folder / computer.namespace
        folder.mkdir(exist_ok=True)
        return folder


def mission_text(policy: str, router: Computer) -> str:
    """Return case2 with a small ring close by, a router in place of endpoints, and a policy."""
    mission = tomllib.loads(CASE2)
    mission["target"] |= {"start_m": [6.0, -5.0], "velocity_m_s": [0.0, 0.0]}
    mission["encirclement"] |= {"radius_m": RADIUS_M, "angular_rate_rad_s": 0.1}
    mission["network"] = {"router": f"tcp/{router.address}:7447", "security": {"keys": "keys"}}
    mission["failsafe"] = {"no_operator": policy, "no_operator_s": NO_OPERATOR_S}
    for vehicle in mission["vehicles"]:
        del vehicle["endpoint"]
        vehicle["altitude_m"] = 3.0
    return tomli_w.dumps(mission)


def fly(policy: str, link: Wireless, seed: int) -> tuple[Flown, Load]:
    """Fly a ring, disconnect and reconnect the laptop; return the effects on the team."""
    with TemporaryDirectory() as folder, ExitStack() as stack:
        network = stack.enter_context(lossy_network((Wireless(), *3 * (link,), link), seed))
        site = Site(network, Path(folder), policy, stack)
        agents = _started(site)
        load = _load(agents[0], RING_S)
        cut_s = time.time()
        network.cut(site.laptop)
        time.sleep(CUT_S)
        network.cut(site.laptop, cut=False)
        back_s = time.time()
        time.sleep(BACK_S)
        for agent in agents:
            agent.send_signal(signal.SIGINT)
        for agent in agents:
            agent.wait(120.0)
        flown = _flown([site.log(vehicle) for vehicle in (1, 2, 3)], cut_s, back_s)
        if faults(policy, flown):
            print(*(site.said(each, "fly") for each in site.companions), sep="\n", file=sys.stderr, flush=True)
        return flown, load


def _started(site: Site) -> list["subprocess.Popen[bytes]"]:
    """Take off by the operator's command, and return the agents once all are on the ring."""
    site.run(site.router, "router", "mission.toml")
    agents = []
    for vehicle, computer in enumerate(site.companions, start=1):
        site.run(computer, "sitl", "mission.toml")
        options = "--only", str(vehicle), "--wait-for-start", "--log", "flight.mcap"
        agents.append(site.run(computer, "fly", "mission.toml", *options))
    site.run(site.laptop, "watch", "--mission", "mission.toml")
    began_s = time.monotonic()
    start = site.run(site.laptop, "start", "mission.toml", "--wait", f"{READY_S:g}", "--json")
    code = start.wait(READY_S + 60.0)
    print(f"cordon start, after {time.monotonic() - began_s:.0f} s: exit code {code}", flush=True)
    print(site.said(site.laptop, "start"), flush=True)
    if code != 0:
        raise SystemExit("\n".join(site.said(each, "fly") for each in site.companions))
    end_s = time.monotonic() + ALOFT_S
    while not all("formation -> encircle" in site.said(each, "fly") for each in site.companions):
        if time.monotonic() > end_s:
            raise SystemExit("not on the ring:\n" + "\n".join(site.said(each, "fly") for each in site.companions))
        time.sleep(0.5)
    return agents


def _load(agent: "subprocess.Popen[bytes]", for_s: float) -> Load:
    """Measure an agent's processes for some time: the proportional share of memory, and processor time."""
    root = psutil.Process(agent.pid)
    processes = [root, *root.children(recursive=True)]
    before_s = sum(sum(each.cpu_times()[:2]) for each in processes)
    time.sleep(for_s)
    spent_s = sum(sum(each.cpu_times()[:2]) for each in processes) - before_s
    return Load(sum(each.memory_full_info().pss for each in processes) / 1e6, spent_s / for_s)


def _flown(paths: Sequence[Path], cut_s: float, back_s: float) -> Flown:
    logs = [read_log(path) for path in paths]
    record = read_flight(logs).evidence.record
    if record.reference != "truth":
        raise SystemExit(f"the flight is not known by truth: {record.truth_missing}")
    start_s = next(iter(logs[0].of_kind(1, Start))).at_s
    cut_s, back_s = cut_s - start_s, back_s - start_s
    last_s = back_s + BACK_S - 1.0
    return Flown(
        [_first_s(record, each, "tactic", "", cut_s) for each in (1, 2, 3)],
        [_tactic(record, each, back_s) for each in (1, 2, 3)],
        [_tactic(record, each, last_s) for each in (1, 2, 3)],
        [_first_s(record, each, "failsafe", f"{Condition.NO_OPERATOR.value}: cleared", back_s) for each in (1, 2, 3)],
        _radius_error_m(record, cut_s - BEFORE_S, cut_s),
        _radius_error_m(record, cut_s, last_s),
        _closest_m(record, last_s),
    )


def _first_s(record: FlightRecord, vehicle: int, kind: str, text: str, after_s: float) -> float:
    """Return the time from a moment to the first event of a vehicle after it, infinity without one."""
    events = (each for each in record.events if (each.vehicle, each.kind) == (vehicle, kind))
    last_s = after_s + CUT_S
    return next((e.time_s - after_s for e in events if text in e.text and after_s < e.time_s < last_s), inf)


def _tactic(record: FlightRecord, vehicle: int, at_s: float) -> str:
    """Return a vehicle's last known tactic until a time."""
    track = next(each for each in record.vehicles if each.vehicle_id == vehicle)
    known = (record.time_s <= at_s) & (track.tactic != "unknown")
    return str(track.tactic[known][-1])


def _radius_error_m(record: FlightRecord, from_s: float, to_s: float) -> float:
    """Return the rms error of all radii on the ring between two times; NaN if no vehicle was on it."""
    during = (record.time_s > from_s) & (record.time_s <= to_s)
    errors = []
    for track in record.vehicles:
        on_ring = during & (track.tactic == Tactic.ENCIRCLE.value)
        errors += (np.hypot(*record.relative(track)[0][on_ring].T) - RADIUS_M).tolist()
    return float(np.sqrt(np.nanmean(np.square(errors)))) if errors else nan


def _closest_m(record: FlightRecord, to_s: float) -> float:
    """Return the smallest distance between two vehicles until a time."""
    flown = record.time_s <= to_s
    tracks = [track.position_m[flown] for track in record.vehicles]
    return float(min(np.nanmin(np.hypot(*(one - other).T)) for one, other in combinations(tracks, 2)))


def faults(policy: str, flown: Flown) -> list[str]:
    """Return the violations of a flight's policy."""
    expected, found = POLICIES[policy], []
    allowed = {expected.value, Tactic.LAND.value} if policy == "return" else {expected.value}
    if not {*flown.cut_tactics, *flown.last_tactics} <= allowed:
        found.append(f"tactics {flown.cut_tactics} and then {flown.last_tactics}")
    if policy == "go_on":
        if min(flown.reacted_s) < inf:
            found.append("a vehicle left its ring")
        if flown.error_after_m > RADIUS_ERROR_MAX_M:
            found.append(f"radius error {flown.error_after_m:.2f} m after the cut")
    else:
        if not all(NO_OPERATOR_S <= each <= REACTS_WITHIN_S for each in flown.reacted_s):
            found.append(f"reacted after {flown.reacted_s}")
        if policy == "hold" and max(flown.noted_s) == inf:
            found.append("a vehicle did not note that the laptop was back")
    if flown.error_before_m > RADIUS_ERROR_MAX_M:
        found.append(f"radius error {flown.error_before_m:.2f} m before the cut")
    if flown.closest_m < SEPARATION_M:
        found.append(f"vehicles came as near as {flown.closest_m:.2f} m")
    return found


def main(arguments: Sequence[str] = sys.argv[1:]) -> int:
    """Fly with each policy; return the number of policies that were not kept."""
    reader = parser("onboard", __doc__ or "")
    reader.add_argument("policies", nargs="*", help="policies to fly (default: all)")
    reader.add_argument("--delay", type=float, default=0.08, help="of each link, one way [s] (default: %(default)s)")
    reader.add_argument("--loss", type=float, default=0.05, help="share of packets lost (default: %(default)s)")
    reader.add_argument("--seed", type=int, default=1, help="seed of the losses (default: %(default)s)")
    options = reader.parse_args(arguments)
    rows, failed = [], 0
    for policy in options.policies or POLICIES:
        flown, load = fly(policy, Wireless(options.delay, options.loss), options.seed)
        wrong = faults(policy, flown)
        failed += bool(wrong)
        rows.append(_row(policy, flown, load, wrong))
        print(rows[-1], flush=True)
    print("\n".join([HEAD, *rows]))
    return failed


def _row(policy: str, flown: Flown, load: Load, wrong: Sequence[str]) -> str:
    did = ", ".join(sorted({*flown.cut_tactics}))
    after = "-" if min(flown.reacted_s) == inf else f"{min(flown.reacted_s):.1f} to {max(flown.reacted_s):.1f} s"
    noted = "-" if max(flown.noted_s) == inf else f"{max(flown.noted_s):.1f} s"
    cells = (
        policy,
        did,
        after,
        noted,
        f"{flown.error_before_m:.3f} m",
        "-" if policy != "go_on" else f"{flown.error_after_m:.3f} m",
        f"{flown.closest_m:.2f} m",
        f"{load.memory_mb:.0f} MB",
        f"{load.core_share:.0%}",
        "; ".join(wrong) or "kept",
    )
    return f"| {' | '.join(cells)} |"


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process that has not ended by itself."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


if __name__ == "__main__":
    sys.exit(main())
