"""Measure what each vehicle of a team sends to its peers: messages and bytes a second, on one ring of 3 to 32 vehicles.

The bytes are those of the messages, which Zenoh and the network add to. All vehicles see the target.
"""

import sys
from collections import Counter
from collections.abc import Sequence

from agents.outputs import TickOutput
from gcs.flight.simulated import simulated_vehicles
from sitl.simulation.simulation import NetworkModel, simulate
from tests.experiments.arguments import parser
from tests.experiments.scaling import RATE_HZ, ring

RADIO_BYTES_S = 5760.0
"""What a radio of 57600 baud carries, with ten bits a byte."""


def traffic(count: int, duration_s: float) -> tuple[float, float, float]:
    """Return a vehicle's messages and bytes a second, and the bytes of the largest message."""
    sizes: Counter[int] = Counter()

    def observe(_tick: int, _vehicle: int, output: TickOutput) -> None:
        sizes.update(len(message.payload) for message in output.messages)

    simulate(
        simulated_vehicles(ring(count), 0),
        NetworkModel(1e6),
        rate_hz=RATE_HZ,
        duration_s=duration_s,
        seed=0,
        observe=observe,
        progress=lambda _: None,
    )
    seconds = count * duration_s
    return sizes.total() / seconds, sum(size * times for size, times in sizes.items()) / seconds, max(sizes)


def main(counts: Sequence[int], duration_s: float) -> int:
    """Print the table."""
    print("| vehicles | messages a second of each | bytes a second of each | largest | of all, share of 57600 baud |")
    print("|---|---|---|---|---|")
    for count in counts:
        messages_hz, bytes_s, largest = traffic(count, duration_s)
        share = count * bytes_s / RADIO_BYTES_S
        print(f"| {count} | {messages_hz:.1f} | {bytes_s:.0f} | {largest:.0f} | {share:.0%} |", flush=True)
    return 0


if __name__ == "__main__":
    reader = parser("bus_traffic", __doc__)
    reader.add_argument("counts", nargs="*", type=int, default=[3, 8, 16, 32], help="vehicles (default: %(default)s)")
    reader.add_argument("--duration", type=float, default=20.0, help="seconds of each flight (default: %(default)s)")
    given = reader.parse_args()
    sys.exit(main(given.counts, given.duration))
