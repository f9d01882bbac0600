"""A participant of a team's bus, and the keys that authenticate it."""

from dataclasses import dataclass
from getpass import getuser
from socket import gethostname

from agents.shell.bus_security import BusSecurity
from agents.team.participant import Participant, name_from
from agents.team.verbs import VERBS, Verb


@dataclass(frozen=True, slots=True)
class Identity:
    """A participant of the bus.

    `security` is None on an insecure bus; `may` are the verbs that an operator may command.
    """

    participant: Participant
    security: BusSecurity | None = None
    may: tuple[Verb, ...] = tuple(VERBS)


@dataclass(frozen=True, slots=True)
class FlyingIdentity:
    """The vehicles of a process that send with the same keys; `security` is None on an insecure bus."""

    vehicle_ids: tuple[int, ...]
    security: BusSecurity | None = None


def user_name() -> str:
    """Return the user and the computer of this process, as a name on the bus."""
    try:
        user = getuser()
    except (OSError, KeyError, ImportError):  # the user id has no name on this system
        user = "operator"
    return name_from(f"{user}.{gethostname()}")
