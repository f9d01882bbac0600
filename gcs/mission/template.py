"""A new mission's text: every key with a comment; positions and limits follow from a few choices."""

import re
from collections.abc import Collection
from dataclasses import dataclass
from json import dumps
from math import ceil, floor, tau
from typing import Literal, NamedTuple
from zlib import crc32

from agents.ring.place import chord_m
from agents.settings.shapes import SPACED_SHAPES, SpacedShape, offset_m
from estimation.profile.autopilots import DEFAULT, AutopilotName
from gcs.autopilots.registry import AUTOPILOTS

Links = Literal["stub", AutopilotName, "udp", "serial"]


class MissionPlace(NamedTuple):
    """The origin of a mission: a position on Earth, and the height of the ground there."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


REAL_LINKS: tuple[Links, ...] = ("udp", "serial")
"""Links with real vehicles at their other ends."""
SIMULATED_PLACE = MissionPlace(47.397742, 8.545594, 488.0)
"""Where simulated vehicles fly: the simulators' default."""
X_BEARING_DEG = 90.0
SPACING_M, SEPARATION_M = 5.0, 3.0
_SIMULATORS = {each.name: each.simulator_port for each in AUTOPILOTS}
PROFILES = {"stub": "stub", "udp": DEFAULT, "serial": DEFAULT, **{name: name for name in _SIMULATORS}}
"""The default profile of vehicles on such links."""

_URLS = {
    "stub": "udpin://127.0.0.1:{own}",
    **{name: f"udpin://127.0.0.1:{{{name}}}" for name in _SIMULATORS},
    "udp": "udpin://0.0.0.0:{own}",
    "serial": "serial:///dev/ttyUSB{index}:57600",
}
_FIRST_PORT, _BLOCK, _BLOCKS = 15000, 10, 1700
"""Above the ports of bundled missions and simulators, below the ephemeral ports."""
_CATCHING_UP_M_S = 0.5
_APPROACH_M = 20.0
"""Distance that the formation flies, relative to the target, before its first vehicle engages: about 40 s."""
_ENGAGED_S = 300.0


def least_radius_m(vehicles: int) -> float:
    """Return the smallest radius at which vehicles keep their separation, in whole centimetres."""
    return 0.1 if vehicles == 1 else ceil(100.0 * SEPARATION_M / chord_m(1.0, vehicles)) / 100.0


def ring_words(radius_m: float, angular_rate_rad_s: float) -> str:
    """Return a rate on a ring as the speed along it and the time of a lap."""
    rate_rad_s = abs(angular_rate_rad_s)
    lap = f"a lap in {tau / rate_rad_s:.0f} s" if rate_rad_s else "no lap"
    return f"{angular_rate_rad_s:g} rad/s on {radius_m:g} m: {rate_rad_s * radius_m:.2g} m/s, {lap}"


def own_ports(name: str, vehicles: int, taken: Collection[int]) -> range:
    """Return a port for each vehicle, derived from the mission's name; skips ranges with `taken` ports."""
    block = crc32(name.encode()) % _BLOCKS
    for step in range(_BLOCKS):
        first = _FIRST_PORT + (block + step) % _BLOCKS * _BLOCK
        ports = range(first, first + vehicles)
        if not any(port in ports for port in taken):
            return ports
    raise ValueError("no free ports")


@dataclass(frozen=True, slots=True, kw_only=True)
class NewMission:
    """The choices for a new mission.

    The target moves along x from `target_start_m`, None for straight ahead. `fence_m` is the fence's margin, 0 for no
    fence.
    """

    name: str
    vehicles: int
    links: Links
    profile: str
    shape: SpacedShape
    radius_m: float
    angular_rate_rad_s: float
    target_speed_m_s: float
    fence_m: float
    ports: range
    place: MissionPlace = SIMULATED_PLACE
    x_bearing_deg: float = X_BEARING_DEG
    target_start_m: tuple[float, float] | None = None

    @property
    def text(self) -> str:
        """The mission's text, not validated."""
        speed_m_s = self.target_speed_m_s + _CATCHING_UP_M_S
        return _MISSION.format(
            name=dumps(self.name, ensure_ascii=False),
            description=dumps(self._description),
            duration_s=self._duration_s,
            shape=self.shape,
            shapes=", ".join(SPACED_SHAPES),
            spacing_m=SPACING_M,
            speed_m_s=speed_m_s,
            speed_max_m_s=max(2.0, 2.0 * speed_m_s),
            leader=self._leader + 1,
            radius_m=self.radius_m,
            rate_rad_s=self.angular_rate_rad_s,
            reach_m=self._reach_m,
            separation_m=SEPARATION_M,
            fence=self._fence,
            latitude_deg=self.place.latitude_deg,
            longitude_deg=self.place.longitude_deg,
            altitude_m=self.place.altitude_m,
            x_bearing_deg=self.x_bearing_deg,
            target_start_m=list(self._target_start_m),
            target_speed_m_s=self.target_speed_m_s,
            range_m=self._reach_m + self.radius_m,
            team=f"{re.sub(r'[^A-Za-z0-9_-]', '-', self.name)[:26]}-{self.ports[0]}",
        ) + "".join(map(self._vehicle, range(self.vehicles)))

    @property
    def _description(self) -> str:
        target = f"moves at {self.target_speed_m_s:g} m/s" if self.target_speed_m_s else "is at rest"
        return f"{self.vehicles} vehicles, from a {self.shape} onto a ring of {self.radius_m:g} m; the target {target}."

    @property
    def _leader(self) -> int:
        return (self.vehicles - 1) // 2

    @property
    def _starts_m(self) -> list[tuple[float, float]]:
        places = (offset_m(self.shape, i, self._leader, SPACING_M) for i in range(self.vehicles))
        return [(round(x, 2) + 0.0, round(y, 2) + 0.0) for x, y in places]

    @property
    def _target_start_m(self) -> tuple[float, float]:
        return self.target_start_m or (self._reach_m + _APPROACH_M, 0.0)

    @property
    def _half_width_m(self) -> float:
        return max(abs(y) for _, y in self._starts_m)

    @property
    def _reach_m(self) -> float:
        """The distance at which vehicles engage: larger than the ring, also for the outermost vehicle."""
        return float(ceil(self.radius_m + self._half_width_m + SPACING_M))

    @property
    def _duration_s(self) -> float:
        depth_m = -min(x for x, _ in self._starts_m)
        approach_m = max(self._target_start_m[0] - self._reach_m, 0.0)
        return 60.0 * ceil(((approach_m + depth_m) / _CATCHING_UP_M_S + _ENGAGED_S) / 60.0)

    @property
    def _fence(self) -> str:
        """The fence around starts, ring and the target's path, its corners whole metres."""
        if not self.fence_m:
            return "# fence_m = [[-20.0, -40.0], [90.0, -40.0], [90.0, 40.0], [-20.0, 40.0]]  # corners [x, y]"
        x_m, y_m = self._target_start_m
        target_end_m = x_m + self.target_speed_m_s * self._duration_s
        back_m = floor(min(*(x for x, _ in self._starts_m), x_m - self.radius_m) - self.fence_m)
        ahead_m = ceil(target_end_m + self.radius_m + self.fence_m)
        right_m = floor(min(-self._half_width_m, y_m - self.radius_m) - self.fence_m)
        left_m = ceil(max(self._half_width_m, y_m + self.radius_m) + self.fence_m)
        corners = [[back_m, right_m], [ahead_m, right_m], [ahead_m, left_m], [back_m, left_m]]
        return f"fence_m = {[[float(x), float(y)] for x, y in corners]}  # corners [x, y]; vehicles stay inside"

    def _vehicle(self, index: int) -> str:
        own = self.ports[index]
        simulators = {name: first + index for name, first in _SIMULATORS.items()}
        url = _URLS[self.links].format(own=own, index=index, **simulators)
        x_m, y_m = self._starts_m[index]
        return _VEHICLE.format(id=index + 1, url=url, own=own, x_m=x_m, y_m=y_m, profile=dumps(self.profile))


def plant_profile(a0_per_s2: float, a1_per_s: float, delay_s: float) -> str:
    """Return the text of a profile with only a plant, equal on both axes."""
    axis = f"a0_per_s2 = {a0_per_s2}\na1_per_s = {a1_per_s}\n"
    return (
        "# A vehicle's plant, x'' = a0 (X_d - x) - a1 x': its response to a position setpoint X_d.\n"
        f"delay_s = {delay_s}  # between a setpoint and its effect\n\n[x]\n{axis}\n[y]\n{axis}"
    )


_MISSION = """\
# A mission of cordon. docs/mission-keys.md has every key with its default and range.
# Lengths are metres, times seconds, angles radians. x points along x_bearing_deg, y to its left, z up.

[mission]
name = {name}
description = {description}
duration_s = {duration_s}  # from the start of the formation to the landing
rate_hz = 10.0  # rate of the control loop
format = 2  # of the keys of this file

[frame]  # origin of the mission frame: for real vehicles, the place where they stand
latitude_deg = {latitude_deg}
longitude_deg = {longitude_deg}
altitude_m = {altitude_m}  # of the ground, above sea level
x_bearing_deg = {x_bearing_deg}  # of the x axis, clockwise from north: the direction of the formation

[formation]
shape = "{shape}"  # {shapes}; or free, with a slot_m for each vehicle
spacing_m = {spacing_m}  # between neighbours
speed_m_s = {speed_m_s}  # along x
speed_max_m_s = {speed_max_m_s}  # of a vehicle that catches up with its slot
leader = {leader}  # the id of the vehicle that the others keep station on

[encirclement]  # the ring around the target
radius_m = {radius_m}
angular_rate_rad_s = {rate_rad_s}  # positive: counter-clockwise seen from above

[decision]  # when a vehicle leaves the formation for the ring
importance_min = 0.6  # of the target, 0 to 1
threat_max = 0.5  # of the target, 0 to 1
distance_max_m = {reach_m}  # largest distance of the target

[safety]
separation_m = {separation_m}  # least distance between vehicles, kept by the guard
{fence}

[target]
start_m = {target_start_m}  # its position at first
velocity_m_s = [{target_speed_m_s}, 0.0]  # or legs = [...], a path of several legs
importance = 0.8  # at least decision.importance_min: vehicles engage
threat = 0.2  # at most decision.threat_max

[target.sensor]  # the vehicles' sensors of the simulated target
range_m = {range_m}  # largest distance of a sighting
rate_hz = 5.0  # sightings per second
noise_m = 0.0  # standard deviation of a sighting

[network]
team = "{team}"  # the team's name on the bus, unique in the network
"""

_VEHICLE = """
[[vehicles]]
id = {id}
url = "{url}"  # its MAVLink connection
endpoint = "tcp/127.0.0.1:{own}"  # its agent's Zenoh endpoint
start_m = [{x_m}, {y_m}]  # its position on the ground before take-off
altitude_m = 8.0  # above the mission's origin
profile = {profile}  # its plant and limits: a bundled profile, or a file beside this one (`cordon identify -o`)
"""
