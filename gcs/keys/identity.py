"""A participant of a team's bus: its name, and the keys by which others know it."""

from dataclasses import dataclass
from getpass import getuser
from re import sub

from agents.shell.bus_security import BusSecurity
from agents.team.messages import Verb
from gcs.keys.holder import VERBS

_NAME_MAX = 32


@dataclass(frozen=True, slots=True)
class Identity:
    """Who speaks on the bus: an operator's name is in its commands and their keys, a sensor's in those of sightings.

    `security` is None on an insecure bus; `may` are the verbs that an operator may command.
    """

    name: str
    security: BusSecurity | None = None
    may: tuple[Verb, ...] = VERBS


def user_name() -> str:
    """Return the name of the user that runs this process, as far as it can stand in a key."""
    try:
        user = getuser()
    except (OSError, KeyError, ImportError):  # the user id has no name on this system
        user = ""
    return sub(r"[^A-Za-z0-9_.-]", "_", user)[:_NAME_MAX] or "operator"
