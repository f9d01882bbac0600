"""The bus of a running team for operators, sensors and observers, and of a watched team from flight to flight.

They connect to the vehicles' endpoints or to the team's router.
"""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from time import monotonic
from types import TracebackType
from typing import Self

from agents.ports import PeerBus, VehicleRefusedError
from agents.shell.clock import MissionClock
from agents.shell.zenoh_bus import ParticipantBus, single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.codec import encode
from agents.team.messages import ROSTER_TOPIC, BusMessage, OperatorCommand, topic_of
from gcs.errors import InputError
from gcs.keys.identity import Identity
from gcs.keys.roster import Roster
from gcs.keys.team_keys import TeamKeys, team_keys
from gcs.mission.mission import Mission


def guest_bus(mission: Mission, identity: Identity, clock: MissionClock | None = None) -> ParticipantBus:
    """Return the bus of an operator, a sensor or an observer, not yet open; a governed `clock` waits for it."""
    endpoints = [vehicle.section.endpoint for vehicle in mission.vehicles]
    team = BusTeam(mission.network.team, mission.ids, mission.network.router)
    return single_bus(identity.participant, team, None, endpoints, identity.security, clock)


def observer(keys: TeamKeys) -> Identity:
    """Return an identity that may receive: an observer's, or an operator's if there are no observer's keys here.

    Raises InputError, and VehicleRefusedError if no flight runs.
    """
    with suppress(InputError):
        return keys.identity("observer")
    return keys.identity("operator")


def send_command(bus: PeerBus, command: OperatorCommand) -> None:
    """Send a command once."""
    bus.publish(topic_of(command), encode(command))


_ROSTER_EVERY_S, _ROSTER_TIMEOUT_S, _POLL_S = 0.5, 10.0, 0.05


async def send_roster(mission: Mission, operator: Identity, roster: Roster) -> Mapping[int, bool]:
    """Send a signed roster to the vehicles on the bus that it admits; return of each whether it has taken it.

    Raises VehicleRefusedError if the bus cannot be joined.
    """
    admitted = {int(name) for holder in roster.valid for name in holder.vehicles} & {*mission.ids}
    taken: dict[int, bool] = {}
    bus = guest_bus(mission, operator)

    def take_presence(vehicle_id: int, present: bool) -> None:
        if present and vehicle_id in admitted:
            taken.setdefault(vehicle_id, False)

    await bus.open(lambda _message: None, lambda *_: None, take_presence)
    try:
        end_s = next_s = monotonic()
        end_s += _ROSTER_TIMEOUT_S
        while monotonic() < end_s and not (len(taken) == len(admitted) and all(taken.values())):
            if monotonic() >= next_s:
                bus.publish(ROSTER_TOPIC, roster.compact())
                next_s += _ROSTER_EVERY_S
            await asyncio.sleep(_POLL_S)
            taken |= {each: True for each in admitted if bus.rosters.get(str(each), 0) >= roster.serial}
        return taken
    finally:
        await bus.close()


_LOOKED_UP_EVERY_S = 1.0


class WatchedBus:
    """Receives the present flight of a team; use it as a context manager, and call `follow` periodically."""

    def __init__(self, mission: Mission, on_message: Callable[[BusMessage], None]) -> None:
        """Take the mission; raises InputError if its team needs keys and has none."""
        self._mission = mission
        self._keys = team_keys(mission)
        self._on_message = on_message
        self._identity: Identity | None = None
        self._bus: PeerBus | None = None
        self._look_up_s = 0.0
        self.refusal = ""
        """Why no flight is watched at present, empty if one is."""

    async def __aenter__(self) -> Self:
        """Return self."""
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the bus."""
        await self._leave()

    async def follow(self) -> None:
        """Join the bus of a flight that has begun; raises InputError if this computer has no keys for it."""
        if monotonic() < self._look_up_s:
            return
        self._look_up_s = monotonic() + _LOOKED_UP_EVERY_S
        try:
            identity = observer(self._keys)
        except VehicleRefusedError as refusal:
            self.refusal = f"waiting for team {self._mission.network.team}: {refusal.reason}"
            return
        except InputError:
            if self._bus is None:
                raise
            return  # the keys were removed: an open bus stays open
        self.refusal = ""
        if identity != self._identity:
            await self._leave()
            self._identity, self._bus = identity, guest_bus(self._mission, identity)
            await self._bus.open(self._on_message, lambda *_: None, lambda _vehicle, _present: None)

    async def _leave(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            await bus.close()
