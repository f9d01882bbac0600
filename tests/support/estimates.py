"""Estimates with given spreads, for tests of what uses them."""

from estimation.state import AxisSpread, PlanarSpread


def own_spread(sigma_m: float = 0.0, sigma_y_m: float | None = None) -> tuple[AxisSpread, AxisSpread]:
    """Return the spread of an own estimate that is uncertain in its position alone."""
    x, y = sigma_m, sigma_m if sigma_y_m is None else sigma_y_m
    return (x**2, 0.0, 0.0, 0.0, 0.0, 0.0), (y**2, 0.0, 0.0, 0.0, 0.0, 0.0)


def target_spread(sigma_m: float = 0.0) -> PlanarSpread:
    """Return the spread of an estimate of a target that is uncertain in its position alone."""
    return sigma_m**2, 0.0, 0.0, 0.0, sigma_m**2, 0.0, 0.0, 0.0, 0.0, 0.0
