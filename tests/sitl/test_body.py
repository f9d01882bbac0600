"""The true motion: limits, wind and a wandering estimate against what they come to in the end."""

import numpy as np
import pytest

from estimation.plant.model import Plant, PlantAxis
from estimation.state import Vector
from sitl.vehicle.body import VehicleBody
from sitl.vehicle.imperfections import IDEAL, Imperfections
from sitl.vehicle.shaping import ShapeLimits

PLANT = Plant(PlantAxis(0.8, 0.9), PlantAxis(0.5, 1.2), 0.1)


def flown(
    imperfections: Imperfections, setpoint_m: tuple[float, float], *, off_m: tuple[float, float] = (0.0, 0.0)
) -> Vector:
    """Return the motions (T, 4) over 40 s at 10 Hz, from rest at (1, 2)."""
    body = VehicleBody(PLANT, (1.0, 2.0), 8.0, (0.0, 0.0), imperfections, np.random.default_rng(0))
    body.command(0.0, setpoint_m)
    motions = []
    for tick in range(400):
        body.advance(tick * 0.1, (tick + 1) * 0.1, off_m)
        motions.append(body.motion)
    return np.array(motions)


def test_wide_limits_leave_the_motion_as_it_is() -> None:
    wide = flown(Imperfections(ShapeLimits(50.0, 50.0, 1e6)), (4.0, -1.0))
    np.testing.assert_allclose(wide, flown(IDEAL, (4.0, -1.0)), atol=1e-9)


def test_limits_hold_in_speed_acceleration_and_in_the_end() -> None:
    motions = flown(Imperfections(ShapeLimits(2.0, 1.0, 5.0)), (21.0, 2.0))
    assert 1.8 < np.abs(motions[:, 2]).max() <= 2.0
    assert np.abs(np.diff(motions[:, 2])).max() / 0.1 <= 1.0 + 1e-6
    assert motions[-1] == pytest.approx([21.0, 2.0, 0.0, 0.0], abs=0.05)


def test_a_steady_wind_moves_the_vehicle_by_drag_over_stiffness() -> None:
    last = flown(Imperfections(wind_m_s=(8.0, -4.0), drag_per_s=0.05), (1.0, 2.0))[-1]
    assert last == pytest.approx([1.0 + 0.4 / 0.8, 2.0 - 0.2 / 0.5, 0.0, 0.0], abs=1e-3)


def test_a_vehicle_steers_its_estimate_to_the_setpoint_not_itself() -> None:
    last = flown(IDEAL, (4.0, -1.0), off_m=(0.3, -0.2))[-1]
    assert last[:2] == pytest.approx([4.0 - 0.3, -1.0 + 0.2], abs=1e-3)


def test_still_air_damps_as_much_as_the_drag() -> None:
    dragged = flown(Imperfections(wind_m_s=(1e-9, 0.0), drag_per_s=0.3), (4.0, -1.0))
    damped = Plant(PlantAxis(0.8, 0.9 + 0.3), PlantAxis(0.5, 1.2 + 0.3), 0.1)
    body = VehicleBody(damped, (1.0, 2.0), 8.0, (0.0, 0.0), IDEAL, np.random.default_rng(0))
    body.command(0.0, (4.0, -1.0))
    for tick in range(20):
        body.advance(tick * 0.1, (tick + 1) * 0.1, (0.0, 0.0))
    assert dragged[19] == pytest.approx(body.motion, abs=0.03)
