"""A mission of N stub vehicles on one ring, all at the rate and with the recording of a flight by default."""

import os
from math import cos, pi, sin

SPACING_M, RADIUS_MIN_M, SPEED_M_S, START_OUTSIDE_M = 6.0, 10.0, 1.0, 1.0

_HEAD = """
[mission]
name = "ring{count}"
description = "{count} vehicles on one ring."
duration_s = {duration_s}
rate_hz = 20.0
[frame]
latitude_deg = 47.397742
longitude_deg = 8.545594
altitude_m = 488.0
x_bearing_deg = 90.0
[network]
team = "ring-{process}"
[formation]
spacing_m = 6.0
speed_m_s = 0.0
leader = 1
[encirclement]
radius_m = {radius_m}
angular_rate_rad_s = {rate_rad_s}
[decision]
importance_min = 0.6
threat_max = 0.5
distance_max_m = 400.0
[safety]
separation_m = 3.0
[target]
start_m = [0.0, 0.0]
velocity_m_s = [0.0, 0.0]
importance = 0.8
threat = 0.2
[target.sensor]
range_m = 500.0
rate_hz = 5.0
noise_m = 0.1
"""
_VEHICLE = """
[[vehicles]]
id = {id}
url = "udpin://127.0.0.1:{link}"
endpoint = "tcp/127.0.0.1:{bus}"
start_m = [{x:.2f}, {y:.2f}]
slot_m = [{slot_x:.2f}, {y:.2f}]
"""


def ring_mission(count: int, duration_s: float, links: list[int], endpoints: list[int]) -> str:
    """Return the mission file of `count` vehicles, 6 m apart on a ring about a resting target, at these ports.

    The team's name contains the process id, because other teams may fly on this computer.
    """
    radius_m = max(RADIUS_MIN_M, SPACING_M * count / (2.0 * pi))
    rate_rad_s = SPEED_M_S / radius_m
    text = _HEAD.format(
        count=count, duration_s=duration_s, process=os.getpid(), radius_m=radius_m, rate_rad_s=rate_rad_s
    )
    start_m = radius_m + START_OUTSIDE_M
    for row, (link, bus) in enumerate(zip(links, endpoints, strict=True)):
        turn = 2.0 * pi * row / count
        x, y = start_m * cos(turn), start_m * sin(turn)
        text += _VEHICLE.format(id=row + 1, link=link, bus=bus, x=x, y=y, slot_x=x - start_m)
    return text
