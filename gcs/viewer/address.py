"""The address of the live view."""

from ipaddress import ip_address
from typing import NamedTuple, Self

from gcs.errors import InputError

_EXAMPLE = "127.0.0.1:8765"


class Address(NamedTuple):
    """Host and port that viewers connect to."""

    host: str
    port: int

    @classmethod
    def parsed(cls, text: str, option: str = "--live-address") -> Self:
        """Parse HOST:PORT, or [HOST]:PORT for IPv6, as an option has it; raises InputError."""
        host, _, port = text.rpartition(":")
        bare = host.removeprefix("[").removesuffix("]")
        bracketed = host == f"[{bare}]"
        if not bare or (":" in bare) != bracketed or not port.isdecimal() or not 0 < int(port) < 65536:
            raise InputError(
                [f"{option}: it must be HOST:PORT, for example {_EXAMPLE} or [::1]:8765 (given: {text!r})"]
            )
        return cls(bare, int(port))

    @property
    def url(self) -> str:
        """The URL to open in a viewer."""
        return f"ws://[{self.host}]:{self.port}" if ":" in self.host else f"ws://{self.host}:{self.port}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer can connect to it."""
        try:
            return ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"
