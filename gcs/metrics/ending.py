"""How a flight ended: of each vehicle, and of the flight as a whole."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from agents.flight_end import FlightEnd
from gcs.autopilots.registry import advice

HEADLINES = {
    FlightEnd.KILLED: "Killed by the operator",
    FlightEnd.ERROR: "Ended by an error in cordon",
    FlightEnd.WATCHDOG: "Ended by the watchdog",
    FlightEnd.IN_FLIGHT: "The log ends in flight",
    FlightEnd.PILOT: "Handed over, not landed by cordon",
    FlightEnd.REFUSED: "Ended by a refusal of the autopilot",
    FlightEnd.BATTERY: "Ended by low battery",
    FlightEnd.FAILSAFE: "Ended by a failsafe",
    FlightEnd.UNKNOWN: "Ended for a reason unknown to this version",
    FlightEnd.ABORTED: "Aborted by the operator",
    FlightEnd.OPERATOR: "Ended by the operator",
    FlightEnd.LANDED: "Landed and disarmed",
    FlightEnd.SIMULATED: "Flown to the end of the simulation",
}
_SEVERITY = {how: place for place, how in enumerate(FlightEnd)}


@dataclass(frozen=True, slots=True)
class VehicleEnding:
    """How one vehicle's flight ended, and the reason in a few words."""

    vehicle: int
    how: FlightEnd
    reason: str


@dataclass(frozen=True, slots=True)
class TeamEnding:
    """How a flight ended: the most severe ending, the reasons of all vehicles, and the vehicles with that ending."""

    how: FlightEnd
    reason: str
    vehicles: tuple[int, ...]

    @classmethod
    def of(cls, endings: Sequence[VehicleEnding]) -> "TeamEnding | None":
        """Return the ending of the flight of these vehicles, None without vehicles."""
        if not endings:
            return None
        ordered = sorted(endings, key=lambda each: (_SEVERITY[each.how], each.vehicle))
        how = ordered[0].how
        alike: dict[str, list[int]] = {}
        for each in ordered:
            alike.setdefault(each.reason, []).append(each.vehicle)
        sentence = "; ".join(f"{named(vehicles)}: {reason}" for reason, vehicles in alike.items())
        concerned = tuple(each.vehicle for each in ordered if each.how is how)
        return cls(how, f"{sentence[:1].upper()}{sentence[1:]}.", concerned)

    @property
    def is_early(self) -> bool:
        """Whether it ended in flight, before its mission was over."""
        return self.how not in (FlightEnd.LANDED, FlightEnd.SIMULATED)

    @property
    def headline(self) -> str:
        """How it ended, in one line."""
        whose = f": {named(self.vehicles)}" if self.is_early and self.vehicles else ""
        return f"{HEADLINES[self.how]}{whose}"


AUTOPILOTS_ALONE = f"only their autopilots control them now: {advice('alone', between='; ', after=' ')}"
WATCH_THEM = "watch them, and take over by remote control or a ground station; cordon does not reconnect to them"


@dataclass(frozen=True, slots=True)
class LostFlight:
    """A flight whose process is gone while its vehicles may be in the air.

    `reason` is a clause about the end, `ended_s` its time [Unix s]. `vehicles` have not landed as far as known.
    """

    reason: str
    vehicles: tuple[int, ...]
    ended_s: float
    autopilots: str = AUTOPILOTS_ALONE
    next_step: str = WATCH_THEM


def named(vehicles: Iterable[int]) -> str:
    """Return vehicles by their ids: `vehicle 2`, `vehicles 1, 2 and 3`."""
    *others, last = map(str, vehicles)
    return f"vehicles {', '.join(others)} and {last}" if others else f"vehicle {last}"
