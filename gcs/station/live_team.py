"""The pictures of a flying team, from the messages on its bus; sends nothing."""

import asyncio
import time
from collections.abc import Collection
from math import inf
from urllib.parse import urlsplit

from agents.ports import VehicleRefusedError
from agents.team.messages import BusMessage
from gcs.console.team_bus import WatchedBus
from gcs.console.team_state import TeamMissions
from gcs.errors import InputError
from gcs.metrics.ending import LostFlight
from gcs.mission.mission import Mission
from gcs.station.broadcast import Publish
from gcs.station.picture import FlightSource, MissionPicture, OperatorRights, mission_picture
from gcs.station.team_picture import TeamPictures
from sitl.server.shared_clock import clock_time_s

PICTURES_HZ = 10.0
_FOLLOWED_EVERY_S, _TRIED_AGAIN_S = 0.2, 1.0
LOOKED_MAX_S = 0.5
"""A longer time between two looks is one for which this process lacked the processor, and has taken no messages."""


class LiveTeam:
    """A source of pictures of the successive flights of one mission's team."""

    def __init__(self, mission: Mission, source: FlightSource = "unstated") -> None:
        """Take the mission; `source` is the kind of its vehicles."""
        self._mission = mission
        self._source = source
        # The wall clock is read once, since it may be set during the flight.
        self._pictures = TeamPictures(mission, time.time() - time.monotonic())
        self._missions = TeamMissions(mission)
        self._standstill = Standstill({urlsplit(each.section.url).port or 0 for each in mission.vehicles})
        self._fault = "searching for the team"
        self._is_over = False
        self.has_lost_flight = False
        """Whether the flight that started this station was lost."""

    def mission(self, operator: OperatorRights) -> MissionPicture:
        """Return the constant part of the pictures, for a page of this operator."""
        return mission_picture(self._mission, self._source, self._mission.mission.duration_s, operator)

    def lose(self, flight: LostFlight) -> None:
        """Take the end of the flying process, from its supervisor."""
        self.has_lost_flight = True
        self._pictures.lose(flight, time.monotonic())

    def recover(self, vehicle_id: int) -> None:
        """Take an operator's confirmation that a vehicle was recovered."""
        self._pictures.recover(vehicle_id)

    async def run(self, publish: Publish) -> None:
        """Publish the team ten times a second, and events as they come, until cancelled.

        Network faults do not end it: the pictures state what separates it from the team.
        """
        listening = asyncio.create_task(self._listen())
        try:
            while True:
                now_s = time.monotonic()
                self._standstill.look(now_s)
                stood_s = self._standstill.duration_s
                picture = self._pictures.picture(now_s, self._link(), stood_s, is_over=self._is_over)
                for event in self._pictures.new_events(now_s):
                    publish(event)
                publish(picture)
                await asyncio.sleep(1.0 / PICTURES_HZ)
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    async def _listen(self) -> None:
        """Receive the messages of the team's flights, whenever one runs."""
        while True:
            try:
                async with WatchedBus(self._mission, self._take) as bus:
                    while True:
                        await bus.follow()
                        self._fault, self._is_over = bus.refusal, bool(bus.refusal)
                        await asyncio.sleep(_FOLLOWED_EVERY_S)
            except (InputError, VehicleRefusedError, OSError) as error:
                self._fault, self._is_over = str(error), False
            await asyncio.sleep(_TRIED_AGAIN_S)

    def _take(self, message: BusMessage) -> None:
        self._standstill.end()
        self._pictures.receive(message, time.monotonic())
        self._missions.receive(message)

    def _link(self) -> str:
        """Return the fault of the link to the team, empty without one."""
        try:
            self._missions.refuse_other()
        except VehicleRefusedError as other:
            return other.reason
        return self._fault or self._missions.difference


class Standstill:
    """Wall time since the last message for which nothing could come from a team; `look` several times a second.

    A busy computer must not look like a team that has vanished.
    """

    def __init__(self, ports: Collection[int]) -> None:
        """Take the UDP ports of the team's vehicles, by which the clock of a flight of stubs is found."""
        self._ports = ports
        self._looked_s, self._simulated_s = inf, inf
        self.duration_s = 0.0

    def look(self, now_s: float) -> None:
        """Add that this process did not look, and that the time of the stubs stood still; `now_s` is the wall's."""
        simulated_s = clock_time_s(self._ports)
        passed_s = max(now_s - self._looked_s, 0.0)
        went_on_s = min(passed_s, LOOKED_MAX_S)
        if simulated_s is not None:
            went_on_s = min(went_on_s, max(simulated_s - self._simulated_s, 0.0))
        self.duration_s += passed_s - went_on_s
        self._looked_s, self._simulated_s = now_s, inf if simulated_s is None else simulated_s

    def end(self) -> None:
        """Take that a message has come."""
        self.duration_s = 0.0
