"""The names of the faults that a flight of stub vehicles can have. Light: the help of the command line lists them."""

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
    "estimator degraded",
    "estimator failing",
    "not following",
    "foreign mode",
    "target lost",
    "link cut",
    "battery low",
    "battery critical",
    "no way home",
    "killed agent",
    "frozen agent",
    "frozen interpreter",
]


def as_option(name: str) -> str:
    """Return a name as a word of the command line."""
    return name.replace(" ", "-")


OPTIONS = tuple(map(as_option, get_args(FaultName)))
