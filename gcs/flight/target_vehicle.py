"""Another MAVLink vehicle as the target: its reported positions become sightings for the agents of this process."""

from collections.abc import Callable, Mapping, Sequence

from agents.ports import VehicleRefusedError
from agents.shell.agent import Agent
from agents.shell.clock import MissionClock
from estimation.state import Sighting, Telemetry
from gcs.link.config import LinkConfig, full_rates
from gcs.link.hub import MavsdkHub
from gcs.link.mavsdk_link import MavsdkLink
from gcs.link.rates import RateController
from gcs.mission.mission import Mission, TargetSection

TARGET_VEHICLE = 20000
"""Its sensor id, distinct from the vehicles' and from those of agents/team/perception.py."""
_EARLY_SHARE = 0.25


class TargetVehicle:
    """Receives the telemetry of the vehicle that is a target and never commands it; inactive for other sources.

    `[target.sensor]` sets the rate and the standard deviation of its sightings. Its messages have to be signed if its
    system id is among the `signing_keys`.
    """

    def __init__(
        self,
        mission: Mission,
        hub: MavsdkHub,
        clock: MissionClock,
        agents: Sequence[Agent],
        signing_keys: Mapping[int, bytes],
    ) -> None:
        target = next((each for each in mission.every_target if each.source == "mavlink"), mission.target)
        self._link: MavsdkLink | None = None
        if target.source == "mavlink" and target.url is not None and target.system_id is not None:
            frame, origin_m = mission.mission_frame(), (*target.start_m, 0.0)
            key = signing_keys.get(target.system_id)
            pace = RateController(full_rates(mission.link, mission.mission.rate_hz))
            config = LinkConfig(target.url, target.system_id, frame, pace, origin_m, signing_key=key)
            self._link = MavsdkLink(hub, config, clock)
        self._agents = agents
        self._take = sightings_of(target, self._see, target.name if mission.targets and target.sensor.names else None)

    async def connect(self) -> None:
        """Find the vehicle; raises VehicleRefusedError."""
        if self._link is None:
            return
        try:
            await self._link.connect(self._take)
        except VehicleRefusedError as refusal:
            raise VehicleRefusedError(f"the target: {refusal.reason}", refusal.next_step) from refusal

    def _see(self, sighting: Sighting) -> None:
        for agent in self._agents:
            agent.see(sighting)

    async def close(self) -> None:
        """Close its link."""
        if self._link is not None:
            await self._link.close()


def sightings_of(
    target: TargetSection, see: Callable[[Sighting], None], name: str | None = None
) -> Callable[[Telemetry], None]:
    """Return a callback for the vehicle's telemetry that calls `see` with sightings at the sensor's rate.

    They have the `name` of their target, None in a mission of one target.
    """
    sensor = target.sensor
    sigma_m, period_s, due_s = max(sensor.noise_m, 0.1), 1.0 / sensor.rate_hz, 0.0

    def take(telemetry: Telemetry) -> None:
        nonlocal due_s
        if telemetry.time_s >= due_s - _EARLY_SHARE * period_s:
            due_s = telemetry.time_s + period_s
            x, y, altitude_m = telemetry.position_m
            covariance, rated = (sigma_m**2, 0.0, sigma_m**2), (target.importance, target.threat)
            place = (x, y), covariance, *rated, altitude_m, sigma_m
            see(Sighting(telemetry.time_s, TARGET_VEHICLE, *place, target=name))

    return take
