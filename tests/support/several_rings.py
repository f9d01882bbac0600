"""A mission of several targets and rings, made from one of a single ring."""

from dataclasses import replace

from gcs.mission.mission import Mission, MissionRing

NORTH, SOUTH, HIGH = 0, 1, 2
"""The numbers of the rings. The first two have a target each, the third is above the second."""


def with_rings(mission: Mission) -> Mission:
    """Return a mission about the targets "boat" and "buoy", which is 80 m farther, with three rings of two places.

    The ring "south" is one of 14 m at 0.06 rad/s, 7 m high. "high" has 8 m and -0.1 rad/s, 12 m high.
    """
    x_m, y_m = mission.target.start_m
    boat = mission.target.model_copy(update={"name": "boat"})
    buoy = boat.model_copy(update={"name": "buoy", "start_m": (x_m + 80.0, y_m), "velocity_m_s": (0.0, 0.0)})
    first = mission.encirclement
    low = first.model_validate(
        first.model_dump(exclude_unset=True) | {"radius_m": 14.0, "angular_rate_rad_s": 0.06, "altitude_m": 7.0}
    )
    high = first.model_validate(
        first.model_dump(exclude_unset=True) | {"radius_m": 8.0, "angular_rate_rad_s": -0.1, "altitude_m": 12.0}
    )
    rings = (MissionRing("north", 0, 2, first), MissionRing("south", 1, 2, low), MissionRing("high", 1, 2, high))
    return replace(mission, targets=(boat, buoy), target=boat, rings=rings)
