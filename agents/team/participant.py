"""The participants of a team's bus, and their names."""

import re
from dataclasses import dataclass
from typing import Literal

from agents.team import external_positions, perception

SENSOR_TOPICS = frozenset({perception.TOPIC, external_positions.TOPIC})
"""Sightings of the target, and positions of vehicles."""


Role = Literal["vehicle", "operator", "sensor", "positions", "observer", "router"]
NAME_LENGTH = 32
_NAME = re.compile(rf"[A-Za-z0-9_.-]{{1,{NAME_LENGTH}}}")
_FOREIGN_TO_NAMES = re.compile(r"[^A-Za-z0-9_.-]")


def is_name(text: str) -> bool:
    """Return whether a text can be a name on the bus."""
    return _NAME.fullmatch(text) is not None


def is_vehicle(name: str) -> bool:
    """Return whether a name is a vehicle's: its id as a number."""
    return name.isascii() and name.isdecimal() and 1 <= int(name[:4]) <= 254 and name == str(int(name[:4]))


def name_from(text: str) -> str:
    """Return a text as a name: invalid characters become '-', and it is cut to the maximum length."""
    return _FOREIGN_TO_NAMES.sub("-", text)[:NAME_LENGTH] or "-"


@dataclass(frozen=True, slots=True)
class Participant:
    """A vehicle (its name is its number), an operator, a sensor of the target, a source of vehicles' positions, an
    observer, which sends nothing, or a router, which forwards messages.

    Raises ValueError for an invalid name.
    """

    role: Role
    name: str

    def __post_init__(self) -> None:
        if not is_name(self.name):
            raise ValueError(
                f"{self.role} {self.name!r}: a name has letters, digits, '_', '.' and '-', at most {NAME_LENGTH}"
            )
        if self.role == "vehicle" and str(self.vehicle_id) != self.name:
            raise ValueError(f"vehicle {self.name!r}: a vehicle's name is its number")

    @property
    def looks_on(self) -> bool:
        """Whether it receives the vehicles' reports."""
        return self.role in ("operator", "observer")

    @property
    def vehicle_id(self) -> int | None:
        """A vehicle's id, None for all others."""
        return int(self.name) if self.role == "vehicle" and self.name.isdecimal() else None


def vehicle(vehicle_id: int) -> Participant:
    """Return a vehicle as a participant."""
    return Participant("vehicle", str(vehicle_id))
