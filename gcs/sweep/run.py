"""One run of a sweep in a worker: from a task to a row."""

from functools import cache

from gcs.console.result import verdict_of
from gcs.errors import Exit, InputError
from gcs.flight.simulated import fly_simulated
from gcs.flightlog.run import versions
from gcs.metrics.metrics import evaluated
from gcs.mission.file import parse_mission
from gcs.sweep.columns import Row, result_row
from gcs.sweep.plan import SweepTask


class UnlikeWorkerError(Exception):
    """A worker has other versions of packages that results depend on."""


def flown(task: SweepTask) -> Row:
    """Fly a run and return its metrics; a failed run is a row with only `error`.

    Raises UnlikeWorkerError if this computer's versions differ from those of the task.
    """
    here = _versions()
    unlike = [
        f"{name} {here.get(name)} instead of {wanted}"
        for name, wanted in task.versions.items()
        if here.get(name) != wanted
    ]
    if unlike:
        raise UnlikeWorkerError(f"a worker has {', '.join(unlike)}")
    try:
        mission = parse_mission(task.mission_text, None, task.profile_texts)
        record = fly_simulated(mission, task.seed, task.duration_s or mission.mission.duration_s, _ignore)
        result = evaluated(mission, record)
        return result_row(result, holds=verdict_of(result) is Exit.HOLDS)
    except InputError as error:
        return failure("; ".join(error.faults))
    except Exception as error:  # no error of one run ends the sweep
        return failure(f"{type(error).__name__}: {error}")


def failure(reason: str) -> Row:
    """Return the row of a run that failed."""
    return {"error": reason}


def _ignore(_time_s: float) -> None:
    """Discard the progress of a run."""


@cache
def _versions() -> dict[str, str]:
    return {each.name: each.version for each in versions()}
