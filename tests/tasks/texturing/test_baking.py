"""Baking: what images show of a body comes back at the right texel, and nothing else does."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from tasks.geometry.rendering import RayScene
from tasks.texturing.baking import Atlas, BakeConfig, atlas_of, baked, bilinear, depth_edges, weighted_median
from tasks.texturing.exposure import gains_of
from tasks.texturing.unwrapping import XatlasUnwrapper, unwrapped
from tests.tasks.texturing.painting import paint, ring, taken

CONFIG = BakeConfig(texel_m=0.01, max_px=256)
seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@pytest.fixture(scope="module")
def body() -> trimesh.Trimesh:
    return trimesh.creation.box((0.9, 0.7, 0.5))


@pytest.fixture(scope="module")
def atlas(body: trimesh.Trimesh) -> Atlas:
    layout = unwrapped(XatlasUnwrapper(), body.vertices, body.faces)
    return atlas_of(layout.vertices, layout.faces, layout.uv, CONFIG)


def error(atlas: Atlas, image: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """How far the texture is from the truth at seen texels, in levels, shape (n, 3)."""
    which = seen[atlas.texels.row, atlas.texels.column]
    return np.abs(image[atlas.texels.row, atlas.texels.column][which] - paint(atlas.points[which]))


def test_texels_lie_on_the_surface(body: trimesh.Trimesh, atlas: Atlas) -> None:
    half = np.array([0.45, 0.35, 0.25])
    assert np.abs(np.abs(atlas.points / half).max(axis=1) - 1.0).max() < 1e-6
    axis = np.abs(atlas.points / half).argmax(axis=1)
    assert (np.abs(atlas.normals[np.arange(len(axis)), axis]) > 0.999).mean() > 0.99
    assert (atlas.side_m**2).sum() == pytest.approx(body.area, rel=0.03), "texels tile the surface"
    assert 0.005 < np.median(atlas.side_m) <= 0.01


def test_a_painted_body_comes_back(body: trimesh.Trimesh, atlas: Atlas) -> None:
    views = [taken(camera, [body]) for camera in ring(10)]
    result = baked(atlas, views, RayScene([body]), CONFIG)
    assert result.seen_share > 0.9
    assert result.covered[atlas.texels.row, atlas.texels.column].all()
    off = error(atlas, result.image, result.seen)
    assert off.mean() < 1.5
    assert np.quantile(off, 0.99) < 6.0
    assert error(atlas, result.image, result.covered).mean() < 3.0, "what is at rims is mended by what is near"
    assert result.gains == pytest.approx(np.ones(10), abs=0.02)
    again = baked(atlas, views, RayScene([body]), CONFIG)
    assert again.image.tobytes() == result.image.tobytes()


def test_exposures_are_solved_for(body: trimesh.Trimesh, atlas: Atlas) -> None:
    true = np.exp(np.random.default_rng(3).normal(0, 0.08, 10))
    true /= true.mean()
    views = [taken(camera, [body], gain=gain) for camera, gain in zip(ring(10), true, strict=True)]
    result = baked(atlas, views, RayScene([body]), CONFIG)
    ratio = result.gains / true
    assert ratio / ratio.mean() == pytest.approx(np.ones(10), abs=0.02)
    as_taken = baked(atlas, views, RayScene([body]), dataclasses.replace(CONFIG, solves_gains=False))
    assert (as_taken.gains == 1).all()
    scaled = error(atlas, result.image * ratio.mean(), result.seen)
    assert scaled.mean() < 0.6 * error(atlas, as_taken.image, as_taken.seen).mean()


def test_what_stands_before_a_surface_is_not_painted_on_it(body: trimesh.Trimesh, atlas: Atlas) -> None:
    pole = trimesh.creation.box((0.06, 0.06, 2.0))
    pole.apply_translation([0.8, 0.1, 0.0])

    def color(points: np.ndarray) -> np.ndarray:
        return np.where((np.abs(points[..., 0] - 0.8) < 0.04)[..., None], [255.0, 0.0, 255.0], paint(points))

    views = [taken(camera, [body, pole], color) for camera in ring(10)]
    known = baked(atlas, views, RayScene([body, pole]), CONFIG)
    assert np.quantile(error(atlas, known.image, known.seen), 0.99) < 8.0
    unknown = baked(atlas, views, RayScene([body]), CONFIG)  # the depth images alone tell of it
    assert np.quantile(error(atlas, unknown.image, unknown.seen), 0.99) < 12.0


def test_an_image_of_something_else_is_outvoted(body: trimesh.Trimesh, atlas: Atlas) -> None:
    cameras = ring(12)
    views = [taken(camera, [body]) for camera in cameras]
    views[4] = taken(cameras[4], [body], lambda points: 255.0 - paint(points))
    result = baked(atlas, views, RayScene([body]), dataclasses.replace(CONFIG, solves_gains=False))
    worth = error(atlas, result.image, result.seen)
    assert np.median(worth) < 1.5
    assert (worth.max(axis=1) > 24).mean() < 0.06, "but where it has no more than one other against it"


def test_readings_that_disagree_hide_a_point(body: trimesh.Trimesh, atlas: Atlas) -> None:
    views = [taken(camera, [body]) for camera in ring(4)]
    shifted = [dataclasses.replace(view, depth=lambda view=view: view.depth() + np.float32(0.2)) for view in views]
    assert baked(atlas, shifted, RayScene([body]), CONFIG).seen_share < 0.02
    blind = [dataclasses.replace(view, depth=lambda view=view: np.zeros_like(view.depth())) for view in views]
    without = [dataclasses.replace(view, depth=None, depth_camera=None) for view in views]
    shares = [baked(atlas, some, RayScene([body]), CONFIG).seen_share for some in (views, blind, without)]
    assert shares[0] == pytest.approx(shares[2], abs=0.02)
    assert shares[1] == pytest.approx(shares[2], abs=0.02)


def test_depth_images_of_another_size_serve(body: trimesh.Trimesh, atlas: Atlas) -> None:
    pairs = zip(ring(6), ring(6, size=(100, 75)), strict=True)
    views = []
    for large, small in pairs:
        coarse = taken(small, [body])
        views.append(dataclasses.replace(taken(large, [body]), depth_camera=small, depth=coarse.depth))
    result = baked(atlas, views, RayScene([body]), CONFIG)
    assert result.seen_share > 0.6
    assert error(atlas, result.image, result.seen).mean() < 1.5


def test_what_no_image_shows(body: trimesh.Trimesh, atlas: Atlas) -> None:
    scene, own = RayScene([body]), np.tile(np.uint8([10, 200, 30]), (len(atlas.points), 1))
    nothing = baked(atlas, [], scene, CONFIG, own)
    assert (nothing.seen_share, nothing.looks, len(nothing.gains)) == (0.0, 0.0, 0)
    assert (nothing.image[nothing.covered] == [10, 200, 30]).all()
    assert (nothing.image == [10, 200, 30]).all(), "between charts, too"
    assert (baked(atlas, [], scene, CONFIG).image == 180).all()
    one_side = [taken(ring(4)[0], [body])]
    half = baked(atlas, one_side, scene, CONFIG, own)
    hidden = (half.covered & ~half.seen)[atlas.texels.row, atlas.texels.column]
    kept = (half.image[atlas.texels.row, atlas.texels.column] == [10, 200, 30]).all(axis=1)
    assert 0.2 < half.seen_share < 0.8
    assert kept[hidden].mean() > 0.9, "all but what is mended at rims"
    assert not kept[~hidden].any()
    spread = baked(atlas, one_side, scene, CONFIG)
    lit = spread.image[spread.seen]
    filled = spread.image[spread.covered & ~spread.seen]
    assert (filled >= lit.min(axis=0) - 1).all()
    assert (filled <= lit.max(axis=0) + 1).all()


def test_gutters_carry_charts_past_their_borders(body: trimesh.Trimesh, atlas: Atlas) -> None:
    result = baked(atlas, [taken(camera, [body]) for camera in ring(8)], RayScene([body]), CONFIG)
    rows, columns = np.nonzero(result.covered)
    inside = np.zeros(result.covered.shape, dtype=bool)
    around = np.random.default_rng(0).permutation(np.argwhere(~result.covered))[:200]
    for row, column in around:
        square = (rows - row) ** 2 + (columns - column) ** 2
        if square.min() <= CONFIG.gutter_px**2:
            inside[row, column] = True
            nearest = np.flatnonzero(square == square.min())
            choices = result.image[rows[nearest], columns[nearest]]
            assert (choices == result.image[row, column]).all(axis=1).any()
    assert inside.any()


@given(rng=seeds)
@settings(max_examples=30, deadline=None)
def test_colors_between_pixels_are_those_of_another_library(rng: np.random.Generator) -> None:
    height, width = rng.integers(1, 9, 2)
    image = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    pixel = rng.uniform(-1.5, [width + 0.5, height + 0.5], (20, 2))
    expected = [map_coordinates(image[..., k].astype(float), pixel.T[::-1], order=1, mode="nearest") for k in range(3)]
    assert bilinear(image, pixel) == pytest.approx(np.stack(expected, axis=1), abs=1e-3)


@given(rng=seeds)
@settings(max_examples=30, deadline=None)
def test_weighted_medians_are_those_of_repeated_values(rng: np.random.Generator) -> None:
    values = rng.integers(0, 50, (6, 5, 2)).astype(np.float32)
    times = rng.integers(0, 4, (6, 5))
    times[:, 0] += times.sum(axis=1) == 0
    found = weighted_median(values, times.astype(np.float32))
    for row in range(6):
        for channel in range(2):
            many = np.sort(np.repeat(values[row, :, channel], times[row]))
            assert found[row, channel] == many[(len(many) - 1) // 2]


@given(rng=seeds, jump=st.floats(0.01, 0.5))
@settings(max_examples=30, deadline=None)
def test_edges_are_where_neighbors_differ(rng: np.random.Generator, jump: float) -> None:
    depth = rng.choice(np.float32([0.0, 1.0, 1.02, 1.3, 2.0]), (6, 7), p=[0.1, 0.5, 0.3, 0.05, 0.05])
    found = depth_edges(depth, jump)
    for row in range(6):
        for column in range(7):
            window = depth[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
            assert found[row, column] == (window.max() - window.min() > jump * window.max())


@given(rng=seeds)
@settings(max_examples=20, deadline=None)
def test_exposures_come_back_up_to_a_common_factor(rng: np.random.Generator) -> None:
    views = int(rng.integers(2, 7))
    true = np.exp(rng.normal(0, 0.15, views))
    view = np.stack([rng.permutation(views)[:2] for _ in range(400)]).astype(np.int32)
    color = (rng.uniform(60, 120, (400, 1, 3)) * true[view][..., None]).astype(np.float32)
    wrong = rng.random(400) < 0.1
    color[wrong, 0] = rng.uniform(60, 120, (wrong.sum(), 3))
    weight = rng.uniform(0.2, 1.0, view.shape).astype(np.float32)
    ratio = gains_of(color, weight, view, views) / true
    assert ratio / ratio.mean() == pytest.approx(np.ones(views), abs=0.05)


def test_exposures_of_images_that_share_nothing_are_one() -> None:
    color, weight = np.full((10, 3, 3), 90, np.float32), np.zeros((10, 3), np.float32)
    weight[:, 0] = 1.0
    view = np.arange(30, dtype=np.int32).reshape(10, 3) % 4
    assert (gains_of(color, weight, view, 4) == 1).all()
    assert gains_of(color, weight, view, 0).shape == (0,)
