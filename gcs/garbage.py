"""The garbage collection of a process that computes for long: rare, as nearly nothing that it makes is cyclic."""

import gc

YOUNG = 10_000
"""New objects until a collection of the young ones. Python's 700 are those of a few ticks, and take 8 % of their time.
"""
YOUNG_OF_A_RUN = 100_000
"""The same where nothing waits for the end of a collection: more than what the vehicles of a simulation keep alive."""
_NEVER = 1_000_000
"""Collections of the middle generation until a full one: weeks."""


def collect_rarely(*, full: bool = True) -> None:
    """Collect young garbage rarely, and never examine what lives already.

    Without `full`, old cyclic garbage stays until the process ends, in a flight a few kilobytes a minute: a full
    collection takes 0.1 s with 32 vehicles and delays every tick.
    """
    gc.freeze()
    _, middle, old = gc.get_threshold()
    gc.set_threshold(YOUNG_OF_A_RUN if full else YOUNG, middle, old if full else _NEVER)
