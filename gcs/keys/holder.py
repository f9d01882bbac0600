"""The holders of keys: their roles, names, and what each role may send on the bus."""

import msgspec

from agents.shell.bus.bus_security import Grant
from agents.team.messages import OPERATOR_TOPIC, OPERATORS_TOPIC, PEER_TOPICS, PRESENCE_TOPIC
from agents.team.participant import SENSOR_TOPICS, Participant, Role
from agents.team.verbs import Verb

_ALL_TOPICS = (*(f"{topic}/*" for topic in sorted(PEER_TOPICS | SENSOR_TOPICS)), f"{OPERATOR_TOPIC}/*/*")
"""What a router forwards: it checks each sender against its certificate."""


class Holder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The holder of a certificate: a vehicle's name is its id. `may` are the verbs that an operator may command.

    `expires_s` is Unix time. A holder's next certificate has the next `generation`, which is part of its common name:
    certificates issued before are no longer valid. `speaks_for` are further vehicles that a vehicle's keys may send
    as, in the keys of a run on one computer. Raises ValueError for an invalid name.
    """

    role: Role
    name: str
    expires_s: float
    may: tuple[Verb, ...] = ()
    generation: int = 1
    revoked: bool = False
    speaks_for: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.generation < 1:
            raise ValueError(f"{self.label}: generation {self.generation}: they count from 1")
        _ = self.participant

    @property
    def participant(self) -> Participant:
        """The holder as a participant of the bus."""
        return Participant(self.role, self.name)

    @property
    def label(self) -> str:
        """Role and name: the name of the holder's folder."""
        return f"{self.role}-{self.name}"

    @property
    def common_name(self) -> str:
        """The common name of the valid certificate; names of holders have no tilde."""
        return self.label if self.generation == 1 else f"{self.label}~{self.generation}"

    @property
    def grant(self) -> Grant:
        """What the holder may send."""
        match self.role:
            case "vehicle":
                names = (self.name, *map(str, self.speaks_for))
                topics = tuple(f"{topic}/{name}" for topic in sorted(PEER_TOPICS) for name in names)
                return Grant(self.common_name, topics, tuple(f"{PRESENCE_TOPIC}/{name}" for name in names))
            case "operator":
                verbs = tuple(f"{OPERATOR_TOPIC}/{verb}/{self.name}" for verb in self.may)
                return Grant(self.common_name, verbs, (f"{OPERATORS_TOPIC}/{self.name}",))
            case "sensor":
                return Grant(self.common_name, tuple(f"{topic}/{self.name}" for topic in sorted(SENSOR_TOPICS)))
            case "observer":
                return Grant(self.common_name)
            case "router":
                return Grant(self.common_name, _ALL_TOPICS, (f"{PRESENCE_TOPIC}/*", f"{OPERATORS_TOPIC}/*"))
