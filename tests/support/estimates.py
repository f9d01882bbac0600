"""Estimates with given covariances, for tests."""

from estimation.state import AxisSpread, PlanarSpread


def own_spread(sigma_m: float = 0.0, sigma_y_m: float | None = None) -> tuple[AxisSpread, AxisSpread]:
    """Return the covariance of an own estimate that is uncertain in position only."""
    x, y = sigma_m, sigma_m if sigma_y_m is None else sigma_y_m
    return (x**2, 0.0, 0.0, 0.0, 0.0, 0.0), (y**2, 0.0, 0.0, 0.0, 0.0, 0.0)


def target_spread(sigma_m: float = 0.0) -> PlanarSpread:
    """Return the covariance of a target estimate that is uncertain in position only."""
    return sigma_m**2, 0.0, 0.0, 0.0, sigma_m**2, 0.0, 0.0, 0.0, 0.0, 0.0
