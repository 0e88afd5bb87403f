"""What sensors do to exact frames: noise that neighbors share, steps of disparity, edges that wander, the projector's shadow, holes; and
colors under other lights, blurred and a pixel off.

More and worse than `tasks.scanner.sensor`: a network that knows one sensor alone sees with no other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FOCAL_BASELINE = (575 * 0.075, 575 * 0.0375)
"""Focal length times baseline of structured-light sensors at full and at half resolution [px m]."""

_SHADOW_FOCAL = 280.0
_NEAREST_M, _FARTHEST_M = 0.3, 5.0


def measured_depth(depth: NDArray[np.float32], facing: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Exact depth [m], shape (h, w), as a sensor by chance has it; 0 where it sees nothing. facing: See `TrainingFrame`."""
    from scipy.ndimage import gaussian_filter

    shape = depth.shape
    if rng.random() < 0.8:  # edges wander by a pixel
        rows, columns = np.indices(shape)
        by = np.rint(rng.normal(0, 0.45, (2, *shape))).astype(np.int64)
        depth = depth[np.clip(rows + by[0], 0, shape[0] - 1), np.clip(columns + by[1], 0, shape[1] - 1)]
    lost = _lost(depth, facing, rng)
    shared = gaussian_filter(rng.normal(size=shape), float(rng.choice([0.5, 0.8, 1.2])))
    error = shared / shared.std()
    if rng.random() < 0.5:
        error += 0.5 * _slow(shape, rng)
    spread = float(rng.choice([0.7, 1.0, 1.0, 1.5, 2.2]))
    growth = float(rng.uniform(0.0008, 0.0025))
    noisy = depth + spread * (0.0012 + growth * np.maximum(depth - 0.4, 0) ** 2) * error
    if rng.random() < 0.5:  # disparities are eighths of a pixel
        scale = 8 * float(rng.choice(FOCAL_BASELINE))
        noisy = scale / np.round(scale / np.maximum(noisy, 0.2))
    return np.where(lost | (depth < _NEAREST_M) | (depth > _FARTHEST_M), 0, noisy).astype(np.float32)


def seen_color(color: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Colors RGB, shape (h, w, 3), as a camera by chance has them."""
    from scipy.ndimage import gaussian_filter

    shape = color.shape[:2]
    seen = color * (rng.uniform(0.6, 1.3) * rng.uniform(0.85, 1.15, 3)).astype(np.float32)
    if rng.random() < 0.4:
        seen = seen * np.exp(0.25 * gaussian_filter(_slow(shape, rng), 4.0)).astype(np.float32)[..., None]
    if rng.random() < 0.6:
        blur = float(rng.uniform(0.3, 1.0))
        seen = gaussian_filter(seen, (blur, blur, 0))
    if rng.random() < 0.35:
        seen = np.roll(seen, tuple(int(value) for value in rng.integers(-2, 3, 2)), (0, 1))
    grain = rng.normal(0, rng.uniform(1, 9), shape)[..., None] + rng.normal(0, 2, color.shape)
    return np.clip(seen + grain, 0, 255).astype(np.uint8)


def _lost(depth: NDArray[np.float32], facing: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Pixels without depth: at edges, in the projector's shadow, under flat angles, in blots and anywhere."""
    from scipy.ndimage import maximum_filter, minimum_filter

    far = np.where(depth > 0, depth, 1e3)
    jump = maximum_filter(far, 3) - minimum_filter(far, 3) > 0.04 * np.maximum(depth, 0.5)
    lost = jump & (rng.random(depth.shape) < rng.uniform(0, 0.7))
    lost |= rng.random(depth.shape) < rng.choice([0.002, 0.01, 0.03])
    lost |= facing < rng.uniform(0.06, 0.2)
    if rng.random() < 0.6:
        side, baseline = int(rng.choice([-1, 1])), float(rng.uniform(0.03, 0.09))
        disparity = _SHADOW_FOCAL * baseline / np.maximum(depth, _NEAREST_M)
        for away in range(1, int(rng.integers(2, 9))):
            nearer = np.roll(depth, side * away, axis=1)
            lost |= (nearer > 0) & (nearer < depth) & (_SHADOW_FOCAL * baseline / np.maximum(nearer, _NEAREST_M) - disparity > away)
    if rng.random() < 0.5:
        lost |= _slow(depth.shape, rng) > rng.uniform(2.0, 3.5)
    return np.asarray(lost)


def _slow(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """What changes over some ten pixels, of mean 0 and deviation about 1, shape (h, w)."""
    from scipy.ndimage import gaussian_filter

    coarse = gaussian_filter(rng.normal(size=(-(-shape[0] // 8), -(-shape[1] // 8))), 1.5)
    return np.kron(coarse / coarse.std(), np.ones((8, 8)))[: shape[0], : shape[1]]
