"""Distances of surfaces, held against plain loops and against shapes whose distances are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from tasks.geometry.meshes import Surface, surface_of
from tasks.geometry.transforms import yaw_pose
from tasks.selection.metrics.surfaces import (
    METRICS,
    Agreement,
    ShapeSamples,
    agreement,
    aligned_iou,
    color_shares,
    divergence,
    regret,
    samples_of,
    surface_variations,
)

ONES, HERE = np.ones(3), np.eye(4)


def box(
    size: tuple[float, float, float], color: tuple[int, int, int] = (100, 100, 100), at: tuple[float, float, float] = (0, 0, 0)
) -> Surface:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    mesh.visual.vertex_colors = np.tile([*color, 255], (len(mesh.vertices), 1)).astype(np.uint8)
    return surface_of([mesh])


def ball(radius: float) -> Surface:
    return surface_of([trimesh.creation.icosphere(4, radius)])


def plain(surface: Surface, seed: int = 0, count: int = 4096, pose: np.ndarray = HERE, scale: np.ndarray = ONES) -> ShapeSamples:
    return samples_of(surface, pose, scale, np.random.default_rng(seed), count)


def by_loops(truth: ShapeSamples, other: ShapeSamples) -> tuple[float, float, float]:
    """CD, squared CD and ECD as specs C.5 writes them, one pair of points after another."""
    long = math.sqrt(sum(v * v for v in truth.box_size))

    def one_way(a: ShapeSamples, b: ShapeSamples) -> tuple[float, float, float]:
        plain_sum = square_sum = bent_sum = 0.0
        for x, n, k in zip(a.points, a.normals, a.variations, strict=True):
            lengths = [math.dist(x, y) for y in b.points]
            nearest = lengths.index(min(lengths))
            dot = sum(float(u) * float(v) for u, v in zip(n, b.normals[nearest], strict=True))
            plain_sum += lengths[nearest]
            square_sum += lengths[nearest] ** 2
            bent_sum += lengths[nearest] + 0.1 * long * (1 - abs(dot)) + 0.1 * long * abs(k - b.variations[nearest])
        return plain_sum / len(a.points), square_sum / len(a.points), bent_sum / len(a.points)

    there, back = one_way(truth, other), one_way(other, truth)
    return tuple(0.5 * (first + second) for first, second in zip(there, back, strict=True))  # type: ignore[return-value]


@pytest.mark.parametrize(("first", "second"), [(ball(0.5), box((1, 0.6, 0.4))), (box((1, 1, 1)), box((1, 1, 1), at=(0.3, 0, 0.1)))])
def test_distances_are_those_of_plain_loops(first: Surface, second: Surface) -> None:
    truth, other = plain(first, 0, 300), plain(second, 1, 250)
    found = agreement(truth, other)
    assert (found.chamfer_m, found.chamfer_m2, found.ecd_m) == pytest.approx(by_loops(truth, other), rel=1e-9)


def test_curvature_is_that_of_plain_loops() -> None:
    points = plain(ball(0.4), 3, 200).points
    found = surface_variations(points)
    for place in range(0, 200, 17):
        order = sorted(range(200), key=lambda other: math.dist(points[place], points[other]))[:16]
        values = sorted(np.linalg.eigvals(np.cov(points[order].T)).real)
        assert found[place] == pytest.approx(values[0] / sum(values), rel=1e-9)
    grid = np.stack([*(axis.ravel() for axis in np.mgrid[0:20, 0:20]), np.zeros(400)], axis=1)
    assert surface_variations(grid) == pytest.approx(0.0, abs=1e-12)
    solid = np.random.default_rng(0).normal(size=(4000, 3))
    assert 0.1 < surface_variations(solid).mean() < 1 / 3


def test_a_shape_is_nothing_away_from_its_own_samples() -> None:
    truth = plain(ball(0.5), 0)
    assert agreement(truth, truth) == Agreement(0.0, 0.0, pytest.approx(0.0, abs=1e-12), 1.0, pytest.approx(1.0), 0.0)
    again = agreement(truth, plain(ball(0.5), 1))
    assert again.chamfer_m < 0.02, "other samples of it are as far as samples are apart"
    assert again.box_iou == pytest.approx(1.0)


def test_parallel_sheets_are_as_far_as_they_are_apart() -> None:
    sheet = Surface(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]), np.zeros((4, 3), np.uint8))
    lower, upper = plain(sheet, 0), plain(sheet, 1, pose=yaw_pose(0, [0, 0, 0.4]))
    found = agreement(lower, upper)
    assert found.chamfer_m == pytest.approx(0.4, abs=1e-3)
    assert found.chamfer_m2 == pytest.approx(0.16, abs=1e-3)
    assert found.ecd_m == pytest.approx(found.chamfer_m, abs=1e-6), "they are flat and face the same way"
    flipped = Surface(sheet.vertices, sheet.faces[:, ::-1], sheet.colors)
    assert agreement(lower, plain(flipped, 1, pose=yaw_pose(0, [0, 0, 0.4]))).ecd_m == pytest.approx(found.ecd_m, abs=1e-6)


def test_balls_in_balls_are_as_far_as_their_radii_differ() -> None:
    found = agreement(plain(ball(0.5), 0), plain(ball(0.3), 1))
    assert found.chamfer_m == pytest.approx(0.2, abs=5e-3)
    assert found.box_iou == pytest.approx(0.6**3, abs=1e-6)


def test_scale_and_pose_go_into_the_samples() -> None:
    found = plain(box((1, 1, 1)), scale=np.array([2.0, 0.5, 1.0]), pose=yaw_pose(np.pi / 2, [3, 0, 0]))
    assert (found.low, found.high) == (pytest.approx([2.75, -1, -0.5]), pytest.approx([3.25, 1, 0.5]))
    assert found.box_size == pytest.approx([2, 0.5, 1])
    assert found.diagonal == pytest.approx(math.sqrt(4 + 0.25 + 1))
    assert np.linalg.norm(found.normals, axis=1) == pytest.approx(1.0)


def test_a_turned_box_has_two_ious() -> None:
    """A square turned by 45 degrees: its own box overlaps in a regular octagon, the box along the axes is twice as large."""
    square = box((1, 1, 1))
    found = agreement(plain(square, 0), plain(square, 1, pose=yaw_pose(np.pi / 4)))
    octagon = 2 * (math.sqrt(2) - 1)
    assert found.oriented_iou == pytest.approx(octagon / (2 - octagon), abs=1e-9)
    assert found.box_iou == pytest.approx(0.5, abs=1e-9)


def test_boxes_along_the_axes_are_held_against_counted_cells() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        low, other = rng.integers(0, 6, (2, 3))
        high, other_high = low + rng.integers(1, 6, 3), other + rng.integers(1, 6, 3)
        cells = [set(np.ndindex(*(h - l))) for l, h in ((low, high), (other, other_high))]  # noqa: E741
        first, second = ({tuple(np.add(cell, at)) for cell in of} for of, at in zip(cells, (low, other), strict=True))
        expected = len(first & second) / len(first | second)
        assert aligned_iou(low.astype(float), high.astype(float), other.astype(float), other_high.astype(float)) == pytest.approx(expected)
    assert aligned_iou(np.zeros(3), np.array([1, 1, 0.0]), np.zeros(3), np.array([1, 1, 0.0])) == 0.0


def test_divergence_of_two_colors_is_known() -> None:
    """Shares p and 1 - p of red against q and 1 - q: p ln(p / q) + (1 - p) ln((1 - p) / (1 - q)), but for the floor of the bins."""
    red, blue = [255, 0, 0], [0, 0, 255]
    first, second = (color_shares(np.array([red] * n + [blue] * (1000 - n), dtype=np.uint8)) for n in (300, 600))
    expected = 0.3 * math.log(0.3 / 0.6) + 0.7 * math.log(0.7 / 0.4)
    assert divergence(first, second) == pytest.approx(expected, rel=2e-3)
    assert divergence(first, first) == 0.0
    only_red, only_blue = (color_shares(np.array([color] * 10, dtype=np.uint8)) for color in (red, blue))
    floor = 1e-6 / (1 + 512e-6)
    top = (1 + 1e-6) / (1 + 512e-6)
    assert divergence(only_red, only_blue) == pytest.approx((top - floor) * math.log(top / floor), rel=1e-12)


def test_bins_are_even_and_joint() -> None:
    every = np.stack(np.meshgrid(*[np.arange(0, 256, 16)] * 3), axis=-1).reshape(-1, 3)
    assert color_shares(every) == pytest.approx(np.full(512, 1 / 512))
    shares = color_shares(np.array([[31, 32, 255]], dtype=np.uint8))
    assert int(shares.argmax()) == (0 * 8 + 1) * 8 + 7


def test_the_direction_is_from_what_was_chosen_to_the_truth() -> None:
    red, mixed = box((1, 1, 1), (255, 0, 0)), box((1, 1, 1), (255, 0, 0))
    mixed.colors[:4] = (0, 0, 255)
    one_way = agreement(plain(mixed, 0), plain(red, 1)).color_kl
    other_way = agreement(plain(red, 0), plain(mixed, 1)).color_kl
    assert other_way > one_way, "colors that the truth lacks are dear, those that are missing are not"


def test_regret_is_what_the_best_would_have_spared() -> None:
    assert regret([0.3, 0.1, 0.2], 0, "chamfer_m") == pytest.approx(0.2)
    assert regret([0.3, 0.1, 0.2], 1, "chamfer_m") == 0.0
    assert regret([0.3, 0.1, 0.2], 1, "box_iou") == pytest.approx(0.2)
    assert regret([0.3, 0.1, 0.2], 0, "box_iou") == 0.0
    assert set(METRICS) == {"chamfer_m", "chamfer_m2", "ecd_m", "box_iou", "oriented_iou", "color_kl"}


def test_the_same_seed_gives_the_same_samples() -> None:
    first, second = plain(ball(0.5), 7), plain(ball(0.5), 7)
    assert all((getattr(first, name) == getattr(second, name)).all() for name in ShapeSamples.__dataclass_fields__)
    assert len(first.points) == 4096
