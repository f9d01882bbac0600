"""Vehicles in reserve: one takes over from a vehicle that runs low, which comes home, or whose flight has ended."""

from math import inf
from random import randrange

from agents.flight_end import FlightEnd
from agents.safety.failsafe import Condition
from agents.shell.life import Phase
from agents.shell.outcome import Outcome
from agents.tactics import Tactic
from agents.team.messages import OperatorCommand
from gcs.flight.team import FlightTeam, Member

LOOK_S = 0.5
"""The period of looking at the batteries [s of the mission clock]."""
CALL_S = 60.0
"""A reserve is called so long before the battery is low as it drains now: about its check, climb and way [s]."""
CALL_SHARE = 0.05
"""The least charge above `failsafe.battery_low` at which it is called: a discharge is not known at first."""
CALL_AGAIN_S = 15.0
"""When a reserve that was refused is called again [s of the mission clock]."""
NAME = "reserve"
"""The origin of the command that sends the relieved vehicle home."""
_LOW = frozenset(
    each.value
    for each in (Condition.BATTERY_WARNING, Condition.BATTERY_LOW, Condition.BATTERY_CRITICAL, Condition.NO_WAY_HOME)
)
_LOST = (FlightEnd.LOST, FlightEnd.KILLED, FlightEnd.ERROR, FlightEnd.BATTERY, FlightEnd.FAILSAFE, FlightEnd.PILOT)
_ON_MISSION = (Tactic.FORMATION, Tactic.ENCIRCLE, Tactic.TRANSIT, Tactic.ASIDE, Tactic.HOLD)


class Reserves:
    """Calls the reserves of one flight, each for one vehicle; a reserve that flies is relieved like any other."""

    def __init__(self, team: FlightTeam) -> None:
        self._team = team
        self._waiting = [each for each in team.members if each.vehicle.section.reserve]
        self._full: dict[int, tuple[float, float]] = {}
        self._relief: dict[int, Member] = {}
        self._lost: set[int] = set()
        self._call_next_s = -inf

    @property
    def waiting(self) -> list[Member]:
        """The members that have not taken off yet."""
        return list(self._waiting)

    def relieved_by(self, vehicle_id: int) -> int | None:
        """Return which vehicle took over from one, None if none did."""
        relief = self._relief.get(vehicle_id)
        return relief.vehicle.id if relief is not None and not relief.agent.in_reserve else None

    def note_end(self, vehicle_id: int, outcome: Outcome) -> None:
        """Take how a vehicle's flight has ended."""
        if outcome.how in _LOST:
            self._lost.add(vehicle_id)

    def note_again(self, vehicle_id: int) -> None:
        """Take that a vehicle flies again, after its flight had ended or from the reserve."""
        self._lost.discard(vehicle_id)
        self._relief.pop(vehicle_id, None)
        self._full.pop(vehicle_id, None)

    async def run(self) -> None:
        """Look at the team until cancelled."""
        while self._waiting:
            self._look()
            await self._team.clock.sleep(LOOK_S)
        while True:
            self._send_home()
            await self._team.clock.sleep(LOOK_S)

    def _look(self) -> None:
        now_s = self._team.clock.now_s()
        self._send_home()
        self._waiting = [each for each in self._waiting if each.agent.in_reserve]
        self._relief = {i: each for i, each in self._relief.items() if each not in self._waiting or _is_called(each)}
        free = [each for each in self._waiting if not _is_called(each) and each.vehicle.id not in self._team.absent]
        if not free or now_s < self._call_next_s:
            return
        for member in self._team.members:
            why = "" if member in self._waiting else self._needs_relief(member, now_s)
            if why and member.vehicle.id not in self._relief:
                relief = free[0]
                self._waiting = [*(each for each in self._waiting if each is not relief), relief]  # refused: the others
                self._relief[member.vehicle.id] = relief
                self._call_next_s = now_s + CALL_AGAIN_S
                self._team.view.print_line(
                    f"vehicle {relief.vehicle.id} is called from the reserve: vehicle {member.vehicle.id}: {why}"
                )
                relief.agent.rejoining.set()
                return

    def _needs_relief(self, member: Member, now_s: float) -> str:
        """Return why a vehicle that began the mission is to be relieved, empty if it is not."""
        vehicle_id, status = member.vehicle.id, member.link.status
        if vehicle_id in self._lost:
            return "its flight has ended"
        if member.agent.phase is not Phase.FLYING:
            return ""
        newest = self._team.newest.get(vehicle_id)
        if newest is not None and newest.alert in _LOW:
            return newest.alert
        if status.battery is None:
            return ""
        since_s, full = self._full.setdefault(vehicle_id, (now_s, status.battery))
        drained_per_s = (full - status.battery) / (now_s - since_s) if now_s - since_s > CALL_S else 0.0
        low = self._team.plan.mission.failsafe.battery_low
        if status.battery < low + max(CALL_SHARE, drained_per_s * CALL_S):
            return f"its battery has {status.battery:.0%} left"
        return ""

    def _send_home(self) -> None:
        """Let vehicles return that are relieved by one that flies on its mission now, if they still fly theirs."""
        for vehicle_id, relief in self._relief.items():
            member = next(each for each in self._team.members if each.vehicle.id == vehicle_id)
            newest, of_relief = (self._team.newest.get(each.vehicle.id) for each in (member, relief))
            flies = of_relief is not None and of_relief.tactic in _ON_MISSION and relief.agent.phase is Phase.FLYING
            if flies and member.agent.phase is Phase.FLYING and newest is not None and newest.tactic in _ON_MISSION:
                now_s = self._team.clock.now_s()
                member.agent.obey(OperatorCommand(now_s, "rtl", vehicle_id, NAME, randrange(2**32)))


def _is_called(member: Member) -> bool:
    return member.agent.rejoining.is_set()
