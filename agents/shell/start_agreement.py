"""The start agreement over the bus: one vehicle compares clocks with its peers and agrees with them on the start."""

import asyncio
from collections.abc import Collection

from agents.ports import PeerBus, VehicleRefusedError
from agents.shell.clock import MissionClock
from agents.shell.start_proposal import PeerClocks, TeamReadiness, is_possible
from agents.team.messages import TOPICS, BusMessage, StartProposal, encode

START_TIMEOUT_S = 120.0
CLOCKS_TIMEOUT_S = 1.2
"""How long a take-off waits for the clocks of the peers present [wall s]: one may still be connecting."""
_PERIOD_S = TOPICS[StartProposal].period_s


class StartAgreement:
    """Sends the time to the peers from `announce` on, and the vehicle's readiness from `agree` on; receives theirs."""

    def __init__(self, bus: PeerBus, clock: MissionClock, vehicle_id: int, members: Collection[int]) -> None:
        self._bus = bus
        self._clock = clock
        self._readiness = TeamReadiness(vehicle_id, members)
        self._clocks = PeerClocks()
        self._duration_s = 0.0
        self._present: set[int] = set()
        self._announcing: asyncio.Task[None] | None = None
        self._agreed = False

    @property
    def start_s(self) -> float | None:
        """The mission's start on the shared clock, once agreed on."""
        return self._readiness.start_s

    @property
    def clock_lags_s(self) -> dict[int, float]:
        """How far the clocks of the peers' computers are behind this one's, as far as is known [wall s]."""
        return self._clocks.lags_s()

    def bound(self, duration_s: float) -> None:
        """Take the mission's duration: one that began earlier is over, and is not joined."""
        self._duration_s = duration_s

    def announce(self) -> None:
        """Send the time to the peers from now on: with the clock at its speed."""
        self._announcing = self._announcing or asyncio.create_task(self._announce())

    def receive(self, message: BusMessage) -> None:
        """Take a message from the bus; messages other than those of the start agreement are ignored.

        A start that cannot be is not taken, nor the readiness that comes with it.
        A member that comes late, or back, is sent the start of the mission that has begun: it joins.
        """
        if self._announcing is None:  # the speed of this clock is not known yet
            return
        if isinstance(message, StartProposal) and self._agreed:
            if message.start_s is None and message.sender in self._readiness.others:
                self._publish(self._readiness.message(self._clock.now_s()))
        elif isinstance(message, StartProposal) and message.sender in self._readiness.others:
            now_s = self._clock.now_s()
            lag_s = now_s - message.time_s
            self._clocks.receive(message.sender, lag_s / self._clock.speed)
            if abs(lag_s) < TOPICS[StartProposal].age_max_s and is_possible(message, now_s, self._duration_s):
                self._readiness.receive(message)

    def note_presence(self, vehicle_id: int, present: bool) -> None:
        """Take whether a peer is present."""
        (self._present.add if present else self._present.discard)(vehicle_id)

    async def compare_clocks(self) -> None:
        """Compare clocks with the peers present, while all are on the ground; later ones are compared in `agree`.

        Raises VehicleRefusedError when a clock differs.
        """
        self.announce()
        end_s = self._clock.now_s() + CLOCKS_TIMEOUT_S * self._clock.speed
        while self._clocks.unmeasured(self._present & self._readiness.others) and self._clock.now_s() < end_s:
            await self._pause()
        self._clocks.require_one_time()

    async def agree(self) -> float:
        """Wait until all members are ready, and return the mission's start at that moment.

        Raises VehicleRefusedError when a member is not heard, or its clock differs.
        """
        self.fall_silent()  # from here on it reports that it is ready
        deadline_s = self._clock.now_s() + START_TIMEOUT_S
        while self.start_s is None or self._clock.now_s() < self.start_s:
            self._clocks.require_one_time()
            now_s = self._clock.now_s()
            if self.start_s is None and now_s > deadline_s:
                missing = ", ".join(map(str, self._readiness.missing(now_s)))
                raise VehicleRefusedError(
                    f"vehicles not heard on the bus within {START_TIMEOUT_S:.0f} s: {missing}",
                    "start their agents, or check the vehicles' endpoints in the mission file",
                )
            self._publish(self._readiness.message(now_s))
            await self._pause()
        self._agreed = True
        return self.start_s

    def fall_silent(self) -> None:
        """Stop sending the time."""
        if self._announcing is not None:
            self._announcing.cancel()

    async def _announce(self) -> None:
        while True:
            self._publish(self._readiness.message(self._clock.now_s(), ready=False))
            await self._pause()

    def _publish(self, message: StartProposal) -> None:
        self._bus.publish(TOPICS[StartProposal].name, encode(message))

    async def _pause(self) -> None:
        await asyncio.sleep(_PERIOD_S / self._clock.speed)
