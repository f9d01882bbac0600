"""The events of one vehicle, and their text: it is made here, for people, and nothing reads it.

An event is noted with its values. Notes are collected here and drained once a tick.
"""

from collections.abc import Mapping
from typing import ClassVar, Literal

import msgspec

Kind = Literal["tactic", "command", "failsafe", "guard", "ring"]
GuardCause = Literal["separation", "fence", "no-fly zone", "traffic", "keep out", "speed", "reach"]
_GUARDED: Mapping[GuardCause, str] = {
    "separation": "evading",
    "fence": "kept inside the fence",
    "no-fly zone": "kept out of a no-fly zone",
    "traffic": "kept clear of traffic",
    "keep out": "kept out of the target's zone",
    "speed": "slowed to the speed limit",
    "reach": "setpoint kept near the vehicle",
}
"""What the guard does for each cause, as text."""


class TacticChange(msgspec.Struct, frozen=True):
    """A change of tactic, and the event that caused it."""

    kind: ClassVar[Kind] = "tactic"
    before: str
    after: str
    event: str

    @property
    def text(self) -> str:
        """It as text."""
        return f"{self.before} -> {self.after}: {self.event}"


class LandingAside(msgspec.Struct, frozen=True):
    """The landing place is not free: it waits `waits_s`, or lands at another place (x, y)."""

    kind: ClassVar[Kind] = "tactic"
    obstacle: str
    place_m: tuple[float, ...] = ()
    waits_s: float = 0.0

    @property
    def text(self) -> str:
        """It as text."""
        if not self.place_m:
            return f"its landing place is not free: {self.obstacle}; it lands aside in {self.waits_s:g} s"
        x, y = self.place_m
        return f"lands aside, at x {x:.1f} m, y {y:.1f} m: {self.obstacle}"


class AlertChange(msgspec.Struct, frozen=True):
    """A condition of the failsafe table begins, reaches the next reaction, or is over."""

    kind: ClassVar[Kind] = "failsafe"
    condition: str
    detail: str = ""
    reaction: str = ""
    is_over: bool = False
    waits_for_resume: bool = False
    """The condition is over, and the vehicle stays in its reaction until a resume."""

    @property
    def text(self) -> str:
        """It as text."""
        if self.is_over:
            return f"{self.condition}: cleared" + ("; resume continues the mission" if self.waits_for_resume else "")
        return f"{self.condition}: {self.detail}: {self.reaction}"


class ResumeRefusal(msgspec.Struct, frozen=True):
    """A resume that was refused, and why."""

    kind: ClassVar[Kind] = "failsafe"
    reason: str

    @property
    def text(self) -> str:
        """It as text."""
        return f"resume refused: {self.reason}"


class CommandOutcome(msgspec.Struct, frozen=True):
    """The outcome of an operator's command; `looks_at_m` is the place (x, y) of the verb look, empty for the target."""

    kind: ClassVar[Kind] = "command"
    verb: str
    origin: str
    did: str
    is_refused: bool = False
    looks_at_m: tuple[float, ...] = ()

    @property
    def text(self) -> str:
        """It as text."""
        return f"{self.verb} by {self.origin}: {self.did}"


class ShapeChange(msgspec.Struct, frozen=True):
    """The formation takes another shape."""

    kind: ClassVar[Kind] = "command"
    shape: str

    @property
    def text(self) -> str:
        """It as text."""
        return f"the formation's shape is '{self.shape}'"


class RingCommanded(msgspec.Struct, frozen=True):
    """The ring that operators have commanded, from now on; `ring` is its number in a mission of several rings."""

    kind: ClassVar[Kind] = "command"
    radius_m: float
    angular_rate_rad_s: float
    altitude_m: float | None = None
    tilt_deg: float = 0.0
    ring: int = 0
    name: str = ""

    @property
    def text(self) -> str:
        """It as text, with the ring's name in a mission of several."""
        altitude = "" if self.altitude_m is None else f", its altitude {self.altitude_m:g} m"
        tilt = f", its tilt {self.tilt_deg:g}°" if self.tilt_deg else ""
        ring = f"the ring '{self.name}': its" if self.name else "the ring's"
        return f"{ring} radius is {self.radius_m:g} m, its rate {self.angular_rate_rad_s:g} rad/s{altitude}{tilt}"


class VehicleAdded(msgspec.Struct, frozen=True):
    """A vehicle that is not in the mission file may join from now on, or why it may not."""

    kind: ClassVar[Kind] = "command"
    vehicle: int
    refusal: str = ""

    @property
    def text(self) -> str:
        """It as text."""
        becomes = f"must not join: {self.refusal}" if self.refusal else "is added"
        return f"vehicle {self.vehicle}, which is not in the mission file, {becomes}"


class PeerRingRefusal(msgspec.Struct, frozen=True):
    """A ring in a peer's state that is not flown, and why; it has a name in a mission of several rings."""

    kind: ClassVar[Kind] = "command"
    sender: int
    reason: str
    name: str = ""

    @property
    def text(self) -> str:
        """It as text."""
        ring = f"ring '{self.name}'" if self.name else "ring"
        return f"refused the {ring} in vehicle {self.sender}'s state: {self.reason}"


class RingChange(msgspec.Struct, frozen=True):
    """How the flown ring differs from the planned one from now on, and why; empty if it does not."""

    kind: ClassVar[Kind] = "ring"
    differs: str

    @property
    def text(self) -> str:
        """It as text."""
        return self.differs or "the whole ring"


class GuardAction(msgspec.Struct, frozen=True):
    """The guard moves a planned aim for these causes, and keeps apart from vehicles `evaded`."""

    kind: ClassVar[Kind] = "guard"
    causes: tuple[GuardCause, ...]
    evaded: tuple[int, ...] = ()

    @property
    def text(self) -> str:
        """It as text: "evading 1, 3, kept inside the fence"."""
        words = [_GUARDED[cause] for cause in self.causes]
        evaded = f"{_GUARDED['separation']} {', '.join(map(str, self.evaded))}".rstrip()
        return ", ".join(evaded if each == _GUARDED["separation"] else each for each in words)


class Revocation(msgspec.Struct, frozen=True):
    """Keys were revoked in flight: nothing is received from these certificates any more."""

    kind: ClassVar[Kind] = "command"
    common_names: tuple[str, ...]

    @property
    def text(self) -> str:
        """It as text."""
        return f"keys revoked: {', '.join(self.common_names) or 'none'}"


class ReferenceChange(msgspec.Struct, frozen=True):
    """A change of what positions refer to."""

    kind: ClassVar[Kind] = "failsafe"
    what: Literal["origin moved", "position jumped"]
    north_m: float
    east_m: float
    up_m: float

    @property
    def by(self) -> str:
        """By how much, as text."""
        north, east, up = (round(each, 1) + 0.0 for each in (self.north_m, self.east_m, self.up_m))  # no -0.0
        return f"{north} m north, {east} m east, {up} m up"

    @property
    def text(self) -> str:
        """It as text."""
        return f"{self.what} {self.by}"


NotedEvent = (
    TacticChange
    | LandingAside
    | AlertChange
    | ResumeRefusal
    | CommandOutcome
    | ShapeChange
    | RingChange
    | RingCommanded
    | PeerRingRefusal
    | GuardAction
    | ReferenceChange
    | Revocation
    | VehicleAdded
)


class Note(msgspec.Struct, frozen=True):
    """One event: time, kind, text, the numbers behind it, and its values."""

    time_s: float
    kind: Kind
    text: str
    because: str = ""
    tactic: TacticChange | None = None
    alert: AlertChange | None = None
    command: CommandOutcome | None = None
    reference: ReferenceChange | None = None
    guard: GuardAction | None = None
    ring: RingCommanded | None = None


class Notes:
    """Collects the notes of one vehicle in the order in which its stages add them."""

    def __init__(self) -> None:
        self._notes: list[Note] = []

    def add(self, time_s: float, event: NotedEvent, because: str = "") -> None:
        """Append a note of an event."""
        note = Note(
            time_s,
            event.kind,
            event.text,
            because,
            event if isinstance(event, TacticChange) else None,
            event if isinstance(event, AlertChange) else None,
            event if isinstance(event, CommandOutcome) else None,
            event if isinstance(event, ReferenceChange) else None,
            event if isinstance(event, GuardAction) else None,
            event if isinstance(event, RingCommanded) else None,
        )
        self._notes.append(note)

    def drained(self) -> tuple[Note, ...]:
        """Return and remove the notes since the last call."""
        notes = tuple(self._notes)
        self._notes.clear()
        return notes
