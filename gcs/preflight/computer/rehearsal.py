"""The computing load of a flight, on the ground: cores that plan and send messages to each other only."""

from collections.abc import Sequence

from agents.core import VehicleCore
from agents.outputs import TickOutput
from estimation.state import Telemetry
from gcs.mission.mission import Mission, MissionVehicle


class Rehearsal:
    """The cores of some vehicles of a mission, each with telemetry of a hover above its start.

    They estimate, plan and guard their formation. What they return goes to the others of them only.
    """

    def __init__(self, mission: Mission, vehicles: Sequence[MissionVehicle]) -> None:
        self._vehicles = vehicles
        self._cores = [VehicleCore(mission.agent_config(vehicle)) for vehicle in vehicles]
        for core in self._cores:
            core.start(0.0)

    def tick(self, index: int, time_s: float) -> TickOutput:
        """Tick the core of a vehicle, by its place in the list, `time_s` after the mission's start."""
        vehicle, core = self._vehicles[index], self._cores[index]
        core.on_telemetry(Telemetry(time_s, (*vehicle.section.start_m, vehicle.section.altitude_m), (0.0, 0.0, 0.0)))
        output = core.tick(time_s)
        for packet in output.messages:
            message = packet.received()
            for other in self._cores:
                if other is not core:
                    other.on_message(message, time_s)
        return output
