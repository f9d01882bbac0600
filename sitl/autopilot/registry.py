"""The autopilots that stubs can have, by their names in profiles and missions."""

from importlib import import_module

from estimation.profile.autopilots import AutopilotName
from sitl.autopilot.autopilot import Autopilot


def autopilot_named(name: AutopilotName) -> type[Autopilot]:
    """Return the class of an autopilot; its file has its name."""
    found: type[Autopilot] = import_module(f"sitl.autopilot.{name}").AUTOPILOT
    return found
