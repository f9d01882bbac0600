"""A mission of two rings about two targets, and flights over them whose every motion is known in closed form."""

from dataclasses import replace
from math import pi, tau

import numpy as np

from estimation.state import Vector
from gcs.metrics.record import FlightRecord, LoopStatistics, TargetPath, VehicleTrack
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission, MissionRing

ENGAGES_S, MOVES_S, DURATION_S = 100.0, 300.0, 600.0
TIME_S = np.arange(round(10.0 * DURATION_S) + 1) / 10.0
RADII_M, RATES_RAD_S = (10.0, 12.0), (0.05, -0.06)
STARTS_M, VELOCITIES_M_S = ((35.0, -5.0), (-20.0, 60.0)), ((0.1, -0.03), (0.0, 0.05))
SPACING_M, FORMATION_M_S = 5.0, 0.2


def two_rings(places: tuple[int, int] = (3, 3)) -> Mission:
    """Case 2 with five vehicles and two targets, with one ring about each: "east" and "north"."""
    case2 = load_mission("case2")
    first = case2.vehicles[0]
    vehicles = tuple(
        replace(first, section=first.section.model_copy(update={"id": number, "start_m": _slot_m(number)}))
        for number in range(1, 6)
    )
    targets = tuple(
        case2.target.model_copy(update={"name": name, "start_m": start_m, "velocity_m_s": velocity_m_s})
        for name, start_m, velocity_m_s in zip(("car", "boat"), STARTS_M, VELOCITIES_M_S, strict=True)
    )
    settings = [
        case2.encirclement.model_copy(update={"radius_m": radius_m, "angular_rate_rad_s": rate_rad_s})
        for radius_m, rate_rad_s in zip(RADII_M, RATES_RAD_S, strict=True)
    ]
    named = zip(("east", "north"), (0, 1), places, settings, strict=True)
    return replace(
        case2,
        vehicles=vehicles,
        target=targets[0],
        targets=targets,
        encirclement=settings[0],
        rings=tuple(MissionRing(*each) for each in named),
    )


def _slot_m(number: int) -> tuple[float, float]:
    return 0.0, SPACING_M * (3 - number)


def target_path(number: int) -> TargetPath:
    """Return the motion of a target."""
    velocity_m_s = np.tile(VELOCITIES_M_S[number], (TIME_S.size, 1))
    return TargetPath(np.array(STARTS_M[number]) + TIME_S[:, None] * velocity_m_s, velocity_m_s)


def ramp(begin_s: float, end_s: float) -> Vector:
    """Return (T,) what rises from 0 at a time to 1 at another."""
    return np.clip((TIME_S - begin_s) / (end_s - begin_s), 0.0, 1.0)


def on_ring(
    vehicle_id: int,
    ring: Vector | int,
    phase_rad: Vector | float,
    radius_m: Vector | float,
    engages_s: float = ENGAGES_S,
) -> VehicleTrack:
    """Return a vehicle in its slot that is on the circle of its ring at `engages_s`, about that ring's target.

    The bearing is the phase and what its ring has turned since the start. Radius and phase may vary slowly with time:
    the velocities leave out their rates.
    """
    rings = np.broadcast_to(ring, TIME_S.shape).astype(np.intp)
    targets = target_path(0), target_path(1)
    centre_m = np.where(rings[:, None] == 0, targets[0].position_m, targets[1].position_m)
    centre_m_s = np.where(rings[:, None] == 0, targets[0].velocity_m_s, targets[1].velocity_m_s)
    rate_rad_s = np.array(RATES_RAD_S)[rings]
    angle_rad = phase_rad + rate_rad_s * TIME_S
    outward = np.column_stack((np.cos(angle_rad), np.sin(angle_rad)))
    forward = np.column_stack((-np.sin(angle_rad), np.cos(angle_rad)))
    radii_m = np.broadcast_to(radius_m, TIME_S.shape)
    engaged = (engages_s - 1e-9 <= TIME_S)[:, None]
    slot_m = _slot_m(vehicle_id) + TIME_S[:, None] * (FORMATION_M_S, 0.0)
    return VehicleTrack(
        vehicle_id,
        np.where(engaged, centre_m + radii_m[:, None] * outward, slot_m),
        np.where(engaged, centre_m_s + (rate_rad_s * radii_m)[:, None] * forward, (FORMATION_M_S, 0.0)),
        np.where(engaged[:, 0], "encircle", "formation"),
        ring=rings,
    )


def flown(*tracks: VehicleTrack) -> FlightRecord:
    """Return the record of a simulated flight of these vehicles."""
    targets = target_path(0), target_path(1)
    return FlightRecord(
        "case2",
        7,
        "simulation",
        "truth",
        TIME_S,
        targets[0].position_m,
        targets[0].velocity_m_s,
        tracks,
        LoopStatistics(10.0, 5 * TIME_S.size, 0),
        6.0,
        targets=targets,
        ring_targets=(0, 1),
    )


def five_vehicles(errors_m: tuple[float, ...] = (0.02, 0.04, 0.06, 0.08, 0.1)) -> FlightRecord:
    """Return three vehicles on the first ring, two on the second, each with a constant error of its radius."""
    places = ((0, 0.0), (0, tau / 3.0), (0, 2.0 * tau / 3.0), (1, 0.0), (1, pi))
    tracks = [
        on_ring(number, ring, phase_rad, RADII_M[ring] + error_m)
        for number, ((ring, phase_rad), error_m) in enumerate(zip(places, errors_m, strict=True), start=1)
    ]
    return flown(*tracks)


CLOSES_S, COMES_S, FROM_M = 20.0, 60.0, 30.0


def one_changes() -> FlightRecord:
    """Return the same without errors, in which vehicle 3 leaves the first ring for the second at `MOVES_S`.

    The two that it leaves take the gaps of two vehicles within `CLOSES_S`, the two to whom it comes those of three. It
    comes from `FROM_M` outside of the second ring, at a constant speed within `COMES_S`, at its bearing on that ring.
    """
    closes = ramp(MOVES_S, MOVES_S + CLOSES_S)
    moved = TIME_S >= MOVES_S - 1e-9
    outside_m = np.where(moved, FROM_M * (1.0 - ramp(MOVES_S, MOVES_S + COMES_S)), 0.0)
    return flown(
        on_ring(1, 0, -tau / 12.0 * closes, RADII_M[0]),
        on_ring(2, 0, tau / 3.0 + tau / 12.0 * closes, RADII_M[0]),
        on_ring(
            3,
            np.where(moved, 1, 0),
            2.0 * tau / 3.0,
            np.where(moved, RADII_M[1] + outside_m, RADII_M[0]),
        ),
        on_ring(4, 1, 0.0, RADII_M[1]),
        on_ring(5, 1, pi - (pi - tau / 3.0) * closes, RADII_M[1]),
    )
