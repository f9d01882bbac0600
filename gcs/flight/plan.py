"""What a flight over MAVLink and Zenoh is to be, before anything of it is there."""

from dataclasses import dataclass
from time import time

from gcs.flight.equipment import Equipment
from gcs.flightlog.records import Run
from gcs.flightlog.run import run_of
from gcs.flightlog.writer import LogWriter
from gcs.mission.mission import Mission, MissionVehicle


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What to fly: mission, duration, which vehicles, how fast time passes (None: find out), equipped with what.

    `log` is what it is recorded in, None if it is not.
    """

    mission: Mission
    duration_s: float
    vehicles: tuple[MissionVehicle, ...]
    stubs: bool
    speed: float | None
    equipment: Equipment | None = None
    log: LogWriter | None = None

    def source(self, speed: float) -> str:
        """Return what flies where time passes that fast: only what is simulated can be faster than the wall."""
        return "sitl" if self.stubs or speed != 1.0 else "flight"

    def run(self, speed: float) -> Run:
        """Return what a log says of the run that begins now."""
        return run_of(
            self.mission,
            [vehicle.id for vehicle in self.vehicles],
            seed=self.mission.mission.seed,
            source=self.source(speed),
            speed=speed,
            began_s=time(),
            duration_s=self.duration_s,
        )
