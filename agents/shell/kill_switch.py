"""Cutting the motors: at once, whatever the agent is doing, and until the vehicle says that it is disarmed."""

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import TypeVar

from agents.ports import VehicleLink, VehicleRefusedError

Result = TypeVar("Result")


class KillSwitch:
    """Carries out a kill over a vehicle's link, beside everything else, and stops what is in its way."""

    def __init__(self, link: VehicleLink, tell: Callable[[str], object]) -> None:
        """Take the link, and whom to tell what came of it: why it failed, or nothing when it did not."""
        self._link = link
        self._tell = tell
        self._thrown = asyncio.Event()
        self._cutting: asyncio.Task[VehicleRefusedError | None] | None = None

    @property
    def thrown(self) -> bool:
        """Whether it has been thrown."""
        return self._thrown.is_set()

    def throw(self) -> None:
        """Cut the motors, unless that is being done; once more if it was done before."""
        if self._cutting is None or self._cutting.done():
            self._cutting = asyncio.create_task(self._cut())
        self._thrown.set()

    async def failure(self) -> VehicleRefusedError | None:
        """Wait until it is done; return why it failed, None when the motors are cut."""
        return None if self._cutting is None else await asyncio.shield(self._cutting)

    async def unless_thrown(self, work: Coroutine[None, None, Result]) -> Result | None:
        """Return what some work returns; None, and the work is stopped, once the switch is thrown."""
        task = asyncio.ensure_future(work)
        thrown = asyncio.create_task(self._thrown.wait())
        try:
            await asyncio.wait((task, thrown), return_when=asyncio.FIRST_COMPLETED)
            return task.result() if task.done() else None
        finally:
            for each in (task, thrown):
                each.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await task

    async def _cut(self) -> VehicleRefusedError | None:
        try:
            await self._link.kill()
        except VehicleRefusedError as refusal:
            self._tell(refusal.reason)
            return refusal
        self._tell("")
        return None
