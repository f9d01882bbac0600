"""The equipment of a stub vehicle that its autopilot depends on: battery and positioning."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Battery:
    """The battery at boot: its charge as a fraction, and the time that a full one lasts while armed [s]."""

    fraction: float = 1.0
    endurance_s: float = 1800.0


@dataclass(frozen=True, slots=True)
class Positioning:
    """The sources of position.

    Without `gps` the vehicle has a local position only, as indoors with cameras. A vehicle that is not `localised`
    never has a position; an `external` one has a position while it receives external positions.
    """

    gps: bool = True
    localised: bool = True
    external: bool = False


FULL_BATTERY = Battery()
GPS_POSITIONING = Positioning()
