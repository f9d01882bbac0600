"""An attacker on a team's bus: plain Zenoh, any key, any payload, at any rate.

As a program it floods: `python -m tests.support.unauthorised_client KIND TEAM SECONDS RATE_HZ ENDPOINT...` sends junk,
states in the names of vehicles, or large payloads.
"""

import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import cycle

import zenoh

from agents.team.codec import encode
from agents.team.messages import MemberState

FAR_M = (5000.0, 5000.0)
LARGE_BYTES = 100_000_000


class UnauthorisedClient:
    """A Zenoh peer that connects to a team's endpoints."""

    def __init__(self, team: str, endpoints: Sequence[str]) -> None:
        config = zenoh.Config()
        for path, value in {
            "mode": "peer",
            "scouting/multicast/enabled": False,
            "connect/endpoints": list(endpoints),
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "connect/retry": {"period_init_ms": 100, "period_max_ms": 200, "period_increase_factor": 1},
            "transport/shared_memory/enabled": False,
        }.items():
            config.insert_json5(path, json.dumps(value))
        self._prefix = f"cordon/{team}"
        self.session = zenoh.open(config)

    def put(self, key: str, payload: bytes, *, insists: bool = False) -> None:
        """Send on a key below the team's; optionally wait until there is room."""
        control = zenoh.CongestionControl
        self.session.put(
            f"{self._prefix}/{key}", payload, congestion_control=control.BLOCK if insists else control.DROP
        )

    def close(self) -> None:
        """Leave."""
        self.session.close()  # type: ignore[no-untyped-call]


def state(sender: int, time_s: float, alert: str = "") -> MemberState:
    """Return a forged state of a vehicle far away."""
    return MemberState(sender, time_s, "formation", FAR_M, (0.0, 0.0), FAR_M, (0.0, 0.0), 8.0, 0.1, alert)


def messages(kind: str) -> Iterator[tuple[str, bytes]]:
    """Yield the keys and payloads of a kind of flood, without end."""
    for number in cycle(range(1, 4)):
        if kind == "junk":
            yield f"junk/{number}", os.urandom(64)
            yield f"member/{number}", os.urandom(64)
        elif kind == "valid":
            yield f"member/{number}", encode(state(number, time.time()))
        else:
            yield f"member/{number}", bytes(LARGE_BYTES)


def flood(stranger: UnauthorisedClient, kind: str, lasting_s: float, rate_hz: float) -> int:
    """Send messages at a rate, in bursts of a few milliseconds; return the number sent."""
    began_s = time.monotonic()
    for sent, (key, payload) in enumerate(messages(kind), start=1):
        stranger.put(key, payload, insists=kind == "large")
        ahead_s = began_s + sent / rate_hz - time.monotonic()
        if ahead_s > 0.002:
            time.sleep(ahead_s)
        if time.monotonic() - began_s > lasting_s:
            return sent
    raise AssertionError


if __name__ == "__main__":
    what, its_team, seconds, rate, *ends = sys.argv[1:]
    someone = UnauthorisedClient(its_team, ends)
    time.sleep(0.5)
    print(flood(someone, what, float(seconds), float(rate)), flush=True)
    someone.close()
