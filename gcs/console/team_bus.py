"""The bus of a running team for operators, sensors and observers: they connect to the vehicles' endpoints or to the
team's router.
"""

from contextlib import suppress

from agents.ports import PeerBus
from agents.shell.bus.zenoh_bus import ParticipantBus, single_bus
from agents.shell.bus.zenoh_session import BusTeam
from agents.shell.clock import MissionClock
from agents.team.codec import encode
from agents.team.messages import OperatorCommand, topic_of
from gcs.errors import InputError
from gcs.keys.identity import Identity
from gcs.keys.team_keys import TeamKeys
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
