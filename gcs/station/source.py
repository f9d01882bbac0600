"""Where the pictures come from that pages show: a team in flight, or what stands in for one."""

from collections.abc import Callable
from typing import Protocol

from gcs.station.picture import EventPicture, MissionPicture, OperatorRights, TeamPicture

Published = MissionPicture | TeamPicture | EventPicture
Publish = Callable[[Published], None]


class Source(Protocol):
    """The pictures of one team."""

    def mission(self, operator: OperatorRights) -> MissionPicture:
        """Return what does not change in flight, with what this operator may do."""
        ...

    async def run(self, publish: Publish) -> None:
        """Publish pictures of the team and events until cancelled.

        Raises InputError when this computer has no keys to listen with.
        """
        ...
