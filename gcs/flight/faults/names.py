"""The names of the faults for stub vehicles. Imports nothing heavy: the help of the command line lists them."""

from typing import Literal, get_args

FaultName = Literal[
    "half of all messages lost",
    "latency",
    "stranger",
    "flood",
    "impostor",
    "liar",
    "one vehicle not heard",
    "nobody hears anybody",
    "telemetry frozen",
    "GPS jump",
    "origin moved",
    "height jumped",
    "estimator degraded",
    "estimator failing",
    "not following",
    "foreign mode",
    "target lost",
    "link cut",
    "lost in the air",
    "battery low",
    "battery critical",
    "second battery",
    "no way home",
    "killed agent",
    "frozen agent",
    "frozen interpreter",
]


def as_option(name: str) -> str:
    """Return a name as it is written on the command line."""
    return name.replace(" ", "-")


OPTIONS = tuple(map(as_option, get_args(FaultName)))
