"""The plan of a flight over MAVLink and Zenoh."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import date
from time import time

from agents.shell.computer import computer_clock
from gcs.checklist import Checklist
from gcs.flight.equipment import Equipment
from gcs.flight.faults.schedule import ScheduledFault
from gcs.flight.log_process import LogProcess
from gcs.flight.recovery_record import RecoveryRecord
from gcs.flightlog.records import Run
from gcs.flightlog.run import run_of
from gcs.keys.identity import user_name
from gcs.keys.roster import Holder
from gcs.keys.team_keys import leaves_this_computer, read_only_folders
from gcs.mission.mission import Mission, MissionVehicle
from gcs.mission.planner import ChosenPlanner, require_loaded
from gcs.preflight.computer import ComputerFacts
from gcs.preflight.findings import Finding, VehicleFacts
from gcs.preflight.keys import KeyFacts
from gcs.preflight.mission import feasibility
from gcs.preflight.preflight import preflight
from sitl.server.shared_clock import ClockName


@dataclass(frozen=True, slots=True)
class TeamRecovery:
    """How vehicles that are in the air are brought home, or with `flies_on` flown on with the mission.

    Those `from_pilot` are taken also if a pilot may fly them. Unless it is `confirmed` already, the operator is asked
    on the terminal; until then vehicles are sent nothing but requests for reports. `beside` others of the team that
    other programs may still fly. What is found and what becomes of it is in `record`.
    """

    from_pilot: tuple[int, ...] = ()
    confirmed: bool = False
    flies_on: bool = False
    beside: bool = False
    record: RecoveryRecord = field(default_factory=RecoveryRecord)


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What to fly: mission, duration, vehicles, speed of the mission clock (None: measure it), and agents' equipment.

    The vehicles with the ids `stubs` are stubs that start with the flight; the others are at their urls. `log` is the
    open log, None for a flight that is not recorded. `wait_s` [wall s] limits the wait on the ground for vehicles that
    are about to be ready. `faults` are those to inject into stubs, in order of time. On the `bench`, boards with
    simulated bodies fly, without propellers. With `awaits_start` the vehicles wait on the ground until an operator
    starts them (`cordon start`). A flight of stubs joins the governed `clock` that they are on, or makes one. `holders`
    are those of the bus's keys when the flight begins. `planner` is the mission's, None for cordon's. A `recovery`
    brings vehicles home that are in the air. Nothing is armed before the required items of a `checklist` are ticked.
    `weather` is noted in the log. A vehicle that the mission adds does not wait for answers of those `off_bus`.
    """

    mission: Mission
    duration_s: float
    vehicles: tuple[MissionVehicle, ...]
    speed: float | None
    stubs: tuple[int, ...] = ()
    equipment: Equipment | None = None
    log: LogProcess | None = None
    wait_s: float = 60.0
    faults: tuple[ScheduledFault, ...] = ()
    bench: bool = False
    awaits_start: bool = False
    clock: ClockName | None = None
    holders: Sequence[Holder] | None = None
    planner: ChosenPlanner | None = None
    recovery: TeamRecovery | None = None
    checklist: Checklist | None = None
    weather: str = ""
    off_bus: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError for a mission with a planner of its own that was not loaded; the way home is cordon's."""
        if self.recovery is None or self.recovery.flies_on:
            require_loaded(self.mission, self.planner, "this flight")

    def source(self, speed: float) -> str:
        """Return the source of the flight's data: only a simulation runs at another speed than the wall clock."""
        if self.bench:
            return "bench"
        if self.is_governed or speed != 1.0:
            return "sitl"
        return "hybrid" if self.stubs else "flight"

    @property
    def only_stubs(self) -> bool:
        """Whether every vehicle is a stub."""
        return {vehicle.id for vehicle in self.vehicles} == {*self.stubs}

    @property
    def is_governed(self) -> bool:
        """Whether the flight is on a governed clock: every vehicle is a stub of this flight, or of one with a clock."""
        return self.only_stubs or self.clock is not None

    @property
    def needs_prompt_computer(self) -> bool:
        """Whether a vehicle flies on the wall's clock: one that is no stub of this flight."""
        return not self.is_governed

    def feasibility(self) -> Sequence[Finding]:
        """Return the preflight findings about the mission alone, which take 0.7 s to compute for a ring of 32."""
        return tuple(feasibility(self.mission, stubs=self.only_stubs))

    def findings(
        self,
        facts: Sequence[VehicleFacts],
        computer: ComputerFacts | None = None,
        feasible: Sequence[Finding] | None = None,
    ) -> Sequence[Finding]:
        """Return the preflight findings about the mission, its vehicles, its keys and this computer, as measured.

        `feasible` are those about the mission alone, if they are known.
        """
        alone = len(self.vehicles) < len(self.mission.vehicles) and leaves_this_computer(self.mission)
        clock = computer_clock() if alone else None
        key_facts = None
        if self.holders is not None:
            key_facts = KeyFacts(self.holders, time() + self.duration_s, read_only_folders(self.mission))
        return preflight(
            self.mission,
            facts,
            date.today(),
            stubs=self.only_stubs,
            bench=self.bench,
            clock=clock,
            computer=computer,
            key_facts=key_facts,
            feasible=feasible,
        )

    def run(self, speed: float) -> Run:
        """Return the log's record of the run that begins now."""
        return run_of(
            self.mission,
            [vehicle.id for vehicle in self.vehicles],
            seed=self.mission.mission.seed,
            source=self.source(speed),
            speed=speed,
            began_s=time(),
            duration_s=self.duration_s,
            faults=[fault.injected.given for fault in self.faults],
            operator=user_name(),
            planner=self.planner,
            weather=self.weather,
        )
