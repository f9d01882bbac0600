"""The identity of a mission: a digest that is equal on all computers that fly, watch or command one team."""

from dataclasses import replace
from hashlib import sha256
from json import dumps

from agents.team.messages import MissionIdentity
from gcs.mission.mission import Mission

_SECTIONS = ("frame", "formation", "encirclement", "safety", "failsafe", "target_filter", "target", "choreography")
_OF_THE_MISSION = {"name", "duration_s", "rate_hz"}
_OF_ONE_COMPUTER = {"url", "true_scale", "sensor"}
"""Keys that may differ between the computers of a team, or concern only simulated vehicles."""


def identified(mission: Mission) -> Mission:
    """Return a mission with its identity; an excitation flight made from it keeps the identity."""
    return replace(mission, identity=MissionIdentity(_printable(mission.mission.name), _digest(mission)))


def _digest(mission: Mission) -> str:
    """Return 16 hexadecimal digits of the digest of sections, vehicles and profiles, without their file paths."""
    sections = {name: getattr(mission, name).model_dump(mode="json") for name in _SECTIONS}
    sections["target"].pop("url", None)
    vehicles = [each.section.model_dump(mode="json", exclude=_OF_ONE_COMPUTER) for each in mission.vehicles]
    profiles = [each.profile.plant for each in mission.vehicles]
    whole = {
        "mission": mission.mission.model_dump(mode="json", include=_OF_THE_MISSION),
        "team": mission.network.team,
        "sections": sections,
        "vehicles": vehicles,
        "plants": [repr(plant) for plant in profiles],
    }
    return sha256(dumps(whole, sort_keys=True).encode()).hexdigest()[:16]


def _printable(name: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in name)
