"""From a mission's TOML text to a checked `Mission`, or to the list of everything that is wrong with it.

Sections are validated one by one and cross-checked as far as they hold, so that one run names every fault at once.
"""

import difflib
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from math import hypot
from pathlib import Path
from typing import TypeVar, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from agents.control.encirclement import chord_m
from agents.settings.sections import (
    ChoreographySettings,
    DecisionSettings,
    EncirclementSettings,
    ExcitationSettings,
    FailsafeSettings,
    FormationSettings,
    SafetySettings,
)
from estimation.plant.file import PlantFileError, PlantShelf
from estimation.settings import OwnFilterSettings, Settings, TargetFilterSettings
from gcs.errors import InputError
from gcs.mission.control_loops import kept_up, unstable_loops
from gcs.mission.excitation import excitation_faults, excited, limits_rise
from gcs.mission.geometry import (
    IndexedVehicles,
    altitudes_fit,
    fence_fits,
    follows_fit,
    limits_agree,
    slots_fit,
)
from gcs.mission.mission import (
    FrameSection,
    LinkSection,
    Mission,
    MissionSection,
    NetworkSection,
    SimulationSection,
    TargetSection,
    VehicleSection,
    VerdictSection,
)
from gcs.mission.plants import LoadedVehicle, fed_as_told, resolved

LAYER_LEAST_M = 1.0
EXCITES = "excite"
"""The key above all sections by which a mission is the flight for identification of the vehicle of that id."""
_BUNDLED = Path(__file__).parent / "missions"
SECTIONS: dict[str, type[Settings]] = {
    "mission": MissionSection,
    "frame": FrameSection,
    "formation": FormationSettings,
    "encirclement": EncirclementSettings,
    "decision": DecisionSettings,
    "safety": SafetySettings,
    "failsafe": FailsafeSettings,
    "own_filter": OwnFilterSettings,
    "target_filter": TargetFilterSettings,
    "target": TargetSection,
    "network": NetworkSection,
    "link": LinkSection,
    "choreography": ChoreographySettings,
    "excitation": ExcitationSettings,
    "simulation": SimulationSection,
    "verdicts": VerdictSection,
}
_REQUIRED = ("mission", "frame", "formation", "encirclement", "target")
_PLAIN_WORDS = {
    "missing": "this key is missing",
    "model_type": "it must be a table",
    "tuple_type": "it must be a list of numbers",
    "too_long": "it holds too many numbers",
}

_S = TypeVar("_S", bound=Settings)


class MissionError(InputError):
    """A mission cannot be flown as written; every fault comes with its path in the file."""


def bundled_missions() -> list[str]:
    """Return the names of the missions that come with cordon."""
    return sorted(path.stem for path in _BUNDLED.glob("*.toml"))


def mission_path(name: str) -> Path:
    """Return where a mission is written."""
    return _BUNDLED / f"{name}.toml" if name in bundled_missions() else Path(name)


def load_mission(name: str) -> Mission:
    """Load a bundled mission by its bare name, or a file by its path; raises MissionError with every fault."""
    path = mission_path(name)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        known = ", ".join(bundled_missions())
        raise MissionError([f"{name}: {error.strerror or error}; bundled missions: {known}"]) from error
    except UnicodeDecodeError as error:
        raise MissionError([f"{name}: not a text file: {error}"]) from error
    return parse_mission(text, path.parent)


def parse_mission(text: str, folder: Path, plant_texts: Mapping[str, str] | None = None) -> Mission:
    """Check a mission's text; plants whose text is not given are looked up in `folder`.

    Raises MissionError with every fault.
    """
    shelf = PlantShelf(folder, plant_texts)
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers and nesting beyond Python's limits
        raise MissionError([f"not TOML: {error}"]) from error
    excites = content.pop(EXCITES, None)
    faults = [
        unknown_key("", key, [*SECTIONS, "vehicles"]) for key in content if key not in SECTIONS and key != "vehicles"
    ]
    faults += [f"{name}: this section is missing" for name in _REQUIRED if name not in content]
    sections = {
        name: validated(model, content.get(name, {}), name, faults)
        for name, model in SECTIONS.items()
        if name in content or name not in _REQUIRED
    }
    # Thresholds that do not hold are told once, not again for every vehicle.
    decision = content.get("decision", {}) if sections["decision"] is not None else {}
    vehicles = _vehicles(content.get("vehicles", []), decision, shelf, faults)
    faults += _cross_checked(sections, vehicles)
    if faults:
        raise MissionError(faults)
    sections.pop("decision")
    complete = tuple(resolved(*vehicle) for vehicle in vehicles if vehicle is not None)
    mission = Mission(**sections, vehicles=complete, text=text, plant_texts=shelf.texts)  # type: ignore[arg-type]  # each is of its section's model
    if unstable := list(unstable_loops(mission)):
        raise MissionError(unstable)
    return mission if excites is None else _excited(mission, excites)


def excitation_mission(mission: Mission, vehicle_id: int) -> Mission:
    """Return the flight for identification of one of a mission's vehicles; raises MissionError with every fault.

    Its text is the mission's, with a first line that says so: whoever reads it has the same flight.
    """
    if mission.excites:
        return mission
    return parse_mission(f"{EXCITES} = {vehicle_id}\n{mission.text}", Path(), mission.plant_texts)


def _excited(mission: Mission, vehicle_id: object) -> Mission:
    vehicle = next((each for each in mission.vehicles if each.id == vehicle_id), None)
    if vehicle is None:
        ids = ", ".join(map(str, mission.ids))
        raise MissionError([f"{EXCITES}: no vehicle has the id {_shown(vehicle_id)} (ids: {ids})"])
    if faults := list(excitation_faults(mission, vehicle)):
        raise MissionError(faults)
    return excited(mission, vehicle)


def validated(model: type[_S], content: object, path: str, faults: list[str]) -> _S | None:
    """Return a section of a mission file, or None and add everything that is wrong with it to the faults."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        faults += [_plain(model, path, fault) for fault in error.errors()]
        return None


def _plain(model: type[Settings], path: str, fault: ErrorDetails) -> str:
    """Return a fault of a section in a user's words."""
    *parents, last = fault["loc"] or ("",)
    if fault["type"] == "extra_forbidden":
        return unknown_key(_place(path, parents), str(last), _known_keys(model, parents))
    reason = _PLAIN_WORDS.get(fault["type"]) or fault["msg"].removeprefix("Value error, ").replace(
        "Input should be", "it must be"
    )
    given = "" if fault["type"] == "missing" else f" (given: {_shown(fault['input'])})"
    return f"{_place(path, fault['loc'])}: {reason}{given}"


def _place(path: str, below: Sequence[int | str]) -> str:
    return path + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in below)


def _known_keys(model: type[Settings], parents: Sequence[int | str]) -> list[str]:
    """Return the keys of a table somewhere below a section."""
    for key in filter(lambda part: isinstance(part, str), parents):
        annotation = model.model_fields[str(key)].annotation
        kinds = (annotation, *get_args(annotation))
        model = next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Settings))
    return list(model.model_fields)


def _shown(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def unknown_key(parent: str, key: str, known: list[str]) -> str:
    """Return what to say of a key that is none of the known."""
    near = difflib.get_close_matches(key, known, n=1)
    hint = f"; did you mean '{near[0]}'?" if near else f"; known keys: {', '.join(sorted(known))}"
    return f"{parent}{'.' if parent else ''}{key}: unknown key{hint}"


def _vehicles(content: object, decision: object, shelf: PlantShelf, faults: list[str]) -> list[LoadedVehicle | None]:
    if not isinstance(content, list) or not content:
        faults.append("vehicles: a mission needs at least one [[vehicles]] table")
        return []
    return [_vehicle(entry, decision, shelf, f"vehicles[{i}]", faults) for i, entry in enumerate(content)]


def _vehicle(entry: object, decision: object, shelf: PlantShelf, path: str, faults: list[str]) -> LoadedVehicle | None:
    if isinstance(entry, dict) and isinstance(decision, dict):
        # A vehicle overrides single thresholds; the others are the mission's.
        own = entry.get("decision", {})
        entry = {**entry, "decision": {**decision, **own} if isinstance(own, dict) else own}
    section = validated(VehicleSection, entry, path, faults)
    if section is None:
        return None
    try:
        return section, shelf.open(section.plant)
    except PlantFileError as error:
        faults += [f"{path}.plant: {fault}" for fault in error.faults]
        return None


def _cross_checked(sections: dict[str, Settings | None], vehicles: list[LoadedVehicle | None]) -> Iterator[str]:
    """Check what concerns more than one section, as far as those sections hold."""
    known = [(i, vehicle[0]) for i, vehicle in enumerate(vehicles) if vehicle is not None]
    yield from _distinct(known, "id", lambda v: v.id)
    yield from _distinct(known, "system_id", lambda v: v.system_id or v.id)
    yield from _distinct(known, "url", lambda v: _exclusive_part(v.url))
    yield from _distinct(known, "endpoint", lambda v: v.endpoint)
    formation, ring, safety = sections.get("formation"), sections.get("encirclement"), sections.get("safety")
    if isinstance(formation, FormationSettings) and len(known) == len(vehicles) and known:
        ids = [vehicle.id for _, vehicle in known]
        if formation.leader not in ids:
            yield f"formation.leader: no vehicle has the id {formation.leader} (ids: {', '.join(map(str, ids))})"
    if isinstance(safety, SafetySettings):
        yield from _separated(known, safety, ring, len(vehicles))
        yield from _inside_limits(sections, known, safety)
    frame = sections.get("frame")
    if isinstance(frame, FrameSection):
        yield from _located(frame, known)
    link = sections.get("link")
    yield from kept_up(sections.get("mission"), link)
    if isinstance(link, LinkSection):
        yield from fed_as_told(link, vehicles)
    yield from _way_home(known, sections.get("choreography"))
    yield from _in_order(sections.get("failsafe"))
    yield from limits_rise(sections.get("excitation"))
    target = sections.get("target")
    if isinstance(formation, FormationSettings) and formation.speed_m_s > formation.speed_max_m_s:
        highest = formation.speed_max_m_s
        yield f"formation.speed_m_s: {formation.speed_m_s} m/s is more than speed_max_m_s = {highest} m/s"
    if isinstance(ring, EncirclementSettings):
        yield from _within_reach(ring)
    if isinstance(ring, EncirclementSettings) and isinstance(target, TargetSection):
        yield from _fast_enough(ring, target)


def _inside_limits(
    sections: dict[str, Settings | None], vehicles: IndexedVehicles, safety: SafetySettings
) -> Iterator[str]:
    mission, formation, ring, target = (
        sections.get(name) for name in ("mission", "formation", "encirclement", "target")
    )
    ring = ring if isinstance(ring, EncirclementSettings) else None
    target = target if isinstance(target, TargetSection) else None
    mission = mission if isinstance(mission, MissionSection) else None
    formation = formation if isinstance(formation, FormationSettings) else None
    yield from slots_fit(vehicles, safety, formation, sections.get("network"))
    yield from limits_agree(safety, ring, formation)
    layers = sections.get("choreography")
    layer_m = layers.layer_m if isinstance(layers, ChoreographySettings) else 0.0
    yield from altitudes_fit(vehicles, safety, layer_m)
    yield from follows_fit(vehicles, safety, ring, target)
    yield from fence_fits(safety, vehicles, ring, target, mission)


def _exclusive_part(url: str) -> str:
    """Return what no other vehicle can use: the port listened on, the device, or the host and port called."""
    scheme, _, rest = url.partition("://")
    if scheme in ("udpin", "tcpin"):
        return rest.rpartition(":")[2]
    return rest.partition(":")[0] if scheme == "serial" else rest


def _distinct(
    vehicles: list[tuple[int, VehicleSection]], key: str, value: Callable[[VehicleSection], object]
) -> Iterator[str]:
    for (i, one), (k, other) in combinations(vehicles, 2):
        if value(one) == value(other):
            # An id that is doubled doubles the system id: one fault, not two.
            if key == "system_id" and one.id == other.id:
                continue
            yield f"vehicles[{k}].{key}: {value(other)} is vehicles[{i}]'s already"


def _separated(
    vehicles: list[tuple[int, VehicleSection]],
    safety: SafetySettings,
    ring: Settings | None,
    count: int,
) -> Iterator[str]:
    least = safety.separation_m
    for (i, one), (k, other) in combinations(vehicles, 2):
        distance = hypot(one.start_m[0] - other.start_m[0], one.start_m[1] - other.start_m[1])
        if distance < least:
            yield (
                f"vehicles[{k}].start_m: {distance:.2f} m from vehicles[{i}], less than safety.separation_m = {least} m"
            )
    if isinstance(ring, EncirclementSettings) and count > 1 and chord_m(ring.radius_m, count) < least:
        yield (
            f"encirclement.radius_m: {count} vehicles on a ring of {ring.radius_m} m are "
            f"{chord_m(ring.radius_m, count):.2f} m apart, less than safety.separation_m = {least} m"
        )


def _way_home(vehicles: list[tuple[int, VehicleSection]], choreography: Settings | None) -> Iterator[str]:
    if not isinstance(choreography, ChoreographySettings):
        return
    order, ids = choreography.landing_order, [vehicle.id for _, vehicle in vehicles]
    for i, vehicle_id in enumerate(order):
        if vehicle_id not in ids:
            known = ", ".join(map(str, ids))
            yield f"choreography.landing_order[{i}]: no vehicle has the id {vehicle_id} (ids: {known})"
        if vehicle_id in order[:i]:
            yield f"choreography.landing_order[{i}]: vehicle {vehicle_id} is in the order already"
    if choreography.landing == "return" and choreography.layer_m < LAYER_LEAST_M and len(vehicles) > 1:
        yield (
            f"choreography.layer_m: {choreography.layer_m} m; vehicles that return cross each other's paths, and need "
            f"layers of at least {LAYER_LEAST_M} m"
        )


def _in_order(failsafe: Settings | None) -> Iterator[str]:
    """Check that what is grave comes after what is less so."""
    if not isinstance(failsafe, FailsafeSettings):
        return
    low, critical = failsafe.battery_low, failsafe.battery_critical
    if critical >= low and critical > 0.0:
        yield f"failsafe.battery_critical: {critical} must be less than battery_low = {low}"
    one_s, all_s = failsafe.peer_silent_s, failsafe.peers_silent_s
    if all_s < one_s:
        yield f"failsafe.peers_silent_s: {all_s} s, for all peers, is less than peer_silent_s = {one_s} s, for one"


def _located(frame: FrameSection, vehicles: list[tuple[int, VehicleSection]]) -> Iterator[str]:
    """Check that the frame lies somewhere on Earth, or else that nothing refers to where."""
    place = {name: getattr(frame, name) for name in ("latitude_deg", "longitude_deg", "altitude_m")}
    for name, value in place.items():
        if frame.local and value is not None:
            yield f"frame.{name}: with local = true it lies nowhere on Earth: leave one of them out (given: {value})"
        if not frame.local and value is None:
            yield f"frame.{name}: this key is missing; indoors, without GPS, write local = true instead"
    for i, vehicle in vehicles:
        if vehicle.origin_m is not None and not frame.local:
            yield f"vehicles[{i}].origin_m: with a [frame] on Earth the vehicle says itself where its origin is"


def _within_reach(ring: EncirclementSettings) -> Iterator[str]:
    if ring.radius_min_m >= ring.radius_m:
        yield f"encirclement.radius_min_m: {ring.radius_min_m} m must be less than radius_m = {ring.radius_m} m"
    if ring.radius_far_m <= ring.radius_m:
        yield f"encirclement.radius_far_m: {ring.radius_far_m} m must be more than radius_m = {ring.radius_m} m"


def _fast_enough(ring: EncirclementSettings, target: TargetSection) -> Iterator[str]:
    needed = abs(ring.angular_rate_rad_s) * ring.radius_m + target.motion.speed_max_m_s
    if needed > ring.speed_max_m_s:
        yield (
            f"encirclement.angular_rate_rad_s: {ring.angular_rate_rad_s} rad/s at {ring.radius_m} m about this target "
            f"takes {needed:.2f} m/s, more than speed_max_m_s = {ring.speed_max_m_s} m/s"
        )
