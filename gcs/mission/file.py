"""From a mission's TOML text to a checked `Mission`, or to the list of all its faults.

Sections are validated one by one and cross-checked as far as they are valid, so that one run reports every fault.
"""

import difflib
from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from json import dumps
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import tomli_w

from agents.settings.sections import EncirclementSettings
from agents.team.messages import AddedVehicle, MissionIdentity
from agents.team.text import printable
from estimation.input_file import TEXT_MAX_LENGTH, read_plain, toml_content
from estimation.profile.profile import ProfileError, ProfileLibrary
from estimation.settings import Settings
from gcs.errors import InputError, KeyFault
from gcs.mission.added_vehicle import added_faults, unable_faults
from gcs.mission.cross_checks import LoadedVehicle, resolved
from gcs.mission.excitation import excitation_faults, excited
from gcs.mission.fault_lines import located, syntax_fault
from gcs.mission.mission import (
    CHECKLIST_MAX,
    CORDONS_PLANNER,
    ChecklistItem,
    Mission,
    SharedLinkSection,
    TargetSection,
    VehicleSection,
)
from gcs.mission.overrides import overridden, places
from gcs.mission.rings import SeveralRings, several_rings
from gcs.mission.sections import ADDED, EXCITES, REQUIRED, SECTIONS, TUNED, TUNING, VEHICLES_MAX
from gcs.mission.validation import shown, unknown_keys, validated

_SECTIONS = ("frame", "formation", "encirclement", "safety", "failsafe", "target_filter", "target", "choreography")
_OF_THE_MISSION = {"name", "duration_s", "rate_hz"}
_OF_ONE_COMPUTER = {"url", "true_scale", "sensor", "gimbal", "camera_url"}
"""Keys that may differ between the computers of a team, or concern only simulated vehicles or cameras."""
_LATER_OF_SAFETY = {
    "no_fly": "no_fly",
    "rally": "rally",
    "elevation": "elevation",
    "min_height_above_ground_m": "elevation",
    "traffic_distance_m": "traffic_distance_m",
    "traffic_height_m": "traffic_distance_m",
}
"""Keys that count only where another one is used: missions without them keep the digests of earlier versions."""
_LATER_OF_VEHICLES = {"reserve": "reserve"}


def identified(mission: Mission) -> Mission:
    """Return a mission with its identity; an excitation flight made from it keeps the identity."""
    return replace(mission, identity=MissionIdentity(printable(mission.mission.name), _digest(mission)))


def _ring(ring: EncirclementSettings) -> dict[str, object]:
    return ring.model_dump(mode="json") | {"radius_far_m": ring.far_m}


def _digest(mission: Mission) -> str:
    """Return 16 hexadecimal digits of the digest of sections, vehicles and profiles, without their file paths."""
    sections = {name: getattr(mission, name).model_dump(mode="json") for name in _SECTIONS}
    sections["encirclement"] = _ring(mission.encirclement)
    sections["safety"] = _used(sections["safety"], _LATER_OF_SAFETY)
    sections["target"] = _comparable(mission.target)
    if mission.targets:
        sections["targets"] = [_comparable(each) for each in mission.targets]
    if mission.rings:
        sections["rings"] = [
            [each.name, each.target, each.places, _ring(each.encirclement), each.shared] for each in mission.rings
        ]
    vehicles = [
        _used(each.section.model_dump(mode="json", exclude=_OF_ONE_COMPUTER), _LATER_OF_VEHICLES)
        for each in mission.vehicles
    ]
    profiles = [each.profile.plant for each in mission.vehicles]
    whole = {
        "mission": mission.mission.model_dump(mode="json", include=_OF_THE_MISSION),
        "team": mission.network.team,
        "sections": sections,
        "vehicles": vehicles,
        "plants": [repr(plant) for plant in profiles],
    }
    if mission.mission.planner != CORDONS_PLANNER:
        whole["planner"] = mission.mission.planner
    return sha256(dumps(whole, sort_keys=True).encode()).hexdigest()[:16]


def _used(section: dict[str, Any], later: Mapping[str, str]) -> dict[str, Any]:
    """Return a section without those of the later keys whose switch is off."""
    return {key: value for key, value in section.items() if key not in later or section[later[key]]}


def _comparable(target: TargetSection) -> dict[str, Any]:
    """Return what must be equal of a target, later keys only where they are used."""
    keys = target.model_dump(mode="json", exclude={"url"})
    if not target.name:
        keys.pop("name")
    if not target.changes:
        keys.pop("changes")
    if target.sensor.names:
        keys["sensor"].pop("names")
    return keys


_BUNDLED = Path(__file__).parent / "missions"


class MissionError(InputError):
    """A mission is invalid; every fault has its path in the file."""


def bundled_missions() -> list[str]:
    """Return the names of the missions that come with cordon."""
    return sorted(path.stem for path in _BUNDLED.glob("*.toml"))


def mission_path(name: str) -> Path:
    """Return the file of a mission."""
    return _BUNDLED / f"{name}.toml" if name in bundled_missions() else Path(name)


def mission_text(name: str) -> str:
    """Return the text of a bundled mission by its bare name, or of a file by its path; raises MissionError."""
    try:
        return read_plain(mission_path(name), 4 * TEXT_MAX_LENGTH).decode("utf-8-sig")
    except OSError as error:
        raise MissionError([f"{name}: {error.strerror or error}; {_other_missions(name)}"]) from error
    except UnicodeDecodeError as error:
        raise MissionError([f"{name}: not a text file: {error}"]) from error


def load_mission(name: str, overrides: Mapping[str, object] = MappingProxyType({})) -> Mission:
    """Load a bundled mission by its bare name, or a file by its path; `overrides` replace values, as in `places`.

    Raises InputError with every fault and its line in the file.
    """
    text, path = mission_text(name), mission_path(name)
    overrides = places(overrides, _ids(text))
    try:
        return parse_mission(overridden(text, overrides), path.parent)
    except InputError as error:
        raise MissionError(located(error.placed, path, text, overrides)) from error


def _ids(text: str) -> list[object]:
    """Return the ids in a mission's text as far as it can be read: what is wrong with it is reported later."""
    try:
        vehicles = toml_content(text).get("vehicles")
    except ValueError:
        return []
    return [each.get("id") for each in vehicles if isinstance(each, dict)] if isinstance(vehicles, list) else []


def _other_missions(name: str) -> str:
    known = bundled_missions()
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"{hint}bundled missions: {', '.join(known)}; `cordon new` writes a file"


def parse_mission(text: str, folder: Path | None, profile_texts: Mapping[str, str] | None = None) -> Mission:
    """Check a mission's text. Profiles whose text is not given are bundled, or files in `folder` (None: bundled only).

    Raises MissionError with every fault.
    """
    try:
        content = toml_content(text)
    except ValueError as error:  # also numbers beyond Python's limits
        raise MissionError([syntax_fault(error, text)]) from error
    excites, added = content.pop(EXCITES, None), content.pop(ADDED, None)
    mission = replace(_checked(content, text, ProfileLibrary(folder, profile_texts)), folder=folder or Path())
    if added is not None:
        mission = _added(mission, added)
    return mission if excites is None else _excited(mission, excites)


def _checked(content: dict[str, Any], text: str, library: ProfileLibrary) -> Mission:
    """Return the mission of a file's content; raises MissionError with every fault."""
    known = [*SECTIONS, "targets", "rings", "links", "vehicles", "tuning", "checklist"]
    faults = unknown_keys("", [key for key in content if key not in known], known)
    several = several_rings(content, faults)
    faults += [
        KeyFault(name, "this section is missing; `cordon new` writes a complete mission")
        for name in REQUIRED
        if name not in content and name not in several.sections
    ]
    sections = _sections(content, several, faults)
    # Invalid thresholds are reported once, not for every vehicle.
    decision = content.get("decision", {}) if sections["decision"] is not None else {}
    links = _links(content.get("links", {}), faults)
    vehicles = _vehicles(content.get("vehicles", []), _Shared(decision, links), library, faults)
    checklist = _checklist(content.get("checklist", []), faults)
    faults += several.checked(sections, vehicles)
    if faults:
        raise MissionError(faults)
    complete = tuple(resolved(*vehicle) for vehicle in vehicles if vehicle is not None)
    read = {"text": text, "profile_texts": library.texts, "parse": parse_mission}
    read |= {"targets": several.mission_targets, "rings": several.mission_rings(sections["encirclement"])}
    read |= {"checklist": checklist}
    mission = Mission(**sections, links=links, vehicles=complete, **read)  # type: ignore[arg-type]  # each is of its section's model
    if unstable := list(several.unstable(mission)):
        raise MissionError(unstable)
    return identified(mission)


def _sections(content: dict[str, Any], several: SeveralRings, faults: list[KeyFault]) -> dict[str, Settings | None]:
    """Return the settings of all sections, merged with those of `[tuning]`; None for invalid or missing sections."""
    sections = {
        name: several.sections[name]
        if name in several.sections
        else validated(model, content.get(name, {}), name, faults)
        for name, model in SECTIONS.items()
        if name in content or name not in REQUIRED or name in several.sections
    }
    tuning = content.get("tuning", {})
    if not isinstance(tuning, dict):
        faults.append(KeyFault("tuning", f"it must be a table (given: {shown(tuning)})"))
        tuning = {}
    faults += unknown_keys("tuning", [key for key in tuning if key not in TUNING], list(TUNING))
    for name, (section, model) in TUNED.items():
        tuned = validated(TUNING[name], tuning.get(name, {}), f"tuning.{name}", faults)
        sections[name] = _merged(model, sections.get(section), tuned)
    return sections


def _merged(model: type[Settings], *parts: Settings | None) -> Settings | None:
    """Return settings merged from their parts, None if a part is invalid or missing."""
    values: dict[str, object] = {}
    for part in parts:
        if part is None:
            return None
        values |= {key: getattr(part, key) for key in type(part).model_fields if key in model.model_fields}
    return model(**values)


def excitation_mission(mission: Mission, vehicle_id: int) -> Mission:
    """Return the excitation flight of one of a mission's vehicles; raises MissionError with every fault.

    Its text is the mission's with one more line at the top; parsed again, it gives the same flight.
    """
    if mission.excites:
        return mission
    return parse_mission(f"{EXCITES} = {vehicle_id}\n{mission.text}", mission.folder, mission.profile_texts)


def _excited(mission: Mission, vehicle_id: object) -> Mission:
    vehicle = next((each for each in mission.vehicles if each.id == vehicle_id), None)
    if vehicle is None:
        ids = ", ".join(map(str, mission.ids))
        raise MissionError([KeyFault(EXCITES, f"no vehicle has the id {shown(vehicle_id)} (ids: {ids})")])
    if faults := list(excitation_faults(mission, vehicle)):
        raise MissionError(faults)
    return excited(mission, vehicle)


def enlarged_mission(mission: Mission, vehicle: Mapping[str, object]) -> Mission:
    """Return a mission with one more vehicle, which joins its flight; `vehicle` are the keys of its table.

    Its text is the mission's with this table at the end, and `added` at the top; parsed again, it gives the same
    mission. Its identity is that of the mission. Raises MissionError with every fault.
    """
    if faults := list(unable_faults(mission)):
        raise MissionError(faults)
    content = toml_content(mission.text)
    table = {key: list(value) if isinstance(value, tuple) else value for key, value in vehicle.items()}
    content["vehicles"].append({**table, "reserve": True})
    text = tomli_w.dumps({ADDED: table["id"], **content})
    return parse_mission(text, mission.folder, mission.profile_texts)


_UNKNOWN = {"url": "udpin://127.0.0.1:1", "endpoint": "tcp/127.0.0.1:1"}
"""Of an added vehicle, for those that only compare its motion with the mission."""


def joined_mission(mission: Mission, vehicle_id: int, vehicle: AddedVehicle) -> Mission:
    """Return a mission with a vehicle that has joined its flight, as far as the others know it.

    It is the mission itself if the vehicle has joined one that takes no other here, as one of an earlier version.
    """
    taken = {each.system_id for each in mission.vehicles}
    table = _UNKNOWN | {"id": vehicle_id, "start_m": vehicle.start_m, "altitude_m": vehicle.altitude_m}
    table |= {
        "profile": mission.vehicles[-1].section.profile,
        "system_id": next(each for each in range(1, 255) if each not in taken),
    }
    try:
        return enlarged_mission(mission, {**table, "slot_m": vehicle.slot_m} if vehicle.slot_m else table)
    except MissionError:
        return mission


def _added(mission: Mission, vehicle_id: object) -> Mission:
    *others, last = mission.vehicles
    if last.id != vehicle_id or not last.section.reserve:
        raise MissionError([KeyFault(ADDED, f"{shown(vehicle_id)} is not the id of the last vehicle, in reserve")])
    without = replace(mission, vehicles=tuple(others))
    if faults := [*unable_faults(without), *added_faults(without, last)]:
        raise MissionError(faults)
    return replace(mission, added=last.id, identity=identified(without).identity)


def _links(content: object, faults: list[KeyFault]) -> dict[str, SharedLinkSection]:
    """Return the valid connections of `[links]`, by their names."""
    if not isinstance(content, dict):
        faults.append(KeyFault("links", f"it must be a table of tables, [links.NAME] (given: {shown(content)})"))
        return {}
    sections = {name: validated(SharedLinkSection, each, f"links.{name}", faults) for name, each in content.items()}
    return {name: section for name, section in sections.items() if section is not None}


def _checklist(content: object, faults: list[KeyFault]) -> tuple[ChecklistItem, ...]:
    """Return the items of `[[checklist]]`, which all differ."""
    if not isinstance(content, list):
        faults.append(KeyFault("checklist", f"write [[checklist]] above each item (given: {shown(content)})"))
        return ()
    if len(content) > CHECKLIST_MAX:
        faults.append(KeyFault("checklist", f"it has at most {CHECKLIST_MAX} items (given: {len(content)})"))
        return ()
    found = [validated(ChecklistItem, each, f"checklist[{i}]", faults) for i, each in enumerate(content)]
    items = [item for item in found if item is not None]
    for i, item in enumerate(items):
        if any(item.text == before.text for before in items[:i]):
            faults.append(KeyFault(f"checklist[{i}].text", f"another item has the same text: {shown(item.text)}"))
    return tuple(items)


class _Shared(NamedTuple):
    """What a vehicle's table takes from the mission unless it has its own: decision thresholds, and urls of links."""

    decision: object
    links: Mapping[str, SharedLinkSection]

    def completed(self, entry: object, path: str, faults: list[KeyFault]) -> object:
        """Return a vehicle's table completed from the mission."""
        if not isinstance(entry, dict):
            return entry
        if isinstance(self.decision, dict):
            # A vehicle overrides single thresholds; the others are the mission's.
            own = entry.get("decision", {})
            entry = {**entry, "decision": {**self.decision, **own} if isinstance(own, dict) else own}
        if "link" not in entry:
            return entry
        if "url" in entry:
            faults.append(KeyFault(f"{path}.url", "the vehicle's link has a url: leave url or link out"))
        link = self.links.get(entry["link"]) if isinstance(entry["link"], str) else None
        if link is None:
            known = ", ".join(self.links) or "none"
            faults.append(KeyFault(f"{path}.link", f"[links] has no valid {shown(entry['link'])} (known: {known})"))
            return entry
        return {**entry, "url": link.url}


def _vehicles(
    content: object, shared: _Shared, library: ProfileLibrary, faults: list[KeyFault]
) -> list[LoadedVehicle | None]:
    if isinstance(content, dict):
        faults.append(KeyFault("vehicles", "[vehicles] is a single table: write [[vehicles]] above each vehicle"))
        return []
    if not isinstance(content, list) or not content:
        faults.append(KeyFault("vehicles", "a mission needs at least one [[vehicles]] table"))
        return []
    if len(content) > VEHICLES_MAX:
        faults.append(KeyFault("vehicles", f"a team has at most {VEHICLES_MAX} vehicles (given: {len(content)})"))
        return []
    return [_vehicle(entry, shared, library, f"vehicles[{i}]", faults) for i, entry in enumerate(content)]


def _vehicle(
    entry: object, shared: _Shared, library: ProfileLibrary, path: str, faults: list[KeyFault]
) -> LoadedVehicle | None:
    section = validated(VehicleSection, shared.completed(entry, path, faults), path, faults)
    if section is None:
        return None
    try:
        return section, library.load(section.profile)
    except ProfileError as error:
        faults += [KeyFault(f"{path}.profile", fault) for fault in error.faults]
        return None
