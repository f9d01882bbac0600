"""A mission of several rings: it is checked as the mission of each ring alone, and the rings against each other."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from agents.settings.sections import EncirclementSection, EncirclementSettings
from estimation.settings import Settings
from gcs.errors import KeyFault
from gcs.mission.cross_checks import LoadedVehicle, cross_checked
from gcs.mission.mission import Mission, MissionRing, TargetSection, VehicleSection
from gcs.mission.ring_tables import ReadRing, read_rings, read_targets
from gcs.mission.stability import unstable_loops
from gcs.mission.tubes import Tube, cutting_rings

_KEY_OF_A_RING = re.compile(r"(?<![\w.])(encirclement|target)(?=$|\.[a-z])")


def several_rings(content: Mapping[str, Any], faults: list[KeyFault]) -> "SeveralRings":
    """Return the targets and rings of a file's content, and append the faults of their tables."""
    targets = read_targets(content, faults)
    rings = read_rings(content, targets, faults)
    given = content.get("rings")
    return SeveralRings(targets, rings, rings is not None and isinstance(given, list) and len(rings) == len(given))


@dataclass(frozen=True, slots=True)
class SeveralRings:
    """The `[[targets]]` and the valid `[[rings]]` of a mission file, None where it has `[target]`, `[encirclement]`.

    `has_all` is whether all rings are valid.
    """

    targets: tuple[TargetSection | None, ...] | None
    rings: tuple[ReadRing, ...] | None
    has_all: bool

    @property
    def sections(self) -> dict[str, Settings | None]:
        """The settings of `[target]` and `[encirclement]` that the tables replace: those of the first ring."""
        found: dict[str, Settings | None] = {}
        first = self.rings[0] if self.rings else None
        if self.targets is not None:
            number = 0 if first is None or first.target is None else first.target
            found["target"] = self.targets[number] if self.targets else None
        if self.rings is not None:
            found["encirclement"] = None if first is None else first.section
        return found

    @property
    def mission_targets(self) -> tuple[TargetSection, ...]:
        """The targets of a valid mission, none if it has one only."""
        targets = self.targets or ()
        return tuple(each for each in targets if each is not None) if len(targets) > 1 else ()

    def mission_rings(self, encirclement: Any) -> tuple[MissionRing, ...]:
        """Return the rings of a valid mission, whose first has these settings; none if it has one only."""
        if self.rings is None or len(self.rings) < 2:
            return ()
        return tuple(
            MissionRing(
                ring.name, ring.target or 0, ring.section.places, _settings(encirclement, ring), ring.section.shared
            )
            for ring in self.rings
        )

    def checked(self, sections: Mapping[str, Any], vehicles: list[LoadedVehicle | None]) -> Iterator[KeyFault]:
        """Yield the faults across the sections for each ring, each fault that they have in common once."""
        if not self.rings:
            yield from cross_checked(sections, vehicles, len(vehicles))
            return
        found: dict[KeyFault, None] = {}
        tubes = []
        for ring in self.rings:
            first = sections["encirclement"]  # None if the tuning has faults
            own = {**sections, "encirclement": None if first is None else _settings(first, ring)}
            if self.targets is not None:
                own["target"] = None if ring.target is None else self.targets[ring.target]
            faults = cross_checked(own, vehicles, ring.section.places)
            found |= dict.fromkeys(self._placed(fault, ring) for fault in faults)
            if first is not None and (target := own.get("target")) is not None:
                tubes.append(Tube(ring.number, own["encirclement"], target.motion, ring.section.shared))
        yield from found
        yield from self._enough_places(len(vehicles))
        known = [vehicle[0] for vehicle in vehicles if vehicle is not None]
        if len(known) == len(vehicles) > 0:
            yield from self._named(known)
            yield from cutting_rings(tubes, known, sections.get("safety"), sections.get("mission"))

    def _named(self, vehicles: Sequence[VehicleSection]) -> Iterator[KeyFault]:
        """Yield a fault for each simulated target that no sensor names: vehicles track named ones only."""
        targets = self.targets or ()
        for number, target in enumerate(targets):
            if target is None or len(targets) < 2 or target.source != "simulated":
                continue
            own = [each.sensor.model_dump(exclude_unset=True) if each.sensor else {} for each in vehicles]
            if not any(each.get("names", target.sensor.names) for each in own):
                reason = (
                    "no sensor names this target, and vehicles track only named ones: let one vehicle's sensor do so"
                )
                yield KeyFault(f"targets[{number}].sensor.names", reason)

    def unstable(self, mission: Mission) -> Iterator[KeyFault]:
        """Yield the unstable loops of a mission on each of its rings."""
        if self.rings is None or not mission.rings:
            yield from unstable_loops(mission)
            return
        faults = (
            self._placed(each, ring) for ring in self.rings for each in unstable_loops(mission.of_ring(ring.number))
        )
        yield from dict.fromkeys(faults)

    def _placed(self, fault: KeyFault, ring: ReadRing) -> KeyFault:
        place, reason = (
            of_ring_text(text, ring.number, None if self.targets is None else ring.target)
            for text in (fault.place, fault.reason)
        )
        return KeyFault(place, reason, fault.line)

    def _enough_places(self, vehicles: int) -> Iterator[KeyFault]:
        places = sum(ring.section.places for ring in self.rings or ())
        if self.has_all and places < vehicles:
            yield KeyFault(
                "rings",
                f"they have {places} places in all for {vehicles} vehicles: raise the places of a ring, or add a ring",
            )


def of_ring_text(text: str, ring: int, target: int | None) -> str:
    """Return a text about the mission of one ring with the keys of that ring and target, None for the only target."""

    def key(match: re.Match[str]) -> str:
        if match[1] == "encirclement":
            return f"rings[{ring}]"
        return match[1] if target is None else f"targets[{target}]"

    return _KEY_OF_A_RING.sub(key, text)


def _settings(encirclement: EncirclementSettings, ring: ReadRing) -> EncirclementSettings:
    """Return the settings of a ring from those of the first, which have the same tuning."""
    return encirclement.model_copy(update={key: getattr(ring.section, key) for key in EncirclementSection.model_fields})
