"""Pictures for tests of the operator's page: a team on its ring about a target that moves."""

import math

from msgspec.structs import replace

from agents.ring.commanded_ring import RingBounds
from agents.team.messages import AutopilotReport, RingValues
from agents.team.verbs import VERBS, Verb
from gcs.console.vehicle_view import VehicleView
from gcs.station.picture import (
    EventPicture,
    FlightPicture,
    MissionPicture,
    OperatorRights,
    PlannedVehicle,
    RingPicture,
    TargetPicture,
    TeamPicture,
)
from gcs.style import COLOURS

FENCE_M = ((-20.0, -35.0), (75.0, -35.0), (75.0, 35.0), (-20.0, 35.0))
RING_BOUNDS = RingBounds(2.3, 40.0, 2.0, 0.5, 2.0, 30.0, 1.0)
RADIUS_MIN_M, SPACING_M, SPEED_M_S = 10.0, 6.0, 0.5


def ring_mission(vehicles: int = 3, may: tuple[Verb, ...] = tuple(VERBS)) -> MissionPicture:
    """Return a mission of this many vehicles, whose ring has room for all, and an operator who may command."""
    radius_m = max(RADIUS_MIN_M, SPACING_M * vehicles / (2.0 * math.pi))
    return MissionPicture(
        mission="case2",
        source="sitl",
        duration_s=600.0,
        rate_hz=10.0,
        origin_deg=(47.397742, 8.545594),
        x_bearing_deg=90.0,
        ring=RingValues(radius_m, SPEED_M_S / radius_m, 8.0, 0.0),
        ring_bounds=RING_BOUNDS,
        separation_m=3.0,
        keep_out_m=4.0,
        altitude_min_m=2.0,
        altitude_max_m=30.0,
        vehicles=tuple(
            PlannedVehicle(number, COLOURS[(number - 1) % len(COLOURS)], (0.0, 4.0 - 4.0 * index, 0.0), 8.0, FENCE_M)
            for index, number in enumerate(range(1, vehicles + 1))
        ),
        operator=OperatorRights("anna", may),
    )


def ring_team(mission: MissionPicture, time_s: float) -> TeamPicture:
    """Return the team on its ring at a time, evenly spaced."""
    vehicles = len(mission.vehicles)
    ring = (mission.ring.radius_m or 0.0, mission.ring.angular_rate_rad_s or 0.0)
    target_m = (35.0 + 0.1 * time_s, -5.0)
    return TeamPicture(
        time_s=time_s,
        wall_s=1.7e9 + time_s,
        vehicles=tuple(_on_ring(index, vehicles, target_m, time_s, *ring) for index in range(vehicles)),
        target=TargetPicture(target_m, (0.1, 0.0), (0.4, 0.15, 0.2), 0.1),
        ring_members=vehicles,
    )


def _on_ring(
    index: int, vehicles: int, target_m: tuple[float, float], time_s: float, radius_m: float, rate_rad_s: float
) -> VehicleView:
    angle = 2.0 * math.pi * index / vehicles + rate_rad_s * time_s
    ahead = angle + 0.06
    chord_m = 2.0 * radius_m * math.sin(math.pi / max(vehicles, 2))
    position_m = (target_m[0] + radius_m * math.cos(angle), target_m[1] + radius_m * math.sin(angle), 8.0 + 0.2 * index)
    return VehicleView(
        vehicle_id=index + 1,
        age_s=0.1,
        is_stale=False,
        tactic="encircle",
        mode="offboard",
        position_m=position_m,
        yaw_rad=angle + math.pi,
        velocity_m_s=(-SPEED_M_S * math.sin(angle) + 0.1, SPEED_M_S * math.cos(angle)),
        aim_m=(target_m[0] + radius_m * math.cos(ahead), target_m[1] + radius_m * math.sin(ahead)),
        autopilot=AutopilotReport(0.82 - 0.03 * (index % 8) - 0.0003 * time_s, 840.0 - time_s, 3, 14 + index % 3),
        estimator="good",
        link_age_s=0.1,
        nearest_id=(index + 1) % vehicles + 1,
        nearest_m=chord_m,
        fence_margin_m=20.0 + index,
        radius_m=radius_m + 0.1 * math.sin(time_s + index),
        angular_rate_rad_s=rate_rad_s,
        lead_rad=2.0 * math.pi / vehicles,
    )


BOAT_M, BUOY_M = (35.0, -5.0), (75.0, 10.0)
RINGS = (
    RingPicture("north", 0, 2, COLOURS[-1], RingValues(10.0, 0.05, 8.0, 0.0), RING_BOUNDS),
    RingPicture("south", 1, 2, COLOURS[-2], RingValues(14.0, 0.06, 7.0, 0.0), RING_BOUNDS),
    RingPicture(
        "high", 1, 2, COLOURS[-3], RingValues(8.0, -0.1, 12.0, 0.0), RingBounds(1.5, 20.0, 2.4, 0.5, 2.0, 30.0, 1.0)
    ),
)
"""The rings of a mission of two targets, "boat" and "buoy"."""


def rings_mission() -> MissionPicture:
    """Return a mission of these rings and three vehicles."""
    return replace(ring_mission(), targets=("boat", "buoy"), rings=RINGS)


def rings_team(_time_s: float = 0.0) -> TeamPicture:
    """Return vehicles 1 and 2 on the rings of boat and buoy, whose radius was commanded to be 12 m, 3 on none."""
    team = ring_team(ring_mission(), 0.0)
    rings = ("north", "south", "")
    vehicles = tuple(
        replace(each, ring=ring, tactic="encircle" if ring else "formation", radius_m=10.5 if ring else None)
        for each, ring in zip(team.vehicles, rings, strict=True)
    )
    still, covariance = (0.0, 0.0), (0.4, 0.15, 0.2)
    targets = tuple(TargetPicture(place_m, still, covariance, 0.1) for place_m in (BOAT_M, BUOY_M))
    commanded = (None, RingValues(12.0), None)
    return replace(team, vehicles=vehicles, target=None, targets=targets, rings=commanded)


def changed(team: TeamPicture, vehicle_id: int, **fields: object) -> TeamPicture:
    """Return a team's picture with fields of one vehicle replaced."""
    vehicles = (replace(each, **fields) if each.vehicle_id == vehicle_id else each for each in team.vehicles)
    return replace(team, vehicles=tuple(vehicles))


def ring_flight(duration_s: float = 60.0) -> FlightPicture:
    """Return a recorded flight at 5 Hz with an event after 10 s and an alarm of vehicle 2 after 30 s."""
    mission = replace(ring_mission(may=()), source="log", duration_s=duration_s, operator=OperatorRights())
    teams = [ring_team(mission, number / 5.0) for number in range(int(5.0 * duration_s) + 1)]
    alarm = {"alert": "link lost", "advice": "Wait: it returns and lands by itself.", "severity": "alarm"}
    teams = [
        changed(team, 2, is_stale=True, age_s=2.0, **alarm) if (team.time_s or 0.0) >= 30.0 else team for team in teams
    ]
    events = (
        EventPicture(1, 0.0, 1.7e9, "information", "the mission begins"),
        EventPicture(2, 10.0, 1.7e9 + 10.0, "warning", "decides to encircle", 1),
        EventPicture(3, 30.0, 1.7e9 + 30.0, "alarm", "link lost", 2),
    )
    return FlightPicture(mission, tuple(teams), events)
