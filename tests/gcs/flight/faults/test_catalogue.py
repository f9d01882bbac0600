"""Where an estimate jumps: along the line that passes the other vehicles the farthest away. Whom faults affect."""

from math import cos, pi, radians, sin

import pytest

from estimation.frames import Triple
from gcs.flight.faults.catalogue import clearest_line, vehicle_injections
from gcs.flight.faults.team_faults import TeamInFlight
from gcs.mission.file import load_mission
from sitl.faults import VehicleFaults, VehicleInjection

OFF_MAX = sin(radians(2.5))
"""Half a step between two lines."""


def on_ring(bearing_deg: float) -> Triple:
    return 10.0 * cos(radians(bearing_deg)), 10.0 * sin(radians(bearing_deg)), 5.0


@pytest.mark.parametrize(
    ("place_m", "others_m", "line_rad"),
    [
        ((0.0, -4.0, 5.0), [(0.0, 0.0, 5.0), (0.0, 4.0, 5.0)], 0.0),
        ((3.0, 1.0, 5.0), [(0.0, -2.0, 5.0)], 0.75 * pi),
        (on_ring(70.0), [on_ring(190.0), on_ring(310.0)], radians(70.0) + pi / 2.0),
    ],
    ids=["a line is left across", "away from one", "an even ring is left along its tangent"],
)
def test_the_line_that_passes_the_others_the_farthest_away(
    place_m: Triple, others_m: list[Triple], line_rad: float
) -> None:
    x, y = clearest_line(place_m, others_m)
    assert abs(x * sin(line_rad) - y * cos(line_rad)) <= OFF_MAX
    assert x * x + y * y == pytest.approx(1.0)


def test_the_faults_of_a_vehicle_alone_are_those_without_flying_process_bus_and_team() -> None:
    mission = load_mission("case2")
    places_m = {1: (0.0, 4.0, 6.0), 2: (0.0, 0.0, 6.0), 3: (0.0, -4.0, 6.0)}
    found = vehicle_injections(TeamInFlight(mission, 1, (1, 2, 3), places_m))
    assert {"link-cut", "GPS-jump", "not-following", "foreign-mode", "battery-low", "no-way-home"} <= found.keys()
    assert not {"latency", "liar", "flood", "target-lost", "killed-agent", "stranger"} & found.keys()
    assert found["link-cut"] == VehicleInjection(VehicleFaults(link_cut=True))
    alone = vehicle_injections(TeamInFlight(mission, 1, (1,), {1: (0.0, 4.0, 6.0)}))
    assert alone.keys() == found.keys()
