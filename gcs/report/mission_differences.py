"""What differs between the missions of several flights: the keys whose values differ, by their place in a mission file.

Values are those that were flown, defaults included: a key that one file leaves out and the other sets to its default
is the same.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from json import dumps

from estimation.bounded_toml import toml_content
from gcs.mission.mission import Mission
from gcs.mission.sections import SECTIONS, TUNED, TUNING


@dataclass(frozen=True, slots=True)
class Difference:
    """A place, such as `encirclement.radius_m`, and the value of each flight there; None where it has none."""

    place: str
    values: tuple[object, ...]

    @property
    def shown(self) -> tuple[str, ...]:
        """The values as text."""
        return tuple(
            "–" if each is None else each if isinstance(each, str) else dumps(each, ensure_ascii=False)
            for each in self.values
        )


def mission_differences(missions: Sequence[Mission]) -> tuple[Difference, ...]:
    """Return the places at which not all missions have the same value, in the order of a mission file.

    Of vehicles that not all missions have the ids are given alone, at `vehicles`.
    """
    common = min(len(mission.vehicles) for mission in missions)
    values = [dict(_placed(mission, common)) for mission in missions]
    places = dict.fromkeys(place for each in values for place in each)
    found = (Difference(place, tuple(each.get(place) for each in values)) for place in places)
    return tuple(each for each in found if any(value != each.values[0] for value in each.values))


def _placed(mission: Mission, vehicles: int) -> Iterator[tuple[str, object]]:
    """Return every value of a mission, its first vehicles and the profiles that it names, with its place."""
    for name in SECTIONS:
        if name != "decision":  # its thresholds are the vehicles'
            yield from _keys(mission, name, name)
    yield from _keys(mission, "target_filter", TUNED["target_filter"][0])
    for name, link in mission.links.items():
        yield from _flat(f"links.{name}", link.model_dump(mode="json"))
    yield "vehicles", list(mission.ids)
    for index, vehicle in enumerate(mission.vehicles[:vehicles]):
        yield from _flat(f"vehicles[{index}]", vehicle.section.model_dump(mode="json"))
    for name, text in mission.profile_texts.items():
        yield from _flat(f"profile {name}", toml_content(text))


def _keys(mission: Mission, name: str, section: str) -> Iterator[tuple[str, object]]:
    """Return the values of a section and of its tuning, each where a mission file has it."""
    tuned = TUNING[name].model_fields if name in TUNING else {}
    for key, value in getattr(mission, name).model_dump(mode="json").items():
        yield from _flat(f"tuning.{name}.{key}" if key in tuned else f"{section}.{key}", value)


def _flat(place: str, value: object) -> Iterator[tuple[str, object]]:
    """Return the values in a table, or in an array of tables, each with its place."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _flat(f"{place}.{key}", each)
    elif isinstance(value, list) and any(isinstance(each, dict) for each in value):
        for index, each in enumerate(value):
            yield from _flat(f"{place}[{index}]", each)
    else:
        yield place, value
