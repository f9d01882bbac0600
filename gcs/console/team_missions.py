"""Which mission a team on the bus flies, against the mission that an operator named."""

from agents.ports import VehicleRefusedError
from agents.team.messages import BusMessage, MissionIdentity, StartProposal
from gcs.mission.mission import Mission

ENDS_FLIGHT = frozenset({"hold", "land", "rtl", "abort", "kill"})
"""Verbs that are sent to a team of the same mission whose file has been changed since: they need nothing of it."""


class TeamMissions:
    """The missions that the vehicles on the bus fly, as they say themselves."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._flown: dict[int, MissionIdentity] = {}

    @property
    def any_received(self) -> bool:
        """Whether a vehicle has said which mission it flies."""
        return bool(self._flown)

    def receive(self, message: BusMessage) -> None:
        """Take a message from the bus."""
        if isinstance(message, StartProposal) and message.mission is not None:
            self._flown[message.sender] = message.mission

    def require_same(self) -> None:
        """Raise VehicleRefusedError unless a vehicle flies the mission of this name.

        One vehicle is enough: another cannot keep the operator from the team by what it says of itself.
        """
        ours = self._mission.mission.name
        if self._flown and all(each.name != ours for each in self._flown.values()):
            names = ", ".join(sorted({repr(each.name) for each in self._flown.values()}))
            raise VehicleRefusedError(
                f"team {self._mission.network.team} flies the mission {names}, not {ours!r}",
                "name the mission that it flies by --mission",
            )

    @property
    def difference(self) -> str:
        """What differs though the mission has the same name; empty if nothing does."""
        ours = self._mission.identity
        if not self._flown or ours in self._flown.values():
            return ""
        return f"the team flies another version of the mission {self._mission.mission.name!r}"

    def require_version(self, verb: str) -> None:
        """Raise VehicleRefusedError where a command or sighting depends on the mission's content, and that differs."""
        if self.difference and verb not in ENDS_FLIGHT:
            raise VehicleRefusedError(
                f"{verb}: {self.difference}",
                "name by --mission the file that it flies, as it was at its start, with the same --set",
            )
