"""Measure what keys cost on the bus: the start, a message's way there and back, and computing time.

All vehicles of a team are sessions of this process, as is one operator: figures compare the two kinds of bus; a flight
has each vehicle's agent in one process, or each in its own.
"""

import asyncio
import os
import time
from contextlib import AsyncExitStack
from functools import partial
from statistics import median
from tempfile import TemporaryDirectory

from agents.shell.zenoh_bus import ZenohBus
from gcs.keys.run_keys import RunKeys
from gcs.keys.team_keys import NoKeys, TeamKeys
from tests.experiments.arguments import parser
from tests.support.wire import free_ports

TEAM = "measured"
PAYLOAD = bytes(200)
RATE_HZ = 20.0
"""Messages of each vehicle: member and angle at 10 Hz."""
ROUND_TRIPS = 200
LOADED_S = 5.0


class Counter:
    """What one bus has received: messages, and vehicles that are present."""

    def __init__(self) -> None:
        self.messages = 0
        self.present: set[int] = set()
        self.bus: ZenohBus

    def take(self, key: str, payload: bytes) -> None:
        self.messages += 1
        if key.startswith("command/"):
            self.bus.publish("answer", payload)

    def note_presence(self, vehicle_id: int, present: bool) -> None:
        (self.present.add if present else self.present.discard)(vehicle_id)


async def until(condition: partial[bool]) -> None:
    end_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end_s, "the bus did not come together"
        await asyncio.sleep(0.002)


async def opened(
    stack: AsyncExitStack, keys: TeamKeys, ids: tuple[int, ...]
) -> tuple[list[Counter], ZenohBus, Counter]:
    """Open the buses of all vehicles at once, and then an operator's; return once all vehicles know each other."""
    ends = {i: f"tcp/127.0.0.1:{port}" for i, port in zip(ids, free_ports(len(ids)), strict=True)}
    counters = []
    for i in ids:
        identity, counter = keys.identity("vehicle", str(i)), Counter()
        others = [end for k, end in ends.items() if k != i]
        counter.bus = ZenohBus(identity.participant, TEAM, ids, ends[i], others, security=identity.security)
        counters.append(counter)
    await asyncio.gather(*(each.bus.open(each.take, each.note_presence) for each in counters))
    for each in counters:
        stack.push_async_callback(each.bus.close)
    await until(partial(lambda: all(len(each.present) == len(ids) - 1 for each in counters)))
    operator, received = keys.identity("operator"), Counter()
    bus = ZenohBus(operator.participant, TEAM, ids, None, list(ends.values()), security=operator.security)
    received.bus = bus
    return counters, bus, received


async def round_trip_s(bus: ZenohBus, received: Counter, vehicles: int) -> float:
    """Return the median time from a command until all vehicles have answered."""
    times_s = []
    for number in range(ROUND_TRIPS):
        before, began_s = received.messages, time.perf_counter()
        bus.publish("command/hold", b"%d" % number)
        while received.messages < before + vehicles:
            assert time.perf_counter() < began_s + 5.0, "an answer is missing"
            await asyncio.sleep(0.0)
        times_s.append(time.perf_counter() - began_s)
        await asyncio.sleep(0.02)
    return median(times_s)


async def loaded_share(counters: list[Counter]) -> float:
    """Return the share of a core that messages at their flight's rate take."""
    began_s, cpu_s = time.perf_counter(), time.process_time()
    period_s, sent = 1.0 / RATE_HZ, 0
    while time.perf_counter() < began_s + LOADED_S:
        for each in counters:
            each.bus.publish("member" if sent % 2 else "angle", PAYLOAD)
        sent += 1
        await asyncio.sleep(max(0.0, began_s + sent * period_s - time.perf_counter()))
    return (time.process_time() - cpu_s) / (time.perf_counter() - began_s)


async def measure(vehicles: int, *, secure: bool) -> str:
    """Return a line of the table."""
    ids = tuple(range(1, vehicles + 1))
    async with AsyncExitStack() as stack:
        began_s = time.perf_counter()
        keys: TeamKeys = NoKeys()
        if secure:
            run = RunKeys(TEAM, ids)
            stack.enter_context(run.held())
            keys = run
        made_s = time.perf_counter() - began_s
        counters, operator, received = await opened(stack, keys, ids)
        started_s = time.perf_counter() - began_s
        began_s = time.perf_counter()
        await operator.open(received.take, received.note_presence)
        stack.push_async_callback(operator.close)
        await until(partial(lambda: len(received.present) == vehicles))
        joined_s = time.perf_counter() - began_s
        await asyncio.sleep(0.3)
        trip_s = await round_trip_s(operator, received, vehicles)
        share = await loaded_share(counters)
    name = "keys" if secure else "plain"
    return (
        f"| {vehicles} | {name} | {made_s * 1e3:.0f} | {started_s * 1e3:.0f} | {joined_s * 1e3:.0f} |"
        f" {trip_s * 1e3:.2f} | {share:.1%} |"
    )


def main() -> None:
    """Measure teams of the given sizes, with keys and without."""
    reader = parser("bus_security", __doc__ or "")
    reader.add_argument("vehicles", nargs="*", type=int, default=[3, 16], help="team sizes (default: 3 16)")
    sizes = reader.parse_args().vehicles
    import gcs.keys.certificates  # noqa: F401  # so that it is not measured with the first keys

    columns = ("vehicles", "bus", "keys [ms]", "team together [ms]", "operator joined [ms]", "answers [ms]", "core")
    print(f"| {' | '.join(columns)} |")
    print("|---|---|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        for vehicles in sizes:
            for secure in (False, True):
                print(asyncio.run(measure(vehicles, secure=secure)), flush=True)


if __name__ == "__main__":
    main()
