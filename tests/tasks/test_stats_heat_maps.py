"""Heat maps: the same points give the same bytes, and the farthest point of a place is what is seen."""

from __future__ import annotations

import io
import itertools
import re

import numpy as np
import pytest
from PIL import Image

from schemas.capture import Shell
from tasks.fidelity.marked_points import OBJECT, SHELL, MarkedPoints
from tasks.stats.heat_maps import CELL_M, MOST_CELLS, farthest_of_cells, heat_map
from tasks.stats.style import Picture
from tests.samples import sample

ROOM = sample(Shell, floor_polygon=((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)))


def marked(distance: float, part: int = OBJECT) -> MarkedPoints:
    """A level top of 1 by 1 m, one point in each cell, at one distance; below it points that are near."""
    across = np.arange(20) * 0.05 + 1.025
    top = np.stack([*(axis.ravel() for axis in np.meshgrid(across, across)), np.ones(400)], axis=1)
    points = np.concatenate([top, top - [0, 0, 0.5]])
    return MarkedPoints(points, np.repeat([distance, 0.0], 400), np.full(800, part, np.uint8))


def reds(data: bytes) -> int:
    """Pixels of the map, left of its bar, that are as dark a red as the farthest distance."""
    with Image.open(io.BytesIO(data)) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)[:, : int(0.7 * image.width)]
    return int(((pixels[..., 0] > 100) & (pixels[..., 0] < 160) & (pixels[..., 1] < 30)).sum())


def test_the_farthest_point_of_a_place_is_seen_and_far_is_far() -> None:
    far, farther, near, shell = (
        heat_map(points, ROOM, "demo/a") for points in (marked(0.2), marked(np.inf), marked(0.0), marked(0.2, SHELL))
    )
    assert far == farther == heat_map(marked(0.2), ROOM, "demo/a")
    assert reds(far.png) > 5000
    assert reds(near.png) == reds(shell.png) == 0
    # the top lies on four by four squares of a quarter of a metre; what is near says nothing
    assert told(far) == {
        f"x {x:.2f} to {x + 0.25:.2f} m, y {y:.2f} to {y + 0.25:.2f} m: over 0.20 m"
        for x, y in itertools.product((1.0, 1.25, 1.5, 1.75), repeat=2)
    }
    assert told(near) == told(shell) == set()


def told(drawn: Picture) -> set[str]:
    return set(re.findall(r'<g class="tip"[^>]*>\s*<title>([^<]*)</title>', drawn.svg))


def test_the_order_of_points_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    points = MarkedPoints(rng.uniform(0, 3, (500, 3)), rng.exponential(0.1, 500), rng.integers(0, 3, 500).astype(np.uint8))
    turn = rng.permutation(500)
    turned = MarkedPoints(points.points[turn], points.distance[turn], points.part[turn])
    assert heat_map(points, None, "demo/a") == heat_map(turned, None, "demo/a")


def test_nothing_scanned_is_a_picture_too() -> None:
    nothing = MarkedPoints(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.uint8))
    with Image.open(io.BytesIO(heat_map(nothing, ROOM, "demo/a").png)) as image:
        assert image.width == 900


@pytest.mark.parametrize("extent", [0.0, 3.0, 19.8, 20.0, 150.0, 1e6])
def test_a_map_has_so_many_cells_and_each_point_is_in_it(extent: float) -> None:
    points = np.concatenate([marked(0.1).points[:, :2], [[1.025 + extent, 1.5]]])
    cells, low, high = farthest_of_cells(points, np.append(np.zeros(800), 0.2))
    assert max(cells.shape) <= MOST_CELLS
    assert (cells == 0.2).sum() == 1
    assert (low <= points.min(axis=0)).all()
    assert (points.max(axis=0) <= high).all()
    size = (high - low) / cells.shape
    assert size[0] == pytest.approx(size[1])
    if extent < 19.9:
        assert size == pytest.approx(CELL_M), "of ordinary rooms"


def test_a_stray_point_far_away_is_a_picture_too() -> None:
    near = marked(0.1)
    far = MarkedPoints(np.concatenate([near.points, [[1e5, -1e5, 0]]]), np.append(near.distance, 0.2), np.append(near.part, near.part[:1]))
    with Image.open(io.BytesIO(heat_map(far, ROOM, "demo/a").png)) as image:
        assert image.width == 900
