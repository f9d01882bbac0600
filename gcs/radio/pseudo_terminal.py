"""A serial device that is none: a pseudo terminal, whose other end a program opens by a name."""

import os
import tty
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from gcs.link.relay.carriers import Received, Stream
from gcs.link.relay.gate import Address


class PseudoTerminal:
    """A carrier of what another program reads and writes at `path`, a link to the other end; it is removed at the end.

    Raises OSError when there is something at `path` that is not such a link left behind.
    """

    blocks = False

    def __init__(self, path: Path) -> None:
        if path.is_symlink() and not path.exists():
            path.unlink()  # its terminal ended with the program that made it
        self.known: Address = (str(path), 0)
        self._path = path
        master, self._slave = os.openpty()  # kept open: without any reader the master could not be read
        tty.setraw(self._slave)
        self._stream = Stream(master, lambda: os.close(master))
        try:
            path.symlink_to(os.ttyname(self._slave))
        except OSError:
            self._end()
            raise

    def watched(self) -> Sequence[int]:
        """Return the file descriptor that becomes readable."""
        return (self._stream.descriptor,)

    def receive(self) -> Iterator[Received]:
        """Yield what has arrived."""
        self._stream.write()
        if data := self._stream.read():
            yield data, self.known

    def send(self, frame: bytes, _address: Address) -> bool:
        """Send one frame; return whether it was taken."""
        return self._stream.write(frame)

    def call_again(self) -> None:
        """Do nothing: a terminal does not end."""

    def close(self) -> None:
        """Remove the link."""
        self._end()
        with suppress(OSError):
            self._path.unlink()

    def _end(self) -> None:
        self._stream.close()
        os.close(self._slave)
