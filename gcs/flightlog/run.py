"""The record of the run as a whole, and the mission that was flown, from that record."""

import platform
from collections.abc import Sequence
from importlib.metadata import version

from gcs.flightlog.container import LogError
from gcs.flightlog.reader import FlightLog
from gcs.flightlog.records import FORMAT, PlannerRecord, PlantText, Run, Version
from gcs.mission.file import MissionError, parse_mission
from gcs.mission.mission import Mission
from gcs.mission.planner import ChosenPlanner

_COMPUTES = ("cordon-gcs", "numpy", "osqp", "scipy", "filterpy", "msgspec")
"""The packages on which computed numbers may depend."""
_OTHER_CLOCK_S = 1e6
"""A flight's clock that is further from Unix time is another one, as that of a simulation."""


def versions() -> tuple[Version, ...]:
    """Return the versions that a bit-exact repetition depends on."""
    here = (Version("python", platform.python_version()), Version("machine", platform.machine()))
    return (*(Version(name, version(name)) for name in _COMPUTES), *here)


def run_of(
    mission: Mission,
    vehicles: Sequence[int],
    *,
    seed: int,
    source: str,
    speed: float,
    began_s: float,
    duration_s: float,
    faults: Sequence[str] = (),
    operator: str = "",
    planner: ChosenPlanner | None = None,
    weather: str = "",
) -> Run:
    """Return the record of a run; `began_s` is Unix time, `faults` are those injected into stub vehicles.

    `operator` is the user who begins it, `planner` the planner if it is not cordon's, `weather` what people wrote about
    it.
    """
    plants = tuple(PlantText(name, text) for name, text in sorted(mission.profile_texts.items()))
    return Run(
        format=FORMAT,
        mission=mission.mission.name,
        mission_text=mission.text,
        plants=plants,
        seed=seed,
        source=source,
        speed=speed,
        began_s=began_s,
        duration_s=duration_s,
        vehicles=tuple(vehicles),
        versions=versions(),
        faults=tuple(faults),
        operator=operator,
        planner=None if planner is None else PlannerRecord(planner.name, planner.distribution, planner.digest),
        weather=weather,
    )


def planner_text(planner: PlannerRecord) -> str:
    """Return what the log knows of a planner: name, distribution, digest of its source."""
    source = f"source {planner.digest}" if planner.digest else ""
    return ", ".join(filter(None, (planner.name, planner.distribution, source)))


def unix_offset_s(log: FlightLog) -> float:
    """Return what leads from the clock of a flight to Unix time: nothing, if that is its clock.

    Else the run's first record is at its begin, and a second is one of the flight's clock also where that ran faster.
    """
    run = log.run
    firsts_s = [records[0].time_ns / 1e9 * run.speed for records in log.vehicles.values() if records]
    offset_s = run.began_s - min(firsts_s, default=run.began_s)
    return offset_s if abs(offset_s) > _OTHER_CLOCK_S else 0.0


def mission_of(log: FlightLog) -> Mission:
    """Return the mission that was flown, with its own plants; raises LogError if this version refuses it."""
    run = log.run
    try:
        return parse_mission(run.mission_text, None, {plant.name: plant.text for plant in run.plants})
    except MissionError as error:
        raise LogError([f"{log.path}: its mission: {fault}" for fault in error.faults]) from error
