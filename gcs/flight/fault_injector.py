"""Injects scheduled faults into a flight of stub vehicles, and prints each when it begins."""

import asyncio
import os
from collections.abc import Sequence

from estimation.frames import Triple
from gcs.flight.faults.failing_equipment import FailingEquipment
from gcs.flight.faults.injection import Injection, TeamInFlight, last_in_line
from gcs.flight.faults.schedule import ScheduledFault
from gcs.flight.faults.team_faults import PresentFaults
from gcs.flight.faults.unauthorised_client import UnauthorisedClient
from gcs.flight.stubs import FlightStubs
from gcs.flight.team import FlightTeam

_PERIOD_S = 0.1
_SHOWN_S = 0.3
"""Time to show the line that names a fault before the fault ends the process [wall s]."""


class FaultInjector:
    """The faults of one flight: those scheduled, and those present in its equipment."""

    def __init__(self, faults: Sequence[ScheduledFault]) -> None:
        """Take the faults in order of time."""
        self.faults = tuple(faults)
        self._present = PresentFaults()
        self._unauthorised_clients: list[asyncio.Task[None]] = []

    def equipment(self) -> FailingEquipment:
        """Return the equipment that the faults act on."""
        return FailingEquipment(self._present)

    async def run(self, team: FlightTeam, stubs: FlightStubs) -> None:
        """Inject each fault at its time of the mission, until cancelled."""
        try:
            for each in self.faults:
                while team.start_s is None:
                    await team.clock.sleep(_PERIOD_S)
                await team.clock.sleep_until(team.start_s + each.injected.at_s)
                await self._begin(each, team, stubs)
            await asyncio.Event().wait()
        finally:
            for client in self._unauthorised_clients:
                client.cancel()

    async def _begin(self, scheduled: ScheduledFault, team: FlightTeam, stubs: FlightStubs) -> None:
        """Print a fault, and inject it if the vehicles that it needs are airborne."""
        fault, airborne = scheduled.fault, _airborne(team)
        subject = scheduled.injected.vehicle or (last_in_line(team.plan.mission, tuple(airborne)) if airborne else 0)
        time, named = f"{scheduled.injected.at_s:.1f} s", fault.name + ("" if fault.of_team else f", vehicle {subject}")
        if subject not in airborne or len(airborne) < fault.vehicles_min:
            team.view.print_line(f"{time}: not injected: {named}: too few vehicles are airborne", "warning")
            return
        team.view.print_line(f"{time}: injected: {named}")
        scene = TeamInFlight(team.plan.mission, subject, tuple(airborne), airborne)
        injection = fault.inject(scene)
        if injection.ends_flight:
            await asyncio.sleep(_SHOWN_S)
        self._inject(injection, team, stubs)

    def _inject(self, injection: Injection, team: FlightTeam, stubs: FlightStubs) -> None:
        for vehicle_id, each in injection.vehicles.items():
            stubs.inject(team.plan.mission.vehicle(vehicle_id).system_id, each)
        if injection.unauthorised_client:
            self._unauthorised_clients.append(
                asyncio.create_task(UnauthorisedClient(team.plan.mission, team.clock).run())
            )
        self._present.set(self._present.now.with_more(injection.team))
        if injection.signal is not None:
            os.kill(os.getpid(), injection.signal)


def _airborne(team: FlightTeam) -> dict[int, Triple]:
    """Return the positions [m] of the armed vehicles, from their own estimates."""
    return {
        member.vehicle.id: member.link.motion.position_m
        for member in team.members
        if member.link.status.armed and member.link.motion is not None
    }
