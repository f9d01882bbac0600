"""How a flight ended: of each vehicle, and of the flight as a whole."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from agents.flight_end import FlightEnd, LastPosition
from agents.tactics import Tactic
from gcs.autopilots.registry import advice

if TYPE_CHECKING:  # the supervisor of a flight would wait for NumPy
    from estimation.frames import MissionFrame, Triple

HEADLINES = {
    FlightEnd.LOST: "Lost",
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
    FlightEnd.FLIES_ON: "Flies on",
}
_SEVERITY = {how: place for place, how in enumerate(FlightEnd)}


_WATCH_IT = "watch it where `cordon rejoin --add` flies it; Ctrl-C there brings it down"

UNACCOUNTED = "unaccounted for"
"""The alert of a vehicle that no report shows on the ground and no pilot has, until an operator confirms otherwise."""


@dataclass(frozen=True, slots=True)
class Unaccounted:
    """A vehicle that is unaccounted for: its newest position and its age, None if they are not known.

    `position_m` is in the mission frame; latitude and longitude are None in a local frame.
    """

    vehicle: int
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    position_m: "Triple | None" = None
    age_s: float | None = None

    @classmethod
    def of(cls, vehicle: int, last: LastPosition, frame: "MissionFrame") -> "Unaccounted":
        """Return it from a vehicle's newest position in the mission frame."""
        if frame.is_local:
            return cls(vehicle, None, None, last.position_m, last.age_s)
        place = frame.geodetic_from_mission(last.position_m)
        return cls(vehicle, place.latitude_deg, place.longitude_deg, last.position_m, last.age_s)

    @property
    def place(self) -> str:
        """Where it was last and how long ago, as text."""
        if self.position_m is None or self.age_s is None:
            return "its last position is in the flight log"
        x, y, z = self.position_m
        at = (
            f"x {x:.1f} m, y {y:.1f} m"
            if self.latitude_deg is None
            else f"{self.latitude_deg:.6f}, {self.longitude_deg:.6f}"
        )
        return f"last at {at}, height {z:.1f} m, {self.age_s:.0f} s ago"

    @property
    def line(self) -> str:
        """It as a sentence at the end of a flight."""
        return f"Vehicle {self.vehicle} is {UNACCOUNTED}: {self.place}"


@dataclass(frozen=True, slots=True)
class VehicleEnding:
    """How one vehicle's flight ended, the reason in a few words, and where it was last if it is unaccounted for.

    One that `joined` the flight from a process of its own ended as far as the others received it, last at `heard_s`
    since the mission's start.
    """

    vehicle: int
    how: FlightEnd
    reason: str
    unaccounted: Unaccounted | None = None
    joined: bool = False
    heard_s: float | None = None

    @property
    def fell_silent(self) -> bool:
        """Whether it joined, and was received in the air last although the others flew on."""
        return self.joined and self.how is FlightEnd.LOST


@dataclass(frozen=True, slots=True)
class HeardLast:
    """A vehicle of another process as it was received last: its tactic, when since the mission's start, and where.

    `silent_s` passed from then until the last one that could receive it ended its flight; it `is_high` above the ground
    or about to land.
    """

    vehicle: int
    tactic: str
    heard_s: float
    silent_s: float
    position_m: "Triple"
    is_high: bool

    def ending(self, frame: "MissionFrame", lost_after_s: float) -> VehicleEnding:
        """Return how its flight ended: it had joined the others, which receive the states of those in the air only."""
        if self.tactic == Tactic.PILOT_OVERRIDE.value:
            how, reason = FlightEnd.PILOT, "joined this flight, and was handed over or fell"
        elif self.silent_s <= lost_after_s:
            how, reason = FlightEnd.FLIES_ON, f"joined this flight and still flies ({self.tactic}): {_WATCH_IT}"
        elif self.tactic == Tactic.LAND.value and not self.is_high:
            how, reason = FlightEnd.LANDED, "joined this flight and landed"
        else:
            how, reason = FlightEnd.LOST, "joined this flight and fell silent in the air"
        lost = Unaccounted.of(self.vehicle, LastPosition(self.position_m, self.silent_s), frame)
        unaccounted = lost if how is FlightEnd.LOST else None
        return VehicleEnding(self.vehicle, how, reason, unaccounted, joined=True, heard_s=self.heard_s)


@dataclass(frozen=True, slots=True)
class TeamEnding:
    """How a flight ended: the most severe ending, the reasons of all vehicles, and the vehicles with that ending.

    `unaccounted` are the vehicles that were unaccounted for at its end, `still_flying` those that had joined it and had
    not landed.
    """

    how: FlightEnd
    reason: str
    vehicles: tuple[int, ...]
    unaccounted: tuple[Unaccounted, ...] = ()
    still_flying: tuple[int, ...] = ()

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
        lost = tuple(each.unaccounted for each in ordered if each.unaccounted is not None)
        aloft = tuple(each.vehicle for each in ordered if each.how is FlightEnd.FLIES_ON)
        return cls(how, f"{sentence[:1].upper()}{sentence[1:]}.", concerned, lost, aloft)

    @property
    def is_early(self) -> bool:
        """Whether it ended in flight, before its mission was over."""
        return self.how not in (FlightEnd.LANDED, FlightEnd.SIMULATED, FlightEnd.FLIES_ON)

    @property
    def headline(self) -> str:
        """How it ended, in one line."""
        whose = f": {named(self.vehicles)}" if self.is_early and self.vehicles else ""
        return f"{HEADLINES[self.how]}{whose}"


AUTOPILOTS_ALONE = f"only their autopilots control them now: {advice('alone', between='; ', after=' ')}"
SEARCH = "search at its last position, then confirm that it was recovered"
"""The advice on the page, where it is confirmed."""
RECOVERY = "cordon recover"


def watch_them(recovery: str = RECOVERY) -> str:
    """Return what to do about vehicles that only their autopilots control; `recovery` is the command for them."""
    return f"watch them; bring home those in the air by `{recovery}`, remote control or a ground station"


WATCH_THEM = watch_them()


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
