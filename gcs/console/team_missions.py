"""Comparison of the mission that a team flies with the mission that an operator named."""

from agents.ports import VehicleRefusedError
from agents.team.messages import BusMessage, MissionIdentity, StartProposal
from gcs.mission.mission import Mission


class TeamMissions:
    """The missions that the vehicles on the bus report."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._flown: dict[int, MissionIdentity] = {}

    @property
    def any_received(self) -> bool:
        """Whether any vehicle has reported its mission."""
        return bool(self._flown)

    def receive(self, message: BusMessage) -> None:
        """Process a message from the bus."""
        if isinstance(message, StartProposal) and message.mission is not None:
            self._flown[message.sender] = message.mission

    def require_same(self) -> None:
        """Raise VehicleRefusedError unless a vehicle flies the mission of this name.

        One vehicle is enough: a wrong report of another one must not block the operator's commands.
        """
        ours = self._mission.mission.name
        if self._flown and all(each.name != ours for each in self._flown.values()):
            names = ", ".join(sorted({repr(each.name) for each in self._flown.values()}))
            raise VehicleRefusedError(
                f"team {self._mission.network.team} flies the mission {names}, not {ours!r}",
                "give the mission that it flies by --mission",
            )

    @property
    def difference(self) -> str:
        """The difference between missions of the same name; empty if there is none."""
        ours = self._mission.identity
        if not self._flown or ours in self._flown.values():
            return ""
        return f"the team flies another version of the mission {self._mission.mission.name!r}"

    def require_version(self, verb: str) -> None:
        """Raise VehicleRefusedError if the mission's content, on which a command or sighting depends, differs."""
        if self.difference:
            raise VehicleRefusedError(
                f"{verb}: {self.difference}",
                "give by --mission the file as it was at the start of the flight, with the same --set",
            )
