"""The equipment of an agent beside its link: the bus to its peers, and its sensor of the target."""

from agents.ports import PeerBus, TargetSensor
from agents.shell.zenoh_bus import ZenohBus
from agents.team import participant
from agents.team.participant import Participant
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.simulation import target_sensor

RATE_SHARE = 10.0
"""How many times as often as every tick a peer may send on a topic: ticks that were late come in a burst, and the speed
of a simulator may not be known yet."""
KEYBOARD = "keys"
"""The name of the operator at the keyboard."""


class Equipment:
    """Creates the equipment that the mission specifies; a drill passes in one that can fail."""

    def bus(self, mission: Mission, vehicle: MissionVehicle, speed: float) -> PeerBus:
        """Return a vehicle's bus, not yet open; the mission's clock passes `speed` times as fast as the wall's."""
        others = [other.section.endpoint for other in mission.vehicles if other.id != vehicle.id]
        rate_hz = RATE_SHARE * mission.mission.rate_hz * max(speed, 1.0)
        return ZenohBus(
            participant.vehicle(vehicle.id),
            mission.network.team,
            mission.ids,
            vehicle.section.endpoint,
            others,
            rate_hz=rate_hz,
        )

    def operator_bus(self, mission: Mission) -> ZenohBus:
        """Return the bus of the operator at this computer's keyboard, not yet open."""
        endpoints = [vehicle.section.endpoint for vehicle in mission.vehicles]
        return ZenohBus(Participant("operator", KEYBOARD), mission.network.team, mission.ids, None, endpoints)

    def sensor(self, mission: Mission, vehicle_id: int, start_s: float) -> TargetSensor:
        """Return a vehicle's sensor; the mission starts at `start_s`."""
        return target_sensor(mission, vehicle_id, start_s, mission.mission.seed)
