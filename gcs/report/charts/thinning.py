"""Thinning of lines to the points that a figure of some hundred pixels shows, to keep pages small."""

import numpy as np

from estimation.state import Vector


def thinned(time_s: Vector, values: Vector, points_max: int) -> tuple[Vector, Vector]:
    """Return at most `points_max` points of a line (at least 8): its ends, and the extremes of every block.

    Every peak is kept. A block with a NaN keeps one, so that the line is interrupted there.
    """
    kept = _kept(values[:, None], points_max) if values.size > points_max else slice(None)
    return time_s[kept], values[kept]


def thinned_path(position_m: Vector, points_max: int) -> Vector:
    """Return at most `points_max` points (at least 8) of a path (T, 2): its ends, and the extremes in x and in y."""
    return position_m[_kept(position_m, points_max)] if len(position_m) > points_max else position_m


def _kept(columns: Vector, points_max: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the indices of the samples (T, C) to keep, in order: per block, two per column and one for a NaN."""
    samples, width = columns.shape
    count = max(1, (points_max - 2) // (2 * width + 1))
    length = -(-samples // count)
    padded = np.full((count * length, width), np.nan)
    padded[:samples] = columns
    blocks = padded.reshape(count, length, width)
    missing = np.isnan(blocks)
    lowest = np.where(missing, np.inf, blocks).argmin(axis=1)
    highest = np.where(missing, -np.inf, blocks).argmax(axis=1)
    gap = missing.any(axis=2).argmax(axis=1)[:, None]
    within = np.concatenate((lowest, highest, gap), axis=1)
    # Without a NaN the last column is 0, the first sample of the block: one point more, on the line.
    index = np.unique(within + length * np.arange(count)[:, None])
    return np.unique(np.concatenate(([0], index[index < samples], [samples - 1])))
