"""Autocorrelated errors: whitening for a fit, and their effect on its confidence."""

from collections.abc import Sequence

import numpy as np

from estimation.state import Vector

ORDER_MAX = 4


def whitening_filter(errors: Sequence[Vector]) -> Vector:
    """Return the filter (p + 1,) that whitens blocks of errors to variance 1.

    It is the inverse of an autoregressive model; its order p is chosen by Schwarz' criterion.
    """
    best, best_score = np.array([1.0]), np.inf
    scale = float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) or 1.0
    count = sum(each.size - ORDER_MAX for each in errors)
    for order in range(1, ORDER_MAX + 1):
        past = np.concatenate(
            [
                np.column_stack([each[ORDER_MAX - lag : each.size - lag] for lag in range(1, order + 1)])
                for each in errors
            ]
        )
        present = np.concatenate([each[ORDER_MAX:] for each in errors])
        weights, *_ = np.linalg.lstsq(past, present, rcond=None)
        variance = max(float(np.mean((present - past @ weights) ** 2)), (1e-9 * scale) ** 2, 1e-24)
        score = count * np.log(variance) + order * np.log(count)
        if score < best_score:
            best, best_score = np.append(1.0, -weights) / np.sqrt(variance), score
    return np.asarray(best, dtype=np.float64)


def whitened(whitening: Vector, values: Vector) -> Vector:
    """Return filtered values (T,) or (T, k), without the first p, which would need earlier values."""
    if values.ndim == 1:
        return np.convolve(values, whitening, mode="valid")
    return np.column_stack([np.convolve(column, whitening, mode="valid") for column in values.T])


def jackknifed(jacobians: Sequence[Vector], errors: Sequence[Vector]) -> tuple[Vector, int]:
    """Return the covariance (k, k) of a fit by a jackknife over blocks, and the number of blocks.

    The arguments are Jacobians (T, k) and errors (T,) of blocks of time. Errors may be correlated in any way within a
    block; blocks with large influence are weighted accordingly (MacKinnon and Webb 2023, CV3).
    """
    information = np.sum([each.T @ each for each in jacobians], axis=0)
    moves = [
        np.linalg.pinv(information - each.T @ each, hermitian=True) @ (each.T @ error)
        for each, error in zip(jacobians, errors, strict=True)
    ]
    count = len(moves)
    return (count - 1) / count * np.sum([np.outer(move, move) for move in moves], axis=0), count


def autocorrelation(errors: Sequence[Vector], lags: int) -> Vector:
    """Return the autocorrelation of errors at lags 1 to `lags`, (lags,)."""
    energy = sum(float(each @ each) for each in errors) or 1.0
    return np.array([sum(float(each[lag:] @ each[:-lag]) for each in errors) / energy for lag in range(1, lags + 1)])


def whiteness(errors: Sequence[Vector], lags: int = 20) -> tuple[float, float]:
    """Return the share of the first autocorrelations within the 95 % bounds of white noise, and the bounds."""
    count = sum(each.size for each in errors)
    bound = 1.96 / np.sqrt(max(count, 1))
    return float(np.mean(np.abs(autocorrelation(errors, lags)) <= bound)), float(bound)
