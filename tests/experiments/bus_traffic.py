"""Measure the traffic of each vehicle to its peers: messages and bytes a second, on one ring and in formation.

All vehicles see the target; in formation they are 5 m apart, and noise and plants are those of membership.py. Traffic
is counted once the team has settled. The bytes are those of the payloads, without Zenoh's and the network's overhead.
Each observer also receives a report per second from each vehicle; the share is with one observer.
"""

import sys
from collections import Counter
from collections.abc import Sequence

import numpy as np

from agents.outputs import TickOutput
from agents.shell.reporter import target_report
from agents.team.codec import encode
from agents.team.messages import AutopilotReport, VehicleReport
from gcs.mission.mission import Mission
from sitl.simulation.simulation import NetworkModel
from tests.experiments.arguments import parser
from tests.experiments.membership_scenes import abreast, field
from tests.experiments.scaling import SETTLED_S, ring
from tests.support.mission_text import parsed
from tests.support.observed_flight import observed

RADIO_BYTES_S = 5760.0
"""The capacity of a radio of 57600 baud, with ten bits per byte."""


def formation(count: int) -> Mission:
    """Return a mission of vehicles abreast that all see a target but do not engage."""
    random, radius_m = np.random.default_rng(count), 2.0 * count
    mission = field(
        random, abreast(count), radius_m=radius_m, rate_rad_s=0.5 / radius_m, target_m=(radius_m + 4.0, -5.0)
    )
    mission["target"]["threat"] = 0.9
    return parsed(mission)


def report_size(output: TickOutput) -> int:
    """Return the bytes of the report of a tick."""
    target = target_report(output.status)
    known = (True, True, 0.05, 1.234, AutopilotReport(0.712, 1234.0, 3, 14), "good", 1.7e9, 600.0, "", target)
    return len(encode(VehicleReport(output.status.vehicle_id, 1.7e9, "offboard", *known)))


def traffic(mission: Mission, duration_s: float) -> tuple[float, float, float, float]:
    """Return a vehicle's messages and bytes a second, the bytes of the largest message, and those of a report."""
    sizes: Counter[int] = Counter()
    rate_hz, report = mission.mission.rate_hz, 0

    def observe(tick: int, _vehicle: int, output: TickOutput) -> None:
        nonlocal report
        if tick >= SETTLED_S * rate_hz:
            sizes.update(len(message.payload) for message in output.messages)
            report = max(report, report_size(output))

    observed(mission, 0, observe, duration_s=duration_s, network=NetworkModel(1e6))
    seconds = len(mission.vehicles) * (duration_s - SETTLED_S)
    bytes_s = sum(size * times for size, times in sizes.items()) / seconds
    return sizes.total() / seconds, bytes_s, max(sizes), report


def main(counts: Sequence[int], duration_s: float) -> int:
    """Print the table."""
    print(
        "| | vehicles | messages a second of each | bytes a second of each | largest | report | "
        "of all, share of 57600 baud |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, mission in (("ring", ring), ("formation", formation)):
        for count in counts:
            messages_hz, bytes_s, largest, report = traffic(mission(count), duration_s)
            share = count * (bytes_s + report) / RADIO_BYTES_S
            row = (name, count, f"{messages_hz:.1f}", f"{bytes_s:.0f}", largest, report, f"{share:.0%}")
            print(f"| {' | '.join(map(str, row))} |", flush=True)
    return 0


if __name__ == "__main__":
    reader = parser("bus_traffic", __doc__)
    reader.add_argument("counts", nargs="*", type=int, default=[3, 8, 16, 32], help="vehicles (default: %(default)s)")
    reader.add_argument("--duration", type=float, default=30.0, help="seconds of each flight (default: %(default)s)")
    given = reader.parse_args()
    sys.exit(main(given.counts, given.duration))
