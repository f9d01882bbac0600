"""The result of a flight as a summary and as an exit code."""

from gcs.console.summary import summary
from gcs.console.terminal import STDERR
from gcs.errors import Exit
from gcs.metrics.metrics import evaluated
from gcs.metrics.record import FlightRecord
from gcs.metrics.result import FlightResult
from gcs.mission.mission import Mission


def show_result(mission: Mission, record: FlightRecord) -> FlightResult:
    """Evaluate a flight against its mission and print the summary."""
    result = evaluated(mission, record)
    STDERR.print(summary(result))
    return result


def verdict_of(result: FlightResult) -> Exit:
    """Return the exit code of a flight: its ending takes precedence over its verdicts."""
    if result.ended_early:
        return Exit.ENDED_IN_FLIGHT
    return Exit.HOLDS if result.all_hold else Exit.VERDICT_FAILED
