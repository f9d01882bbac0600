"""A UDP relay between one autopilot and cordon: it can be cut, counts setpoints, and reads every flight mode.

It listens at the autopilot's port and forwards to cordon's. It is also a second MAVLink client.
"""

import asyncio
import struct
from collections.abc import Callable, Iterator
from typing import NamedTuple, cast

from pymavlink.dialects.v20 import common as mavlink

LOOPBACK = "127.0.0.1"
HEARTBEAT, GLOBAL_POSITION, SETPOINT, CURRENT_MODE = 0, 33, 84, 436
MAGIC_2, SIGNED, HEAD, CHECKSUM, SIGNATURE = 0xFD, 1, 10, 2, 13
AUTOPILOT = 1
CLIENT_ID, CLIENT_COMPONENT = 250, 190

Address = tuple[str, int]


class Message(NamedTuple):
    """A MAVLink 2 message: its sender, its id, and its payload without trailing zeros."""

    sender: int
    component: int
    kind: int
    payload: bytes


def messages(datagram: bytes) -> Iterator[Message]:
    """Return the MAVLink 2 messages at the start of a datagram."""
    while len(datagram) >= HEAD + CHECKSUM and datagram[0] == MAGIC_2:
        length, flags, sender, component = datagram[1], datagram[2], datagram[5], datagram[6]
        kind = int.from_bytes(datagram[7:10], "little")
        yield Message(sender, component, kind, datagram[HEAD : HEAD + length])
        datagram = datagram[HEAD + length + CHECKSUM + (SIGNATURE if flags & SIGNED else 0) :]


class Relay:
    """Between an autopilot that sends to `front_port` and a client that listens at `back_port`."""

    def __init__(
        self,
        system_id: int,
        front_port: int,
        back_port: int,
        *,
        on_message: Callable[[Message], None],
        on_setpoint: Callable[[], None],
        on_heartbeat: Callable[[], None] = lambda: None,
    ) -> None:
        """Take the receivers of the autopilot's messages, and of the client's setpoints and heartbeats."""
        self.cut = False
        self.setpoints = 0
        self._system_id = system_id
        self._on_message = on_message
        self._on_setpoint = on_setpoint
        self._on_heartbeat = on_heartbeat
        self._autopilot: Address | None = None
        self._client = (LOOPBACK, back_port)
        self._front_port = front_port
        self._front: asyncio.DatagramTransport | None = None
        self._back: asyncio.DatagramTransport | None = None
        self._mavlink = mavlink.MAVLink(None, CLIENT_ID, CLIENT_COMPONENT)

    async def open(self) -> None:
        """Begin."""
        loop = asyncio.get_running_loop()
        front, _ = await loop.create_datagram_endpoint(
            lambda: _Socket(self._from_autopilot), local_addr=(LOOPBACK, self._front_port)
        )
        back, _ = await loop.create_datagram_endpoint(lambda: _Socket(self._from_client), local_addr=(LOOPBACK, 0))
        self._front, self._back = front, back

    async def close(self) -> None:
        """End: the ports are free afterwards."""
        for transport in (self._front, self._back):
            if transport is not None:
                transport.close()
        await asyncio.sleep(0)

    def command(self, command: int, *parameters: float) -> None:
        """Send the autopilot a command as a separate client, also while the link is cut."""
        filled = [*parameters, *[0.0] * (7 - len(parameters))]
        self._send(self._mavlink.command_long_encode(self._system_id, AUTOPILOT, command, 0, *filled))

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter of the autopilot as a separate client; integers too are sent as floats, as ArduPilot does."""
        real = mavlink.MAV_PARAM_TYPE_REAL32
        self._send(self._mavlink.param_set_encode(self._system_id, AUTOPILOT, name.encode(), value, real))

    def set_origin(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """Ask the autopilot as a separate client to take another origin."""
        place = round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(altitude_m * 1e3)
        self._send(self._mavlink.set_gps_global_origin_encode(self._system_id, *place))

    def _send(self, message: mavlink.MAVLink_message) -> None:
        if self._front is not None and self._autopilot is not None:
            self._front.sendto(message.pack(self._mavlink), self._autopilot)

    def _from_autopilot(self, data: bytes, sender: Address) -> None:
        self._autopilot = sender
        for message in messages(data):
            if message.component == AUTOPILOT:
                self._on_message(message)
        if self._back is not None and not self.cut:
            self._back.sendto(data, self._client)

    def _from_client(self, data: bytes, _sender: Address) -> None:
        if self.cut:
            return
        for message in messages(data):
            if message.kind == SETPOINT:
                self.setpoints += 1
                self._on_setpoint()
            elif message.kind == HEARTBEAT:
                self._on_heartbeat()
        if self._front is not None and self._autopilot is not None:
            self._front.sendto(data, self._autopilot)


class _Socket(asyncio.DatagramProtocol):
    def __init__(self, take: Callable[[bytes, Address], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self._take(data, addr)


def flight_mode(message: Message) -> int | None:
    """Return the custom mode in a heartbeat or CURRENT_MODE, None for other messages."""
    if message.kind not in (HEARTBEAT, CURRENT_MODE):
        return None
    return cast(int, struct.unpack("<I", message.payload[:4].ljust(4, b"\0"))[0])


def is_armed(message: Message) -> bool:
    """Return whether a heartbeat reports it."""
    payload = message.payload.ljust(9, b"\0")
    return bool(payload[6] & 128)
