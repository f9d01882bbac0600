"""What a stub vehicle is equipped with as far as its autopilot depends on it: its battery and its positioning."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Battery:
    """The battery at boot: its charge as a fraction of 1, and how long a full one keeps the vehicle armed [s]."""

    fraction: float = 1.0
    endurance_s: float = 1800.0


@dataclass(frozen=True, slots=True)
class Positioning:
    """The sources of position.

    Without `gps` the vehicle has a local position only, as from cameras indoors. A vehicle that is not `localised`
    never has a position; an `external` one has it while it is sent positions.
    """

    gps: bool = True
    localised: bool = True
    external: bool = False


FULL_BATTERY = Battery()
GPS_POSITIONING = Positioning()
