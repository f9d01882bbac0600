"""The equipment of an agent beside its link: the bus to its peers, and its sensor of the target."""

from agents.ports import PeerBus, TargetSensor
from agents.shell.zenoh_bus import ZenohBus
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.simulation import target_sensor


class Equipment:
    """Creates the equipment that the mission specifies; a drill passes in one that can fail."""

    def bus(self, mission: Mission, vehicle: MissionVehicle) -> PeerBus:
        """Return a vehicle's bus, not yet open."""
        others = [other.section.endpoint for other in mission.vehicles if other.id != vehicle.id]
        return ZenohBus(vehicle.id, mission.network.team, vehicle.section.endpoint, others)

    def sensor(self, mission: Mission, vehicle_id: int, start_s: float) -> TargetSensor:
        """Return a vehicle's sensor; the mission starts at `start_s`."""
        return target_sensor(mission, vehicle_id, start_s, mission.mission.seed)
