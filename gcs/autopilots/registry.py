"""The autopilots that cordon knows, and how others find the one of a vehicle."""

from dataclasses import replace
from importlib import import_module
from typing import get_args

from estimation.profile.autopilots import DEFAULT, AutopilotName
from gcs.autopilots.autopilot import Autopilot, Topic, VehicleKind

AUTOPILOTS: tuple[Autopilot, ...] = tuple(
    import_module(f"gcs.autopilots.{name}").AUTOPILOT for name in get_args(AutopilotName)
)
_NAMED = {each.name: each for each in AUTOPILOTS}
UNKNOWN = replace(
    _NAMED[DEFAULT],
    name="",
    label="an unknown autopilot",
    mode=_NAMED["ardupilot"].mode,  # whose numbers other firmware borrows
    parameters_bytewise=False,
    kind=lambda _evidence: VehicleKind.UNKNOWN,
    judges={},
)
"""Any other: nothing of it is judged; it is asked for the default's messages."""


def autopilot_of(name: str) -> Autopilot:
    """Return the autopilot of a name in a mission, a log or MAVSDK, in whatever case."""
    return _NAMED.get(name.lower(), UNKNOWN)


def autopilot_numbered(number: int) -> Autopilot:
    """Return the autopilot of a MAV_AUTOPILOT."""
    return next((each for each in AUTOPILOTS if each.number == number), UNKNOWN)


def advice(topic: Topic, *, between: str = ", ", after: str = ": ") -> str:
    """Return the advice on a topic of each autopilot that has some, after its name."""
    return between.join(f"{each.label}{after}{each.advice[topic]}" for each in AUTOPILOTS if topic in each.advice)
