"""What the command line or a program wants flown, and the checked plan of it."""

from dataclasses import dataclass
from math import inf

from agents.team.text import printable
from gcs.checklist import Checklist, done_by
from gcs.errors import InputError
from gcs.flight.faults.schedule import scheduled_faults
from gcs.flight.plan import FlightPlan, TeamRecovery
from gcs.flight.stubs import lockstep_clock
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.planner import planner_of

WEATHER_MAX = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightRequest:
    """A flight of a mission, as it is asked for.

    The vehicles with the ids `stubs` are stubs that start with the flight, the others are at their urls; with `only`
    this process flies that one vehicle. `speed` is that of the mission clock as a multiple of the wall's, None: 1 with
    stubs, measured otherwise. `duration_s` replaces the mission's. `faults` are texts such as "link-cut@120:2".
    `wait_s` [wall s] limits the wait for vehicles that are not ready; with `awaits_start` they wait for an operator's
    start. On the `bench`, boards in hardware-in-the-loop simulation fly. The mission's planner is imported only if
    `allow_plugins`. Who has done the mission's checklist may be named by `checklist_done`; else its items are ticked on
    the operator's page. `weather` is what people note about it. With a `recovery` the vehicles that are
    in the air are taken, except those `left`, without the checklist. A vehicle that the mission adds joins the flight
    of the others, on their clock; it does not wait for those `off_bus`.
    """

    mission: Mission
    stubs: tuple[int, ...] = ()
    only: int | None = None
    speed: float | None = None
    duration_s: float | None = None
    faults: tuple[str, ...] = ()
    wait_s: float = 60.0
    awaits_start: bool = False
    bench: bool = False
    allow_plugins: bool = False
    checklist_done: str | None = None
    weather: str = ""
    recovery: TeamRecovery | None = None
    left: tuple[int, ...] = ()
    off_bus: tuple[int, ...] = ()

    def plan(self) -> FlightPlan:
        """Return the plan; raises InputError, whose faults name options of `cordon fly`."""
        mission, stubs = self.mission, self.stubs
        if mission.added is not None:
            return self._joining(mission.vehicle(mission.added))
        if stubs and self.only is not None:
            raise InputError(["--only: with --sitl all vehicles fly in this process; use `cordon sitl` for the stubs"])
        if self.only in mission.reserves:
            raise InputError([f"--only: vehicle {self.only} is in reserve: it flies in one process with the others"])
        if self.faults and not stubs:
            raise InputError(["--fault: it needs --sitl: faults are injected into stub vehicles only"])
        clock = None if stubs else lockstep_clock(mission, mission.ids)
        waits = len(stubs) == len(mission.ids) or clock is not None
        require_governed(self.speed, only_stubs=waits, advice="it needs --sitl, or `cordon sitl --lockstep`")
        duration_s = self.duration_s or mission.mission.duration_s
        return FlightPlan(
            mission,
            duration_s,
            self._vehicles(),
            self.speed or (1.0 if stubs else None),
            stubs,
            wait_s=self.wait_s,
            bench=self.bench,
            awaits_start=self.awaits_start,
            faults=scheduled_faults(self.faults, mission, duration_s, stubs),
            clock=clock,
            planner=planner_of(mission, allowed=self.allow_plugins),
            checklist=self._checklist(),
            weather=printable(self.weather)[:WEATHER_MAX],
            recovery=self.recovery,
        )

    def _joining(self, vehicle: MissionVehicle) -> FlightPlan:
        """Return the plan of a vehicle that joins others: the flight that runs already sets the speed."""
        clock = lockstep_clock(self.mission, [each for each in self.mission.ids if each not in self.stubs])
        return FlightPlan(
            self.mission,
            self.mission.mission.duration_s,
            (vehicle,),
            1.0 if self.stubs and clock is None else None,
            self.stubs,
            wait_s=self.wait_s,
            clock=clock,
            checklist=self._checklist(),
            weather=printable(self.weather)[:WEATHER_MAX],
            off_bus=self.off_bus,
        )

    def _checklist(self) -> Checklist | None:
        """Return the checklist to wait for; where operators start the vehicles, `cordon start` requires it."""
        items = self.mission.checklist
        if self.checklist_done is not None and (not items or self.awaits_start):
            where = "`cordon start` takes it" if items else "the mission has no [[checklist]]"
            raise InputError([f"--checklist-done: {where}"])
        if not items or self.awaits_start or self.recovery is not None:
            return None
        checklist = Checklist(self.mission.network.team, items)
        if self.checklist_done is not None:
            checklist.tick_all(done_by(self.checklist_done))
        return checklist

    def _vehicles(self) -> tuple[MissionVehicle, ...]:
        if self.only is not None:
            return (self.mission.vehicle(self.only),)
        vehicles = tuple(each for each in self.mission.vehicles if each.id not in self.left)
        if not vehicles:
            raise InputError(["--leave: no vehicle of the mission is left to take"])
        return vehicles


def require_governed(speed: float | None, *, only_stubs: bool, advice: str) -> None:
    """Raise InputError for a speed that only the computer limits, unless every vehicle is a stub."""
    if speed == inf and not only_stubs:
        raise InputError([f"--speed max: {advice}"])
