"""Findings on the requested traffic of each connection, compared with its data rate."""

from collections.abc import Iterator, Mapping, Sequence

from gcs.autopilots.registry import advice
from gcs.link.config import link_paces
from gcs.link.rates.budget import LOAD_SHARE, Load, fitting, load
from gcs.link.rates.rate_controller import RateController
from gcs.link.rates.rates import SETPOINT_MIN_HZ, Rates, rate_levels
from gcs.mission.mission import Mission
from gcs.preflight.findings import MISSION, Finding, Grade, VehicleFacts, limited

UNASKED_SHARE = 1.5
"""A ratio of received to requested traffic above this indicates streams that were not requested."""


def link_budget(mission: Mission, team: Sequence[VehicleFacts]) -> Iterator[Finding]:
    """Compare requested traffic with the data rate, for each connection whose data rate is known."""
    measured = _measured_bytes_s(mission, team)
    for url, pace in sorted(link_paces(mission).items()):
        if pace.capacity_bytes_s is not None:
            yield _fits(url, pace, pace.capacity_bytes_s)
            if (received_bytes_s := measured.get(url)) is not None:
                yield _received_load(url, pace.load, received_bytes_s)


def _fits(url: str, pace: RateController, capacity_bytes_s: float) -> Finding:
    planned_bytes_s = pace.load.bytes_s
    vehicles = "1 vehicle takes" if pace.vehicles == 1 else f"{pace.vehicles} vehicles take"
    return Finding.graded(
        limited(planned_bytes_s, capacity_bytes_s, LOAD_SHARE),
        MISSION,
        "link budget",
        f"{url}: {vehicles} {planned_bytes_s:.0f} of its {capacity_bytes_s:.0f} bytes/s "
        f"({planned_bytes_s / capacity_bytes_s:.0%}) with {_shown(pace.rates)}",
        f"above {LOAD_SHARE:.0%}, setpoints and commands are delayed",
        _step(pace, capacity_bytes_s),
    )


def _step(pace: RateController, capacity_bytes_s: float) -> str:
    levels = rate_levels(pace.rates)
    rates = levels[fitting(levels, pace.vehicles, capacity_bytes_s, signed=pace.signed)]
    least = load(rates, pace.vehicles, signed=pace.signed)
    if least.bytes_s > LOAD_SHARE * capacity_bytes_s:
        return (
            f"the lowest rates take {least.bytes_s:.0f} bytes/s (setpoints at {SETPOINT_MIN_HZ:g} Hz): use a faster "
            "radio, or fewer vehicles on it"
        )
    return f'set [link] to {_shown(rates)}, or rates = "auto"'


def _shown(rates: Rates) -> str:
    return (
        f"telemetry_rate_hz = {rates.telemetry_hz:.3g}, status_rate_hz = {rates.status_hz:.3g}, "
        f"setpoint_rate_hz = {rates.setpoint_hz:.3g}"
    )


def _received_load(url: str, asked: Load, received_bytes_s: float) -> Finding:
    share = received_bytes_s / asked.down_bytes_s
    return Finding.graded(
        Grade.WARNING if share > UNASKED_SHARE else Grade.PASS,
        MISSION,
        "link traffic",
        f"{url}: {received_bytes_s:.0f} bytes/s received from the vehicles, {asked.down_bytes_s:.0f} bytes/s requested",
        "streams that were not requested delay setpoints and commands",
        f"stop other streams on that port ({advice('streams', between='; ')})",
    )


def _measured_bytes_s(mission: Mission, team: Sequence[VehicleFacts]) -> Mapping[str, float]:
    """Return the traffic received on each connection; each of its vehicles' facts hold the sum."""
    urls = {vehicle.id: vehicle.section.url for vehicle in mission.vehicles}
    return {urls[facts.vehicle_id]: facts.link_bytes_s for facts in team if facts.link_bytes_s is not None}
