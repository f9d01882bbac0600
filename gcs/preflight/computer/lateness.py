"""How late this computer wakes a control loop: timers at the loop's rate on the flight's event loop, under its load.

The load is that of the links, whatever they send, and of cores that plan a flight at rest (`Rehearsal`). Left out are
the messages of other processes, the ring's planner, the log and the live view.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from agents.shell.clock import WallClock
from agents.shell.ticker import Tick, Ticker, TickerClock
from gcs.mission.mission import Mission, MissionVehicle
from gcs.preflight.computer.rehearsal import Rehearsal

MEASURED_S = 3.0


@dataclass(frozen=True, slots=True)
class Lateness:
    """How late timers of `rate_hz` were: `count` deadlines, of which `missed` passed while the one before was late."""

    rate_hz: float
    count: int
    missed: int
    mean_s: float
    max_s: float


def lateness(ticks: Sequence[Tick], rate_hz: float) -> Lateness:
    """Return the lateness of ticks [wall s]; raises ValueError without a tick.

    Deadlines that passed before a tick are counted, each with its own lateness: a pause of 0.5 s at 10 Hz makes five
    deadlines late, the first by 0.5 s.
    """
    late_s = [tick.late_s + before / rate_hz for tick in ticks for before in range(tick.skipped + 1)]
    count = len(late_s)
    if not count:
        raise ValueError("no tick was measured")
    return Lateness(rate_hz, count, count - len(ticks), sum(late_s) / count, max(late_s))


async def measured_lateness(
    mission: Mission,
    vehicles: Sequence[MissionVehicle],
    speed: float = 1.0,
    *,
    duration_s: float = MEASURED_S,
    clock: TickerClock | None = None,
) -> Lateness:
    """Measure `duration_s` [wall s] of one timer for each vehicle, spread over the period as in flight.

    `speed` is how many times as fast as the wall the mission clock runs; the `clock` is the wall's if none is given.
    """
    clock = clock or WallClock()
    rate_hz = mission.mission.rate_hz * speed
    rehearsal, began_s = Rehearsal(mission, vehicles), clock.now_s()
    count = round(duration_s * rate_hz)

    async def timed(index: int) -> list[Tick]:
        start_s = began_s + (1.0 + index / len(vehicles)) / rate_hz
        ticker = Ticker(1.0 / rate_hz, clock, start_s)
        ticks: list[Tick] = []
        while not ticks or ticks[-1].index < count - 1:
            ticks.append(await ticker.next())
            rehearsal.tick(index, ticks[-1].index / mission.mission.rate_hz)
        return ticks

    each = await asyncio.gather(*map(timed, range(len(vehicles))))
    return lateness([tick for ticks in each for tick in ticks], rate_hz)
