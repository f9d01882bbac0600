"""The equipment of agents beside their links: the bus to their peers, and their sensors of the target."""

from collections.abc import Mapping, Sequence

from agents.ports import PeerBus, TargetSensor
from agents.shell.clock import MissionClock
from agents.shell.zenoh_bus import Station, ZenohBus
from agents.shell.zenoh_session import BusTeam
from agents.team import participant
from gcs.keys.team_keys import TeamKeys
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.simulation import target_sensor
from sitl.world import SimulatedSensors

RATE_SHARE = 10.0
"""How many messages per tick a peer may send on a topic: late ticks come in a burst, and a simulator's speed may be
unknown."""


class Equipment:
    """Creates the equipment that the mission specifies; a drill passes in one that can fail."""

    def buses(
        self, mission: Mission, vehicles: Sequence[MissionVehicle], clock: MissionClock, keys: TeamKeys
    ) -> Mapping[int, PeerBus]:
        """Return the bus of each vehicle that this process flies, by its id, not yet open.

        Vehicles with the same keys share a session, which listens at the endpoint of the first. Rates follow from how
        fast the `clock` runs. Raises InputError when keys are missing or not valid.
        """
        here = {vehicle.id: vehicle for vehicle in vehicles}
        stations = [
            Station(
                tuple(map(participant.vehicle, identity.vehicle_ids)),
                here[identity.vehicle_ids[0]].section.endpoint,
                identity.security,
            )
            for identity in keys.flying(tuple(here))
        ]
        elsewhere = [other.section.endpoint for other in mission.vehicles if other.id not in here]
        rate_hz = RATE_SHARE * mission.mission.rate_hz * max(clock.time_scale, 1.0)
        team = BusTeam(mission.network.team, mission.ids, mission.network.router)
        bus = ZenohBus(team, stations, elsewhere, rate_hz, clock)
        return {each: bus.of(participant.vehicle(each)) for each in here}

    def sensor(self, mission: Mission, vehicle_id: int, start_s: float) -> TargetSensor:
        """Return a vehicle's sensor; the mission starts at `start_s`."""
        return target_sensor(mission, vehicle_id, start_s, mission.mission.seed)


class WithoutSensors(Equipment):
    """Equipment that sees no target: of vehicles that are brought home while the target moves on for others."""

    def sensor(self, mission: Mission, vehicle_id: int, start_s: float) -> TargetSensor:  # noqa: ARG002 - sees nothing
        """Return a sensor that sees nothing: a simulated target's motion has begun with the flight of the others."""
        return SimulatedSensors(())
