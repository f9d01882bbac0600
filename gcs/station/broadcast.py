"""The content for all pages: the mission, the newest picture of the team, and the latest events.

Each picture is encoded once. A page takes what is new to it when it can: for a slow page newer pictures of the team
replace older ones, and events beyond the latest 200 are lost. So nothing is queued, and the source waits for no page.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import msgspec

from gcs.station.picture import (
    AnswerPicture,
    ChecklistPicture,
    EventPicture,
    MissionPicture,
    OperatorRights,
    ReceiptPicture,
    TeamPicture,
)

Published = MissionPicture | TeamPicture | EventPicture
Publish = Callable[[Published], None]


class Source(Protocol):
    """The pictures of one team."""

    def mission(self, operator: OperatorRights) -> MissionPicture:
        """Return the constant part of the pictures, with the rights of this operator."""
        ...

    def recover(self, vehicle_id: int) -> None:
        """Take an operator's confirmation that a vehicle was recovered."""
        ...

    async def run(self, publish: Publish) -> None:
        """Publish pictures of the team and events until cancelled.

        Raises InputError when this computer has no keys for the team's bus.
        """
        ...


EVENTS_KEPT = 200
_ANSWERS_KEPT = 1000


@dataclass(slots=True)
class Reading:
    """What one page has received, and the answers to its own commands that wait for it."""

    missions: int = 0
    checklists: int = 0
    teams: int = 0
    events: int = 0
    answers: deque[str] = field(default_factory=lambda: deque(maxlen=_ANSWERS_KEPT))


class Broadcast:
    """The pictures for all pages; `publish` never waits."""

    def __init__(self) -> None:
        self._mission = self._team = ""
        self._checklist = ""
        self._missions = self._teams = self._events = self._checklists = 0
        self._latest: deque[str] = deque(maxlen=EVENTS_KEPT)
        self._changed = asyncio.Event()

    def publish(self, picture: Published | ChecklistPicture) -> None:
        """Publish a picture to all pages; events get their numbers here."""
        match picture:
            case MissionPicture():
                self._mission, self._missions = _encoded(picture), self._missions + 1
            case ChecklistPicture():
                self._checklist, self._checklists = _encoded(picture), self._checklists + 1
            case EventPicture():
                self._events += 1
                self._latest.append(_encoded(msgspec.structs.replace(picture, number=self._events)))
            case _:
                self._team, self._teams = _encoded(picture), self._teams + 1
        self._wake()

    def answer(self, reading: Reading, answer: AnswerPicture | ReceiptPicture) -> None:
        """Publish an answer, or the receipt of a request, to one page."""
        reading.answers.append(_encoded(answer))
        self._wake()

    async def news(self, reading: Reading) -> list[str]:
        """Wait for what is new to a page, and return it, the mission first."""
        while True:
            changed = self._changed
            if news := self._take(reading):
                return news
            await changed.wait()

    def _take(self, reading: Reading) -> list[str]:
        if not self._missions:
            return []
        mission = [self._mission] if reading.missions < self._missions else []
        checklist = [self._checklist] if reading.checklists < self._checklists else []
        team = [self._team] if reading.teams < self._teams else []
        unseen = min(self._events - reading.events, len(self._latest))
        events = list(self._latest)[len(self._latest) - unseen :]
        answers = list(reading.answers)
        reading.answers.clear()
        reading.missions, reading.teams, reading.events = self._missions, self._teams, self._events
        reading.checklists = self._checklists
        return [*mission, *checklist, *team, *events, *answers]

    def _wake(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()


def _encoded(picture: Published | ChecklistPicture | AnswerPicture | ReceiptPicture) -> str:
    return msgspec.json.encode(picture).decode()
