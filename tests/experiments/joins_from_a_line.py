"""Let teams engage all at once from a line 60 m off the target, and measure when their rings have settled.

They fly the stub's plant, at up to 4 m/s, on the rings of `tests/support/ring_mission.py` at 1 m/s. Measured is the
true motion. Exit code 1 if a team needs longer than 45 s or comes nearer than the separation.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations
from math import inf, tau

import numpy as np

from estimation.state import POSITION
from gcs.mission.mission import Mission
from sitl.simulation.simulation import NetworkModel
from tests.experiments.arguments import parser
from tests.support.mission_text import content, parsed
from tests.support.observed_flight import observed
from tests.support.ring_mission import ring_mission

TEAMS = (3, 6, 8, 12, 16, 24, 32)
OFF_M, SPACING_M, RING_M_S, FASTEST_M_S = 60.0, 5.0, 1.0, 4.0
DURATION_S, SETTLES_S = 100.0, 45.0
SPACED_RAD, ON_RING_SHARE = np.radians(5.0), 0.05
NETWORK = NetworkModel(inf, 0.05, 0.0)


def mission_of(count: int) -> Mission:
    """Return the mission of a number of vehicles."""
    ports = list(range(14540, 14540 + count))
    text = content(ring_mission(count, DURATION_S, ports, [port + 1000 for port in ports]))
    radius_m = text["encirclement"]["radius_m"]
    text["encirclement"] |= {"angular_rate_rad_s": RING_M_S / radius_m, "speed_max_m_s": FASTEST_M_S}
    text["tuning"] = {"encirclement": {"radius_far_m": 3.0 * radius_m + OFF_M + count * SPACING_M}}
    text["formation"]["spacing_m"] = SPACING_M
    for place, vehicle in enumerate(text["vehicles"]):
        vehicle["start_m"] = [-OFF_M, ((count - 1) / 2.0 - place) * SPACING_M]
        vehicle.pop("slot_m", None)
    return parsed(text)


def flown(count: int) -> tuple[float, float]:
    """Return after how long all stay on the ring and evenly spaced, and by how much they kept their separation."""
    mission = mission_of(count)
    flight = observed(mission, 0, network=NETWORK)
    away_m = flight.motion[..., POSITION] @ np.array([1.0, 1.0j])  # the target rests at the origin
    bearings_rad = np.sort(np.angle(away_m), axis=1)
    gaps_rad = np.diff(bearings_rad, axis=1, append=bearings_rad[:, :1] + tau)
    settled = (np.abs(gaps_rad - tau / count) <= SPACED_RAD).all(axis=1)
    settled &= (np.abs(np.abs(away_m) / mission.encirclement.radius_m - 1.0) <= ON_RING_SHARE).all(axis=1)
    last = int(np.flatnonzero(~settled)[-1])
    nearest_m = min(
        float(np.abs(away_m[:, one] - away_m[:, other]).min()) for one, other in combinations(range(count), 2)
    )
    settled_s = float(flight.time_s[last + 1]) if last + 1 < settled.size else inf
    return settled_s, nearest_m - mission.safety.separation_m


def main() -> int:
    """Fly all teams."""
    with ProcessPoolExecutor() as pool:
        flights = list(pool.map(flown, TEAMS))
    for count, (settled_s, left_m) in zip(TEAMS, flights, strict=True):
        print(f"{count:>2} vehicles: settled after {settled_s:.1f} s, separation {left_m:+.2f} m")
    return int(any(settled_s > SETTLES_S or left_m < 0.0 for settled_s, left_m in flights))


if __name__ == "__main__":
    parser("joins_from_a_line", __doc__).parse_args()
    sys.exit(main())
