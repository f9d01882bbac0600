"""A station whose simulated team moves on a ring, served by the real server in a separate process, without a flight.

`python -m tests.support.page.moving_station VEHICLES` prints the page's address and serves until it is ended.
"""

import asyncio
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from gcs.mission.file import parse_mission
from gcs.station.access import Access
from gcs.station.broadcast import Broadcast, Publish
from gcs.station.commands import Commands
from gcs.station.live_team import PICTURES_HZ
from gcs.station.picture import EventPicture, MissionPicture, OperatorRights
from gcs.station.server import listen, serve_team
from gcs.viewer.address import Address
from tests.support import ring_mission as flown
from tests.support.page.station import TOKEN
from tests.support.page.station_pictures import ring_mission, ring_team
from tests.support.paths import ROOT, finds_tests
from tests.support.wire import LOOPBACK, free_port, free_ports

EVENTS_HZ = 1.0
"""More events than a flight has: the page's list of events is full after some minutes."""


class MovingTeam:
    """A source of pictures of a team on its ring, at the rate of a flight's, with an event a second."""

    def __init__(self, vehicles: int) -> None:
        self._mission = ring_mission(vehicles)

    def mission(self, operator: OperatorRights) -> MissionPicture:
        """Return the mission with all commands enabled, so that the page shows all its parts."""
        return self._mission

    async def run(self, publish: Publish) -> None:
        """Publish until cancelled."""
        began_s, events = time.monotonic(), 0
        while True:
            time_s = time.monotonic() - began_s
            publish(ring_team(self._mission, time_s))
            if time_s * EVENTS_HZ >= events:
                events += 1
                vehicle_id = events % len(self._mission.vehicles) + 1
                publish(EventPicture(0, time_s, time.time(), "information", "hold -> encircle", vehicle_id))
            await asyncio.sleep(1.0 / PICTURES_HZ)


async def serve_moving(vehicles: int) -> None:
    """Print the page's address and serve it until cancelled."""
    ports = free_ports(2 * vehicles)
    mission = parse_mission(flown.ring_mission(vehicles, 60.0, ports[:vehicles], ports[vehicles:]), None)
    access = Access(Address(LOOPBACK, free_port()), TOKEN)

    def commands(broadcast: Broadcast) -> Commands:
        return Commands(mission, None, broadcast.publish)

    listening = listen(access)
    print(access.url, flush=True)
    await serve_team(MovingTeam(vehicles), commands, access, listening, asyncio.Event())


@contextmanager
def moving_station(vehicles: int) -> Iterator[tuple[str, int]]:
    """Run such a station; yield the page's address and the id of the process."""
    command = [sys.executable, "-m", "tests.support.page.moving_station", str(vehicles)]
    with subprocess.Popen(command, cwd=ROOT, env=finds_tests(), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip(), process.pid
        finally:
            process.kill()


if __name__ == "__main__":
    asyncio.run(serve_moving(int(sys.argv[1])))
