"""The constant part of the operator's page: the mission and its plan."""

from gcs.mission.mission import Mission, MissionVehicle
from gcs.station.picture import FlightSource, MissionPicture, OperatorRights, Pair, PlannedVehicle
from gcs.style import COLOURS


def mission_picture(
    mission: Mission, source: FlightSource, duration_s: float, operator: OperatorRights | None = None
) -> MissionPicture:
    """Return a mission as the page shows it, flown for `duration_s`; without an operator the page is read-only."""
    frame, ring, safety = mission.frame, mission.encirclement, mission.safety
    return MissionPicture(
        mission=mission.mission.name,
        source=source,
        duration_s=duration_s,
        rate_hz=mission.mission.rate_hz,
        origin_deg=origin_deg(mission),
        x_bearing_deg=frame.x_bearing_deg,
        ring_radius_m=ring.radius_m,
        ring_rate_rad_s=ring.angular_rate_rad_s,
        separation_m=safety.separation_m,
        keep_out_m=safety.keep_out_m,
        altitude_min_m=safety.altitude_min_m,
        altitude_max_m=safety.altitude_max_m,
        vehicles=tuple(_planned(mission, row, vehicle) for row, vehicle in enumerate(mission.vehicles)),
        operator=operator or OperatorRights(),
    )


def origin_deg(mission: Mission) -> Pair | None:
    """Return latitude and longitude of a mission's origin; None in a local frame."""
    origin = mission.mission_frame().origin
    return None if origin is None else (origin.latitude_deg, origin.longitude_deg)


def _planned(mission: Mission, row: int, vehicle: MissionVehicle) -> PlannedVehicle:
    section = vehicle.section
    return PlannedVehicle(
        vehicle.id,
        COLOURS[row % len(COLOURS)],
        (*section.start_m, 0.0),
        section.altitude_m,
        tuple(section.limits(mission.safety).fence_m or ()),
    )
