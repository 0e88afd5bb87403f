"""Real tables: planes found in noise, and tables in drawn frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.models.trained.photographs import LEAST_PIXELS, photographed_tables, plane_of


@given(st.integers(0, 1000))
def test_a_plane_is_found_among_a_third_of_other_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    flat = rng.uniform(-0.5, 0.5, (600, 3))
    flat -= (flat @ normal)[:, None] * normal
    points = np.concatenate([flat + normal * (0.7 + rng.normal(0, 0.002, 600))[:, None], rng.uniform(-1, 1, (300, 3))])
    found, middle = plane_of(points)
    assert abs(found @ normal) > 0.999
    assert abs(middle @ normal - 0.7) < 0.004


def test_drawn_tables_have_their_board_at_the_ground_and_things_above(realdata: Callable[[str], Path]) -> None:
    tables = photographed_tables(realdata("rgbd_tum_desk_pair").parent)
    assert {table.truth.group for table in tables} >= {"rgbd_tum_desk_pair/color/1.png", "rgbd_tum_desk_pair/color/2.png"}
    for table in tables:
        points, truth = table.view.points(), table.truth
        assert table.view.pose[2, 3] > 0.2  # the camera looks down on it
        for mask, is_counted in zip(truth.masks, truth.counted, strict=True):
            if is_counted:
                own = points[mask & (table.view.depth > 0)]
                assert len(own) >= LEAST_PIXELS
                assert np.median(own[:, 2]) > -0.02
