"""The outcome of a vehicle that a pilot, or its autopilot, took over."""

from agents.ports import VehicleStatus
from agents.shell.outcome import Ending, Outcome


def override_reason(status: VehicleStatus) -> str:
    """Return the change of flight mode or arming by a pilot or the autopilot, as text."""
    what = f"the flight mode became '{status.mode.value}'" if status.armed else "it disarmed"
    lost = f": it reports that its {status.lost.value} is lost" if status.lost.value else ""
    return f"{what}, which cordon did not request{lost}"


def override_outcome(reason: str, *, restarted: bool) -> Outcome:
    """Return the outcome of a vehicle that was handed over."""
    if restarted:
        return Outcome(Ending.PILOT_OVERRIDE, f"{reason}: its autopilot restarted", "examine the vehicle and its log")
    return Outcome(Ending.PILOT_OVERRIDE, reason, "land it from where the mode was changed: cordon has handed it over")
