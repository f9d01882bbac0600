"""Fly teams over random radios: each team is to fly well, or to be refused before take-off with the reason.

A seed determines a radio: data rate, delay, jitter, losses and how many in a row, and whether three vehicles share it.
A team flies well if its radii are within 0.3 m rms from the middle of the mission on, no autopilot's failsafe acts, and
no vehicle stops its mission. Stubs are judged by their true paths, PX4 simulators (--px4, from the environment variable
CORDON_PX4) by the result of the flight. All fly on the wall's clock, so the computer has to keep up. With --links only
the links are simulated, in simulated time: rates, queue, losses and silences. Exit code 1 if a team neither flies well
nor is refused.
"""

import asyncio
import json
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from math import hypot, isnan, nan
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from agents.inputs import Start
from agents.safety.failsafe import Reaction
from agents.shell.clock import WallClock
from agents.tactics import Tactic
from gcs.errors import Exit
from gcs.flight.stubs import stub_configs
from gcs.flightlog.reader import read_log
from gcs.link.ports import free_ports
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from gcs.radio.emulation import Emulation
from gcs.radio.serving import running_beside
from sitl.radio import Air, RadioSpec
from sitl.server.server import Stub, serve
from tests.experiments.arguments import parser
from tests.support.mission_text import content, text_of
from tests.support.paths import MISSIONS
from tests.support.px4 import Px4Missing, Px4Simulator, px4_build
from tests.support.ring_mission import ring_mission
from tests.support.simulated_link import SimulatedLink

CORDON = Path(sys.executable).with_name("cordon")
"""That of this installation."""
VEHICLES = 3
BAUDS = (19200, 38400, 57600, 115200)
RADIUS_RMS_MAX_M = 0.3
WAIT_S = 20.0
"""How long a team that is not ready is checked again."""
PATIENCE_S = 240.0
"""The time for start, take-off and landing."""
LOOKS_S = 0.05
PX4_SETTLES_S = 45.0
METRES_PER_DEGREE = 111_195.0
STOPPED = {each.value for each in (Tactic.HOLD, Tactic.ASIDE, Tactic.LAND, Tactic.PILOT_OVERRIDE)}
FLEW, REFUSED = "flew well", "refused"


def drawn(seed: int) -> RadioSpec:
    """Draw a radio; those of odd seeds are shared."""
    random = np.random.default_rng(seed)
    return RadioSpec(
        baud=int(random.choice(BAUDS)),
        latency_ms=round(float(random.uniform(20.0, 200.0))),
        jitter_ms=round(float(random.uniform(0.0, 60.0))),
        loss=round(float(random.uniform(0.0, 0.1)), 3),
        burst=round(float(random.uniform(1.0, 6.0)), 1),
        shared=seed % 2 == 1,
        seed=100 * seed,
    )


def mission_text(spec: RadioSpec, duration_s: float, ports: list[int], endpoints: list[int], *, px4: bool) -> str:
    """Return the mission file of a team, at one port for each vehicle or for all."""
    text = (MISSIONS / "px4-trio.toml").read_text(encoding="utf-8")
    mission = content(text if px4 else ring_mission(VEHICLES, duration_s, endpoints, endpoints))
    mission["mission"]["duration_s"] = duration_s
    mission["network"] = {"team": f"radio-{ports[0]}"}
    mission["link"] = {"rates": "auto", "bytes_per_s": spec.bytes_s}
    if spec.shared:
        mission["links"] = {"radio": {"url": f"udpin://127.0.0.1:{ports[0]}"}}
    for vehicle, port, endpoint in zip(mission["vehicles"], ports * VEHICLES, endpoints, strict=False):
        del vehicle["url"]
        own = {"link": "radio"} if spec.shared else {"url": f"udpin://127.0.0.1:{port}"}
        vehicle.update(own, endpoint=f"tcp/127.0.0.1:{endpoint}")
    return text_of(mission)


@contextmanager
def radios(spec: RadioSpec, ports: Sequence[int], places: Sequence[str]) -> Iterator[None]:
    """Carry frames between the station's ports, one for all or one for each, and the vehicles' places."""
    air = Air(spec.bytes_s)
    groups = [places] if spec.shared else [[place] for place in places]
    opened = [
        Emulation(spec.model_copy(update={"seed": spec.seed + number}), f"udpout://127.0.0.1:{port}", group, air)
        for number, (port, group) in enumerate(zip(ports, groups, strict=True))
    ]
    with running_beside(opened):
        yield


@dataclass
class Vehicles:
    """When whose failsafe acted [s], and the stubs' true paths (time [s], x, y [m]) about the target."""

    failsafes: list[tuple[float, int]] = field(default_factory=list)
    paths: dict[int, list[tuple[float, float, float]]] = field(default_factory=dict)

    def radius_error_m(self, radius_m: float, from_s: float, to_s: float) -> float:
        """Return the largest rms radius error; NaN without paths."""
        errors_m = [
            np.array([hypot(x, y) - radius_m for time_s, x, y in path if from_s <= time_s <= to_s])
            for path in self.paths.values()
        ]
        return max((float(np.sqrt(np.mean(each**2))) for each in errors_m if len(each)), default=nan)


@asynccontextmanager
async def stubs(mission: Mission, spec: RadioSpec, ports: Sequence[int], _folder: Path) -> AsyncIterator[Vehicles]:
    """Serve stubs behind radios."""
    seen, stop, ready = Vehicles(), asyncio.Event(), asyncio.Queue[Sequence[Stub]]()
    own = dict(zip(mission.ids, free_ports(VEHICLES), strict=True))
    with radios(spec, ports, [f"udpin://127.0.0.1:{port}" for port in own.values()]):
        serving = asyncio.create_task(serve(stub_configs(mission, own), WallClock(), stop, ready.put_nowait))
        watching = asyncio.create_task(_watch(await ready.get(), seen))
        try:
            yield seen
        finally:
            watching.cancel()
            stop.set()
            await serving


async def _watch(served: Sequence[Stub], seen: Vehicles) -> None:
    clock = WallClock()
    while True:
        for stub in served:
            x, y, _ = stub.autopilot.airframe.position_m
            seen.paths.setdefault(stub.config.vehicle_id, []).append((clock.now_s(), x, y))
            if stub.autopilot.failsafe:
                seen.failsafes.append((clock.now_s(), stub.config.vehicle_id))
        await asyncio.sleep(LOOKS_S)


@asynccontextmanager
async def px4s(mission: Mission, spec: RadioSpec, ports: Sequence[int], folder: Path) -> AsyncIterator[Vehicles]:
    """Start PX4 simulators behind radios, each with a serial line of minimal streams."""
    seen, frame = Vehicles(), mission.frame
    assert frame.latitude_deg is not None
    assert frame.longitude_deg is not None
    assert frame.altitude_m is not None
    simulators = [
        Px4Simulator(
            instance,
            speed=1.0,
            place=(
                frame.latitude_deg + vehicle.section.start_m[1] / METRES_PER_DEGREE,
                frame.longitude_deg,
                frame.altitude_m,
            ),
            parameters={"COM_OBL_RC_ACT": 4.0},
        )
        for instance, vehicle in enumerate(mission.vehicles)
    ]
    lines = [folder / f"autopilot-{instance}" for instance in range(VEHICLES)]
    try:
        for simulator in simulators:
            simulator.start()
        await asyncio.sleep(PX4_SETTLES_S)
        with radios(spec, ports, [f"pty:{line}" for line in lines]):
            for instance, line in enumerate(lines):
                options = ["--instance", str(instance), "start", "-d", str(line), "-b", str(spec.baud), "-m", "minimal"]
                subprocess.run([px4_build() / "bin" / "px4-mavlink", *options], check=True, stdout=subprocess.DEVNULL)
            try:
                yield seen
            finally:
                for simulator in simulators:
                    simulator.stop()  # before its line is gone: PX4 reads a closed one without a pause
        for simulator in simulators:
            if "Failsafe activated" in (simulator.folder / "px4.log").read_text(encoding="utf-8", errors="replace"):
                seen.failsafes.append((nan, simulator.system_id))
    finally:
        for simulator in simulators:
            simulator.close()


async def flight(mission: Path, log: Path, cordon: Path, within_s: float) -> tuple[int, dict[str, Any], str]:
    """Fly with a cordon; return its exit code, JSON and messages."""
    options = ["--json", "--log", str(log), "--wait", f"{WAIT_S:g}"]
    process = await asyncio.create_subprocess_exec(
        *(str(cordon), "fly", str(mission), *options),
        cwd=mission.parent,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        out, err = await asyncio.wait_for(process.communicate(), within_s)
    except TimeoutError:
        process.kill()
        out, err = await process.communicate()
    return process.returncode or 0, json.loads(out) if out.strip() else {}, err.decode()


@dataclass(frozen=True)
class Flown:
    """How a team's flight over a radio went; `warnings` counts those of its links."""

    seed: int
    spec: RadioSpec
    outcome: str
    detail: str = ""
    radius_error_m: float = nan
    warnings: int = 0

    def __str__(self) -> str:
        spec, shares = self.spec, "shared" if self.spec.shared else "own"
        radio = (
            f"{spec.baud} | {shares} | {spec.latency_ms:.0f} + {spec.jitter_ms:.0f} | {spec.loss:.1%} | {spec.burst}"
        )
        return (
            f"| {self.seed} | {radio} | {self.outcome} | {self.radius_error_m:.2f} | {self.warnings} | {self.detail} |"
        )


async def flown(seed: int, spec: RadioSpec, duration_s: float, cordon: Path, logs: Path | None, *, px4: bool) -> Flown:
    """Fly a team over a radio, and judge it; its flight log is kept in `logs`."""
    ports, endpoints = free_ports(1 if spec.shared else VEHICLES), free_ports(VEHICLES)
    with TemporaryDirectory() as place:
        folder = Path(place)
        path, log = folder / "radio.toml", (logs or folder) / f"{seed}.mcap"
        path.write_text(mission_text(spec, duration_s, ports, endpoints, px4=px4), encoding="utf-8")
        mission = load_mission(str(path))
        async with (px4s if px4 else stubs)(mission, spec, ports, folder) as seen:
            within_s = duration_s + WAIT_S + PATIENCE_S
            code, result, said = await flight(path, log, cordon, within_s)
        if code == Exit.REFUSED and "vehicles" not in result:
            return Flown(seed, spec, REFUSED, _refusals(said))
        if not result.get("vehicles"):
            return Flown(seed, spec, f"exit code {code}", said.strip().splitlines()[-1] if said.strip() else "")
        start_s = next(read_log(log).of_kind(mission.ids[0], Start)).at_s
    rms_m = seen.radius_error_m(mission.encirclement.radius_m, start_s + duration_s / 2.0, start_s + duration_s)
    if px4:
        rms_m = max((each["radius_error_rms_m"] or nan for each in result["vehicles"]), default=nan)
    # Only those of the mission count; of PX4's the time is not known.
    failed = {i: at_s - start_s for at_s, i in reversed(seen.failsafes)}
    failed = {i: after_s for i, after_s in failed.items() if isnan(after_s) or 0.0 <= after_s <= duration_s}
    events = [each for each in result["events"] if each["time_s"] < duration_s]
    stops = [f"{each['vehicle']} {each['text']}" for each in events if each["kind"] == "tactic" and _stops(each)]
    alerts = [f"{each['vehicle']} {each['text']}" for each in events if each["kind"] == "failsafe" and _begins(each)]
    warnings = sum("link degraded" in alert for alert in alerts)
    alerts = [alert for alert in alerts if not alert.endswith(Reaction.DEGRADE.value)]
    faults = {
        "left offboard": ", ".join(f"vehicle {i} at {at_s:.0f} s" for i, at_s in failed.items()),
        "stopped": "; ".join((*stops[:1], *alerts[:2])) if stops else "",
        "radius": "" if rms_m <= RADIUS_RMS_MAX_M else "its ring",
        "ended": "" if code in (Exit.HOLDS, Exit.VERDICT_FAILED) else str(result["ended"]["reason"]),
    }
    fault = next((name for name, detail in faults.items() if detail), FLEW)
    return Flown(seed, spec, fault, faults.get(fault, ""), rms_m, warnings)


def simulated(seed: int, spec: RadioSpec, duration_s: float) -> Flown:
    """Simulate the links of a team, without flights."""
    shares = [(spec, VEHICLES)]
    if not spec.shared:
        shares = [(spec.model_copy(update={"seed": spec.seed + number}), 1) for number in range(VEHICLES)]
    links = [SimulatedLink(*share) for share in shares]
    if refusals := list(filter(None, (link.check() for link in links))):
        return Flown(seed, spec, REFUSED, refusals[0])
    silences = [link.fly(duration_s) for link in links]
    offboard, motion = sum(len(each.offboard_s) for each in silences), sum(len(each.motion_s) for each in silences)
    warnings = sum(len(link.faults) for link in links)
    outcome = "left offboard" if offboard else "stopped" if motion else FLEW
    detail = f"{offboard} silences of setpoints, {motion} of motion" if outcome != FLEW else ""
    return Flown(seed, spec, outcome, detail, warnings=warnings)


def of_seed(seed: int, duration_s: float, cordon: Path, logs: Path | None, *, px4: bool, only_links: bool) -> Flown:
    """Draw a radio, and fly a team over it or simulate its links."""
    if only_links:
        return simulated(seed, drawn(seed), duration_s)
    return asyncio.run(flown(seed, drawn(seed), duration_s, cordon, logs, px4=px4))


def _stops(event: dict[str, Any]) -> bool:
    _, _, after = event["text"].partition(" -> ")
    return any(after.startswith(tactic) for tactic in STOPPED)


def _begins(event: dict[str, Any]) -> bool:
    alert = event.get("alert")
    return alert is not None and not alert["is_over"]


def _refusals(said: str) -> str:
    """Return what the refusals in a table of findings say, or the last message, without its next step."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    rows = [" ".join(line.split()[1:]) for line in lines if line.startswith("refuse ")]
    messages = [line for line in lines if not line.startswith("next:")]
    return "; ".join(dict.fromkeys(rows or messages[-1:]))[:160]


def main(
    count: int,
    first: int,
    duration_s: float,
    jobs: int,
    cordon: Path,
    logs: Path | None,
    *,
    px4: bool,
    only_links: bool,
) -> int:
    """Fly a number of teams, each in a process of its own, some at a time, and print the table."""
    print("| seed | baud | line | delay, ms | lost | in a row | outcome | radius rms, m | warnings | |")
    print(f"{'|---' * 10}|", flush=True)
    teams = list[Flown]()
    # One that is judged computes for a second, in which stubs and radios of the same process would be silent.
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        flying = [
            pool.submit(of_seed, seed, duration_s, cordon, logs, px4=px4, only_links=only_links)
            for seed in range(first, first + count)
        ]
        for each in as_completed(flying):
            teams.append(each.result())
            print(teams[-1], flush=True)
    for outcome, number in Counter(team.outcome for team in teams).most_common():
        print(f"{number} of {count}: {outcome}")
    return 0 if all(team.outcome in (FLEW, REFUSED) for team in teams) else 1


if __name__ == "__main__":
    reader = parser("random_radios", __doc__)
    reader.add_argument("count", nargs="?", type=int, default=100, help="number of radios (default: %(default)s)")
    reader.add_argument("--seed", type=int, default=0, help="first seed (default: %(default)s)")
    reader.add_argument("--duration", type=float, default=90.0, help="mission duration, s (default: %(default)s)")
    reader.add_argument("--jobs", type=int, default=1, help="flights at a time (default: %(default)s)")
    reader.add_argument("--links", action="store_true", help="simulate the links only")
    reader.add_argument("--px4", action="store_true", help="fly PX4 simulators, one team at a time")
    reader.add_argument("--cordon", type=Path, default=CORDON, help="command that flies (default: %(default)s)")
    reader.add_argument("--logs", type=Path, help="existing folder in which the flight logs are kept")
    given = reader.parse_args()
    try:
        if given.px4:
            px4_build()
        sys.exit(
            main(
                given.count,
                given.seed,
                given.duration,
                1 if given.px4 else given.jobs,
                given.cordon.absolute(),
                given.logs and given.logs.absolute(),
                px4=given.px4,
                only_links=given.links,
            )
        )
    except Px4Missing as reason:
        sys.exit(str(reason))
