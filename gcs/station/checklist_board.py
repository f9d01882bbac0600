"""The mission's checklist on the operator's page: shows who has ticked what, and takes ticks from pages."""

import asyncio
from collections.abc import Callable

from gcs.checklist import Checklist
from gcs.errors import InputError
from gcs.station.picture import ChecklistItemPicture, ChecklistPicture

_READ_EVERY_S = 0.3


class ChecklistBoard:
    """Follows the ticks of one mission's checklist until cancelled; `who` names the operator of the page, if any."""

    def __init__(self, checklist: Checklist, who: Callable[[], str]) -> None:
        self._checklist = checklist
        self._who = who

    async def run(self, publish: Callable[[ChecklistPicture], None]) -> None:
        """Publish the checklist whenever it has changed; without items, nothing."""
        shown = None
        while True:
            picture = await asyncio.to_thread(self._picture)
            if picture != shown and self._checklist.items:
                publish(picture)
            shown = picture
            await asyncio.sleep(_READ_EVERY_S)

    def tick(self, number: int, *, ticked: bool) -> None:
        """Take a tick from a page; none of an unknown item, nor from a page without an operator."""
        if (by := self._who()) and number < len(self._checklist.items):
            self._checklist.tick(number, by, ticked=ticked)

    def _picture(self) -> ChecklistPicture:
        try:
            ticks = self._checklist.ticks()
        except InputError as error:
            return ChecklistPicture((), error.faults[0])
        return ChecklistPicture(
            tuple(
                ChecklistItemPicture(item.text, item.required, tick.by, tick.wall_s, tick.used)
                if tick
                else ChecklistItemPicture(item.text, item.required)
                for item, tick in zip(self._checklist.items, ticks, strict=True)
            ),
            may_tick=bool(self._who()),
        )
