"""The equipment of an agent beside its link: the bus to its peers, and its sensor of the target."""

from agents.ports import PeerBus, TargetSensor
from agents.shell.zenoh_bus import ZenohBus
from gcs.keys.team_keys import TeamKeys
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.simulation import target_sensor

RATE_SHARE = 10.0
"""How many times as often as every tick a peer may send on a topic: ticks that were late come in a burst, and the speed
of a simulator may not be known yet."""


class Equipment:
    """Creates the equipment that the mission specifies; a drill passes in one that can fail."""

    def bus(self, mission: Mission, vehicle: MissionVehicle, speed: float, keys: TeamKeys) -> PeerBus:
        """Return a vehicle's bus, not yet open; the mission's clock passes `speed` times as fast as the wall's.

        Raises InputError when its keys are not here or do not count.
        """
        identity = keys.identity("vehicle", str(vehicle.id))
        others = [other.section.endpoint for other in mission.vehicles if other.id != vehicle.id]
        rate_hz = RATE_SHARE * mission.mission.rate_hz * max(speed, 1.0)
        return ZenohBus(
            identity.participant,
            mission.network.team,
            mission.ids,
            vehicle.section.endpoint,
            others,
            rate_hz=rate_hz,
            security=identity.security,
        )

    def sensor(self, mission: Mission, vehicle_id: int, start_s: float) -> TargetSensor:
        """Return a vehicle's sensor; the mission starts at `start_s`."""
        return target_sensor(mission, vehicle_id, start_s, mission.mission.seed)
