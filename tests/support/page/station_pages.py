"""Pages of a station without a browser: connections that read its pictures, some slowly and some never.

`python -m tests.support.page.station_pages ADDRESS COUNT` opens them, again whenever one is closed, and prints once a
second how many are open, how many messages a second those that read at once receive, and how many were closed by the
station in all. It runs until it is killed.
"""

import asyncio
import socket
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from itertools import cycle, islice

from websockets.exceptions import WebSocketException

from tests.support.page.station import entered, stream
from tests.support.wire import LOOPBACK

PAUSES_S = (0.0, 0.0, 0.0, 1.0, 3600.0)
"""The pauses of pages between reads, in turn: of five, three read at once, one slowly, one never."""
_WINDOW_BYTES = 4096
_AGAIN_S = 0.5


@dataclass
class Readers:
    """The counts of this process's pages: open pages, messages read by fast ones, closed pages."""

    opened: int = 0
    messages: int = 0
    closed: int = 0


async def read(port: int, cookie: str, pause_s: float, readers: Readers) -> None:
    """Read as one page does, and connect again whenever the connection ends."""
    while True:
        connection = socket.socket()
        connection.setblocking(False)
        if pause_s > 0.0:  # otherwise the system's buffers hold the unread messages of minutes
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _WINDOW_BYTES)
        with connection, suppress(WebSocketException, OSError):
            await asyncio.get_running_loop().sock_connect(connection, (LOOPBACK, port))
            async with stream(port, cookie, sock=connection, max_queue=1) as page:
                readers.opened += 1
                try:
                    async for _ in page:
                        readers.messages += pause_s == 0.0
                        await asyncio.sleep(pause_s)
                finally:
                    readers.opened -= 1
                    readers.closed += 1
        await asyncio.sleep(_AGAIN_S)


async def report(readers: Readers) -> None:
    """Print the counts once a second."""
    while True:
        before, began_s = readers.messages, time.monotonic()
        await asyncio.sleep(1.0)
        messages_hz = (readers.messages - before) / (time.monotonic() - began_s)
        print(readers.opened, round(messages_hz), readers.closed, flush=True)


async def read_all(address: str, count: int) -> None:
    """Read as this many pages."""
    port, cookie = entered(address)
    readers = Readers()
    async with asyncio.TaskGroup() as group:
        group.create_task(report(readers))
        for pause_s in islice(cycle(PAUSES_S), count):
            group.create_task(read(port, cookie, pause_s, readers))


if __name__ == "__main__":
    asyncio.run(read_all(sys.argv[1], int(sys.argv[2])))
