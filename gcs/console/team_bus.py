"""The bus of a running team, as operators, sensors and observers join it: they connect to the vehicles' endpoints."""

from contextlib import suppress

from agents.ports import PeerBus
from agents.shell.zenoh_bus import ZenohBus
from agents.team.messages import TOPICS, OperatorCommand, encode
from gcs.errors import InputError
from gcs.keys.holder import Role
from gcs.keys.identity import Identity
from gcs.keys.team_keys import TeamKeys
from gcs.mission.mission import Mission

_OPERATOR_ID = 0


def speaking_bus(mission: Mission, identity: Identity) -> PeerBus:
    """Return the bus of an operator or a sensor, not yet open."""
    endpoints = [vehicle.section.endpoint for vehicle in mission.vehicles]
    return ZenohBus(_OPERATOR_ID, mission.network.team, None, endpoints, security=identity.security)


def listening_bus(mission: Mission, identity: Identity) -> PeerBus:
    """Return the bus of an observer, who sends nothing; not yet open."""
    endpoints = [vehicle.section.endpoint for vehicle in mission.vehicles]
    return ZenohBus(None, mission.network.team, None, endpoints, security=identity.security)


def observer(keys: TeamKeys) -> Identity:
    """Return an identity to listen with: an observer's, or an operator's where no observer's keys are here.

    Raises InputError, and VehicleRefusedError where no flight runs.
    """
    with suppress(InputError):
        return keys.identity(Role.OBSERVER)
    return keys.identity(Role.OPERATOR)


def send_command(bus: PeerBus, command: OperatorCommand) -> None:
    """Send a command once."""
    bus.publish(TOPICS[OperatorCommand].name, encode(command))
