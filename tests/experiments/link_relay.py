"""Measure the delay and computing time that the relay between MAVSDK and the vehicles adds to each frame.

The vehicles and MAVSDK's ends are in another process, which time-stamps each frame; this process holds the relays only.
As the reference, the other process sends the same frames directly from socket to socket.
"""

import multiprocessing
import secrets
import select
import socket
import struct
import time
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from statistics import median, quantiles

from gcs.link.relay.frames import MAGIC_V2, FrameStream, header
from gcs.link.relay.relay import Relay
from gcs.link.relay.relay_thread import RelayThread
from gcs.link.relay.signing import Signing
from tests.experiments.arguments import parser
from tests.support.wire import LOOPBACK, free_ports

UP_HZ, SETPOINTS_PER_S = 100, 20
"""Frame rates of each vehicle: telemetry at the requested rates, and setpoints."""
MEASURED_S = 10.0
HEARTBEAT, OWN_MESSAGE, SETPOINT = 0, 30, 84
HEARTBEAT_PAYLOAD = bytes((0, 0, 0, 0, 2, 12, 0, 4, 3))
REPEATED_S = 0.2

Key = bytes | None


def frame(system_id: int, component: int, message: int, payload: bytes) -> bytes:
    """Return a MAVLink 2 frame without a valid checksum: the relay reads headers and signatures only."""
    return (
        bytes((MAGIC_V2, len(payload), 0, 0, 0, system_id, component))
        + message.to_bytes(3, "little")
        + payload
        + b"\0\0"
    )


def dated(system_id: int, component: int, message: int) -> bytes:
    return frame(system_id, component, message, struct.pack("<d", time.monotonic()) + bytes(32))


def age_s(data: bytes) -> float:
    return float(time.monotonic() - struct.unpack_from("<d", data, 10)[0])


@dataclass
class Vehicle:
    """One vehicle's socket, MAVSDK's end of its relay, and a pair of sockets without a relay between them."""

    system_id: int
    port: int
    inner: socket.socket
    key: Key
    outer: socket.socket = field(default_factory=lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    direct: socket.socket = field(default_factory=lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM))

    def __post_init__(self) -> None:
        self.signing = None if self.key is None else Signing(self.key)
        self.stream = FrameStream()
        self.direct.bind((LOOPBACK, 0))
        self.ages_s: dict[str, list[float]] = {"up": [], "down": [], "direct": []}

    def sign(self, data: bytes) -> bytes:
        return data if self.signing is None else self.signing.sign(data)

    def heartbeat(self) -> None:
        self.outer.sendto(self.sign(frame(self.system_id, 1, HEARTBEAT, HEARTBEAT_PAYLOAD)), (LOOPBACK, self.port))

    def send_up(self) -> None:
        self.outer.sendto(self.sign(dated(self.system_id, 1, OWN_MESSAGE)), (LOOPBACK, self.port))
        self.outer.sendto(dated(self.system_id, 1, OWN_MESSAGE), self.direct.getsockname())

    def send_down(self) -> None:
        self.inner.sendall(dated(245, 190, SETPOINT))

    def receive(self, source: socket.socket) -> None:
        if source is self.inner:
            for each in self.stream.feed(source.recv(65_536)):
                if header(each).message == OWN_MESSAGE:
                    self.ages_s["up"].append(age_s(each))
            return
        data = source.recv(65_536)
        if source is self.direct:
            self.ages_s["direct"].append(age_s(data))
        elif header(data).message == SETPOINT:
            self.ages_s["down"].append(age_s(data))


def play(vehicles: list[Vehicle], control: Connection) -> None:
    """Play the vehicles and MAVSDK: heartbeats until the relays have verified them, then time-stamped frames."""
    owners = {source: each for each in vehicles for source in (each.inner, each.outer, each.direct)}
    while not control.poll(REPEATED_S):
        for each in vehicles:
            each.heartbeat()
    control.recv()
    began_s, sent, count = time.monotonic(), 0, len(vehicles)
    while (now_s := time.monotonic()) < began_s + MEASURED_S:
        # Frames are spread evenly over time and vehicles, so that none waits for another.
        while sent < (now_s - began_s) * UP_HZ * count:
            each = vehicles[sent % count]
            each.send_up()
            if sent // count % (UP_HZ // SETPOINTS_PER_S) == 0:
                each.send_down()
            sent += 1
        due_s = began_s + sent / (UP_HZ * count) - time.monotonic()
        for source in select.select(owners, [], [], max(0.0, due_s))[0]:
            owners[source].receive(source)
    control.send({kind: [age for each in vehicles for age in each.ages_s[kind]] for kind in ("up", "down", "direct")})


def lateness(ages_s: list[float]) -> str:
    return f"{median(ages_s) * 1e6:.0f} | {quantiles(ages_s, n=100)[98] * 1e6:.0f}"


def measure(count: int, *, signed: bool) -> str:
    """Return a line of the table."""
    thread = RelayThread("relays")
    relays, vehicles = [], []
    for system_id, port in enumerate(free_ports(count), 1):
        relay = Relay(f"udpin://{LOOPBACK}:{port}", thread)
        host, inner_port = relay.inner_url.removeprefix("tcpout://").split(":")
        inner = socket.create_connection((host, int(inner_port)))
        inner.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        relays.append(relay)
        vehicles.append(Vehicle(system_id, port, inner, secrets.token_bytes(32) if signed else None))
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("fork").Process(target=play, args=(vehicles, there))
    process.start()
    for relay, vehicle in zip(relays, vehicles, strict=True):
        relay.start()
        relay.claim(vehicle.system_id, None if vehicle.key is None else Signing(vehicle.key))
    for relay, vehicle in zip(relays, vehicles, strict=True):
        while not (found := relay.candidates(vehicle.system_id)):
            time.sleep(0.05)
        relay.verify(vehicle.system_id, found[0])
    cpu_s = time.process_time()
    here.send("begin")
    ages_s = here.recv()
    cpu_s = time.process_time() - cpu_s
    process.join()
    for relay in relays:
        relay.close()
    thread.close()
    frames, sent = len(ages_s["up"]) + len(ages_s["down"]), count * MEASURED_S * (UP_HZ + SETPOINTS_PER_S)
    return (
        f"| {count} | {'yes' if signed else 'no'} | {lateness(ages_s['up'])} | {lateness(ages_s['down'])} |"
        f" {lateness(ages_s['direct'])} | {cpu_s / frames * 1e6:.0f} | {cpu_s / MEASURED_S:.1%} |"
        f" {1 - frames / sent:.2%} |"
    )


def main() -> None:
    """Measure the given numbers of vehicles, unsigned and signed."""
    reader = parser("link_relay", __doc__ or "")
    reader.add_argument("vehicles", nargs="*", type=int, default=[3, 16], help="numbers of vehicles (default: 3 16)")
    counts = reader.parse_args().vehicles
    lates = (f"{way} {figure} [us]" for way in ("up", "down", "direct") for figure in ("median", "p99"))
    columns = ("vehicles", "signed", *lates, "per frame [us]", "core", "lost")
    print(f"| {' | '.join(columns)} |")
    print("|" + "---|" * len(columns))
    for count in counts:
        for signed in (False, True):
            print(measure(count, signed=signed), flush=True)


if __name__ == "__main__":
    main()
