"""The whole configuration of one agent."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, pi

from agents.settings.sections import (
    ChoreographySettings,
    DecisionSettings,
    EncirclementSettings,
    ExcitationSettings,
    FailsafeSettings,
    FormationSettings,
    GimbalSettings,
    SafetySettings,
)
from agents.settings.shapes import SHAPES, Shape, SpacedShape, gap_m, offset_m
from estimation.plant.model import Plant
from estimation.settings import OwnFilterSettings, TargetFilterSettings

CLIMB_SLOWEST_M_S = 0.5
SETTLE_S = 3.0


@dataclass(frozen=True, slots=True)
class RingConfig:
    """One of a mission's rings: its name, that of its target, how many vehicles fly on it at most, and its settings.

    It may cut others if it is `shared`.
    """

    name: str
    target: str
    places: int
    encirclement: EncirclementSettings
    shared: bool = False


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """The complete configuration of one agent.

    Its sections `formation` to `choreography` have the keys of docs/mission-keys.md, such as `encirclement.radius_m`,
    whose names end with the unit. Positions are in the mission frame, heights above its origin.

    `slots` are the vehicles of the formation in line order, with this one; `line_start_m` is the start of the leader's
    line, `altitude_m` its flying height, `communication_radius_m` the radio range. `home_m` is where it takes off
    (None: it lands in place), `rally_m` are its spots at the rally points, `starts_m` the places where the vehicles of
    `slots` take off (empty: not known), `layers_from_m` is the lowest layer's height
    and `altitude_lowest_m` the lowest flying height (None: its own). The ring's lowest vehicle stays between the two of
    `lowest_between_m`, which keeps every vehicle inside its limits. `slots_m` are the positions in a free formation,
    `gaps` the weights of the ring's gaps. With `excitation` it flies for identification.
    With a `gimbal` its camera looks at the target. Those
    of the formation in `reserves` do not fly from the start. The last one in line is `added` if it is not in the
    mission file and joins in flight.

    A mission of several rings has them all in `rings`, and the names of its targets in `targets`; `ring` is the number
    of the one that the vehicle flies, whose settings are `encirclement`. Both are empty with one ring.
    """

    vehicle_id: int
    slots: tuple[int, ...]
    line_start_m: tuple[float, float]
    altitude_m: float
    rate_hz: float
    communication_radius_m: float
    plant: Plant
    formation: FormationSettings
    encirclement: EncirclementSettings
    decision: DecisionSettings = field(default_factory=DecisionSettings)
    safety: SafetySettings = field(default_factory=SafetySettings)
    failsafe: FailsafeSettings = field(default_factory=FailsafeSettings)
    own_filter: OwnFilterSettings = field(default_factory=OwnFilterSettings)
    target_filter: TargetFilterSettings = field(default_factory=TargetFilterSettings)
    choreography: ChoreographySettings = field(default_factory=ChoreographySettings)
    home_m: tuple[float, float] | None = None
    rally_m: tuple[tuple[float, float], ...] = ()
    starts_m: tuple[tuple[float, float], ...] = ()
    layers_from_m: float | None = None
    altitude_lowest_m: float | None = None
    lowest_between_m: tuple[float | None, float | None] = (None, None)
    slots_m: tuple[tuple[float, float], ...] = ()
    gaps: Mapping[int, float] = field(default_factory=dict, hash=False)
    excitation: ExcitationSettings | None = None
    gimbal: GimbalSettings | None = None
    profile: str = ""
    targets: tuple[str, ...] = ()
    rings: tuple[RingConfig, ...] = ()
    ring: int = 0
    reserves: tuple[int, ...] = ()
    added: int | None = None

    @property
    def landing_places_m(self) -> tuple[tuple[float, float], ...]:
        """Where it may land: where it takes off and its spots at rally points; none without a home."""
        return () if self.home_m is None else (self.home_m, *self.rally_m)

    @property
    def others_landing_places_m(self) -> list[tuple[int, tuple[float, float]]]:
        """Where the other vehicles may land, each with its id: about a rally point they stand as at the start."""
        if self.home_m is None:
            return []
        (x, y), others = self.home_m, zip(self.slots, self.starts_m, strict=True) if self.starts_m else ()
        spots_m = [(spot_x - x, spot_y - y) for spot_x, spot_y in self.landing_places_m]
        return [
            (other, (other_x + spot_x, other_y + spot_y))
            for other, (other_x, other_y) in others
            if other != self.vehicle_id
            for spot_x, spot_y in spots_m
        ]

    def with_added(
        self, vehicle_id: int, start_m: tuple[float, float], slot_m: tuple[float, ...] = ()
    ) -> "AgentConfig":
        """Return the configuration in a team that a vehicle joins which is not in the mission file.

        It is the last in line, so that the others keep their slots and layers, and land before it. One that has been
        added before may come back from another place.
        """
        before = len(self.slots) - (self.added == vehicle_id)
        slots_m = (*self.slots_m[:before], (slot_m[0], slot_m[1])) if slot_m else self.slots_m
        return replace(
            self,
            slots=(*self.slots[:before], vehicle_id),
            starts_m=(*self.starts_m[:before], start_m) if self.starts_m else (),
            slots_m=slots_m,
            gaps={**self.gaps, vehicle_id: 1.0},
            reserves=(*(each for each in self.reserves if each != vehicle_id), vehicle_id),
            added=vehicle_id,
        )

    def on_ring(self, ring: int) -> "AgentConfig":
        """Return the configuration of this vehicle on another of its mission's rings; it is this one with one ring."""
        return replace(self, ring=ring, encirclement=self.rings[ring].encirclement) if self.rings else self

    def with_flown(self, ring: int, flown: EncirclementSettings) -> "AgentConfig":
        """Return the configuration with other settings of one of the mission's several rings."""
        rings = [replace(each, encirclement=flown) if k == ring else each for k, each in enumerate(self.rings)]
        return replace(self, rings=tuple(rings))

    @property
    def target(self) -> str | None:
        """The name of the target of the ring that it flies, None in a mission of one target."""
        return self.rings[self.ring].target if self.rings and self.targets else None

    @property
    def starters(self) -> tuple[int, ...]:
        """The vehicles of the formation that begin the mission together."""
        return tuple(each for each in self.slots if each not in self.reserves)

    @property
    def places(self) -> int:
        """How many vehicles fly on its ring at most."""
        return self.rings[self.ring].places if self.rings else len(self.slots)

    @property
    def lowest_m(self) -> float:
        """The flying height of the team's lowest vehicle."""
        return self.altitude_m if self.altitude_lowest_m is None else self.altitude_lowest_m

    @property
    def shape(self) -> Shape:
        """The formation's shape."""
        return self.formation.shape or ("free" if self.slots_m else "line")

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The possible shapes: "free" if there are slots, the others by separation and radio range."""
        return tuple(shape for shape in SHAPES if (self.slots_m if shape == "free" else self._is_possible(shape)))

    @property
    def turns_nose(self) -> bool:
        """Whether the yaw of setpoints is anything but 0."""
        return self.formation.yaw != "fixed" or self.encirclement.yaw != "fixed"

    def reshaped(self, shape: Shape) -> "AgentConfig":
        """Return a copy with another shape of the formation."""
        return replace(self, formation=self.formation.model_copy(update={"shape": shape}))

    def with_ring(
        self,
        radius_m: float | None = None,
        angular_rate_rad_s: float | None = None,
        altitude_m: float | None = None,
        tilt_deg: float | None = None,
    ) -> "AgentConfig":
        """Return a copy with other values of the ring; None for one that stays.

        Vehicles engage from as far outside a larger ring as before: one that held on it comes back when it resumes.
        """
        names = ("radius_m", "angular_rate_rad_s", "altitude_m", "tilt_deg")
        given = zip(names, (radius_m, angular_rate_rad_s, altitude_m, tilt_deg), strict=True)
        update = {name: value for name, value in given if value is not None} | {"radius_far_m": self.encirclement.far_m}
        ring = self.encirclement.model_copy(update=update)
        engages_m = self.decision.distance_max_m + max(0.0, ring.radius_m - self.encirclement.radius_m)
        return replace(self, encirclement=ring, decision=self.decision.model_copy(update={"distance_max_m": engages_m}))

    def slot_offset_m(self, vehicle_id: int, relative_to: int) -> tuple[float, float]:
        """Return the slot of `vehicle_id` relative to that of another member [m]."""
        (x, y), (other_x, other_y) = self._slot_m(vehicle_id), self._slot_m(relative_to)
        return x - other_x, y - other_y

    def _is_possible(self, shape: SpacedShape) -> bool:
        """Return whether vehicles keep their separation in a shape, and those that keep station hear each other."""
        formation, count = self.formation, len(self.slots)
        if count == 1:
            return True
        farthest_m = self.communication_radius_m if formation.station == "predecessor" else inf
        far_m = gap_m(shape, count, self.slots.index(formation.leader), formation.spacing_m)
        return formation.spacing_m >= self.safety.separation_m and far_m <= farthest_m

    def _slot_m(self, vehicle_id: int) -> tuple[float, float]:
        place, shape = self.slots.index(vehicle_id), self.shape
        if shape == "free":
            return self.slots_m[place]
        return offset_m(shape, place, self.slots.index(self.formation.leader), self.formation.spacing_m)

    @property
    def clearance_rad(self) -> float:
        """The angle between two vehicles on the ring at which they are one separation apart."""
        half_chord = self.safety.separation_m / 2.0 / self.encirclement.radius_m
        return min(2.0 * half_chord, pi / 2.0)

    @property
    def take_off_altitude_m(self) -> float:
        """The vehicle's layer from take-off until all are in their slots; without layers its flying height."""
        return self._layer_m(self.slots.index(self.vehicle_id))

    @property
    def return_altitude_m(self) -> float:
        """The vehicle's layer on the way home, above all flying heights, in landing order from the lowest."""
        return self._layer_m(self.landing_order.index(self.vehicle_id) + 1)

    @property
    def rising_s(self) -> float:
        """How long the slowest vehicle climbs to its layer on the way home; until then none moves horizontally [s].

        The ring may be higher or lower than the flying heights: from there a vehicle comes as it went.
        """
        ring = self.encirclement
        off_m = abs(ring.lowest_m(self.lowest_m) - self.lowest_m)
        layers_s = len(self.slots) * self.choreography.layer_m / CLIMB_SLOWEST_M_S
        return SETTLE_S + layers_s + (off_m + ring.rise_m) / ring.climb_max_m_s

    @property
    def landing_order(self) -> tuple[int, ...]:
        """All vehicles in the order in which they land."""
        return self.choreography.in_landing_order(self.slots)

    def _layer_m(self, number: int) -> float:
        if self.choreography.layer_m == 0.0:
            return self.altitude_m
        lowest_m = self.altitude_m if self.layers_from_m is None else self.layers_from_m
        return lowest_m + number * self.choreography.layer_m
