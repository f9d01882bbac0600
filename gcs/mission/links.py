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
    """`[link]`: message rates of each vehicle's motion, its status, and its attitude while its clock is measured; and
    the rate of setpoints: every tick (none), or less. Setpoints that MAVSDK repeats by itself, 20 times a second, count
    as well. `bytes_per_s` is a connection's data rate, both directions together; none: what the rate of a serial device
    allows, unlimited elsewhere. With `rates` = "auto" the rates above are upper limits. Lower ones are used if the
    connection carries no more, and are reduced in flight if messages are lost or a radio reports a full buffer: first
    status, then motion, then setpoints, which stay at 5 Hz or more.
    Setpoints carry velocities for vehicles whose profile has `feedforward`; if `feedforward` is given here, true or
    false, profiles of the other kind are refused. With `signing_key_file`, a file beside the mission, MAVLink 2
    messages to and from every vehicle are signed, and a vehicle that does not sign is refused (`cordon keys issue
    mavlink`).
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
    """`[links.NAME]`: a connection that several vehicles share, such as a mesh radio; system ids distinguish them.
    The vehicles refer to it by `link` instead of a `url`. Its `bytes_per_s` and `rates` replace those of `[link]`.
    """

    url: Annotated[str, AfterValidator(connection_url)]
    bytes_per_s: BytesPerSecond | None = None
    rates: RateChoice | None = None


def capacity_bytes_s(url: str, given: float | None) -> float | None:
    """Return a connection's data rate, both directions together: as given, by its serial rate, or None: unlimited."""
    scheme, _, rest = url.partition("://")
    if given is not None or scheme != "serial":
        return given
    return int(rest.rpartition(":")[2]) / BITS_A_BYTE
