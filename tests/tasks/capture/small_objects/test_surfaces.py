"""Passes over pixels are, to the bit, what whole arrays give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tasks.capture.small_objects import surfaces

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]


def pair(axis: int, reach: int = 1) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of an image that give pixels and their neighbors `reach` further along an axis."""
    near, far, full = slice(None, -reach), slice(reach, None), slice(None)
    return ((near, full), (far, full)) if axis == 0 else ((full, near), (full, far))


def plain_steps(points: Array, valid: Bools, pixel: Array, gap: float, gap_pixels: float) -> list[Bools]:
    steps = []
    for here, there in map(pair, (0, 1)):
        distance = np.linalg.norm(points[here] - points[there], axis=-1)
        steps.append(valid[here] & valid[there] & (distance <= np.maximum(gap, gap_pixels * pixel[here])))
    return steps


def plain_smoothed(points: Array, steps: tuple[Bools, Bools]) -> Array:
    total, weight = points.copy(), np.ones(points.shape[:2])
    for axis, step in enumerate(steps):
        here, there = pair(axis)
        total[here] += np.where(step[..., None], points[there], 0)
        total[there] += np.where(step[..., None], points[here], 0)
        weight[here] += step
        weight[there] += step
    return np.asarray(total / weight[..., None])


def plain_normals(points: Array, toward: Array, stands: Bools, steps: tuple[Bools, Bools]) -> tuple[Array, Bools]:
    tangents, sure = [], stands.copy()
    for axis, step in enumerate(steps):
        (here, there), (low, high) = pair(axis, 2), pair(axis)
        tangent, both = np.zeros_like(points), np.zeros(stands.shape, dtype=bool)
        middle = (slice(1, -1), slice(None)) if axis == 0 else (slice(None), slice(1, -1))
        tangent[middle] = points[there] - points[here]
        both[middle] = step[low] & step[high]
        sure &= both
        tangents.append(tangent)
    normal = np.cross(tangents[0], tangents[1])
    length = np.linalg.norm(normal, axis=-1)
    normal /= np.maximum(length, 1e-12)[..., None]
    normal *= np.where((normal * toward).sum(axis=-1) < 0, -1.0, 1.0)[..., None]
    return normal, sure & (length > 0)


def plain_hollows(points: Array, toward: Array, stands: Bools, steps: tuple[Bools, Bools], reach: int, crease: float) -> Bools:
    normal, is_sure = plain_normals(points, toward, stands, steps)
    hollow = np.zeros(is_sure.shape, dtype=bool)
    for axis in (0, 1):
        here, there = pair(axis, 2 * reach)
        along = points[there] - points[here]
        bend = ((normal[there] - normal[here]) * along).sum(axis=-1) / np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
        middle = (slice(reach, -reach), slice(None)) if axis == 0 else (slice(None), slice(reach, -reach))
        hollow[middle] |= is_sure[here] & is_sure[there] & (bend < -crease)
    return hollow


def plain_connected(smooth: Bools, tint: Array, steps: tuple[Bools, Bools], luma: float, chroma: float) -> Indices:
    index, firsts, seconds = np.arange(smooth.size).reshape(smooth.shape), [], []
    for axis, step in enumerate(steps):
        here, there = pair(axis)
        difference = np.abs(tint[here] - tint[there])
        is_other = (difference[..., 0] > luma) | (difference[..., 1:].max(axis=-1, initial=0) > chroma)
        joined = step & smooth[here] & smooth[there] & ~is_other
        firsts.append(index[here][joined])
        seconds.append(index[there][joined])
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(smooth.size, smooth.size))
    component = connected_components(graph, directed=False)[1].reshape(smooth.shape)
    label = np.full(smooth.shape, -1, dtype=np.int64)
    label[smooth] = np.unique(component[smooth], return_inverse=True)[1]
    return label


def plain_grown(patch: Indices, stands: Bools, steps: tuple[Bools, Bools]) -> Indices:
    patch = patch.copy()
    while True:
        before = patch.copy()
        for axis, step in enumerate(steps):
            here, there = pair(axis)
            for target, source in ((here, there), (there, here)):
                is_open = step & stands[target] & (patch[target] < 0) & (before[source] >= 0)
                patch[target] = np.where(is_open, before[source], patch[target])
        if (patch == before).all():
            return patch


def plain_medians(height: Array, inside: Bools) -> Array:
    medians = np.zeros(height.shape)
    for y, x in zip(*np.nonzero(inside), strict=True):
        window = slice(max(y - 1, 0), y + 2), slice(max(x - 1, 0), x + 2)
        medians[y, x] = np.median(height[window][inside[window]])
    return medians


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), h=st.integers(5, 40), w=st.integers(5, 40), rough=st.sampled_from([0.0, 0.002, 0.02]))
def test_surfaces_are_those_of_whole_arrays(seed: int, h: int, w: int, rough: float) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((h, w)) * 0.005
    fold = np.abs(columns - rng.uniform(0, columns.max())) * rng.choice([-1.0, 0.0, 1.0, 3.0])
    points = np.stack([columns, rows, fold + rough * rng.standard_normal((h, w))], axis=-1)
    toward = np.array([0.1, -0.2, 2.0]) - points
    toward /= np.linalg.norm(toward, axis=-1)[..., None]
    stands, valid = rng.random((h, w)) < 0.9, rng.random((h, w)) < 0.97
    pixel, tint = rng.uniform(0.001, 0.004, (h, w)), np.round(rng.random((h, w, 3)), 1)
    steps = surfaces.steps(points, valid, pixel, 0.015, 5.0)
    for step, plain in zip(steps, plain_steps(points, valid, pixel, 0.015, 5.0), strict=True):
        assert np.array_equal(step, plain)
    smooth = surfaces.smoothed(points, *steps)
    assert np.array_equal(smooth.view(np.int64), plain_smoothed(points, steps).view(np.int64))
    hollow = surfaces.hollows(smooth, toward, stands, *steps, 2, 0.5)
    assert np.array_equal(hollow, plain_hollows(smooth, toward, stands, steps, 2, 0.5))
    patch = surfaces.connected(stands & ~hollow, tint, *steps, 0.6, 0.5)
    assert np.array_equal(patch, plain_connected(stands & ~hollow, tint, steps, 0.6, 0.5))
    some = np.where(rng.random((h, w)) < 0.1, patch, -1)
    assert np.array_equal(surfaces.grown(some, stands, *steps), plain_grown(some, stands, steps))
    assert np.array_equal(surfaces.median_heights(points[..., 2], stands), plain_medians(points[..., 2], stands))
    every, rest = points[::2, ::2, 2], stands[::2, ::2]
    assert np.array_equal(surfaces.median_heights(every, rest), plain_medians(every, rest))


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (1, 7), (7, 1), (2, 2), (3, 4)])
def test_images_smaller_than_a_neighborhood(shape: tuple[int, int]) -> None:
    points, everywhere = np.ones((*shape, 3)), np.ones(shape, dtype=bool)
    steps = surfaces.steps(points, everywhere, np.ones(shape), 0.015, 5.0)
    assert [step.shape for step in steps] == [(max(shape[0] - 1, 0), shape[1]), (shape[0], max(shape[1] - 1, 0))]
    assert np.array_equal(surfaces.smoothed(points, *steps), points)
    assert not surfaces.hollows(points, points, everywhere, *steps, 2, 0.5).any()
    assert np.array_equal(surfaces.connected(everywhere, points, *steps, 1.0, 1.0), np.zeros(shape))
    assert np.array_equal(surfaces.median_heights(points[..., 2], everywhere), points[..., 2])
    seeds = np.where(np.arange(points[..., 0].size).reshape(shape) == 0, 0, -1)
    assert np.array_equal(surfaces.grown(seeds, everywhere, *steps), np.zeros(shape))
