"""A periodic look at a link, which comes early when the link needs attention."""

import asyncio

from agents.shell.clock import MissionClock


class Attention:
    """Waits for periods of a link, or until it is notified."""

    def __init__(self, clock: MissionClock) -> None:
        self._clock = clock
        self._over = asyncio.Event()
        self._notified = False

    def notify(self) -> None:
        """End the present wait."""
        self._notified = True
        self._over.set()

    async def wait(self, period_s: float) -> bool:
        """Wait for a period [s of the link] or for a notification, and return whether it was notified."""
        timer = self._clock.call_at(self._clock.now_s() + period_s * self._clock.time_scale, self._over.set)
        try:
            await self._over.wait()
        finally:
            timer.cancel()
        self._over.clear()
        notified, self._notified = self._notified, False
        return notified
