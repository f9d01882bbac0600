"""Watching a team from another terminal: what it shows, and that it says nothing.

That its death disturbs nobody: see `tests/wire/test_onlookers.py`.
"""

import asyncio
import re
import signal
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from io import StringIO

import pytest
from rich.console import Console

from agents.shell.zenoh_bus import single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.codec import encode
from agents.team.messages import MemberState
from agents.team.participant import vehicle
from gcs.console.watch import WatchView, watch
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.support.mission_text import INSECURE
from tests.support.wire import PATIENCE_S, cordon, until

pytestmark = pytest.mark.wire


@asynccontextmanager
async def watched(mission: Mission) -> AsyncIterator[tuple[StringIO, asyncio.Event]]:
    """Watch in this process; what it prints."""
    output, stop = StringIO(), asyncio.Event()
    task = asyncio.create_task(watch(mission, WatchView(Console(file=output, width=200)), stop))
    try:
        yield output, stop
    finally:
        stop.set()
        await task


async def test_what_is_heard_is_shown_and_nothing_is_said(mission_file: Callable[..., str]) -> None:
    mission = load_mission(mission_file("case2", INSECURE))
    heard: list[object] = []
    bus = single_bus(vehicle(1), BusTeam(mission.network.team, mission.ids), mission.vehicle(1).section.endpoint)
    await bus.open(heard.append, lambda *sensed: heard.append(sensed), lambda *presence: heard.append(presence))
    try:
        async with watched(mission) as (output, _):

            def shown(tactic: str, text: str) -> bool:
                state = MemberState(1, time.time(), tactic, (1.0, -2.0), (0.0, 0.0), (1.0, -2.0), (0.0, 0.0), 8.0)
                bus.publish("member", encode(state))
                return text in output.getvalue()

            await until(lambda: shown("formation", "vehicle 1: connected, tactic formation"))
            await until(lambda: shown("hold", "vehicle 1: formation -> hold"))
            await until(lambda: "vehicle 1: no messages, last tactic hold" in output.getvalue())
            await until(lambda: shown("hold", "vehicle 1: messages restored"))
        await asyncio.sleep(0.3)
        assert (heard, bus.drops.total) == ([], 0), "it has said something, or shown itself"
    finally:
        await bus.close()


def test_with_nobody_there_it_says_so_and_waits_until_it_is_told_to_end(mission_file: Callable[..., str]) -> None:
    with cordon("watch", "--mission", mission_file("case2")) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert re.search(r"waiting for team test-\d+: no flight", line)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, out) == (0, "")
        assert "Traceback" not in err
