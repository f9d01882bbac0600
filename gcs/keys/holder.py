"""The holders of keys: their roles, their names, and what each role may send on the bus."""

from enum import StrEnum
from typing import Annotated, get_args

import msgspec

from agents.shell.bus_security import Grant
from agents.team.messages import TOPICS, CommandAnswer, MemberState, NeighbourAngle, StartProposal, TargetPackage, Verb
from agents.team.perception import TOPIC as PERCEPTION

NAME_PATTERN = r"^[A-Za-z0-9_.-]{1,32}$"
VERBS: tuple[Verb, ...] = get_args(Verb)
UNLESS_NAMED: tuple[Verb, ...] = tuple(verb for verb in VERBS if verb != "kill")
"""What an operator may whose verbs are not named: a kill drops vehicles, and is granted by name only."""
_VEHICLES_SEND = (MemberState, NeighbourAngle, TargetPackage, StartProposal, CommandAnswer)


class Role(StrEnum):
    """What the holder of a key is to the team."""

    VEHICLE = "vehicle"
    OPERATOR = "operator"
    SENSOR = "sensor"
    OBSERVER = "observer"


class Holder(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The holder of a certificate: a vehicle's name is its id. `may` are the verbs that an operator may command.

    `expires_s` is Unix time. Who is issued a certificate again has the next `generation`, which the certificate's
    common name states: what was issued before no longer counts.
    """

    role: Role
    name: Annotated[str, msgspec.Meta(pattern=NAME_PATTERN)]
    expires_s: float
    may: tuple[Verb, ...] = ()
    generation: Annotated[int, msgspec.Meta(ge=1)] = 1
    revoked: bool = False

    @property
    def label(self) -> str:
        """Role and name, as the holder's folder is called."""
        return f"{self.role}-{self.name}"

    @property
    def common_name(self) -> str:
        """The common name of the certificate that counts; no name holds a tilde."""
        return self.label if self.generation == 1 else f"{self.label}~{self.generation}"

    @property
    def grant(self) -> Grant:
        """What the holder may send."""
        match self.role:
            case Role.VEHICLE:
                topics = tuple(f"{TOPICS[kind].name}/{self.name}" for kind in _VEHICLES_SEND)
                return Grant(self.common_name, topics, (f"alive/{self.name}",))
            case Role.OPERATOR:
                return Grant(self.common_name, tuple(f"command/{verb}/{self.name}" for verb in self.may))
            case Role.SENSOR:
                return Grant(self.common_name, (f"{PERCEPTION}/{self.name}",))
            case Role.OBSERVER:
                return Grant(self.common_name)
