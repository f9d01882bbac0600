"""An emulated radio between a station's connection and those of its vehicles: splits bytes into frames, delays them."""

import os
import select
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import ceil, inf
from pathlib import Path

from gcs.link.relay.carriers import Carrier, Received, StreamCarrier, open_carrier
from gcs.link.relay.frames import FrameStream, radio_status
from gcs.link.relay.gate import Address
from sitl.radio import Air, Channel, Counts, RadioSpec


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


LOOK_PERIOD_S = 0.2
STATUS_PERIOD_S = 1.0
TERMINAL = "pty:"


def open_place(place: str) -> Carrier:
    """Open a connection by its url, or a pseudo terminal by pty:PATH; raises OSError or ValueError."""
    return PseudoTerminal(Path(place.removeprefix(TERMINAL))) if place.startswith(TERMINAL) else open_carrier(place)


@dataclass(slots=True)
class _End:
    """A connection, the address that it last received from, and a frame parser for each address."""

    carrier: Carrier
    address: Address | None
    streams: dict[Address, FrameStream] = field(default_factory=dict)

    @classmethod
    def at(cls, place: str) -> "_End":
        carrier = open_place(place)
        return cls(carrier, carrier.known)

    def frames(self) -> list[bytes]:
        frames = []
        self.carrier.call_again()
        for data, address in self.carrier.receive():
            self.address = address if data else self.carrier.known
            frames += self.streams.setdefault(address, FrameStream()).feed(data)
        return frames

    def send(self, frame: bytes) -> None:
        if self.address is not None:
            self.carrier.send(frame, self.address)


class Emulation:
    """Carries the frames between one station and its vehicles, through a radio for each vehicle or one for all.

    Raises OSError or ValueError if a connection cannot be opened.
    """

    def __init__(self, spec: RadioSpec, station: str, vehicles: Sequence[str], air: Air | None = None) -> None:
        """Open all connections; `air` is shared with other emulations."""
        self._spec = spec
        self.places = tuple(vehicles)
        self._ends = [_End.at(station)]
        try:
            for place in vehicles:
                self._ends.append(_End.at(place))
        except (OSError, ValueError):
            self.close()
            raise
        self._station, receivers = self._ends[0], self._ends[1:]
        groups = [receivers] if spec.shared else [[end] for end in receivers]
        shared = air or Air(spec.bytes_s)
        self._ups = [(group, self._channel(index, shared)) for index, group in enumerate(groups)]
        self._downs = [(end, self._channel(len(groups) + index, shared)) for index, end in enumerate(receivers)]
        self._status_next_s = -inf
        self._sequence = 0

    def _channel(self, index: int, shared: Air) -> Channel:
        air = shared if self._spec.shared else Air(self._spec.bytes_s)
        return Channel(self._spec, air, (self._spec.seed, index))

    @property
    def up(self) -> list[Counts]:
        """Counts of the frames to the vehicles, for each radio."""
        return [channel.counts for _, channel in self._ups]

    @property
    def groups(self) -> list[str]:
        """The connections that each count of `up` covers."""
        return [", ".join(self.places)] if self._spec.shared else list(self.places)

    @property
    def down(self) -> list[Counts]:
        """Counts of the frames from each vehicle."""
        return [channel.counts for _, channel in self._downs]

    def watched(self) -> list[int]:
        """Return the file descriptors of all connections."""
        return [descriptor for end in self._ends for descriptor in end.carrier.watched()]

    def turn(self, now_s: float) -> None:
        """Receive from both sides, and send the frames that are due."""
        for frame in self._station.frames():
            for _, channel in self._ups:
                channel.send(frame, now_s)
        for end, channel in self._downs:
            for frame in end.frames():
                channel.send(frame, now_s)
            for frame in channel.arrived(now_s):
                self._station.send(frame)
        for group, channel in self._ups:
            for frame in channel.arrived(now_s):
                for end in group:
                    end.send(frame)
        if now_s >= self._status_next_s:
            self._status_next_s = now_s + STATUS_PERIOD_S
            self._report(now_s)

    def due_s(self) -> float:
        """Return when a frame arrives next [s]."""
        return min(channel.arrives_s() for _, channel in (*self._ups, *self._downs))

    def close(self) -> None:
        """Close all connections."""
        for end in self._ends:
            end.carrier.close()

    def _report(self, now_s: float) -> None:
        """Send the station a RADIO_STATUS of each radio, as SiK radios do."""
        for _, channel in self._ups:
            self._sequence += 1
            waiting = channel.waiting_bytes(now_s) / self._spec.buffer_bytes
            self._station.send(radio_status(self._sequence, 1.0 - waiting))


def run(emulations: Sequence[Emulation], stops: Callable[[], bool], each_second: Callable[[], object]) -> None:
    """Run radios until `stops`; `each_second` is called once a second."""
    second_s = time.monotonic()
    while not stops():
        poll = select.poll()
        for emulation in emulations:
            for descriptor in emulation.watched():
                poll.register(descriptor, select.POLLIN)
        due_s = min(emulation.due_s() for emulation in emulations)
        poll.poll(ceil(1e3 * min(max(due_s - time.monotonic(), 0.0), LOOK_PERIOD_S)))
        now_s = time.monotonic()
        for emulation in emulations:
            emulation.turn(now_s)
        if now_s >= second_s:
            second_s += 1.0
            each_second()
