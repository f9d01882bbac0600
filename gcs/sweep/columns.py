"""The columns of a sweep's table: the values of a flight's JSON result, each named by its path.

Metrics of vehicles and of transitions also have `.mean` and `.worst` over the team. Units are in the names. A metric
that does not apply is missing, never 0.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Any, Literal

from gcs.metrics.result import FlightResult

Scalar = bool | int | float | str
Row = dict[str, Scalar]
"""The values of one run by column; values that do not apply are missing."""
Worst = Literal["max", "min"]


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name, the type and meaning of its values, and which extreme is the worst, if any."""

    name: str
    kind: type[Scalar]
    meaning: str
    worst: Worst | None = None


RUN = (
    Column("seed", int, "seed of noise, delays and losses"),
    Column("error", str, "why the run failed; a failed run has no other values"),
    Column("holds", bool, "no verdict failed, and the flight did not end early"),
)
FLIGHT = (
    Column("ended.how", str, "how the flight ended: `simulated` at the end of its time"),
    Column("ended.reason", str, "how the flight ended, as text"),
    Column("duration_s", float, "simulated time flown"),
    Column("window_begin_s", float, "start of the window of the ring metrics"),
    Column("window_end_s", float, "end of the window of the ring metrics"),
    Column(
        "ring.settling_time_s",
        float,
        "time from the last engagement to the settled ring; missing if it never settles",
        "max",
    ),
    Column("ring.spacing_error_rms_deg", float, "error of the spacings on the ring, rms", "max"),
    Column("ring.spacing_error_max_deg", float, "error of the spacings on the ring, largest", "max"),
    Column("ring.first_settled_at_s", float, "when the ring first settled, if it left its limits later"),
    Column("ring.unsettled_at_s", float, "when a settled ring last left its limits"),
    Column("closest_approach_m", float, "smallest distance between two vehicles", "min"),
    Column("guard_interventions", int, "setpoints that the guard moved", "max"),
    Column("guard_causes", str, "setpoints that the guard moved, by cause, as JSON"),
    Column("engagement.to_engage", int, "vehicles expected to engage the target"),
    Column("engagement.engaged", int, "vehicles that engaged the target", "min"),
    Column("loop.rate_hz", float, "rate of the control loop"),
    Column("loop.ticks", int, "ticks of all vehicles"),
    Column("loop.missed", int, "missed ticks"),
    Column("verdicts.C1", bool, "radius within its tolerance"),
    Column("verdicts.C2", bool, "angular rate within its tolerance"),
    Column("verdicts.C3", bool, "spacing within its tolerance"),
    Column("verdicts.formation", bool, "formation within its tolerances"),
    Column("verdicts.separation", bool, "separation kept"),
    Column("verdicts.engaged", bool, "all vehicles expected to engage the target did"),
)
FLOCKING = (
    Column("separation_min_m", float, "distance to the nearest other vehicle, smallest", "min"),
    Column("separation_mean_m", float, "distance to the nearest other vehicle, mean", "min"),
    Column("alignment_error_rms_m_s", float, "velocity relative to the team's mean, rms", "max"),
    Column("alignment_order_mean", float, "length of the mean direction of flight"),
    Column("cohesion_mean_m", float, "distance to the team's centroid, mean"),
    Column("cohesion_max_m", float, "distance to the team's centroid, largest"),
)
"""In formation, in the window of the ring metrics, and over the flight: `reynolds.PHASE.NAME`."""
VEHICLE = (
    Column("engaged_at_s", float, "time at which a vehicle engaged the target", "max"),
    Column("tactic", str, "tactic at the end"),
    Column("radius_error_rms_m", float, "error of the radius on the ring, rms", "max"),
    Column("radius_error_max_m", float, "error of the radius on the ring, largest", "max"),
    Column("angular_rate_mean_rad_s", float, "angular rate on the ring, mean over time"),
    Column("angular_rate_error_rms_rad_s", float, "error of the angular rate on the ring, rms", "max"),
    Column("formation_speed_error_rms_m_s", float, "error of the speed in formation, rms", "max"),
    Column("formation_spacing_error_rms_m", float, "error of the distance to the predecessor in formation, rms", "max"),
)
"""Of each vehicle: `vehicle_ID.NAME`; over the team: `vehicles.NAME.mean` and `vehicles.NAME.worst`."""
TRANSITION = (
    Column("settling_time_s", float, "time from an engagement to the settled ring", "max"),
    Column("speed_max_m_s", float, "highest speed relative to the target", "max"),
    Column("forwards_min_m_s", float, "lowest speed along the ring in its direction", "min"),
    Column("acceleration_max_m_s2", float, "largest acceleration", "max"),
    Column("spacing_overshoot_deg", float, "overshoot of a spacing beyond even spacing", "max"),
    Column("spacing_monotonic", bool, "V (18) never grew from 5 s on", "min"),
)
"""Over the transitions after the engagements: `transitions.NAME.worst`."""


def _over(prefix: str, columns: Iterable[Column], *, mean: bool) -> Iterable[Column]:
    for each in columns:
        if mean and each.kind is float:
            yield Column(f"{prefix}.{each.name}.mean", float, f"mean over the vehicles: {each.meaning}", each.worst)
        if each.worst is not None:
            yield Column(f"{prefix}.{each.name}.worst", each.kind, f"worst value: {each.meaning}", each.worst)


TEAM = (
    *FLIGHT,
    *(
        replace(each, name=f"reynolds.{phase}.{each.name}", meaning=f"{where}: {each.meaning}")
        for phase, where in (
            ("formation", "in formation"),
            ("ring", "in the window of the ring metrics"),
            ("flight", "whole flight"),
        )
        for each in FLOCKING
    ),
    *_over("vehicles", VEHICLE, mean=True),
    Column("transitions.count", int, "engagements; those within 3 s of each other are one"),
    *_over("transitions", TRANSITION, mean=False),
)
"""Every column of a flight but those of single vehicles."""


def columns(rows: Iterable[Row]) -> tuple[Column, ...]:
    """Return the columns of these runs, without those of the varied keys: single vehicles last, by their ids."""
    ids = {
        int(name.partition(".")[0].removeprefix("vehicle_"))
        for row in rows
        for name in row
        if name.startswith("vehicle_")
    }
    single = [
        Column(f"vehicle_{i}.{each.name}", each.kind, each.meaning, each.worst) for i in sorted(ids) for each in VEHICLE
    ]
    return (*RUN, *TEAM, *single)


def result_row(result: FlightResult, *, holds: bool) -> Row:
    """Return a result as a row: values that depend only on mission and seed, without wall times."""
    plain: dict[str, Any] = result.to_dict()
    begin_s, end_s = plain["window_s"] or (None, None)
    values = {
        **_flat(plain),
        "holds": holds,
        "window_begin_s": begin_s,
        "window_end_s": end_s,
        "guard_causes": json.dumps(plain["guard_causes"], sort_keys=True),
        "transitions.count": len(plain["transitions"]),
        **{f"engagement.{name}": len(ids) for name, ids in plain["engagement"].items()},
        **_condensed("vehicles", VEHICLE, plain["vehicles"]),
        **_condensed("transitions", TRANSITION, plain["transitions"]),
        **{f"vehicle_{each['id']}.{name}": value for each in plain["vehicles"] for name, value in each.items()},
    }
    ids = [each["id"] for each in plain["vehicles"]]
    wanted = {each.name for each in (*RUN, *TEAM)} | {f"vehicle_{i}.{each.name}" for i in ids for each in VEHICLE}
    return {name: value for name, value in values.items() if name in wanted and value is not None}


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of nested tables by their paths."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat


def _condensed(prefix: str, parts: Iterable[Column], tables: Sequence[Mapping[str, Any]]) -> Row:
    """Return the mean and the worst value of each column over the tables that have it."""
    row: Row = {}
    for each in parts:
        known = [table[each.name] for table in tables if table[each.name] is not None]
        if known and each.kind is float:
            row[f"{prefix}.{each.name}.mean"] = fmean(known)
        if known and each.worst is not None:
            row[f"{prefix}.{each.name}.worst"] = max(known) if each.worst == "max" else min(known)
    return row
