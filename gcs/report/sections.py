"""The sections of a report, built from a flight; a section without data states what is missing."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from gcs.metrics.ending import named
from gcs.metrics.result import FlightResult
from gcs.metrics.reynolds import Flocking, flocking
from gcs.report import tables
from gcs.report.charts import metrics as panels_metrics
from gcs.report.charts import onboard as panels_onboard
from gcs.report.charts import panels
from gcs.report.charts.chart import WIDE_IN, Chart, chart, rows_of_two
from gcs.report.charts.lanes import draw_lanes, key_rows, lanes_height_in
from gcs.report.charts.panels import Sheet
from gcs.report.evidence.criteria import Criteria
from gcs.report.evidence.estimate_errors import (
    NEES_EXPECTED,
    WITHIN_SHARE,
    EstimateError,
    consistency,
    own_errors,
    target_errors,
)
from gcs.report.evidence.flight import FlightEvidence, VehicleEvidence
from gcs.report.evidence.lyapunov import decays
from gcs.report.page_parts import Section
from gcs.report.summary import ring_paragraph

_OPTIMISTIC = {
    "own": "Likely causes: an error of the autopilot's position that changes slowly, or more acceleration than the "
    "filter models",
    "target": "Likely causes: errors of the vehicles' own positions, or manoeuvres beyond those that the filter models",
}
_PESSIMISTIC = {
    "own": "Likely cause: the filter models more noise, or more acceleration, than there was",
    "target": "Likely cause: the filter models more noise, or more manoeuvres, than there were",
}
_NO_TRUTH = "The reference has errors of its own, which the bounds do not cover"


def consistency_note(name: str, errors: Sequence[EstimateError], ids: Sequence[int], *, true: bool) -> str:
    """Return for which vehicles the table contradicts a consistent filter, and why; empty where it does not.

    `name` is `own` or `target`; `ids` are the vehicles' by row; `true` is whether the reference is the truth.
    """
    found = [(ids[error.row], each) for error in errors if (each := consistency(error)) is not None]
    optimistic = [(vehicle_id, each) for vehicle_id, each in found if each.is_optimistic]
    pessimistic = [(vehicle_id, each) for vehicle_id, each in found if each.is_pessimistic]
    whose = "position" if name == "own" else "target"
    notes = []
    if optimistic:
        least = min(each.within for _, each in optimistic)
        times = (max(each.nees for _, each in optimistic) / NEES_EXPECTED) ** 0.5
        notes.append(
            f"In this flight, errors of the {whose} estimate of {named(i for i, _ in optimistic)} leave the bounds "
            f"more often: down to {least:.1%} are within, and they are up to {times:.1f} times as "
            "large as the covariance states. "
            f"{_OPTIMISTIC[name] if true else _NO_TRUTH}."
        )
    if pessimistic:
        least = min(each.nees for _, each in pessimistic)
        notes.append(
            f"In this flight, the covariance of the {whose} estimate of {named(i for i, _ in pessimistic)} is too "
            f"large: the NEES is down to {least:.2f}. {_PESSIMISTIC[name]}."
        )
    return " ".join(notes)


_POINTS = 1200
# Limits the page of sixteen vehicles to a few megabytes; up to eight vehicles get `_POINTS` each.
_POINTS_OF_ALL = 9600
_POINTS_LEAST = 300
_TALL_IN = 3.9


@dataclass(frozen=True)
class ReportedFlight:
    """A flight with the values that several sections share; built by `flight_of`."""

    evidence: FlightEvidence
    result: FlightResult
    criteria: Criteria
    sheet: Sheet

    @cached_property
    def flocking(self) -> Flocking:
        """Reynolds' flocking metrics."""
        return flocking(self.evidence.record)


def flight_of(evidence: FlightEvidence, result: FlightResult, criteria: Criteria) -> ReportedFlight:
    """Return a flight with its evidence in the order of the record, empty where a vehicle has none."""
    record = evidence.record
    known = {vehicle.vehicle_id: vehicle for vehicle in evidence.vehicles}
    ids = [track.vehicle_id for track in record.vehicles]
    aligned = tuple(known.get(vehicle_id, VehicleEvidence(vehicle_id)) for vehicle_id in ids)
    points = max(_POINTS_LEAST, min(_POINTS, _POINTS_OF_ALL // max(len(ids), 1)))
    sheet = panels.sheet_of(record, result, criteria.every_ring, criteria.formation, points)
    return ReportedFlight(replace(evidence, vehicles=aligned), result, criteria, sheet)


def sections(flight: ReportedFlight) -> tuple[Section, ...]:
    """Return the sections of the page below the verdicts, in order."""
    if not (flight.sheet.record.time_s.size > 1 and flight.sheet.record.vehicles):
        return (Section("empty", "No data", missing=("The record of this flight holds no motion.",)),)
    return (
        _paper(flight),
        *(_ring(flight, number) for number in range(len(flight.sheet.rings))),
        _errors(flight),
        _events(flight),
        _estimates(flight),
        _loops(flight),
        *([_planner(flight)] if any(vehicle.loop.values for vehicle in flight.evidence.vehicles) else ()),
        _links(flight),
        _power(flight),
        _reynolds(flight),
        *(() if flight.sheet.rings else (_lyapunov(flight),)),
        _metrics(flight),
    )


_SPEEDS = ("speeds", panels.draw_speeds, "Speed in x of every vehicle in formation over time.")
_OF_A_RING = (
    ("radii", panels.draw_radii, "Distance to the target on the ring over time."),
    ("rates", panels.draw_rates, "Angular velocity about the target over time."),
    ("spacings", panels.draw_spacings, "Angle from each vehicle to the next over time."),
)


def _paper(flight: ReportedFlight) -> Section:
    sheet = flight.sheet
    over_time = (_SPEEDS,) if sheet.rings else (_SPEEDS, *_OF_A_RING)
    draws = [partial(chart, name, partial(draw, sheet=sheet), alt) for name, draw, alt in over_time]
    drawn = rows_of_two([partial(_map, sheet), *draws])
    numbered = zip(("1, 4", "2", "3, 5", "3, 5", "6")[: len(drawn)], drawn, strict=True)
    headed = [replace(each, title=f"{each.title} (figure {number})") for number, each in numbered]
    headed[0] = replace(headed[0], title="Paths (figure 1, 4)", finding="")
    return Section(
        "paper",
        "The paper's figures",
        "Figures 1 to 6 of the paper for this flight; the target is black. Circles mark the engagement of a vehicle, "
        "diamonds its final position; the grey area is the window of the ring metrics.",
        tuple(headed),
    )


def _ring(flight: ReportedFlight, number: int) -> Section:
    """Return the section of one of several rings."""
    sheet, criteria, named = flight.sheet.rings[number], flight.criteria.of_ring(number), flight.result.rings[number]
    anchor, heading = f"ring-{number}", f"Ring {named.name}"
    if sheet.result.window_s is None:
        return Section(anchor, heading, missing=("No vehicle was on this ring.",))
    periods = decays(sheet.record.time_s, sheet.motion, criteria.spacing_gain_per_s)
    draws = [
        *((name, partial(draw, sheet=sheet), alt) for name, draw, alt in _OF_A_RING),
        *(
            (name, partial(draw, sheet=sheet, criteria=criteria), f"{alt}{_OVER_TIME}")
            for name, draw, alt in _RING_ERRORS
        ),
    ]
    if periods:
        draws.append(("lyapunov", partial(panels_metrics.draw_lyapunov, sheet=sheet, periods=periods), _LYAPUNOV_ALT))
    charts = rows_of_two([partial(chart, f"{name}-{anchor}", draw, alt) for name, draw, alt in draws])
    both = (tables.ring_table(sheet.result), *((tables.decay_table(periods),) if periods else ()))
    return Section(anchor, heading, ring_paragraph(named, criteria), charts, both)


def _map(sheet: Sheet, width_in: float) -> Chart:
    alt = "Map of the paths of all vehicles and targets, with the final rings."
    height_in = panels.map_height_in(panels.landmarks_m(sheet), width_in)
    return chart(
        "paths", partial(panels.draw_paths, sheet=sheet), alt, height_in, width_in=width_in, is_over_time=False
    )


_OVER_TIME = " of every vehicle over time, with its tolerance."
_RING_ERRORS = (
    ("radius-error", panels_metrics.draw_radius_error, "Running rms error of the radius"),
    ("rate-error", panels_metrics.draw_rate_error, "Running rms error of the angular velocity"),
    ("spacing-error", panels_metrics.draw_spacing_error, "Running rms error of the angular spacing"),
)
_LYAPUNOV_ALT = "V over time, with the expected decay after every change of the ring."


def _errors(flight: ReportedFlight) -> Section:
    sheet, criteria = flight.sheet, flight.criteria
    draws = (
        *(() if sheet.rings else _RING_ERRORS),
        (
            "formation-speed",
            partial(panels_metrics.draw_formation_errors, spacing=False),
            "Running rms error of the speed in formation",
        ),
        (
            "formation-spacing",
            partial(panels_metrics.draw_formation_errors, spacing=True),
            "Running rms error of the spacing in formation",
        ),
    )
    charts = rows_of_two(
        [
            partial(
                chart,
                name,
                partial(draw, sheet=sheet, criteria=criteria),
                f"{alt}{_OVER_TIME}",
            )
            for name, draw, alt in draws
        ]
    )
    lead = (
        f"Each line is the root mean square over the last {panels_metrics.RUNNING_S:g} seconds, on a logarithmic scale "
        "with the tolerance of the verdict. Formation errors count from 30 s after the start."
    )
    return Section("errors", f"{'Formation' if sheet.rings else 'Ring and formation'} over time", lead, charts)


def _events(flight: ReportedFlight) -> Section:
    record, evidence = flight.sheet.record, flight.evidence
    charts, missing = [], []
    if len(record.vehicles) > 1:
        draw = partial(
            panels_metrics.draw_closest, sheet=flight.sheet, flocking=flight.flocking, criteria=flight.criteria
        )
        alt = "Distance of the two vehicles closest to each other over time, with the required separation."
        charts.append(chart("closest", draw, alt, width_in=WIDE_IN))
    else:
        missing.append("One vehicle: there is no distance to another.")
    lanes = partial(draw_lanes, sheet=flight.sheet, evidence=evidence)
    alt = "A lane for each vehicle: tactics, engagement, commands, failsafes and guard interventions; injected faults."
    rows = key_rows(flight.sheet, evidence)
    timeline = chart("lanes", lanes, alt, lanes_height_in(record), key_rows=rows, width_in=WIDE_IN)
    charts.insert(0, timeline)
    if not record.events:
        missing.append("No events were recorded.")
    lead = (
        "The tactics and the engagement of every vehicle, the operator's commands, the failsafes, the guard's "
        "interventions and injected faults; and the horizontal distance of the two vehicles closest to each other, "
        "with its minimum marked by a triangle."
    )
    events = (tables.event_table(record.events),) if record.events else ()
    return Section("events", "Timeline and closest approach", lead, tuple(charts), events, tuple(missing), keyed=False)


def _estimates(flight: ReportedFlight) -> Section:
    record, vehicles = flight.sheet.record, flight.evidence.vehicles
    true = record.reference == "truth"
    comparison, target = target_errors(record, vehicles)
    own = own_errors(record, vehicles)
    drawn = [("target", f"Target: {comparison}", target), ("own", "Own position: estimation error", own)]
    missing = []
    if not target:
        missing.append("No target estimate was recorded.")
    if not true:
        missing.append("The true positions are not known: errors of the own estimates are not available.")
    elif not own:
        missing.append("No own estimate was recorded.")
    lead = (
        "Errors along x and y, with three standard deviations of each vehicle's own covariance (thin dashes). Of a "
        f"consistent filter {WITHIN_SHARE:.1%} of the errors are within these bounds, and the mean normalised "
        f"estimation error squared (NEES) of both axes is {NEES_EXPECTED:g}. "
    )
    reference = "The truth is the simulator's." if true else "The truth is not known: each title names the reference."
    shown = [(name, heading, errors) for name, heading, errors in drawn if errors]
    ids = [vehicle.vehicle_id for vehicle in vehicles]
    notes = [f" {consistency_note(name, errors, ids, true=true)}" for name, _, errors in shown]
    return Section(
        "estimates",
        "Estimation errors",
        f"{lead}{reference}{''.join(notes)}".rstrip(),
        tuple(_error_chart(flight, name, heading, errors) for name, heading, errors in shown),
        tuple(tables.error_table(heading, errors, flight.evidence) for _, heading, errors in shown),
        tuple(missing),
    )


def _error_chart(flight: ReportedFlight, name: str, heading: str, errors: list[EstimateError]) -> Chart:
    draws = [
        partial(panels_onboard.draw_errors, sheet=flight.sheet, errors=errors, axis=axis, heading=heading)
        for axis in (0, 1)
    ]
    return chart(name, draws, f"{heading}, in x and y over time with three-sigma bounds.", _TALL_IN)


def _loops(flight: ReportedFlight) -> Section:
    if not any(vehicle.loop.time_s.size for vehicle in flight.evidence.vehicles):
        return Section("loop", "Control loop", missing=("The timing of the control loops was not recorded.",))
    draw = partial(panels_onboard.draw_ticks, sheet=flight.sheet, evidence=flight.evidence)
    alt = "Computing time of every tick on a logarithmic scale over time."
    return Section(
        "loop",
        "Control loop",
        "Computing time of each tick, with the period of the loop. A red cross marks skipped ticks. A fallback plan is "
        f"flown where the optimization has no solution.{_in_wall_time(flight)}",
        rows_of_two([partial(chart, "ticks", draw, alt)]),
        (tables.loop_table(flight.evidence),),
    )


def _planner(flight: ReportedFlight) -> Section:
    """Return the values of a user's planner, which are there in every tick that it planned."""
    lead = f"Numbers that the planner {flight.evidence.facts['planner']} returned with its plans."
    return Section("planner", "Planner", lead, tables=(tables.value_table(flight.evidence),), keyed=False)


def _in_wall_time(flight: ReportedFlight) -> str:
    """Return which figures are wall time, in a sentence; empty where mission time is the same."""
    speed = flight.evidence.speed
    if speed == 1.0:
        return ""
    return (
        f" The flight ran {speed:g} times as fast as real time: computing times, periods, intervals and ages are wall "
        "time, the time axes are mission time."
    )


def _links(flight: ReportedFlight) -> Section:
    vehicles = flight.evidence.vehicles
    speed = flight.evidence.speed
    telemetry = [(row, *panels_onboard.intervals_ms(v.telemetry, speed)) for row, v in enumerate(vehicles)]
    ages = [(row, v.telemetry.received_s, 1e3 * v.telemetry.age_s) for row, v in enumerate(vehicles)]
    series = (
        ("intervals", telemetry, "interval [ms]", "Telemetry: interval between samples"),
        ("ages", ages, "age [ms]", "Telemetry: age on reception"),
        (
            "peers",
            panels_onboard.ages_by_sender(flight.evidence),
            "age [ms]",
            "Peers: age of messages on reception",
        ),
    )
    charts = rows_of_two(
        [
            partial(
                chart,
                f"link-{name}",
                partial(panels_onboard.draw_reception, sheet=flight.sheet, received=received, label=label, what=what),
                f"{what}, over time.",
            )
            for name, received, label, what in series
            if any(time_s.size for _, time_s, _ in received)
        ]
    )
    if not charts:
        return Section("links", "Links", missing=("Reception of telemetry and messages was not recorded.",))
    dropped = [f"vehicle {v.vehicle_id} {v.dropped}" for v in vehicles if v.dropped]
    refused = f"Messages dropped: {'; '.join(dropped)}." if dropped else "No message was dropped."
    lead = "Telemetry of the own autopilot, and messages of the peers in the colour of their sender."
    lead = f"{lead} {refused}{_in_wall_time(flight)}"
    return Section("links", "Links", lead, charts, (tables.link_table(flight.evidence),))


def _reynolds(flight: ReportedFlight) -> Section:
    if len(flight.sheet.record.vehicles) < 2:
        return Section("reynolds", "Reynolds' rules", missing=("One vehicle: the flocking metrics do not apply.",))
    sheet, figures = flight.sheet, flight.flocking
    draws = (
        ("nearest", panels_metrics.draw_nearest, "Distance of every vehicle to the nearest other over time."),
        ("mismatch", panels_metrics.draw_mismatch, "Velocity of every vehicle relative to the team's mean over time."),
        ("order", panels_metrics.draw_order, "Order parameter of the directions of flight over time."),
        ("cohesion", panels_metrics.draw_cohesion, "Distance of every vehicle to the team's centroid over time."),
    )
    lead = (
        "Separation, alignment and cohesion as flown. In formation all vehicles fly in one direction; on the ring the "
        "directions cancel out, and the order parameter is near 0."
    )
    charts = rows_of_two(
        [partial(chart, name, partial(draw, sheet=sheet, flocking=figures), alt) for name, draw, alt in draws]
    )
    table = tables.reynolds_table(flight.result)
    return Section("reynolds", "Reynolds' rules", lead, charts, (table,))


def _lyapunov(flight: ReportedFlight) -> Section:
    gain = flight.criteria.spacing_gain_per_s
    periods = decays(flight.sheet.record.time_s, flight.sheet.motion, gain)
    if not periods:
        missing = ("Fewer than two vehicles were on the ring: V is not defined.",)
        return Section("lyapunov", "Lyapunov function", missing=missing)
    draws = (
        (
            "lyapunov",
            panels_metrics.draw_lyapunov,
            _LYAPUNOV_ALT,
        ),
        ("decays", panels_metrics.draw_decays, "V after every change of the ring, with the expected decay."),
    )
    charts = rows_of_two(
        [partial(chart, name, partial(draw, sheet=flight.sheet, periods=periods), alt) for name, draw, alt in draws],
        beside=1,
    )
    expected = (
        ""
        if gain is None
        else f" With γ = {gain:g} /s, V is expected to decay as exp(−2γt) (dashed) while no bound is active."
    )
    lead = (
        "V = ½ Σ eᵢ² over the spacing errors eᵢ on the ring, equations (17) to (20) of the paper. V is restarted "
        f"whenever a vehicle joins or leaves the ring.{expected}"
    )
    return Section(
        "lyapunov",
        "Lyapunov function",
        lead,
        charts,
        (tables.decay_table(periods),),
        keyed=False,
    )


def _power(flight: ReportedFlight) -> Section:
    evidence, sheet = flight.evidence, flight.sheet
    charts = []
    if any(v.altitude_m.size and v.own.time_s.size for v in evidence.vehicles):
        draw = partial(panels_onboard.draw_altitudes, sheet=sheet, evidence=evidence)
        charts.append(partial(chart, "heights", draw, "Height of every vehicle over time."))
    if any(v.battery.size for v in evidence.vehicles):
        draw = partial(panels_onboard.draw_batteries, sheet=sheet, evidence=evidence)
        charts.append(partial(chart, "batteries", draw, "Battery of every vehicle over time."))
    if any(np.nan_to_num(v.loop.yaw_rad).any() for v in evidence.vehicles):
        draw = partial(panels_onboard.draw_yaws, sheet=sheet, evidence=evidence)
        charts.append(partial(chart, "yaws", draw, "Yaw of every vehicle's setpoints over time."))
    missing = () if charts else ("Neither heights nor batteries were recorded.",)
    return Section("power", "Height, yaw and battery", charts=rows_of_two(charts), missing=missing)


def _metrics(flight: ReportedFlight) -> Section:
    both = (tables.vehicle_table(flight.result), tables.team_table(flight.result))
    return Section("metrics", "Metrics", tables=both)
