"""Measure the effect of a flooded bus on a team in flight, and the admission time of a message.

A team of stubs flies case2 on a bus without keys in real time. An attacker in another process sends random bytes, then
states with the vehicles' ids, then payloads of 100 MB. An operator commands hold and resume during each flood.
"""

import asyncio
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from agents.core import VehicleCore
from agents.inputs import Message
from agents.team.codec import Admission, encode
from agents.team.messages import MemberState, Verb
from gcs.console.command_client import CommandClient
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.experiments.arguments import parser
from tests.support.mission_text import CASE2, INSECURE
from tests.support.paths import ROOT, finds_tests

KINDS = ("junk", "valid", "large")
MISSED_MAX, GROWTH_MAX_MB, HOLD_MAX_S = 0.01, 20.0, 0.3
HOLDS = 3
_TAKE_OFF_S = 40.0
_MESSAGES = 20_000


def insecure(folder: Path) -> Path:
    """Write case2 with a bus without keys and a unique team name."""
    path = folder / "flooded.toml"
    text = re.sub(r'(?m)^team = ".*"$', "", CASE2.replace(*INSECURE))
    path.write_text(text.replace("[network]\n", f'[network]\nteam = "flooded-{os.getpid()}"\n'), encoding="utf-8")
    return path


def resident_mb(session: int) -> float:
    """Return the memory of all processes of a session."""
    total = 0.0
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if os.getsid(int(entry.name)) == session:
                total += int((entry / "statm").read_text().split()[1]) * 4096 / 1e6
        except (OSError, ValueError):
            continue
    return total


async def hold_s(mission: Mission) -> float:
    """Command hold, then resume, a few times; return the longest time until all vehicles answered a hold."""
    longest_s = 0.0
    verbs: tuple[Verb, ...] = ("hold", "resume")
    for verb in verbs * HOLDS:
        answers = await CommandClient(mission).command(verb, mission.ids, None)
        after_s = [9.9 if answer is None or not answer.obeyed else answer.after_s for answer in answers.values()]
        if verb == "hold":
            longest_s = max(longest_s, *after_s)
    return longest_s


def flooded(kind: str, mission: Mission, lasting_s: float, rate_hz: float) -> tuple[int, float]:
    """Flood a team; return the number of messages sent, and the time of a hold."""
    ends = [vehicle.section.endpoint for vehicle in mission.vehicles]
    arguments = [kind, mission.network.team, str(lasting_s), str(2.0 if kind == "large" else rate_hz), *ends]
    command = [sys.executable, "-m", "tests.support.stranger", *arguments]
    with subprocess.Popen(command, cwd=ROOT, env=finds_tests(), stdout=subprocess.PIPE, text=True) as stranger:
        time.sleep(min(2.0, lasting_s / 2.0))
        longest_s = asyncio.run(hold_s(mission))
        return int(stranger.communicate()[0]), longest_s


def fly(kind: str, lasting_s: float, rate_hz: float) -> bool:
    """Fly under one kind of flood, print its effects, and return whether all limits are kept."""
    with TemporaryDirectory() as folder:
        path = insecure(Path(folder))
        mission = load_mission(str(path))
        duration_s = lasting_s + 40.0
        options = ["--sitl", "--speed", "1", "--duration", str(duration_s), "--json", "--log", f"{folder}/flight.mcap"]
        command = [sys.executable, "-m", "gcs", "fly", str(path), *options]
        pipe = subprocess.PIPE
        with subprocess.Popen(
            command, cwd=ROOT, stdout=pipe, stderr=subprocess.DEVNULL, start_new_session=True
        ) as team:
            time.sleep(_TAKE_OFF_S)
            before_mb = resident_mb(team.pid)
            sent, longest_s = flooded(kind, mission, lasting_s, rate_hz) if kind else (0, asyncio.run(hold_s(mission)))
            time.sleep(2.0)
            growth_mb = resident_mb(team.pid) - before_mb
            loop = json.loads(team.communicate()[0])["loop"]
        share = loop["missed"] / (loop["ticks"] + loop["missed"])
        log_mb = Path(folder, "flight.mcap").stat().st_size / 1e6
    print(
        f"{kind or 'nothing':8} {sent / lasting_s:8.0f} sent/s  "
        f"missed {loop['missed']} of {loop['ticks']} ({share:.2%})  "
        f"memory {growth_mb:+.1f} MB  hold {longest_s * 1e3:.0f} ms  log {log_mb:.1f} MB",
        flush=True,
    )
    return share < MISSED_MAX and growth_mb < GROWTH_MAX_MB and longest_s < HOLD_MAX_S


def message_us() -> float:
    """Return the time to admit a peer's message and to pass it to a core [us]."""
    mission = load_mission("case2")
    core = VehicleCore(mission.agent_config(mission.vehicle(1)))
    here = (0.0, 0.0)
    states = [MemberState(2, 1.0 + 1e-6 * n, "hold", here, here, here, here) for n in range(_MESSAGES)]
    payloads = [encode(state) for state in states]
    admission = Admission()
    times_us = []
    for payload in payloads:
        began = time.perf_counter()
        message = admission.admitted("member/2", payload)
        assert message is not None
        core.take(Message(1.0, message))
        times_us.append((time.perf_counter() - began) * 1e6)
    return median(times_us)


def main() -> int:
    """Measure; return 1 if a limit is exceeded."""
    reader = parser("bus_flood", __doc__ or "")
    reader.add_argument("--rate", type=float, default=10_000.0, help="messages a second (default: %(default)s)")
    reader.add_argument("--lasting", type=float, default=20.0, help="seconds of each flood (default: %(default)s)")
    arguments = reader.parse_args()
    print(f"a peer's message: {message_us():.2f} us")
    held = [fly(kind, arguments.lasting, arguments.rate) for kind in ("", *KINDS)]
    return 0 if all(held) else 1


if __name__ == "__main__":
    sys.exit(main())
