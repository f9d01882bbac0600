"""A flight for identification: the preview of its time, space and speed, and the values flown."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from msgspec import structs
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from agents.control.excitation import Part, Preview, programme
from agents.tactics import Tactic
from estimation.state import Vector
from gcs.metrics.record import FlightRecord
from gcs.metrics.ring import measured
from gcs.mission.excitation import box_m
from gcs.mission.mission import Mission

_FLOWN_SHARE = 0.95
"""Share of its duration: a part that was flown for less was interrupted, or never began."""


def preview_view(mission: Mission, planned: Preview) -> RenderableType:
    """Return the time, space and speed of a flight for identification, as text."""
    vehicle, settings = mission.vehicles[0], mission.excitation
    (x_low, y_low), _, (x_high, y_high), _ = box_m(settings, vehicle.section.start_m)
    start_x, start_y = vehicle.section.start_m
    limits = f"at most {settings.speed_max_m_s:g} m/s, also with a plant error of {settings.plant_doubt:.0%}"
    rows = {
        "vehicle": f"{vehicle.id}, profile '{vehicle.section.profile}', start at ({start_x:g}, {start_y:g}) m",
        "box": f"x from {x_low:g} to {x_high:g} m, y from {y_low:g} to {y_high:g} m, "
        f"{vehicle.section.altitude_m:g} m high; the guard's fence encloses it and the way to it",
        "time": f"{planned.duration_s:.0f} s, without take-off and landing",
        "speed": f"{planned.speed_m_s:.2f} m/s predicted, {limits}",
        "acceleration": f"{planned.acceleration_m_s2:.2f} m/s² predicted",
        "reach": f"{planned.reach_m:.2f} m from the middle of the box predicted; {settings.half_width_m:g} m allowed",
        "distance": f"{planned.distance_m:.0f} m predicted",
    }
    table = Table.grid(padding=(0, 2))
    for name, words in rows.items():
        table.add_row(Text(name), Text(words, style="dim"))
    parts = Table.grid(padding=(0, 2))
    for part in programme(mission.agent_config(vehicle)).parts:
        times, amplitude = f"{part.begin_s:.0f} to {part.end_s:.0f} s", f"up to {part.amplitude_m:.2f} m"
        parts.add_row(Text(part.name), Text(times, style="dim"), Text(amplitude, style="dim"))
    return Group(Text(f"{mission.mission.name}: flight for identification", style="bold"), table, Text(), parts)


@dataclass(frozen=True, slots=True)
class FlownExcitation:
    """A flight for identification, while the vehicle was excited: its figures, and the parts that are missing."""

    duration_s: float
    speed_m_s: float
    reach_m: float
    distance_m: float
    parts_missing: tuple[str, ...]
    guard_interventions: int | None


def flown_view(planned: Preview, flown: FlownExcitation) -> RenderableType:
    """Return the values flown beside those of the preview."""
    table = Table.grid(padding=(0, 2))
    for name, unit, value, foreseen in (
        ("speed", "m/s", flown.speed_m_s, planned.speed_m_s),
        ("reach", "m", flown.reach_m, planned.reach_m),
        ("distance", "m", flown.distance_m, planned.distance_m),
    ):
        table.add_row(Text(name), Text(f"{value:.2f} {unit}"), Text(f"{foreseen:.2f} {unit} predicted", style="dim"))
    table.add_row(Text("guard"), Text(f"moved {flown.guard_interventions} setpoints"))
    return table


def flown_excitation(mission: Mission, record: FlightRecord) -> FlownExcitation:
    """Return the figures of a flight from the samples received: a simulator's truth may have short gaps, too."""
    track, settings = record.vehicles[0], mission.excitation
    excited = (track.tactic == Tactic.EXCITE.value) & measured(record)[0]
    start_x, start_y = mission.vehicles[0].section.start_m
    parts = programme(mission.agent_config(mission.vehicles[0])).parts
    in_box = excited & (record.time_s >= parts[0].begin_s)
    away_m = track.position_m[in_box] - (start_x + settings.offset_m[0], start_y + settings.offset_m[1])
    steps_m = np.diff(track.position_m[excited], axis=0)
    rate_hz = mission.mission.rate_hz

    def is_missing(part: Part) -> bool:
        during = (record.time_s >= part.begin_s) & (record.time_s < part.end_s)
        return bool(np.count_nonzero(excited & during) < _FLOWN_SHARE * (part.end_s - part.begin_s) * rate_hz)

    return FlownExcitation(
        duration_s=np.count_nonzero(excited) / rate_hz,
        speed_m_s=_largest(np.hypot(*track.velocity_m_s[excited].T)),
        reach_m=_largest(np.abs(away_m)),
        distance_m=float(np.hypot(*steps_m.T).sum()),
        parts_missing=tuple(part.name for part in parts if is_missing(part)),
        guard_interventions=None if record.guard is None else record.guard.interventions,
    )


def _largest(values: Vector) -> float:
    return float(values.max()) if values.size else 0.0


def preview_dict(mission: Mission, planned: Preview) -> Mapping[str, object]:
    """Return vehicle, box and preview as a plain dict."""
    vehicle = mission.vehicles[0]
    return {
        "mission": mission.mission.name,
        "vehicle": vehicle.id,
        "profile": vehicle.section.profile,
        "box_m": box_m(mission.excitation, vehicle.section.start_m),
        "altitude_m": vehicle.section.altitude_m,
        "speed_max_m_s": mission.excitation.speed_max_m_s,
        "preview": structs.asdict(planned),
    }
