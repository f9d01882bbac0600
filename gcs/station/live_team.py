"""The pictures of a team that flies: it listens on the team's bus, and sends nothing."""

import asyncio
import time

from agents.ports import VehicleRefusedError
from agents.team.messages import BusMessage
from gcs.console.team_missions import TeamMissions
from gcs.console.watched_bus import WatchedBus
from gcs.errors import InputError
from gcs.mission.mission import Mission
from gcs.station.mission_picture import mission_picture
from gcs.station.picture import FlightSource, MissionPicture, OperatorRights
from gcs.station.source import Publish
from gcs.station.team_picture import TeamPictures

PICTURES_HZ = 10.0
_FOLLOWED_EVERY_S, _TRIED_AGAIN_S = 0.2, 1.0


class LiveTeam:
    """A source of pictures of the flights of one mission's team, one after the other."""

    def __init__(self, mission: Mission, source: FlightSource = "flight") -> None:
        """Take the mission that flies; `source` is what its vehicles are."""
        self._mission = mission
        self._source = source
        # The wall clock may be set meanwhile: it is read once.
        self._pictures = TeamPictures(mission, time.time() - time.monotonic())
        self._missions = TeamMissions(mission)
        self._fault = "looking for the team"
        self._is_over = False

    def mission(self, operator: OperatorRights) -> MissionPicture:
        """Return what does not change in flight, for a page of this operator."""
        return mission_picture(self._mission, self._source, self._mission.mission.duration_s, operator)

    async def run(self, publish: Publish) -> None:
        """Publish the team ten times a second, and events as they come, until cancelled.

        Nothing that the network does ends it: what keeps it from the team is in the pictures.
        """
        listening = asyncio.create_task(self._listen())
        try:
            while True:
                now_s = time.monotonic()
                picture = self._pictures.picture(now_s, self._link(), is_over=self._is_over)
                for event in self._pictures.new_events(now_s):
                    publish(event)
                publish(picture)
                await asyncio.sleep(1.0 / PICTURES_HZ)
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    async def _listen(self) -> None:
        """Listen to the flights of the team, whenever one runs."""
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
        self._pictures.receive(message, time.monotonic())
        self._missions.receive(message)

    def _link(self) -> str:
        """Return what keeps the page from the team, empty when nothing does."""
        try:
            self._missions.require_same()
        except VehicleRefusedError as other:
            return other.reason
        return self._fault or self._missions.difference
