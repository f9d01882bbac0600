"""Reports of the target from the operator's page: a place on the map becomes a sighting on the team's bus."""

import asyncio

from agents.ports import VehicleRefusedError
from agents.team.perception import ExternalSighting, Perception, SightingRefusedError, encode_sighting
from gcs.console.command_client import CommandClient
from gcs.errors import InputError
from gcs.keys.identity import Identity
from gcs.keys.team_keys import TeamKeys
from gcs.mission.mission import Mission
from gcs.station.picture import SightingRequest

_IMPORTANCE, _THREAT = 0.8, 0.2
"""As `cordon target` reports by default."""


class TargetReports:
    """Sends an operator's reports of the target with a sensor's keys on this computer; without keys, none."""

    def __init__(self, mission: Mission, keys: TeamKeys) -> None:
        self._mission = mission
        self._keys = keys
        self._names = [each.name for each in mission.targets]
        self._checks = Perception(mission.mission_frame(), lambda _reason: None, self._names)
        self._sensor: Identity | None = None
        self.refusal = "no flight runs"
        """Why no report is sent, empty if they are."""

    def follow(self) -> None:
        """Look up the sensor's keys of the present flight; reads files."""
        try:
            self._sensor, self.refusal = self._keys.identity("sensor"), ""
        except VehicleRefusedError as refusal:
            self._sensor, self.refusal = None, refusal.reason
        except InputError as error:
            self._sensor, self.refusal = None, error.faults[0]

    def fault(self, request: SightingRequest) -> str:
        """Return why vehicles would refuse a report, empty if they would not."""
        if self.refusal:
            return self.refusal
        if (request.target is None) is bool(self._names) or (request.target or 0) >= max(len(self._names), 1):
            return f"the report names no target of the mission (targets: {', '.join(self._names) or 'one, unnamed'})"
        try:
            self._checks.read(encode_sighting(self._sighting(request)), now_s=0.0, time_scale=1.0)
        except SightingRefusedError as refused:
            return str(refused)
        return ""

    async def send(self, request: SightingRequest) -> tuple[int, ...]:
        """Send a report for its time; return the vehicles on the bus. Raises VehicleRefusedError."""
        client = await asyncio.to_thread(CommandClient, self._mission, self._sensor)
        return tuple(sorted(await client.send_sighting(self._sighting(request), request.lasting_s)))

    def _sighting(self, request: SightingRequest) -> ExternalSighting:
        variance_m2 = request.sigma_m**2
        name = None if request.target is None else self._names[request.target]
        covariance_m2 = (variance_m2, 0.0, variance_m2)
        return ExternalSighting("mission", request.position_m, covariance_m2, _IMPORTANCE, _THREAT, target=name)
