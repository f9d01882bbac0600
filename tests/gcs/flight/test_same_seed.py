"""The same seed gives the same recorded flight, whatever is not ideal about its vehicles."""

from pathlib import Path

from gcs.flightlog.reader import read_log
from gcs.flightlog.records import Cost, Run, RunEnd
from gcs.mission.mission import Mission
from tests.support.flight_logs import engaging, record_simulation


def imperfect() -> Mission:
    """Return a mission with noise, losses, outliers, wander, gusts, limits, and telemetry between ticks."""
    return engaging(
        "case2-field",
        (("simulation", "wander_m"), 0.2),
        (("simulation", "wind_m_s"), [2.0, -1.0]),
        (("simulation", "gusts"), True),
        (("simulation", "speed_max_m_s"), 3.0),
        (("simulation", "telemetry_rate_hz"), 23.0),
        (("target", "sensor", "outlier_share"), 0.05),
        (("target", "sensor", "outlier_m"), 4.0),
    )


WALL_CLOCK = (Run, RunEnd, Cost)
"""The kinds of records that hold what the computer's clock said."""


def recorded(path: Path, seed: int) -> dict[int, list[tuple[str, int, bytes]]]:
    """Fly, and return each vehicle's records, and the run's as those of 0: kinds, times and bytes."""
    record_simulation(imperfect(), path, seed=seed, duration_s=12.0)
    log = read_log(path)
    return {
        vehicle_id: [
            (each.kind.__name__, each.time_ns, each.payload) for each in records if each.kind not in WALL_CLOCK
        ]
        for vehicle_id, records in (log.vehicles | {0: log.run_records}).items()
    }


def test_the_same_seed_gives_the_same_log_to_the_byte_and_another_does_not(tmp_path: Path) -> None:
    once, again, other = (recorded(tmp_path / f"{number}.mcap", seed) for number, seed in enumerate((3, 3, 4)))
    kinds = {kind for kind, _, _ in once[1]}
    assert kinds >= {"Telemetry", "Sighting", "Truth", "Decision"}
    assert once[0]  # messages
    assert once == again
    assert once[1] != other[1]
