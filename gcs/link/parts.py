"""The MAVSDK objects of one connected vehicle."""

from typing import Any, NamedTuple

from gcs.link.calls import VehicleCalls
from gcs.link.external_position import ExternalPositionSender
from gcs.link.feed import VehicleFeed


class LinkParts(NamedTuple):
    """The MAVSDK objects of a connected link."""

    system: Any
    feed: VehicleFeed
    calls: VehicleCalls
    action: Any
    offboard: Any
    external: ExternalPositionSender | None

    def destroy(self) -> None:
        """Destroy MAVSDK's plugins; blocks until running callbacks have returned."""
        if self.external is not None:
            self.external.close()
        self.offboard.destroy()
        self.action.destroy()
        self.feed.close()
