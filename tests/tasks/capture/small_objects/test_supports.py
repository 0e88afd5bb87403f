"""What carries small objects: the list, and the slabs over boards of generated furniture."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.capture.small_objects.supports import DILATION_M, parsed_kinds, support_kind, support_kinds, support_slabs
from tasks.furniture import generate
from tasks.furniture.tops.sizes import surface
from tasks.geometry.meshes import sample_surface, surface_of
from tasks.geometry.transforms import transform_points, yaw_pose


def instance(word: str, size: tuple[float, float, float], yaw: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose of the box, its extents, and noisy points of a generated piece of furniture."""
    rng = np.random.default_rng(seed)
    points = sample_surface(surface_of(generate(word, size, rng).parts), 20_000, rng)[0]
    pose = yaw_pose(yaw, [1.0, -2.0, 0.0])
    return pose @ yaw_pose(0.0, [0, 0, size[2] / 2]), np.array(size), transform_points(points + rng.normal(0, 0.002, points.shape), pose)


def test_the_list_says_how_each_category_carries() -> None:
    assert support_kinds()["desk"].kind == "top"
    assert support_kinds()["bookshelf"].kind == "shelf"
    assert support_kind("bedside table") == support_kind("nightstand")
    assert support_kind("mug") is None
    assert support_slabs("mug", np.eye(4), np.ones(3), np.zeros((0, 3))) == ()


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("category,kind\n", "slab_m"),
        ("category,kind,slab_m\ndesk,roof,0.6\n", "line 2, kind"),
        ("category,kind,slab_m\ndesk,top,\n", "slab_m"),
        ("category,kind,slab_m\ndesk,top,0.6\nDesk,top,0.6\n", "line 3, category"),
        ("category,kind,slab_m\ndesk,top,nan\n", "slab_m"),
    ],
)
def test_a_list_that_says_nothing_is_refused(text: str, field: str) -> None:
    with pytest.raises(InputError) as raised:
        parsed_kinds(text, "supports.csv")
    assert field in raised.value.field


@settings(max_examples=12)
@given(yaw=st.floats(-3, 3), width=st.floats(1.0, 1.7), height=st.floats(0.6, 0.8), seed=st.integers(0, 3))
def test_the_top_of_a_desk_is_found(yaw: float, width: float, height: float, seed: int) -> None:
    pose, size, points = instance("desk", (0.7, width, height), yaw, seed)
    (slab,) = support_slabs("desk", pose, size, points)
    assert slab.height == pytest.approx(height, abs=0.006)
    corner = transform_points(np.array([[0.34, 0.49 * width, 0.3 + height / 2]]), pose)
    assert slab.holds(corner).all()
    outside = transform_points(np.array([[0.36 + DILATION_M, 0, height / 2 + 0.1], [0, 0, height / 2 + 0.7], [0, 0, 0.0]]), pose)
    assert not slab.holds(outside).any()


def test_what_stands_on_a_desk_does_not_lift_its_top() -> None:
    pose, _, points = instance("desk", (0.7, 1.4, 0.75), 0.3, 0)
    lid = np.random.default_rng(0).uniform([-0.2, -0.2, 0.55], [0.2, 0.2, 0.56], (1500, 3))  # a box, seen from above
    points = np.concatenate([points, transform_points(lid, pose)])
    (slab,) = support_slabs("desk", pose @ yaw_pose(0, [0, 0, 0.15]), np.array([0.7, 1.4, 1.05]), points)
    assert slab.height == pytest.approx(0.75, abs=0.006)


@settings(max_examples=12)
@given(yaw=st.floats(-3, 3), height=st.floats(1.2, 2.0), seed=st.integers(0, 3))
def test_every_board_of_a_shelf_has_its_slab(yaw: float, height: float, seed: int) -> None:
    size = (0.32, 0.9, height)
    pose, extents, points = instance("bookshelf", size, yaw, seed)
    slabs = support_slabs("bookshelf", pose, extents, points)
    top = surface("bookshelf", size)
    true = [level for level, _ in top.levels if level > 0.2] + [height]
    assert [slab.height for slab in slabs] == pytest.approx(true, abs=0.006)
    for slab, (level, clear) in zip(slabs[:-1], [pair for pair in top.levels if pair[0] > 0.2], strict=True):
        assert slab.high[2] <= clear + 0.005, level
        # neither back nor sides lie within
        assert -0.5 * 0.32 + 0.008 <= slab.low[0] <= -0.5 * 0.32 + 0.04
        assert 0.45 - 0.06 <= slab.high[1] <= 0.45 - 0.02
        assert -0.45 + 0.02 <= slab.low[1] <= -0.45 + 0.06


def test_without_points_the_box_is_the_support() -> None:
    (slab,) = support_slabs("table", yaw_pose(0, [0, 0, 0.37]), np.array([0.8, 1.2, 0.74]), np.zeros((0, 3)))
    assert slab.height == pytest.approx(0.74)
