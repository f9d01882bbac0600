"""How a flight is asked to end before its time."""

import asyncio


class Stop:
    """The operator's wish to end: at first vehicles hold and land, at the second time they land at once."""

    def __init__(self) -> None:
        self.wanted = asyncio.Event()
        self.hurried = asyncio.Event()

    def ask(self) -> None:
        """Ask, or ask again."""
        (self.hurried if self.wanted.is_set() else self.wanted).set()
