"""The source of the pictures that pages show: a team in flight, or a substitute."""

from collections.abc import Callable
from typing import Protocol

from gcs.station.picture import EventPicture, MissionPicture, OperatorRights, TeamPicture

Published = MissionPicture | TeamPicture | EventPicture
Publish = Callable[[Published], None]


class Source(Protocol):
    """The pictures of one team."""

    def mission(self, operator: OperatorRights) -> MissionPicture:
        """Return the constant part of the pictures, with the rights of this operator."""
        ...

    async def run(self, publish: Publish) -> None:
        """Publish pictures of the team and events until cancelled.

        Raises InputError when this computer has no keys for the team's bus.
        """
        ...
