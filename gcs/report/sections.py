"""The parts of a report, made from a flight: what there is to see, and one line where there is nothing."""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import isclose

import numpy as np

from gcs.metrics.metrics import ring_motion
from gcs.metrics.result import FlightResult
from gcs.metrics.reynolds import Flocking, flocking
from gcs.report import tables
from gcs.report.charts import inside as panels_inside
from gcs.report.charts import metrics as panels_metrics
from gcs.report.charts import panels
from gcs.report.charts.chart import WIDTH_IN, Chart, chart
from gcs.report.charts.lanes import draw_lanes, key_rows, lanes_height_in
from gcs.report.charts.panels import Sheet
from gcs.report.evidence.asked import Asked
from gcs.report.evidence.beliefs import Error, own_errors, target_errors
from gcs.report.evidence.flight import FlightEvidence, VehicleEvidence
from gcs.report.evidence.lyapunov import decays
from gcs.report.view import Section

_POINTS = 1200
# Sixteen vehicles share what makes a page of a few megabytes; half a dozen have as many points as they like.
_POINTS_OF_ALL = 9600
_POINTS_LEAST = 300
_TALL_IN = 3.9


@dataclass(frozen=True)
class Flight:
    """A flight with what is measured only once: see `flight_of`."""

    evidence: FlightEvidence
    result: FlightResult
    asked: Asked
    sheet: Sheet

    @cached_property
    def flocking(self) -> Flocking:
        """Reynolds' figures."""
        return flocking(self.evidence.record)


def flight_of(evidence: FlightEvidence, result: FlightResult, asked: Asked) -> Flight:
    """Return a flight to be shown, its evidence in the order of the record, empty where a vehicle has none."""
    record = evidence.record
    known = {vehicle.vehicle_id: vehicle for vehicle in evidence.vehicles}
    ids = [track.vehicle_id for track in record.vehicles]
    aligned = tuple(known.get(vehicle_id, VehicleEvidence(vehicle_id)) for vehicle_id in ids)
    points = max(_POINTS_LEAST, min(_POINTS, _POINTS_OF_ALL // max(len(ids), 1)))
    sheet = Sheet(record, result, asked.ring, asked.formation, ring_motion(record), points)
    return Flight(replace(evidence, vehicles=aligned), result, asked, sheet)


def sections(flight: Flight) -> tuple[Section, ...]:
    """Return the parts of the page below the verdicts, in order."""
    if not (flight.sheet.record.time_s.size > 1 and flight.sheet.record.vehicles):
        return (Section("empty", "Nothing to show", missing=("The record of this flight holds no motion.",)),)
    return (
        _paper(flight),
        _errors(flight),
        _events(flight),
        _estimates(flight),
        _loops(flight),
        _links(flight),
        _reynolds(flight),
        _lyapunov(flight),
        _power(flight),
        _metrics(flight),
    )


def _paper(flight: Flight) -> Section:
    sheet = flight.sheet
    span_m = np.ptp(panels.landmarks_m(sheet), axis=0)
    map_height_in = float(np.clip(0.85 * WIDTH_IN * span_m[1] / max(span_m[0], 1e-9) + 0.6, 2.4, 5.0))
    drawn = (
        chart(
            "paths",
            partial(panels.draw_paths, sheet=sheet),
            "Map of the paths of all vehicles and of the target, with the ring at the end.",
            map_height_in,
        ),
        chart(
            "speeds", partial(panels.draw_speeds, sheet=sheet), "Speed in x of every vehicle in formation over time."
        ),
        chart("radii", partial(panels.draw_radii, sheet=sheet), "Distance to the target on the ring over time."),
        chart("rates", partial(panels.draw_rates, sheet=sheet), "Angular velocity about the target over time."),
        chart("spacings", partial(panels.draw_spacings, sheet=sheet), "Angle from each vehicle to the next over time."),
    )
    numbered = zip(("1, 4", "2", "3, 5", "3, 5", "6"), drawn, strict=True)
    headed = [replace(each, title=f"{each.title} (figure {number})") for number, each in numbered]
    headed[0] = replace(headed[0], title="Paths (figure 1, 4)", finding="")
    return Section(
        "paper",
        "The paper's figures",
        "Figures 1 to 6 of the paper, from this flight; the target is black. Circles mark where a vehicle left the "
        "formation for the ring, diamonds where it was at the end; the grey ground is the ring metrics' window.",
        tuple(headed),
    )


def _errors(flight: Flight) -> Section:
    sheet, asked = flight.sheet, flight.asked
    draws = (
        ("radius-error", panels_metrics.draw_radius_error, "Running error of the radius"),
        ("rate-error", panels_metrics.draw_rate_error, "Running error of the angular velocity"),
        ("spacing-error", panels_metrics.draw_spacing_error, "Running error of the angles between neighbours"),
        (
            "formation-speed",
            partial(panels_metrics.draw_formation_errors, spacing=False),
            "Running error of the speed in formation",
        ),
        (
            "formation-spacing",
            partial(panels_metrics.draw_formation_errors, spacing=True),
            "Running error of the places in formation",
        ),
    )
    charts = tuple(
        chart(name, partial(draw, sheet=sheet, asked=asked), f"{alt} of every vehicle over time, with its tolerance.")
        for name, draw, alt in draws
    )
    lead = (
        f"Each line is the root mean square of the last {panels_metrics.RUNNING_S:g} seconds, on a logarithmic scale "
        "beside the tolerance of the verdict. The errors in formation are judged from 30 s after the start."
    )
    return Section("errors", "Ring and formation over time", lead, charts)


def _events(flight: Flight) -> Section:
    record, evidence = flight.sheet.record, flight.evidence
    charts, missing = [], []
    if len(record.vehicles) > 1:
        draw = partial(panels_metrics.draw_closest, sheet=flight.sheet, flocking=flight.flocking, asked=flight.asked)
        alt = "Distance of the two vehicles closest to each other over time, with the separation asked for."
        charts.append(chart("closest", draw, alt))
    else:
        missing.append("A vehicle alone has nobody to come close to.")
    lanes = partial(draw_lanes, record=record, evidence=evidence)
    alt = "A lane for each vehicle with its tactics over time, commands, failsafes and what the guard did."
    rows = key_rows(record, evidence)
    charts.append(chart("lanes", lanes, alt, lanes_height_in(len(record.vehicles)), key_rows=rows))
    if not record.events:
        missing.append("No events were noted.")
    lead = (
        "The horizontal distance of the two vehicles closest to each other, its least marked by a triangle; and what "
        "every vehicle was doing, the operator's commands, the failsafes, and where the guard changed setpoints."
    )
    told = (tables.event_table(record.events),) if record.events else ()
    return Section("events", "Closest approach and time line", lead, tuple(charts), told, tuple(missing), keyed=False)


def _estimates(flight: Flight) -> Section:
    record, vehicles = flight.sheet.record, flight.evidence.vehicles
    true = record.reference == "truth"
    words, target = target_errors(record, vehicles)
    own = own_errors(record, vehicles)
    drawn = [("target", f"Target: {words}", target), ("own", "Own position: error of the estimate", own)]
    missing = []
    if not target:
        missing.append("No vehicle's belief of the target was kept.")
    if not true:
        missing.append("Nobody knew where the vehicles truly were: their own errors cannot be shown.")
    elif not own:
        missing.append("No vehicle's estimate of itself was kept.")
    lead = (
        "Errors along x and y, with the bounds of three standard deviations that each vehicle itself believed in "
        "(thin dashes): of honest beliefs 99.7 % of the errors lie between them. "
    )
    held = "The truth is the simulator's." if true else "No truth is known: each chart says what it compares with."
    shown = [(name, heading, errors) for name, heading, errors in drawn if errors]
    return Section(
        "estimates",
        "What the vehicles believed",
        lead + held,
        tuple(_error_chart(flight, name, heading, errors) for name, heading, errors in shown),
        tuple(tables.error_table(heading, errors, flight.evidence) for _, heading, errors in shown),
        tuple(missing),
    )


def _error_chart(flight: Flight, name: str, heading: str, errors: list[Error]) -> Chart:
    draws = [
        partial(panels_inside.draw_errors, sheet=flight.sheet, errors=errors, axis=axis, heading=heading)
        for axis in (0, 1)
    ]
    return chart(name, draws, f"{heading}, in x and y over time with three-sigma bounds.", _TALL_IN)


def _loops(flight: Flight) -> Section:
    if not any(vehicle.loop.time_s.size for vehicle in flight.evidence.vehicles):
        return Section("loop", "Control loop", missing=("The timing of the control loops was not kept.",))
    draw = partial(panels_inside.draw_ticks, sheet=flight.sheet, evidence=flight.evidence)
    alt = "Computing time of every tick on a logarithmic scale over time."
    return Section(
        "loop",
        "Control loop",
        "How long each tick computed, beside the period it had. A red cross marks ticks that were skipped; a fallback "
        "plan stands in for one that could not be solved.",
        (chart("ticks", draw, alt),),
        (tables.loop_table(flight.evidence),),
    )


def _links(flight: Flight) -> Section:
    vehicles = flight.evidence.vehicles
    telemetry = [(row, *panels_inside.intervals_ms(v.telemetry)) for row, v in enumerate(vehicles)]
    ages = [(row, v.telemetry.heard_s, 1e3 * v.telemetry.age_s) for row, v in enumerate(vehicles)]
    series = (
        ("intervals", telemetry, "interval [ms]", "Telemetry: time since the one before"),
        ("ages", ages, "age [ms]", "Telemetry: age when heard"),
        (
            "peers",
            panels_inside.ages_by_sender(flight.evidence),
            "age [ms]",
            "Peers: age of what each said, when heard",
        ),
    )
    charts = tuple(
        chart(
            f"link-{name}",
            partial(panels_inside.draw_heard, sheet=flight.sheet, heard=heard, label=label, what=what),
            f"{what}, over time.",
        )
        for name, heard, label, what in series
        if any(time_s.size for _, time_s, _ in heard)
    )
    if not charts:
        return Section("links", "Links", missing=("What was heard, and when, was not kept.",))
    dropped = [f"{v.dropped} by vehicle {v.vehicle_id}" for v in vehicles if v.dropped]
    refused = f"Messages refused as malformed or late: {', '.join(dropped)}." if dropped else "No message was refused."
    lead = f"What came from the own autopilot, and from the others by its sender's colour. {refused}"
    return Section("links", "Links", lead, charts, (tables.link_table(flight.evidence),))


def _reynolds(flight: Flight) -> Section:
    if len(flight.sheet.record.vehicles) < 2:
        return Section("reynolds", "Reynolds' rules", missing=("A vehicle alone is no flock.",))
    sheet, figures = flight.sheet, flight.flocking
    draws = (
        ("nearest", panels_metrics.draw_nearest, "Distance of every vehicle to the nearest other over time."),
        ("mismatch", panels_metrics.draw_mismatch, "Velocity of every vehicle relative to the team's mean over time."),
        ("order", panels_metrics.draw_order, "Order parameter of the directions of flight over time."),
        ("cohesion", panels_metrics.draw_cohesion, "Distance of every vehicle to the team's centroid over time."),
    )
    lead = (
        "Separation, alignment and cohesion as flown. In formation all fly the same way; on the ring the directions "
        "cancel out, and alignment gives way to the even spacing."
    )
    charts = tuple(chart(name, partial(draw, sheet=sheet, flocking=figures), alt) for name, draw, alt in draws)
    table = tables.reynolds_table(flight.result)
    return Section("reynolds", "Reynolds' rules", lead, charts, (table,))


def _lyapunov(flight: Flight) -> Section:
    gain = flight.asked.spacing_gain_per_s
    stretches = decays(flight.sheet.record.time_s, flight.sheet.motion, gain)
    if not stretches:
        missing = ("There were never two vehicles on the ring: V is not defined.",)
        return Section("lyapunov", "Lyapunov function", missing=missing)
    draws = (
        (
            "lyapunov",
            panels_metrics.draw_lyapunov,
            "V over time, and the promised decay from every change of the ring.",
        ),
        ("decays", panels_metrics.draw_decays, "V after every change of the ring, beside the promised decay."),
    )
    charts = tuple(
        chart(name, partial(draw, sheet=flight.sheet, stretches=stretches), alt) for name, draw, alt in draws
    )
    promise = "" if gain is None else f" With γ = {gain:g} /s, V is promised to decay as exp(−2γt) (dashed)."
    if gain is not None and any(not isclose(each.decay_per_s or 0.0, 2.0 * gain) for each in stretches):
        promise += " On a ring of many the gain is bounded, and the promise is slower."
    lead = (
        "V = ½ Σ eᵢ² over the spacing errors eᵢ on the ring, equations (17) to (20) of the paper. V starts anew "
        f"whenever a vehicle joins or leaves.{promise}"
    )
    return Section(
        "lyapunov",
        "Lyapunov function",
        lead,
        charts,
        (tables.decay_table(stretches),),
        keyed=False,
    )


def _power(flight: Flight) -> Section:
    evidence, sheet = flight.evidence, flight.sheet
    charts = []
    if any(v.altitude_m.size and v.own.time_s.size for v in evidence.vehicles):
        draw = partial(panels_inside.draw_altitudes, sheet=sheet, evidence=evidence)
        charts.append(chart("heights", draw, "Height of every vehicle over time."))
    if any(v.battery.size for v in evidence.vehicles):
        draw = partial(panels_inside.draw_batteries, sheet=sheet, evidence=evidence)
        charts.append(chart("batteries", draw, "Battery of every vehicle over time."))
    if any(np.nan_to_num(v.loop.yaw_rad).any() for v in evidence.vehicles):
        draw = partial(panels_inside.draw_yaws, sheet=sheet, evidence=evidence)
        charts.append(chart("yaws", draw, "Yaw of every vehicle's setpoints over time."))
    missing = () if charts else ("Neither heights nor batteries were kept.",)
    return Section("power", "Height, yaw and battery", charts=tuple(charts), missing=missing)


def _metrics(flight: Flight) -> Section:
    both = (tables.vehicle_table(flight.result), tables.ring_table(flight.result))
    return Section("metrics", "Metrics", tables=both)
