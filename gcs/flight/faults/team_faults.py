"""The faults of a flying process: of its agents' buses and sensors, and of the process itself."""

import asyncio
import ctypes
import os
import time
from collections.abc import Mapping
from typing import Literal

import msgspec

HANG_S = 6
"""Duration of an injected hang of the process: longer than the supervisor waits."""

Hang = Literal["", "interpreter", "event loop", "exit"]


class TeamFaults(msgspec.Struct, frozen=True):
    """All faults of a flying process that are present at a time.

    `loss` is the share of messages that each agent does not receive, `delay_s` the delay of the others' messages [wall
    s]; no other vehicle receives the messages of `not_received`. Vehicles with `falsified_positions` report positions
    that are off by their `position_offset_m`; the states of `impostors` come from two sources, the second of which is
    off; `flooders` also send junk messages. `blind` sensors see no target. A process may `hang`.
    """

    loss: float = 0.0
    delay_s: float = 0.0
    not_received: frozenset[int] = frozenset()
    falsified_positions: frozenset[int] = frozenset()
    impostors: frozenset[int] = frozenset()
    position_offset_m: Mapping[int, tuple[float, float]] = {}
    flooders: frozenset[int] = frozenset()
    blind: bool = False
    hang: Hang = ""

    def with_more(self, more: "TeamFaults") -> "TeamFaults":
        """Return both: the vehicles of either, and the greater of two values. New faults end a hang."""
        return TeamFaults(
            loss=max(self.loss, more.loss),
            delay_s=max(self.delay_s, more.delay_s),
            not_received=self.not_received | more.not_received,
            falsified_positions=self.falsified_positions | more.falsified_positions,
            impostors=self.impostors | more.impostors,
            position_offset_m={**self.position_offset_m, **more.position_offset_m},
            flooders=self.flooders | more.flooders,
            blind=self.blind or more.blind,
            hang=more.hang,
        )


class PresentFaults:
    """The present faults of this process, and its event loop once its buses exist."""

    def __init__(self) -> None:
        self.now = TeamFaults()
        self.loop: asyncio.AbstractEventLoop | None = None

    def set(self, faults: TeamFaults) -> None:
        """Replace the present faults. A hang begins at once."""
        self.now = faults
        if faults.hang == "interpreter":
            ctypes.PyDLL(None).sleep(HANG_S)  # unlike CDLL, this keeps the lock: no thread of Python runs
        elif faults.hang == "event loop" and self.loop is not None:
            self.loop.call_soon_threadsafe(time.sleep, HANG_S)
        elif faults.hang == "exit":
            os._exit(0)
