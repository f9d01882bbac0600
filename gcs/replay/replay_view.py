"""The result of a replay as a table for a terminal and as JSON data."""

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gcs.console.summary import VERDICT_STYLES
from gcs.metrics.catalogue import VerdictState
from gcs.replay.comparison import COVARIANCE_TOLERANCE, TOLERANCE, FieldDifference
from gcs.replay.cores import DecisionDifference, Failure, Moment, Replay, VehicleReplay

FIELDS_SHOWN, INPUTS_SHOWN = 8, 20
_COLUMNS = ("vehicle", "ticks", "compared", "identical")


def replay_view(replay: Replay) -> RenderableType:
    """Return a replay for a terminal: what was compared, and each vehicle's first difference with its inputs."""
    parts: list[RenderableType] = [Text(_comparison_line(replay), style="yellow" if replay.other_versions else "dim")]
    parts.append(_table(replay.vehicles))
    for vehicle in replay.vehicles:
        parts += _findings(vehicle)
    return Group(*parts)


def replay_dict(replay: Replay) -> dict[str, Any]:
    """Return a replay as plain data; the tolerance is None where decisions have to be identical bit for bit."""
    return {
        "mission": replay.mission,
        "same": replay.same,
        "other_versions": list(replay.other_versions),
        "tolerance": TOLERANCE if replay.other_versions else None,
        "vehicles": [_vehicle_dict(vehicle) for vehicle in replay.vehicles],
    }


def _comparison_line(replay: Replay) -> str:
    if not replay.other_versions:
        return f"{replay.mission}: compared bit for bit (all versions as in the flight)"
    return (
        f"{replay.mission}: compared within {TOLERANCE:g} (m, m/s, rad; covariances {COVARIANCE_TOLERANCE:g}); "
        f"versions differ: {'; '.join(replay.other_versions)}"
    )


def _table(vehicles: Sequence[VehicleReplay]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("")
    for name in _COLUMNS:
        table.add_column(name, justify="right")
    table.add_column("", no_wrap=False)
    for each in vehicles:
        same = each.difference is None and each.failure is None
        # A vehicle that was not compared to the end has no verdict.
        passes = VerdictState.NOT_JUDGED if each.gap else VerdictState.PASSES
        state = passes if same else VerdictState.FAILS
        counts = map(str, (each.vehicle_id, each.ticks, each.compared, each.identical))
        table.add_row(Text(state.sign, style=VERDICT_STYLES[state]), *counts, Text(each.gap, style="yellow"))
    return table


def _findings(vehicle: VehicleReplay) -> Iterator[RenderableType]:
    failure, difference = vehicle.failure, vehicle.difference
    if failure is not None:
        then = "as in the flight" if failure.recorded else "not in the flight"
        headline = f"vehicle {vehicle.vehicle_id}: the core raises an exception, {then}: {_when(failure.moment)}"
        yield Text(f"\n{headline}", style="bold red")
        yield Text(f"  {failure.error}")
        yield from _inputs(failure.moment)
    if difference is not None:
        yield Text(f"\nvehicle {vehicle.vehicle_id}: first difference: {_when(difference.moment)}", style="bold red")
        yield from _fields(difference.fields)
        if failure is None or failure.moment.tick != difference.moment.tick:
            yield from _inputs(difference.moment)


def _when(moment: Moment) -> str:
    time = "" if moment.time_s is None else f", {moment.mission_time(moment.time_s)}"
    return f"tick {moment.tick}{time}"


def _fields(fields: Sequence[FieldDifference]) -> Iterator[RenderableType]:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("  field", "recorded", "replayed"):
        table.add_column(name)
    for each in fields[:FIELDS_SHOWN]:
        table.add_row(Text(f"  {each.field or 'decision'}"), Text(str(each.recorded)), Text(str(each.replayed)))
    yield table
    if len(fields) > FIELDS_SHOWN:
        yield Text(f"  and {len(fields) - FIELDS_SHOWN} more fields", style="dim")


def _inputs(moment: Moment) -> Iterator[RenderableType]:
    yield Text("  inputs since the previous tick:", style="dim")
    hidden = len(moment.inputs) - INPUTS_SHOWN
    if hidden > 0:
        yield Text(f"    {hidden} earlier inputs not shown", style="dim")
    for item in moment.inputs[-INPUTS_SHOWN:]:
        yield Text(f"    {item.describe(moment.mission_time)}")


def _vehicle_dict(vehicle: VehicleReplay) -> dict[str, Any]:
    return {
        "id": vehicle.vehicle_id,
        "ticks": vehicle.ticks,
        "compared": vehicle.compared,
        "identical": vehicle.identical,
        "gap": vehicle.gap or None,
        "difference": None if vehicle.difference is None else _difference_dict(vehicle.difference),
        "failure": None if vehicle.failure is None else _failure_dict(vehicle.failure),
    }


def _difference_dict(difference: DecisionDifference) -> dict[str, Any]:
    fields = [msgspec.to_builtins(each._asdict()) for each in difference.fields]
    return {**_moment_dict(difference.moment), "fields": fields}


def _failure_dict(failure: Failure) -> dict[str, Any]:
    return {**_moment_dict(failure.moment), "error": failure.error, "recorded": failure.recorded}


def _moment_dict(moment: Moment) -> dict[str, Any]:
    known = moment.time_s is not None and moment.start_s is not None
    return {
        "tick": moment.tick,
        "time_s": moment.time_s - moment.start_s if known else None,  # type: ignore[operator]  # both are known
        "inputs": [item.describe(moment.mission_time) for item in moment.inputs],
    }
