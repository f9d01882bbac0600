"""The sections `[link]` and `[links]`: connections to the vehicles, message rates, and data rates."""

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
    """`[link]`: message rates between cordon and each vehicle (docs/hardware.md)."""

    telemetry_rate_hz: float = Field(20.0, ge=1.0, le=50.0, description="rate of position and velocity")
    attitude_rate_hz: float = Field(
        10.0, ge=5.0, le=50.0, description="rate of the attitude while the vehicle's clock is measured"
    )
    status_rate_hz: float = Field(2.0, ge=0.2, le=10.0, description="rate of status messages")
    setpoint_rate_hz: float | None = Field(None, ge=1.0, le=100.0, description="rate of setpoints; none: every tick")
    bytes_per_s: BytesPerSecond | None = Field(
        None, description="data rate of a connection, both directions; none: that of a serial device, else unlimited"
    )
    rates: RateChoice = Field(
        "fixed", description="`auto`: the rates are upper limits, and are lowered to what the connection carries"
    )
    feedforward: bool | None = Field(None, description="refuse profiles without velocities (true) or with them (false)")
    signing_key_file: str | None = Field(
        None,
        min_length=1,
        description="MAVLink 2 signing keys, a file beside the mission (`cordon keys issue mavlink`)",
    )


class SharedLinkSection(Settings):
    """`[links.NAME]`: a connection that several vehicles share, such as a mesh radio; system ids distinguish them."""

    url: Annotated[str, AfterValidator(connection_url)] = Field(description="the connection")
    bytes_per_s: BytesPerSecond | None = Field(None, description="in place of that of `[link]`")
    rates: RateChoice | None = Field(None, description="in place of that of `[link]`")


def capacity_bytes_s(url: str, given: float | None) -> float | None:
    """Return a connection's data rate, both directions together: as given, by its serial rate, or None: unlimited."""
    scheme, _, rest = url.partition("://")
    if given is not None or scheme != "serial":
        return given
    return int(rest.rpartition(":")[2]) / BITS_A_BYTE
