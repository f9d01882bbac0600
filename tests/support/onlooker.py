"""A minimal client of the Foxglove WebSocket for tests: handshake, subscription, messages. It uses no code of cordon or
of the server's library.
"""

import asyncio
import base64
import json
import os
import struct
from dataclasses import dataclass, field
from typing import Any, Self

from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

TEXT, PONG = 1, 10
MESSAGE_DATA = 1


@dataclass
class Onlooker:
    """A connected viewer: the advertised channels by topic, and its subscriptions."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    info: dict[str, Any] = field(default_factory=dict)
    channels: dict[str, dict[str, Any]] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)

    @classmethod
    async def connected(cls, port: int, *headers: str) -> Self:
        """Connect, with further headers; raises OSError while nothing listens."""
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        key = base64.b64encode(os.urandom(16)).decode()
        writer.write(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n".encode()
            + "".join(f"{header}\r\n" for header in headers).encode()
            + b"\r\n"
        )
        answer = await reader.readuntil(b"\r\n\r\n")
        assert answer.startswith(b"HTTP/1.1 101"), answer
        return cls(reader, writer)

    async def know(self, *topics: str) -> None:
        """Wait until all these topics have been advertised."""
        while not set(topics) <= set(self.channels):
            kind, payload = await self._frame()
            if kind == TEXT:
                self._hear(json.loads(payload))

    async def subscribe(self, *topics: str) -> None:
        """Subscribe to topics once they are known.

        The server advertises a channel a moment before it knows that this client may subscribe to it.
        """
        await self.know(*topics)
        await asyncio.sleep(1.0)
        first = len(self.topics)
        self.topics |= dict(enumerate(topics, first))
        wanted = [{"id": first + k, "channelId": self.channels[topic]["id"]} for k, topic in enumerate(topics)]
        self.say({"op": "subscribe", "subscriptions": wanted})

    def say(self, message: dict[str, Any]) -> None:
        """Send a message."""
        payload, mask = json.dumps(message).encode(), os.urandom(4)
        self._send(TEXT, payload, mask)

    async def message(self) -> tuple[str, int, Any]:
        """Return the next message of a subscription: its topic, its time [ns], and its decoded content."""
        while True:
            kind, payload = await self._frame()
            if kind == TEXT:
                self._hear(json.loads(payload))
            elif payload[0] == MESSAGE_DATA:
                subscription, time_ns = struct.unpack_from("<IQ", payload, 1)
                topic = self.topics[subscription]
                return topic, time_ns, self._decoded(topic, payload[13:])

    async def close(self) -> None:
        """Close the socket without a closing handshake."""
        self.writer.transport.abort()

    def _hear(self, message: dict[str, Any]) -> None:
        if message["op"] == "serverInfo":
            self.info = message
        for channel in message.get("channels", ()):
            self.channels[channel["topic"]] = channel

    def _decoded(self, topic: str, payload: bytes) -> Any:
        channel = self.channels[topic]
        schema = Schema(1, base64.b64decode(channel["schema"]), channel["schemaEncoding"], channel["schemaName"])
        decode = DecoderFactory().decoder_for(channel["encoding"], schema)
        assert decode is not None
        return decode(payload)

    async def _frame(self) -> tuple[int, bytes]:
        """Return the next data frame; this server does not fragment frames."""
        while True:
            first, second = await self.reader.readexactly(2)
            length = second & 0x7F
            if length >= 126:
                size, form = (2, ">H") if length == 126 else (8, ">Q")
                (length,) = struct.unpack(form, await self.reader.readexactly(size))
            payload = await self.reader.readexactly(length)
            assert first & 0x80, "a frame in pieces"
            match first & 0x0F:
                case 1 | 2 as kind:
                    return kind, payload
                case 9:
                    self._send(PONG, payload, os.urandom(4))
                case kind:
                    raise EOFError(f"the server ended it: frame {kind}, {payload!r}")

    def _send(self, kind: int, payload: bytes, mask: bytes) -> None:
        size = (
            struct.pack(">BB", 0x80 | kind, 0x80 | len(payload))
            if len(payload) < 126
            else struct.pack(">BBH", 0x80 | kind, 0x80 | 126, len(payload))
        )
        self.writer.write(size + mask + bytes(byte ^ mask[k % 4] for k, byte in enumerate(payload)))
