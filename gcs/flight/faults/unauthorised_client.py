"""An intruder on the bus, injected as a fault: sessions without keys send under the ids of vehicles and an operator."""

from contextlib import AsyncExitStack, suppress

from agents.ports import VehicleRefusedError
from agents.shell.bus.zenoh_bus import ParticipantBus, single_bus
from agents.shell.bus.zenoh_session import BusTeam
from agents.shell.clock import MissionClock
from agents.team.codec import encode
from agents.team.messages import MemberState, NeighbourAngle, OperatorCommand
from agents.team.participant import Participant, vehicle
from gcs.mission.mission import Mission

_PERIOD_S = 0.02
_FAR_M = (500.0, 500.0)
_STILL_M_S = (0.0, 0.0)
_ORIGIN = "stranger"


class UnauthorisedClient:
    """Sends states from far away, one bearing for all vehicles, and the command to hold, as long as it runs."""

    def __init__(self, mission: Mission, clock: MissionClock) -> None:
        """Take the team and its clock: messages with another date are dropped from any sender."""
        self._mission = mission
        self._clock = clock
        self._number = 0

    async def run(self) -> None:
        """Send until it is cancelled."""
        async with AsyncExitStack() as stack:
            vehicles = {i: await self._joined(stack, vehicle(i)) for i in self._mission.ids}
            operator = await self._joined(stack, Participant("operator", _ORIGIN))
            while True:
                self._send(vehicles, operator)
                await self._clock.sleep(_PERIOD_S * self._clock.time_scale)

    async def _joined(self, stack: AsyncExitStack, participant: Participant) -> ParticipantBus:
        mission = self._mission
        endpoints = [each.section.endpoint.replace("tls/", "tcp/") for each in mission.vehicles]
        bus = single_bus(participant, BusTeam(mission.network.team, mission.ids), None, endpoints)
        stack.push_async_callback(bus.close)
        with suppress(VehicleRefusedError):
            await bus.open(lambda *_: None, lambda *_: None, lambda *_: None)
        return bus

    def _send(self, vehicles: dict[int, ParticipantBus], operator: ParticipantBus) -> None:
        now_s = self._clock.now_s()
        for i, bus in vehicles.items():
            angle = NeighbourAngle(i, now_s, 0.0, 0.0, self._mission.encirclement.radius_m)
            state = MemberState(i, now_s, "encircle", _FAR_M, _STILL_M_S, _FAR_M, _STILL_M_S, angle=angle)
            bus.publish("member", encode(state))
        self._number += 1
        operator.publish("command/hold", encode(OperatorCommand(now_s, "hold", None, _ORIGIN, self._number)))
