"""A pseudo terminal in place of a serial device: another program opens its other end by a name."""

import os
import tty
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from gcs.link.relay.carriers import Received, StreamCarrier
from gcs.link.relay.gate import Address


class PseudoTerminal:
    """A carrier to a program that opens `path`, a symbolic link to the other end of a pseudo terminal.

    The link is removed at the end. Raises OSError if `path` exists and is not a dangling link.
    """

    blocks = False

    def __init__(self, path: Path) -> None:
        if path.is_symlink() and not path.exists():
            path.unlink()  # the program that created it has ended
        self.known: Address = (str(path), 0)
        self._path = path
        master, self._slave = os.openpty()  # kept open: the master cannot be read without an open slave
        tty.setraw(self._slave)
        self._stream = StreamCarrier(master, lambda: os.close(master))
        try:
            path.symlink_to(os.ttyname(self._slave))
        except OSError:
            self._end()
            raise

    def watched(self) -> Sequence[int]:
        """Return the file descriptor that becomes readable."""
        return (self._stream.descriptor,)

    def receive(self) -> Iterator[Received]:
        """Yield received data."""
        self._stream.write()
        if data := self._stream.read():
            yield data, self.known

    def send(self, frame: bytes, _address: Address) -> bool:
        """Send one frame; return whether it was accepted."""
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
