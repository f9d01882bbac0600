"""A network of computers on links with delay and loss, in user space: for kernels without netem.

Each computer is a network namespace with a TUN device; this process forwards its packets with delay and loss.
"""

import fcntl
import heapq
import os
import random
import selectors
import struct
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from tests.support.computers import Computer, ip, namespace

_SET_NAME, _TUN, _NO_HEADER = 0x400454CA, 0x0001, 0x1000
"""From the kernel's if_tun.h: the request that names a device, and the flags of a device for IP packets."""
_PACKET_MAX = 65536
_DESTINATION = slice(16, 20)
"""The position of the destination address in an IPv4 packet."""


@dataclass(frozen=True)
class Wireless:
    """A computer's link to the others: each packet takes `delay_s` on it, and is lost with probability `loss`."""

    delay_s: float = 0.0
    loss: float = 0.0


class LossyNetwork:
    """Forwards packets between computers, over the link of the sender and that of the receiver."""

    def __init__(self, links: Sequence[Wireless], seed: int, stack: ExitStack) -> None:
        """Make a computer for each link; skips the test where this is not permitted."""
        self._chance = random.Random(seed)
        self._due: list[tuple[float, int, int, bytes]] = []
        self._sent = 0
        self._cut: set[int] = set()
        self._stop = threading.Event()
        self.computers: list[Computer] = []
        self._links: dict[bytes, tuple[int, Wireless]] = {}
        self._ready = selectors.DefaultSelector()
        stack.callback(self._ready.close)
        for k, link in enumerate(links, start=1):
            name = namespace(f"cl{os.getpid() % 100_000}n{k}", stack)
            device = _tun(f"cl{os.getpid() % 100_000}t{k}", stack)
            address = f"10.78.0.{k}"
            ip("link", "set", f"cl{os.getpid() % 100_000}t{k}", "netns", name, "name", "net")
            ip("-n", name, "address", "add", f"{address}/24", "dev", "net")
            ip("-n", name, "link", "set", "net", "up")
            self.computers.append(Computer(name, address))
            self._links[bytes((10, 78, 0, k))] = device, link
            self._ready.register(device, selectors.EVENT_READ, link)

    def cut(self, computer: Computer, cut: bool = True) -> None:
        """Cut or restore the link of a computer."""
        device, _ = self._links[bytes(map(int, computer.address.split(".")))]
        (self._cut.add if cut else self._cut.discard)(device)

    def run(self) -> None:
        """Forward packets until `stop`."""
        while not self._stop.is_set():
            wait_s = self._due[0][0] - time.monotonic() if self._due else 0.1
            for key, _ in self._ready.select(min(max(wait_s, 0.0), 0.1)):
                self._take(key.fd, key.data)
            while self._due and self._due[0][0] <= time.monotonic():
                _, _, device, packet = heapq.heappop(self._due)
                os.write(device, packet)

    def stop(self) -> None:
        """End `run`."""
        self._stop.set()

    def _take(self, device: int, link: Wireless) -> None:
        packet = os.read(device, _PACKET_MAX)
        receiver = self._links.get(packet[_DESTINATION])
        if receiver is None or device in self._cut or receiver[0] in self._cut:
            return
        if self._chance.random() < link.loss or self._chance.random() < receiver[1].loss:
            return
        self._sent += 1
        due_s = time.monotonic() + link.delay_s + receiver[1].delay_s
        heapq.heappush(self._due, (due_s, self._sent, receiver[0], packet))


@contextmanager
def lossy_network(links: Sequence[Wireless], seed: int = 1) -> Iterator[LossyNetwork]:
    """Set up a connected computer for each link, for the duration of the context."""
    with ExitStack() as stack:
        network = LossyNetwork(links, seed, stack)
        passing = threading.Thread(target=network.run, daemon=True)
        passing.start()
        try:
            yield network
        finally:
            network.stop()
            passing.join()


def _tun(name: str, stack: ExitStack) -> int:
    """Return a new open TUN device of this name, which is deleted when it is closed."""
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    stack.callback(os.close, device)
    fcntl.ioctl(device, _SET_NAME, struct.pack("16sH", name.encode(), _TUN | _NO_HEADER))
    return device
