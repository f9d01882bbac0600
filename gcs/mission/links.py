"""The sections `[link]` and `[links]`: how vehicles are connected, at what rates, and what a connection carries."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from estimation.settings import Settings

BITS_A_BYTE = 10
"""On a serial line: a start bit, eight data bits, a stop bit."""

BytesPerSecond = Annotated[float, Field(ge=100.0, le=1e9)]
RateChoice = Literal["fixed", "auto"]


def connection_url(url: str) -> str:
    """Return the url of a vehicle's connection; raises ValueError for anything else."""
    scheme, _, rest = url.partition("://")
    host, _, port = rest.rpartition(":")
    if scheme == "serial" and host and port.isdecimal() and int(port) > 0:
        return url
    known = ("udpin", "udpout", "tcpin", "tcpout")
    if scheme not in known or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError("a vehicle's url is like udpin://127.0.0.1:14540 or serial:///dev/ttyUSB0:57600")
    return url


class LinkSection(Settings):
    """`[link]`: how often a vehicle tells its motion, its attitude while its clock is measured, and its status; and how
    often setpoints are sent: every tick (none), or less often. What MAVSDK repeats by itself, 20 times a second, counts
    as a setpoint. `bytes_per_s` is what a connection carries, both ways together: none is what the rate of a serial
    device allows, and no bound elsewhere. With `rates` = "auto" the rates above are upper limits: lower ones are chosen
    where a connection carries no more, and lowered in flight where messages are lost or a radio reports that its buffer
    is full; status first, then motion, then setpoints, none of these below 5 Hz.
    Velocities go with the setpoints of vehicles whose profile has `feedforward`; given here as well, true or false,
    profiles of the other kind are refused. With `signing_key_file`, a file beside the mission, MAVLink 2 messages to
    and from every vehicle are signed, and a vehicle that does not sign is refused (`cordon keys issue mavlink`).
    """

    telemetry_rate_hz: float = Field(20.0, ge=1.0, le=50.0)
    attitude_rate_hz: float = Field(10.0, ge=5.0, le=50.0)
    status_rate_hz: float = Field(2.0, ge=0.2, le=10.0)
    setpoint_rate_hz: float | None = Field(None, ge=1.0, le=100.0)
    bytes_per_s: BytesPerSecond | None = None
    rates: RateChoice = "fixed"
    feedforward: bool | None = None
    signing_key_file: str | None = Field(None, min_length=1)


class SharedLinkSection(Settings):
    """`[links.NAME]`: a connection that carries several vehicles, told apart by their system ids, such as a mesh radio.
    They name it by `link` in place of a `url` of their own. Its `bytes_per_s` and `rates` stand for those of `[link]`.
    """

    url: Annotated[str, AfterValidator(connection_url)]
    bytes_per_s: BytesPerSecond | None = None
    rates: RateChoice | None = None


def capacity_bytes_s(url: str, given: float | None) -> float | None:
    """Return what a connection carries both ways together: as given, by its serial rate, or None without a bound."""
    scheme, _, rest = url.partition("://")
    if given is not None or scheme != "serial":
        return given
    return int(rest.rpartition(":")[2]) / BITS_A_BYTE
