"""Command a whole team at once, again and again, and count the ticks that the commands cost.

The vehicles are stubs of `cordon sitl`, flown as real ones: on the wall's clock, at raised priority where the system
permits it; or those of `cordon fly --sitl` on a governed clock. Each command goes to all vehicles at once, and the last
one lands them. Judged are the ticks in control.
"""

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from agents.ports import VehicleRefusedError
from agents.team.verbs import Verb
from cordon.lockstep import LockstepClient
from gcs.console.command_client import CommandClient
from gcs.errors import InputError
from gcs.flight.stubs import url_ports
from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Cost
from gcs.link.ports import free_ports
from gcs.mission.file import load_mission
from tests.experiments.arguments import parser
from tests.support.paths import ROOT
from tests.support.ring_mission import ring_mission

RATE_HZ = 20.0
DURATION_S = 900.0
IN_FLIGHT_WITHIN_S = 90.0
PATIENCE_WALL_S = 600.0
"""How long a busy computer may take for a flight on a governed clock."""
AFTER_S = 3.0
"""The time after each command whose ticks are judged, and until the next command."""
VERBS: Sequence[Verb] = ("hold", "resume", "abort", "resume", "hold", "rtl", "hold", "resume", "abort")


@dataclass(frozen=True)
class Sent:
    """A command: when it was sent [Unix s], its slowest answer [s], and how many vehicles obeyed."""

    verb: Verb
    sent_s: float
    slowest_s: float
    obeyed: int


def fly(vehicles: int, last: Verb, *, governed: bool) -> bool:
    """Fly and command a team, print a table; return whether all obeyed and no tick was missed."""
    with TemporaryDirectory() as folder:
        mission, log = Path(folder, "ring.toml"), Path(folder, "flight.mcap")
        ports = free_ports(2 * vehicles)
        within_s = PATIENCE_WALL_S if governed else IN_FLIGHT_WITHIN_S
        mission.write_text(ring_mission(vehicles, DURATION_S, ports[:vehicles], ports[vehicles:]), encoding="utf-8")
        cordon = [sys.executable, "-m", "gcs"]
        command = [*cordon, "fly", str(mission), "--json", "--log", str(log)]
        with ExitStack() as stack:
            if governed:
                command += ["--sitl", "--speed", "max"]
            else:
                stack.enter_context(_raised_stubs([*cordon, "sitl", str(mission)]))
            result = stack.enter_context(Path(folder, "result.json").open("wb"))
            flight = subprocess.Popen(command, cwd=ROOT, stdout=result, stdin=subprocess.DEVNULL)
            sent = asyncio.run(_command(mission, [*VERBS, last], flight, within_s, governed=governed))
            flight.wait(within_s)
        text = Path(folder, "result.json").read_text(encoding="utf-8")
        _print(vehicles, sent, log)
    loop, ended = json.loads(text).get("loop"), json.loads(text)["ended"]
    print(f"ticks: {loop}; ended: {ended['how']}", flush=True)
    return loop is not None and loop["missed"] == 0 and all(each.obeyed == vehicles for each in sent)


@contextmanager
def _raised_stubs(command: Sequence[str]) -> Iterator[None]:
    """Serve the stubs at raised priority: their own lateness is not measured here."""
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL) as stubs:
        with suppress(PermissionError):
            os.sched_setscheduler(stubs.pid, os.SCHED_RR, os.sched_param(1))
        yield
        stubs.terminate()


async def _command(
    mission: Path, verbs: Sequence[Verb], flight: "subprocess.Popen[bytes]", within_s: float, *, governed: bool
) -> list[Sent]:
    loaded = load_mission(str(mission))
    client = await _client(mission, flight)
    await client.open()
    try:
        end_s = time.monotonic() + within_s
        while {*client.tactics.values()} - {"formation", "encircle"} or len(client.tactics) < len(loaded.ids):
            if time.monotonic() > end_s or flight.poll() is not None:
                raise RuntimeError(f"not in flight: {client.tactics}")
            await asyncio.sleep(0.1)
        clock = LockstepClient(*url_ports(loaded, loaded.ids).values()) if governed else None
        sent = []
        for verb in verbs:
            await _sleep(clock)
            sent_s = time.time() if clock is None else clock.now_s
            answers = await client.command(verb, loaded.ids, None)
            times_s = [answer.after_s for answer in answers.values() if answer is not None]
            obeyed = sum(answer is not None and answer.obeyed for answer in answers.values())
            sent.append(Sent(verb, sent_s, max(times_s, default=np.inf), obeyed))
        await _sleep(clock)
        return sent
    finally:
        await client.close()


async def _sleep(clock: LockstepClient | None) -> None:
    """Wait on the vehicles' clock, or on the wall's."""
    await (asyncio.sleep(AFTER_S) if clock is None else asyncio.to_thread(clock.sleep, AFTER_S))


async def _client(mission: Path, flight: "subprocess.Popen[bytes]") -> CommandClient:
    while flight.poll() is None:
        with suppress(VehicleRefusedError, InputError):
            return CommandClient(load_mission(str(mission)))
        await asyncio.sleep(0.5)
    raise RuntimeError("the flight has ended")


def _print(vehicles: int, sent: Sequence[Sent], path: Path) -> None:
    log = read_log(path)
    ticks_s = [[cost.time_s for cost in log.of_kind(each, Cost)] for each in log.vehicles]
    print(f"\n{vehicles} vehicles; load of the computer over a minute {os.getloadavg()[0]:.1f}")
    print("| command | obeyed | slowest answer, s | missed ticks | longest period, ms |\n|---|---|---|---|---|")
    for each in sent:
        periods_s = np.concatenate([_periods_s(times_s, each.sent_s) for times_s in ticks_s])
        missed = int((np.round(periods_s * RATE_HZ) - 1.0).clip(0.0).sum())
        longest_ms = 1e3 * periods_s.max(initial=0.0)
        print(f"| {each.verb} | {each.obeyed} | {each.slowest_s:.2f} | {missed} | {longest_ms:.0f} |", flush=True)


def _periods_s(times_s: Sequence[float], sent_s: float) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Return the periods between the ticks of one vehicle, from the tick before a command on."""
    return np.diff([time_s for time_s in times_s if sent_s - 1.0 / RATE_HZ <= time_s <= sent_s + AFTER_S])


def main() -> None:
    """Fly teams of the given sizes."""
    reader = parser("commands_at_once", __doc__ or "")
    reader.add_argument("vehicles", nargs="*", type=int, default=[16, 32], help="team sizes (default: 16 32)")
    reader.add_argument("--last", choices=("land", "rtl", "kill"), default="land", help="the last command")
    reader.add_argument("--governed", action="store_true", help="fly `cordon fly --sitl --speed max`")
    chosen = reader.parse_args()
    well = [fly(count, chosen.last, governed=chosen.governed) for count in chosen.vehicles]
    sys.exit(0 if all(well) else 1)


if __name__ == "__main__":
    main()
