"""Coming together before a mission: one vehicle's part in comparing clocks and agreeing on the start, over the bus."""

import asyncio
from collections.abc import Collection

from agents.ports import PeerBus, VehicleRefusedError
from agents.shell.clock import MissionClock
from agents.shell.start_proposal import Assembly, PeerClocks
from agents.team.messages import (
    TOPICS,
    BusMessage,
    StartProposal,
    encode,
)

START_TIMEOUT_S = 120.0
CLOCKS_TIMEOUT_S = 1.2
"""How long a take-off waits to hear the clocks of the peers that are there [wall s]: one may still be connecting."""
_PERIOD_S = TOPICS[StartProposal].period_s


class StartAgreement:
    """Tells the peers the time from `announce` on, that the vehicle is up from `agree` on, and hears theirs."""

    def __init__(self, bus: PeerBus, clock: MissionClock, vehicle_id: int, members: Collection[int]) -> None:
        self._bus = bus
        self._clock = clock
        self._assembly = Assembly(vehicle_id, members)
        self._clocks = PeerClocks()
        self._present: set[int] = set()
        self._announcing: asyncio.Task[None] | None = None
        self._over = False

    @property
    def start_s(self) -> float | None:
        """The mission's start on the shared clock, once agreed on."""
        return self._assembly.start_s

    @property
    def clock_lags_s(self) -> dict[int, float]:
        """How far the clocks of the peers' computers are behind this one's, as far as is known [wall s]."""
        return self._clocks.lags_s()

    def announce(self) -> None:
        """Tell the peers the time from now on: with the clock at its speed."""
        self._announcing = self._announcing or asyncio.create_task(self._announce())

    def hear(self, message: BusMessage) -> None:
        """Take what came over the bus; it is about start proposals alone.

        Once the mission has begun, who comes late, or back, is told when that was: it joins.
        """
        if self._announcing is None:  # this clock has not got its speed yet
            return
        if isinstance(message, StartProposal) and self._over:
            if message.start_s is None and message.sender in self._assembly.others:
                self._say(self._assembly.speak(self._clock.now_s()))
        elif isinstance(message, StartProposal):
            lag_s = self._clock.now_s() - message.time_s
            self._clocks.hear(message.sender, lag_s / self._clock.speed)
            if abs(lag_s) < TOPICS[StartProposal].age_max_s:
                self._assembly.hear(message)

    def note_presence(self, vehicle_id: int, present: bool) -> None:
        """Take the news that a peer has come or gone."""
        (self._present.add if present else self._present.discard)(vehicle_id)

    async def compare_clocks(self) -> None:
        """Compare with every peer that is there, while all are on the ground; those that come later do so then.

        Raises VehicleRefusedError when one has another time.
        """
        self.announce()
        end_s = self._clock.now_s() + CLOCKS_TIMEOUT_S * self._clock.speed
        while self._clocks.unjudged(self._present & self._assembly.others) and self._clock.now_s() < end_s:
            await self._pause()
        self._clocks.require_one_time()

    async def agree(self) -> float:
        """Wait for everybody to be up, and return when the mission starts, at that moment.

        Raises VehicleRefusedError when somebody is not heard, or has another time.
        """
        self.fall_silent()  # from here on it says that it is ready
        deadline_s = self._clock.now_s() + START_TIMEOUT_S
        while self.start_s is None or self._clock.now_s() < self.start_s:
            self._clocks.require_one_time()
            now_s = self._clock.now_s()
            if self.start_s is None and now_s > deadline_s:
                missing = ", ".join(map(str, self._assembly.missing(now_s)))
                raise VehicleRefusedError(
                    f"vehicles not heard on the bus within {START_TIMEOUT_S:.0f} s: {missing}",
                    "start their agents, or check the vehicles' endpoints in the mission file",
                )
            self._say(self._assembly.speak(now_s))
            await self._pause()
        self._over = True
        return self.start_s

    def fall_silent(self) -> None:
        """Tell the time no more."""
        if self._announcing is not None:
            self._announcing.cancel()

    async def _announce(self) -> None:
        while True:
            self._say(self._assembly.speak(self._clock.now_s(), ready=False))
            await self._pause()

    def _say(self, message: StartProposal) -> None:
        self._bus.publish(TOPICS[StartProposal].name, encode(message))

    async def _pause(self) -> None:
        await asyncio.sleep(_PERIOD_S / self._clock.speed)
