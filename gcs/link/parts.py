"""The MAVSDK objects of one connected vehicle."""

from typing import Any, NamedTuple

from gcs.link.calls import VehicleCalls
from gcs.link.feed import VehicleFeed


class LinkParts(NamedTuple):
    """The MAVSDK objects of a connected link."""

    system: Any
    feed: VehicleFeed
    calls: VehicleCalls
    action: Any
    offboard: Any

    def destroy(self) -> None:
        """Destroy MAVSDK's plugins; blocks until running callbacks have returned."""
        self.offboard.destroy()
        self.action.destroy()
        self.feed.close()
