"""Measure the cost of keys on the bus: start, round-trip time of a message, and computing time.

The vehicles of a team share one session, as in one process, or have one each, as in separate processes. All sessions,
including an operator's, are in this process.
"""

import asyncio
import os
import time
from contextlib import AsyncExitStack
from functools import partial
from statistics import median
from tempfile import TemporaryDirectory

from agents.shell.bus.zenoh_bus import ParticipantBus, Station, ZenohBus, single_bus
from agents.shell.bus.zenoh_session import BusTeam
from agents.team.codec import encode
from agents.team.messages import BusMessage, CommandAnswer, MemberState, OperatorCommand
from agents.team.participant import vehicle
from gcs.keys.run_keys import RunKeys
from gcs.keys.team_keys import NoKeys, TeamKeys
from tests.experiments.arguments import parser
from tests.support.wire import free_ports

TEAM = "measured"
RATE_HZ = 20.0
"""Message rate of each vehicle: twice that of a flight."""
ROUND_TRIPS = 200
LOADED_S = 5.0


class Counter:
    """One participant's record: messages received, and vehicles present. A vehicle answers commands."""

    def __init__(self, bus: ParticipantBus) -> None:
        self.bus = bus
        self.messages = 0
        self.present: set[int] = set()

    async def open(self) -> None:
        """Join."""
        await self.bus.open(self._take, lambda *_: None, self._note_presence)

    def _take(self, message: BusMessage) -> None:
        self.messages += 1
        if isinstance(message, OperatorCommand) and self.bus.vehicle_id is not None:
            self.bus.publish(
                "answer", encode(CommandAnswer(self.bus.vehicle_id, 1.0, message.number, "holds", outcome="obeyed"))
            )

    def _note_presence(self, vehicle_id: int, present: bool) -> None:
        (self.present.add if present else self.present.discard)(vehicle_id)


async def until(condition: partial[bool]) -> None:
    end_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end_s, "the bus did not come together"
        await asyncio.sleep(0.002)


async def opened(
    stack: AsyncExitStack, keys: TeamKeys, ids: tuple[int, ...], processes: int
) -> tuple[list[Counter], ParticipantBus, Counter]:
    """Open the buses of all vehicles at once, then an operator's; return when all vehicles are connected."""
    team, ends = BusTeam(TEAM, ids), [f"tcp/127.0.0.1:{port}" for port in free_ports(processes)]
    counters = []
    for k, end in enumerate(ends):
        own = ids[k::processes]
        (identity,) = keys.flying(own)
        others = [other for other in ends if other != end]
        bus = ZenohBus(team, [Station(tuple(map(vehicle, own)), end, identity.security)], others)
        counters += [Counter(bus.of(vehicle(i))) for i in own]
    await asyncio.gather(*(each.open() for each in counters))
    for each in counters:
        stack.push_async_callback(each.bus.close)
    await until(partial(lambda: all(len(each.present) == len(ids) - 1 for each in counters)))
    operator = keys.identity("operator")
    received = Counter(single_bus(operator.participant, team, None, ends, operator.security))
    return counters, received.bus, received


async def round_trip_s(bus: ParticipantBus, received: Counter, vehicles: int) -> float:
    """Return the median time from a command until all vehicles have answered."""
    times_s = []
    for number in range(ROUND_TRIPS):
        before, began_s = received.messages, time.perf_counter()
        name = bus.participant.name
        bus.publish("command/hold", encode(OperatorCommand(time.time(), "hold", None, name, number)))
        while received.messages < before + vehicles:
            assert time.perf_counter() < began_s + 5.0, "an answer is missing"
            await asyncio.sleep(0.0)
        times_s.append(time.perf_counter() - began_s)
        await asyncio.sleep(0.02)
    return median(times_s)


async def loaded_share(counters: list[Counter]) -> float:
    """Return the share of a processor core that messages take at the rate of a flight."""
    began_s, cpu_s = time.perf_counter(), time.process_time()
    period_s, sent, still = 1.0 / RATE_HZ, 0, (0.0, 0.0)
    while time.perf_counter() < began_s + LOADED_S:
        for each in counters:
            state = MemberState(int(each.bus.participant.name), time.time(), "encircle", still, still, still, still)
            each.bus.publish("member", encode(state))
        sent += 1
        await asyncio.sleep(max(0.0, began_s + sent * period_s - time.perf_counter()))
    return (time.process_time() - cpu_s) / (time.perf_counter() - began_s)


async def measure(vehicles: int, processes: int, *, secure: bool) -> str:
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
        counters, operator, received = await opened(stack, keys, ids, processes)
        started_s = time.perf_counter() - began_s
        began_s = time.perf_counter()
        await received.open()
        stack.push_async_callback(operator.close)
        await until(partial(lambda: len(received.present) == vehicles))
        joined_s = time.perf_counter() - began_s
        await asyncio.sleep(0.3)
        trip_s = await round_trip_s(operator, received, vehicles)
        share = await loaded_share(counters)
    name = "keys" if secure else "plain"
    return (
        f"| {vehicles} | {processes} | {name} | {made_s * 1e3:.0f} | {started_s * 1e3:.0f} | {joined_s * 1e3:.0f} |"
        f" {trip_s * 1e3:.2f} | {share:.1%} |"
    )


def main() -> None:
    """Measure teams of the given sizes, with keys and without."""
    reader = parser("bus_security", __doc__ or "")
    reader.add_argument("vehicles", nargs="*", type=int, default=[3, 16], help="team sizes (default: 3 16)")
    sizes = reader.parse_args().vehicles
    import gcs.keys.certificates  # noqa: F401  # so that it is not measured with the first keys

    columns = (
        "vehicles",
        "sessions",
        "bus",
        "keys [ms]",
        "team together [ms]",
        "operator joined [ms]",
        "answers [ms]",
        "core",
    )
    print(f"| {' | '.join(columns)} |")
    print("|---|---|---|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        for vehicles in sizes:
            for processes, secure in ((1, False), (1, True), (vehicles, False), (vehicles, True)):
                print(asyncio.run(measure(vehicles, processes, secure=secure)), flush=True)


if __name__ == "__main__":
    main()
