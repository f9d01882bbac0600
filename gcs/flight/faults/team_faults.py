"""The faults of a flying process, of its agents' buses and sensors, and the changes that a fault makes."""

import asyncio
import ctypes
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, field
from signal import Signals
from typing import Literal

import msgspec

from agents.ports import VehicleRefusedError
from agents.shell.clock import MissionClock
from agents.shell.zenoh_bus import ParticipantBus, single_bus
from agents.shell.zenoh_session import BusTeam
from agents.team.codec import encode
from agents.team.messages import MemberState, NeighbourAngle, OperatorCommand
from agents.team.participant import Participant, vehicle
from estimation.frames import Triple
from gcs.mission.mission import Mission
from sitl.faults import VehicleInjection

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


HANG_S = 6
"""Duration of an injected hang of the process: longer than the supervisor waits."""

Hang = Literal["", "interpreter", "event loop", "exit"]


class TeamFaults(msgspec.Struct, frozen=True):
    """All faults of a flying process that are present at a time.

    `loss` is the share of messages that each agent does not receive, `delay_s` the delay of the others' messages [wall
    s]; no other vehicle receives the messages of `not_received`. Vehicles with `falsified_positions` report positions
    that are off by their `position_offset_m`; the states of `impostors` come from two sources, the second of which is
    off; `flooders` also send junk messages. `blind` sensors see no target. A process may `hang`.
    """

    loss: float = 0.0
    delay_s: float = 0.0
    not_received: frozenset[int] = frozenset()
    falsified_positions: frozenset[int] = frozenset()
    impostors: frozenset[int] = frozenset()
    position_offset_m: Mapping[int, tuple[float, float]] = {}
    flooders: frozenset[int] = frozenset()
    blind: bool = False
    hang: Hang = ""

    def with_more(self, more: "TeamFaults") -> "TeamFaults":
        """Return both: the vehicles of either, and the greater of two values. New faults end a hang."""
        return TeamFaults(
            loss=max(self.loss, more.loss),
            delay_s=max(self.delay_s, more.delay_s),
            not_received=self.not_received | more.not_received,
            falsified_positions=self.falsified_positions | more.falsified_positions,
            impostors=self.impostors | more.impostors,
            position_offset_m={**self.position_offset_m, **more.position_offset_m},
            flooders=self.flooders | more.flooders,
            blind=self.blind or more.blind,
            hang=more.hang,
        )


class PresentFaults:
    """The present faults of this process, and its event loop once its buses exist."""

    def __init__(self) -> None:
        self.now = TeamFaults()
        self.loop: asyncio.AbstractEventLoop | None = None

    def set(self, faults: TeamFaults) -> None:
        """Replace the present faults. A hang begins at once."""
        self.now = faults
        if faults.hang == "interpreter":
            ctypes.PyDLL(None).sleep(HANG_S)  # unlike CDLL, this keeps the lock: no thread of Python runs
        elif faults.hang == "event loop" and self.loop is not None:
            self.loop.call_soon_threadsafe(time.sleep, HANG_S)
        elif faults.hang == "exit":
            os._exit(0)


@dataclass(frozen=True, slots=True)
class TeamInFlight:
    """A team in flight: the fault's subject, the airborne vehicles, and their positions [m]."""

    mission: Mission
    subject: int
    airborne: tuple[int, ...]
    places_m: Mapping[int, Triple]

    @property
    def others(self) -> tuple[int, ...]:
        """All airborne vehicles but the subject."""
        return tuple(i for i in self.airborne if i != self.subject)


@dataclass(frozen=True, slots=True)
class Injection:
    """Faults of the flying process, those of vehicles by id, a signal to the process, and whether a client intrudes."""

    team: TeamFaults = field(default_factory=TeamFaults)
    vehicles: Mapping[int, VehicleInjection] = field(default_factory=dict)
    signal: Signals | None = None
    unauthorised_client: bool = False

    @property
    def ends_flight(self) -> bool:
        """Whether it ends the flying process."""
        return self.signal is not None or bool(self.team.hang)


def last_in_line(mission: Mission, airborne: Sequence[int]) -> int:
    """Return the vehicle that faults are injected into: the last in line, the leader only when no other is airborne."""
    return max(airborne, key=lambda i: (i != mission.formation.leader, mission.ids.index(i)))
