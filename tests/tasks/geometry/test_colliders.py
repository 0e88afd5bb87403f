"""Rays from six sides at an asset and its collider, and the pieces that keep the measure."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tasks.candidates.closing import solid_field
from tasks.candidates.scan_crop import closed_crop, pieces_of_crop
from tasks.furniture import generate
from tasks.geometry.colliders import ColliderShares, collider_shares, sightlines
from tasks.geometry.decomposition import split
from tasks.geometry.hulls import LIMITS, is_within
from tasks.geometry.meshes import load_glb, surface_of
from tasks.geometry.pieces import PieceConfig, pieces
from tasks.geometry.transforms import yaw_pose

CONFIG = PieceConfig()


def box(size: Sequence[float], at: Sequence[float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return mesh


def prism(outline: list[tuple[float, float]], height: float) -> trimesh.Trimesh:
    return trimesh.creation.extrude_polygon(shapely.Polygon(outline), height)


# ---- the measure


def test_a_filled_notch_stops_the_rays_that_would_have_entered_it() -> None:
    """A cube of 60 cm without a quarter: rays into the notch from two sides go 30 cm farther, those along it hit nothing."""
    notched = prism([(0, 0), (0.6, 0), (0.6, 0.3), (0.3, 0.3), (0.3, 0.6), (0, 0.6)], 0.6)
    whole = box((0.6, 0.6, 0.6), (0.3, 0.3, 0.3))
    into = 2 * 20 * 40
    through = 2 * 19 * 19  # the row of rays beside each wall of the notch stops less than 2 cm from it
    meeting = 4 * 40 * 40 + 2 * (40 * 40 - 20 * 20)
    shares = collider_shares([notched], [whole])
    assert shares == ColliderShares(pytest.approx((into + through) / (meeting + through)), 0.0)
    assert collider_shares([notched], [notched]) == (0.0, 0.0)
    back = collider_shares([whole], [notched])
    assert back.early == 0.0
    assert back.miss == pytest.approx((into + 2 * 20 * 20) / (6 * 40 * 40))


def test_a_collider_that_is_too_small_misses_near_the_silhouette() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.3)
    smaller = trimesh.creation.icosphere(subdivisions=5, radius=0.297)
    # Behind by more than 1 cm: a - b > 0.01 with a^2 - b^2 = 0.3^2 - 0.297^2, the half chords of both at one distance from the middle.
    b = 0.5 * ((0.3**2 - 0.297**2) / 0.01 - 0.01)
    assert collider_shares([ball], [smaller]).miss == pytest.approx(1 - (0.297**2 - b**2) / 0.3**2, abs=0.02)
    assert collider_shares([ball], [smaller]).early == 0.0
    # Before it by more than 2 cm, where rays graze both.
    b = 0.5 * ((0.3**2 - 0.297**2) / 0.02 - 0.02)
    assert collider_shares([smaller], [ball]).early == pytest.approx(b**2 / 0.297**2, abs=0.01)
    assert collider_shares([smaller], [ball]).miss == 0.0
    assert collider_shares([ball], [trimesh.creation.icosphere(subdivisions=5, radius=0.27)]).miss == pytest.approx(1.0, abs=0.01)


@pytest.mark.whole
@given(st.floats(0.01, 3.0), st.floats(0.01, 3.0), st.floats(0.01, 3.0), st.floats(-50, 50))
def test_rays_cover_the_box_evenly_and_all_meet_it(x: float, y: float, z: float, at: float) -> None:
    sight = sightlines([box((x, y, z), (at, 0, 0))])
    assert np.isfinite(sight.seen).all()
    assert len(sight.rays) == 2 * sum(int(np.prod(np.delete(sight.counts, axis))) for axis in range(3))
    assert (np.array([x, y, z]) / sight.counts <= 0.015 + 1e-9).all()
    assert sight.shares([box((x, y, z), (at, 0, 0))]) == (0.0, 0.0)


def test_what_no_ray_meets_has_no_shares() -> None:
    speck = trimesh.Trimesh([[0, 0, 0], [0, 0, 0], [0, 0, 0]], [[0, 1, 2]], process=False)
    assert collider_shares([speck], [box((1e-6, 1e-6, 1e-6), (1, 1, 1))]) == (0.0, 0.0)


# ---- pieces that keep it


def keeps(parts: Sequence[trimesh.Trimesh], known: Sequence[trimesh.Trimesh] | None = None, most: int = 128) -> None:
    """Pieces keep the measure, are no more than so many, are taken by engines, and stay in the box of what is seen."""
    made = pieces(parts, known, CONFIG)
    assert collider_shares(parts, made.hulls) == pytest.approx(made.shares)
    assert made.shares.early <= 0.02
    assert made.shares.miss <= 0.02
    assert len(made.hulls) <= most
    assert all(is_within(hull, LIMITS) for hull in made.hulls)
    bounds, cloud = surface_of(parts).bounds, np.concatenate([hull.vertices for hull in made.hulls])
    thin = np.ptp(bounds, axis=0) < CONFIG.thickness_m
    assert (cloud.min(axis=0) >= bounds[0] - np.where(thin, CONFIG.thickness_m, 1e-9)).all()
    assert (cloud.max(axis=0) <= bounds[1] + np.where(thin, CONFIG.thickness_m, 1e-9)).all()
    assert cloud[:, 2].min() == pytest.approx(bounds[0, 2], abs=1e-6), "it stands on what is seen to stand"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("category", ["pillow", "ceiling lamp", "ball", "ottoman", "backpack", "clock"])
def test_rounded_furniture_is_no_smaller_than_it_looks(category: str, seed: int) -> None:
    model = generate(category, None, np.random.default_rng(seed))
    keeps(model.parts, model.pieces, most=40)


@pytest.mark.whole
@pytest.mark.parametrize(("category", "extents"), [("ceiling lamp", (0.38, 0.31, 0.16)), ("book stack", (0.22, 0.52, 0.27))])
def test_closed_scans_do_not_collide_as_coarser_slabs(category: str, extents: tuple[float, float, float]) -> None:
    model = generate(category, extents, np.random.default_rng(1))
    scanned = trimesh.util.concatenate([part.subdivide_to_size(0.02) for part in model.parts])
    crop = surface_of([scanned])
    crop = dataclasses.replace(crop, vertices=crop.vertices + np.random.default_rng(0).normal(0, 0.004, crop.vertices.shape))
    field = solid_field(crop)
    closed, (_, slabs) = closed_crop(crop, field), pieces_of_crop(crop, field)
    assert max(collider_shares([closed], slabs)) > 0.02
    keeps([closed], slabs)


def l_shaped_cabinet() -> list[trimesh.Trimesh]:
    """Two runs of open cupboards along two walls, each a bottom, a top, a back and uprights."""

    def run(length: float, count: int) -> list[trimesh.Trimesh]:
        boards = [box((0.6, length, 0.04), (0.3, length / 2, z)) for z in (0.02, 0.45, 0.88)]
        boards += [box((0.02, length, 0.9), (0.01, length / 2, 0.45))]
        return boards + [box((0.6, 0.02, 0.9), (0.3, 0.01 + (length - 0.02) * i / count, 0.45)) for i in range(count + 1)]

    first, second = run(2.0, 4), run(1.6, 3)
    for board in second:
        board.apply_transform(yaw_pose(-np.pi / 2, [0.0, 0.6, 0.0]))
    return [trimesh.util.concatenate(first + second)]


@pytest.mark.whole
def test_an_l_shaped_cabinet_keeps_its_corner_and_its_compartments_open() -> None:
    cabinet = l_shaped_cabinet()
    keeps(cabinet)
    # The same as one body of one surface: nothing falls apart by itself.
    joined = trimesh.boolean.union(cabinet[0].split(), engine="manifold")
    assert len(joined.split()) == 5, "compartments that are closed all around are surfaces of their own"
    keeps([joined], most=64)
    assert collider_shares([joined], [joined.convex_hull]).early > 0.35


def test_a_frame_which_no_single_cut_improves_becomes_bars() -> None:
    frame = trimesh.creation.extrude_polygon(shapely.box(0, 0, 1, 0.8).difference(shapely.box(0.1, 0.1, 0.9, 0.7)), 0.06)
    made = pieces([frame], None, CONFIG)
    assert (made.method, len(made.hulls)) == ("cut", 4)
    assert max(made.shares) <= 0.02
    assert made.properties.volume == pytest.approx(frame.volume, rel=0.02)


def test_surfaces_without_volume_keep_their_openings_too() -> None:
    """A box of single sheets, open above, which encloses nothing and whose sheets are seen from both sides."""
    sheets = [box((0.6, 0.4, 1e-9), (0, 0, 0)), *(box((1e-9, 0.4, 0.3), (x, 0, 0.15)) for x in (-0.3, 0.3))]
    sheets += [box((0.6, 1e-9, 0.3), (0, y, 0.15)) for y in (-0.2, 0.2)]
    keeps([trimesh.util.concatenate(sheets)], most=10)


def test_known_pieces_that_fill_an_opening_are_replaced() -> None:
    ell = prism([(0, 0), (1, 0), (1, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)], 0.3)
    made = pieces([ell], [ell.convex_hull], CONFIG)
    assert (made.method, len(made.hulls)) == ("cut", 2)
    assert pieces([ell], [box((1, 0.2, 0.3), (0.5, 0.1, 0.15)), box((0.2, 1, 0.3), (0.1, 0.5, 0.15))], CONFIG).method == "generator"


@given(st.integers(0, 10_000), st.integers(0, 2), st.floats(-0.9, 0.9))
def test_cutting_a_surface_loses_none_of_it(seed: int, axis: int, place: float) -> None:
    triangles = np.random.default_rng(seed).uniform(-1, 1, (20, 3, 3))
    below, above, within = split(triangles, axis, place)
    assert not len(within)

    def area(some: np.ndarray) -> float:
        return float(np.linalg.norm(np.cross(some[:, 1] - some[:, 0], some[:, 2] - some[:, 0]), axis=1).sum())

    assert area(below) + area(above) == pytest.approx(area(triangles))
    assert below.reshape(-1, 3)[:, axis].max(initial=-1) <= place + 1e-6
    assert above.reshape(-1, 3)[:, axis].min(initial=1) >= place - 1e-6


@pytest.mark.parametrize("name", ["aws_NightStand_01", "aws_TV_01", pytest.param("aws_KitchenCabinet_01", marks=pytest.mark.slow)])
def test_library_models_keep_their_openings(realdata: Callable[[str], Path], name: str) -> None:
    keeps(load_glb((realdata("assets") / f"{name}.glb").read_bytes()))
