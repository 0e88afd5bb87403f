"""Steps in time as vectors, and the last steps of each step of a walk."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def sinusoids(times: ArrayLike, width: int) -> NDArray[np.float32]:
    """Numbers of steps (...) as sines and cosines in turn, shape (..., width): of 10000^(-2 j / width) times the number."""
    phases = np.asarray(times, dtype=np.float64)[..., None] * 10_000.0 ** (-np.arange(0, width, 2) / width)
    return np.stack([np.sin(phases), np.cos(phases)], axis=-1).reshape(*phases.shape[:-1], width).astype(np.float32)


def sliding(count: int, window: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each of so many steps the last ones up to it, oldest first, shape (count, window), and how many these are, (count,).

    Rows are filled up with the step itself.
    """
    steps = np.arange(count)
    sizes = np.minimum(steps + 1, window)
    places = np.arange(window)
    return np.minimum((steps + 1 - sizes)[:, None] + places, steps[:, None]), sizes
