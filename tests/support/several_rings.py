"""A mission of several targets and rings, made from one of a single ring."""

from gcs.mission.mission import Mission

NORTH, SOUTH, HIGH = 0, 1, 2
"""The numbers of the rings. The first two have a target each, the third is above the second."""


def with_rings(mission: Mission) -> Mission:
    """Return a mission about the targets "boat" and "buoy", which is 80 m farther, with three rings of two places.

    The ring "south" is one of 14 m at 0.06 rad/s, 7 m high. "high" has 8 m and -0.1 rad/s, 12 m high. A boat that moves
    comes to the ring "south", which is shared, after ten minutes.
    """
    x_m, y_m = mission.target.start_m
    low = {"radius_m": 14.0, "angular_rate_rad_s": 0.06, "altitude_m": 7.0}
    high = {"radius_m": 8.0, "angular_rate_rad_s": -0.1, "altitude_m": 12.0}
    return mission.replace(
        targets=[{"name": "boat"}, {"name": "buoy", "start_m": [x_m + 80.0, y_m], "velocity_m_s": [0.0, 0.0]}],
        rings=[
            {"name": "north", "target": "boat", "places": 2},
            {"name": "south", "target": "buoy", "places": 2, "shared": True, **low},
            {"name": "high", "target": "buoy", "places": 2, **high},
        ],
    )
