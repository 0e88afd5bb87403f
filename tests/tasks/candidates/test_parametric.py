"""Parametric candidates, held against furniture that is drawn here and nowhere else: boxes, their surfaces sampled as a scan has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bench.shelves import models_in
from schemas.capture import Instance
from tasks import selection
from tasks.candidates.parametric import Parametric, fit_of, parametric_asset, turned_back
from tasks.candidates.parametric.cases import counters, cut_out, tables
from tasks.candidates.parametric.distances import fit_target, misfits
from tasks.candidates.parametric.drawing import Block, FurnitureTemplate
from tasks.candidates.parametric.fitting import ParametricFit, turned
from tasks.candidates.parametric.forms import KINDS, board_levels, kind_of, turned_rectangle
from tasks.candidates.parametric.seats import chairs, sofas
from tasks.candidates.provider import NothingToOffer
from tasks.candidates.request import CandidateRequest
from tasks.geometry.meshes import dump_points, load_glb, sample_surface, surface_of
from tasks.geometry.transforms import flat, transform_points, yaw_pose
from tasks.selection.methods.geometric import Geometric
from tasks.stage import Blobs, Context
from tests.samples import sample
from tests.tasks.candidates.crops import candidates_of, crop_of_parts, scanned

Array = NDArray[np.float64]
Bounds = tuple[float, float, float, float, float, float]
NOISE_M = 0.005


def seen_surface(boxes: Sequence[Bounds], rng: np.random.Generator, unseen: int | None = None, count: int = 5000) -> Array:
    """Noisy points of the outside of boxes (x0, y0, z0, x1, y1, z1), half of them dropped, none of undersides, none that face the
    direction `unseen` (0..3: +x, +y, -x, -y)."""
    points, normals = [], []
    areas = []
    for x0, y0, z0, x1, y1, z1 in boxes:
        sides = np.array([x1 - x0, y1 - y0, z1 - z0])
        low = np.array([x0, y0, z0])
        for axis in range(3):
            for end in (0, 1):
                if axis == 2 and end == 0:
                    continue
                area = np.prod(np.delete(sides, axis))
                areas.append(area)
                drawn = low + rng.random((1500, 3)) * sides
                drawn[:, axis] = low[axis] + end * sides[axis]
                normal = np.zeros(3)
                normal[axis] = 2 * end - 1
                points.append(drawn)
                normals.append(np.tile(normal, (1500, 1)))
    share = np.array(areas) / max(areas)
    kept = [p[: int(1500 * s)] for p, s in zip(points, share, strict=True)]
    facing = np.concatenate([n[: int(1500 * s)] for n, s in zip(normals, share, strict=True)])
    cloud = np.concatenate(kept)
    ahead = cloud + 1e-4 * facing
    visible = np.ones(len(cloud), dtype=bool)
    for x0, y0, z0, x1, y1, z1 in boxes:
        visible &= ~((ahead > [x0, y0, z0]) & (ahead < [x1, y1, z1])).all(axis=1)
    if unseen is not None:
        visible &= facing @ [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)][unseen] < 0.5
    visible &= rng.random(len(cloud)) < 0.5
    cloud = cloud[visible]
    return cloud[rng.permutation(len(cloud))[:count]] + rng.normal(0, NOISE_M, (min(len(cloud), count), 3))


def request_of(
    category: str, points: Array, size: Sequence[float], yaw: float = 0.0, neighbors: Sequence[Instance] = (), **changes: object
) -> CandidateRequest:
    """An instance of points in the frame of its box, z from the bottom, that stands somewhere in the world."""
    center = np.array([1.5, -2.0, 0.5 * size[2]])
    world = transform_points(points - [0, 0, 0.5 * size[2]], yaw_pose(yaw, center))
    blobs = Blobs()
    colors = np.tile(np.array([90, 120, 60], np.uint8), (len(points), 1))
    values: dict[str, object] = {
        "scene_id": "test/room", "instance_id": "0001", "category": category, "raw_label": category, "nyu40_label": "unlabeled",
        "is_structure": False, "box_pose": flat(yaw_pose(yaw, center)), "box_size": tuple(float(v) for v in size), "hidden_m": None,
        "points_blob": blobs.add(dump_points(world, colors), "ply"), "point_count": len(points), "mesh_blob": None,
    }  # fmt: skip
    instance = sample(Instance, **{**values, **changes})
    return CandidateRequest(instance, None, Context("test/room", "candidates", 1, dict(blobs)), None, neighbors)


def plan_of(blocks: Sequence[Block], turn: int) -> shapely.Geometry:
    """What blocks cover of the floor, turned into the box's frame."""
    spans = turned(np.array([block.spans for block in blocks]), turn)
    return shapely.union_all([shapely.box(x0, y0, x1, y1) for x0, x1, y0, y1, _, _ in spans])


def plan_iou(boxes: Sequence[Bounds], fit: ParametricFit) -> float:
    true, own = shapely.union_all([shapely.box(b[0], b[1], b[3], b[4]) for b in boxes]), plan_of(fit.blocks, fit.turn)
    return float(true.intersection(own).area / true.union(own).area)


def quarter(boxes: Sequence[Bounds], turns: int) -> list[Bounds]:
    """Boxes turned by quarters about +Z."""
    out = list(boxes)
    for _ in range(turns):
        out = [(-y1, x0, z0, -y0, x1, z1) for x0, y0, z0, x1, y1, z1 in out]
    return out


def named(fit: ParametricFit) -> dict[str, float]:
    return {p.name: v for p, v in zip(fit.template.parameters, fit.values, strict=True)}


# Sofas


@dataclasses.dataclass(frozen=True)
class DrawnSofa:
    """A sofa that faces +x: seats of `deep` along the wall at -x, returns of `wide` at `sides` of y, backs along the walls."""

    sides: tuple[int, ...]
    x: float
    y: float
    z: float
    deep: float
    wide: float
    seat: float
    back: float
    arm: float

    def boxes(self) -> list[Bounds]:
        hx, hy = 0.5 * self.x, 0.5 * self.y
        boxes: list[Bounds] = [
            (-hx, -hy, 0.07, -hx + self.deep, hy, self.seat),
            (-hx, -hy, 0.07, -hx + self.back, hy, self.z),
        ]
        for s in self.sides:
            y0, y1 = sorted((s * hy, s * (hy - self.wide)))
            boxes.append((-hx, y0, 0.07, hx, y1, self.seat))
            y0, y1 = sorted((s * hy, s * (hy - self.back)))
            boxes.append((-hx, y0, 0.07, hx, y1, self.z))
        for s in {-1, 1} - set(self.sides):
            y0, y1 = sorted((s * hy, s * (hy - self.arm)))
            boxes.append((-hx, y0, 0.07, -hx + self.deep, y1, self.seat + 0.2))
        return boxes


bent_sofas = st.builds(
    DrawnSofa,
    sides=st.sampled_from([(1,), (-1,), (-1, 1)]), x=st.floats(1.6, 2.1), y=st.floats(2.5, 3.2), z=st.floats(0.75, 0.9),
    deep=st.floats(0.8, 1.0), wide=st.floats(0.7, 0.95), seat=st.floats(0.38, 0.46), back=st.floats(0.14, 0.26), arm=st.floats(0.12, 0.25),
)  # fmt: skip


@pytest.mark.whole
@settings(max_examples=25, deadline=None)
@given(bent_sofas, st.floats(-3.1, 3.1), st.integers(0, 3), st.sampled_from([None, 0, 1, 2, 3]), st.integers(0, 2**32 - 1))
def test_a_sofa_round_a_bend_is_recovered(sofa: DrawnSofa, yaw: float, turns: int, unseen: int | None, seed: int) -> None:
    boxes = quarter(sofa.boxes(), turns)
    size = (sofa.x, sofa.y, sofa.z) if turns % 2 == 0 else (sofa.y, sofa.x, sofa.z)
    points = seen_surface(boxes, np.random.default_rng(seed), unseen)
    _, fit, _, _ = fit_of(request_of("couch", points, size, yaw), Parametric())
    assert plan_iou(boxes, fit) >= 0.9
    if fit.template.name == "U" or len(sofa.sides) == 2:
        assert (fit.template.name, fit.turn) == ("U", turns)
    values = named(fit)
    widths = sorted([values["depth"], values["return"]])  # an L is an L from both of its walls
    assert widths == pytest.approx(sorted([sofa.deep, sofa.wide]), abs=0.06)
    assert values["seat"] == pytest.approx(sofa.seat, abs=0.04)
    assert values["back"] == pytest.approx(sofa.back, abs=0.06)


def test_a_straight_sofa_stays_straight() -> None:
    sofa = DrawnSofa((), 0.9, 2.1, 0.8, 0.9, 0.0, 0.42, 0.2, 0.2)
    points = seen_surface(sofa.boxes(), np.random.default_rng(2))
    _, fit, _, _ = fit_of(request_of("sofa", points, (0.9, 2.1, 0.8), 0.4), Parametric())
    assert (fit.template.name, fit.turn) == ("straight", 0)
    assert named(fit)["arm"] == pytest.approx(0.2, abs=0.05)


U_SOFA = DrawnSofa((-1, 1), 1.8, 3.0, 0.8, 0.9, 0.85, 0.42, 0.2, 0.2)


def test_an_asset_is_closed_convex_in_its_box_and_the_same_every_time() -> None:
    points = seen_surface(U_SOFA.boxes(), np.random.default_rng(0))
    first, second = (parametric_asset(request_of("sofa", points, (1.8, 3.0, 0.8), 1.0), Parametric()) for _ in range(2))
    assert first.files == second.files
    asset = first.asset
    assert (asset.provider, asset.license, asset.category, asset.name) == ("parametric", "CC0-1.0", "sofa", "U sofa")
    assert asset.is_watertight
    assert asset.extents == pytest.approx((1.8, 3.0, 0.8), abs=1e-5)
    assert asset.pieces_blob is not None
    pieces = load_glb(first.files[asset.pieces_blob])
    for piece in pieces:
        assert piece.is_volume
        assert piece.convex_hull.volume == pytest.approx(piece.volume, rel=1e-4)
    for k, piece in enumerate(pieces):
        for other in pieces[:k]:  # they touch and do not overlap
            sides = np.minimum(piece.bounds[1], other.bounds[1]) - np.maximum(piece.bounds[0], other.bounds[0])
            assert sides.min() < 1e-5
    surface = surface_of(load_glb(first.files[asset.mesh_blob]))
    assert (np.abs(surface.colors.astype(int)[:, :3] - [90, 120, 60]) <= 2).all()
    # what stands in the bend is not in the sofa
    assert not plan_of(
        [Block("", (p.bounds[0][0], p.bounds[1][0]), (p.bounds[0][1], p.bounds[1][1]), (0, 1)) for p in pieces], 0
    ).intersects(shapely.box(0.15, -0.5, 0.85, 0.5))


@settings(max_examples=60, deadline=None)
@given(
    extents=st.tuples(st.floats(0.3, 3.0), st.floats(0.3, 3.0), st.floats(0.3, 2.0)),
    make=st.sampled_from([sofas, chairs, tables, counters]), seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_blocks_of_any_values_lie_in_the_box_and_do_not_overlap(
    extents: tuple[float, float, float], make: Callable[[tuple[float, float, float]], list[FurnitureTemplate]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    half = 0.5 * np.array(extents) * [1, 1, 0] + [0, 0, extents[2]]
    for template in make(extents):
        blocks = template.blocks([float(rng.uniform(p.low, p.high)) for p in template.parameters])
        spans = np.array([block.spans for block in blocks]).reshape(-1, 3, 2)
        assert (spans[:, :, 0] >= np.array([-half[0], -half[1], 0.0]) - 1e-9).all(), template.name
        assert (spans[:, :, 1] <= half + 1e-9).all(), template.name
        for k in range(len(spans)):
            shared = np.minimum(spans[k, :, 1], spans[:k, :, 1]) - np.maximum(spans[k, :, 0], spans[:k, :, 0])
            assert (shared.min(axis=1) <= 1e-9).all() if k else True, (template.name, blocks[k], blocks[:k])


# Desks, shelves, worktops


@settings(max_examples=6, deadline=None)
@given(
    st.floats(1.4, 1.7), st.floats(1.5, 1.9), st.floats(0.55, 0.75), st.floats(0.45, 0.6), st.sampled_from([-1, 1]), st.integers(0, 3),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_a_desk_with_a_return_is_recovered(x: float, y: float, deep: float, wide: float, side: int, turns: int, seed: int) -> None:
    hx, hy, z = 0.5 * x, 0.5 * y, 0.74
    y0, y1 = sorted((side * hy, side * (hy - wide)))
    boxes: list[Bounds] = [
        (-hx, -hy, z - 0.03, -hx + deep, hy, z),
        (-hx, y0, z - 0.03, hx, y1, z),
        (hx - 0.45, y0 + 0.02, 0, hx - 0.02, y1 - 0.02, z),
    ]
    far = -side * (hy - 0.05)
    boxes += [(a - 0.02, far - 0.02, 0, a + 0.02, far + 0.02, z) for a in (-hx + 0.05, -hx + deep - 0.05)]
    boxes = quarter(boxes, turns)
    size = (x, y, z) if turns % 2 == 0 else (y, x, z)
    kind, fit, _, _ = fit_of(request_of("ofice desk", seen_surface(boxes, np.random.default_rng(seed)), size, 0.3), Parametric())
    assert kind == "desk"
    assert plan_iou(boxes, fit) >= 0.9
    values = named(fit)
    assert sorted([values["depth"], values["return"]]) == pytest.approx(sorted([deep, wide]), abs=0.04)


def shelf_boxes(tops: Sequence[float], x: float = 0.32, y: float = 0.9, z: float = 1.9) -> list[Bounds]:
    boards: list[Bounds] = [(-0.5 * x, -0.5 * y, top - 0.02, 0.5 * x, 0.5 * y, top) for top in (*tops, z)]
    sides: list[Bounds] = [(-0.5 * x, s * 0.5 * y - 0.01, 0, 0.5 * x, s * 0.5 * y + 0.01, z) for s in (-0.98, 0.98)]
    return [*boards, *sides, (-0.5 * x, -0.5 * y, 0, -0.5 * x + 0.01, 0.5 * y, z)]


@pytest.mark.parametrize("tops", [(0.06, 0.5, 0.8, 1.45), (0.08, 0.53, 0.99, 1.44), (0.06, 0.45, 0.75, 1.1, 1.35, 1.6)])
def test_a_shelf_has_the_boards_that_were_seen(tops: tuple[float, ...]) -> None:
    points = seen_surface(shelf_boxes(tops), np.random.default_rng(3), unseen=2)
    _, fit, _, _ = fit_of(request_of("bookcase", points, (0.32, 0.9, 1.9), 0.7), Parametric())
    assert fit.turn == 0
    levels = sorted(v for k, v in named(fit).items() if k.startswith("level"))
    assert levels == pytest.approx(tops, abs=0.02)


def test_boards_above_eyes_are_where_an_even_row_has_them() -> None:
    tops = [0.08 + k * (1.9 - 0.08) / 5 for k in range(5)]
    points = seen_surface(shelf_boxes(tops), np.random.default_rng(4), unseen=2)
    upper = (points[:, 2] > 1.0) & (np.abs(points[:, 1]) < 0.42) & (points[:, 0] > -0.14)
    levels = board_levels(points[~upper], (0.32, 0.9, 1.9))
    assert [level.height for level in levels] == pytest.approx(tops, abs=0.03)
    assert [level.is_seen for level in levels] == [True, True, True, False, False]


def test_a_worktop_is_cut_out_where_a_sink_is_let_in() -> None:
    rest = [
        (-0.3, -1.5, 0.0, 0.3, 0.2, 0.04),
        (-0.3, 0.8, 0.0, 0.3, 1.5, 0.04),
        (-0.3, 0.2, 0.0, -0.2, 0.8, 0.04),
        (0.2, 0.2, 0.0, 0.3, 0.8, 0.04),
    ]
    points = seen_surface(rest, np.random.default_rng(5))
    size = (0.6, 3.0, 0.04)
    bare = request_of("kitchen counter", points, size, 0.5)
    pose = np.array(bare.instance.box_pose).reshape(4, 4)
    sink = sample(
        Instance, scene_id="test/room", instance_id="0002", category="sink", box_size=(0.4, 0.6, 0.2),
        box_pose=flat(pose @ yaw_pose(0.0, [0.0, 0.5, -0.06])),
    )  # fmt: skip
    _, fit, _, _ = fit_of(dataclasses.replace(bare, neighbors=(bare.instance, sink)), Parametric())
    top = plan_of([block for block in fit.blocks if block.part == "top"], fit.turn)
    assert top.area == pytest.approx(0.6 * 3.0 - 0.4 * 0.6, abs=1e-3)
    assert not top.intersects(shapely.box(-0.19, 0.21, 0.19, 0.79))
    _, whole, _, _ = fit_of(bare, Parametric())
    assert plan_of(whole.blocks, whole.turn).area == pytest.approx(1.8, abs=1e-6)


millimetres = st.integers(-1000, 1000), st.integers(100, 1000)
rectangles = st.tuples(*millimetres, *millimetres).map(lambda v: ((v[0] / 1000, (v[0] + v[1]) / 1000), (v[2] / 1000, (v[2] + v[3]) / 1000)))


@given(rectangles, st.lists(rectangles, max_size=3))
def test_what_is_cut_out_is_what_geometry_says(rectangle: tuple, holes: list[tuple]) -> None:
    def polygon(r: tuple) -> shapely.Geometry:
        (x0, x1), (y0, y1) = r
        return shapely.box(x0, y0, x1, y1)

    rest = [polygon(r) for r in cut_out(rectangle, holes)]
    expected = polygon(rectangle).difference(shapely.union_all([polygon(h) for h in holes]))
    assert sum(r.area for r in rest) == pytest.approx(expected.area, abs=1e-9)
    assert shapely.union_all(rest).symmetric_difference(expected).area == pytest.approx(0.0, abs=1e-9)


def test_legs_that_the_scan_lost_are_there() -> None:
    points = seen_surface([(-0.4, -0.7, 0.70, 0.4, 0.7, 0.73)], np.random.default_rng(6))
    # the box holds the top alone; the floor is 68 cm farther down
    request = request_of("table", points - [0, 0, 0.68], (0.8, 1.4, 0.05), 0.2, hidden_m=(0, 0, 0, 0, 0.68, 0))
    made = parametric_asset(request, Parametric())
    assert made.asset.extents[2] == pytest.approx(0.73, abs=1e-6)
    assert made.asset.pieces_blob is not None
    feet = [piece for piece in load_glb(made.files[made.asset.pieces_blob]) if piece.bounds[0][2] < 1e-6]
    assert len(feet) == 4
    assert {tuple(np.sign(foot.centroid[:2]).astype(int)) for foot in feet} == {(-1, -1), (-1, 1), (1, -1), (1, 1)}


# Refusals


@pytest.mark.whole
@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from(sorted(KINDS)), st.tuples(st.floats(0.9, 2.5), st.floats(0.9, 2.5), st.floats(0.7, 2.0)), st.integers(0, 2**32 - 1),
    st.booleans(),
)  # fmt: skip
def test_nothing_is_offered_for_what_has_no_form(category: str, size: tuple[float, float, float], seed: int, is_round: bool) -> None:
    rng = np.random.default_rng(seed)
    if is_round:  # a ball
        points = rng.normal(size=(1500, 3))
        points *= 0.5 * np.array(size) / np.linalg.norm(points, axis=1)[:, None]
    else:
        points = (rng.random((1500, 3)) - 0.5) * size
    with pytest.raises(NothingToOffer):
        parametric_asset(request_of(category, points + np.array([0, 0, 0.5 * size[2]]), size), Parametric())


def test_too_little_is_said() -> None:
    points = seen_surface(U_SOFA.boxes(), np.random.default_rng(0))
    with pytest.raises(NothingToOffer, match="40 points are too few to fit a sofa"):
        parametric_asset(request_of("sofa", points[:40], (1.8, 3.0, 0.8)), Parametric())
    with pytest.raises(NothingToOffer, match="no template of a lamp"):
        parametric_asset(request_of("lamp", points, (1.8, 3.0, 0.8)), Parametric())


@pytest.mark.parametrize(
    ("word", "kind"),
    [
        ("Couch", "sofa"), ("corner sofa", "sofa"), ("office desk", "desk"), ("kitchen counter", "kitchen counter"), ("lamp", None),
        ("refrigerator", None), ("widget", None),
    ],
)  # fmt: skip
def test_words_lead_to_templates(word: str, kind: str | None) -> None:
    assert kind_of(request_of(word, np.zeros((1, 3)), (1, 1, 1))) == kind


# Distances


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_points_are_thinned_to_as_many_as_asked_for(most: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(200, 3))
    kept = fit_target(points, np.array([2.0, 2.0, 2.0]), np.zeros(6, dtype=bool), 0.05, most).points
    assert 1 <= len(kept) <= most
    assert {tuple(p) for p in kept} <= {tuple(p) for p in points}


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_distances_are_those_of_an_independent_implementation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = np.array([1.0, 1.4, 0.9])
    points = (rng.random((120, 3)) - [0.5, 0.5, 0.0]) * size
    low = (rng.random((2, 3)) - [0.5, 0.5, 0.0]) * size * 0.5
    low[1] = low[0] + [0.5, 0.0, 0.0]  # side by side
    high = low + np.array([0.5, 0.4, 0.3])
    blocks = np.stack([low, high], axis=2).reshape(1, 2, 6)
    target = fit_target(points, size, np.zeros(6, dtype=bool), 0.05, 500)
    outside, _, covered, _ = misfits(target, blocks, np.array([2]))[0]
    expected = []
    for point in target.points:
        gaps = [np.linalg.norm(np.maximum(np.maximum(a - point, point - b), 0)) for a, b in zip(low, high, strict=True)]
        depths = [min((point - a).min(), (b - point).min()) for a, b in zip(low, high, strict=True)]
        expected.append(max(depths) if max(depths) >= 0 else min(gaps))
    assert outside == pytest.approx(np.minimum(expected, 0.15).mean(), abs=1e-9)
    assert covered == pytest.approx(np.mean(np.array(expected) <= 0.05), abs=1e-9)


def test_surface_that_nothing_could_see_does_not_count() -> None:
    size = np.array([1.0, 1.0, 1.0])
    blocks = np.array([[[-0.5, 0.5, -0.5, 0.5, 0.0, 1.0]]])
    points = seen_surface([(-0.5, -0.5, 0, 0.5, 0.5, 1)], np.random.default_rng(0), unseen=0)
    seen = misfits(fit_target(points, size, np.zeros(6, dtype=bool), 0.05, 500), blocks, np.array([1]))[0]
    known = misfits(fit_target(points, size, np.array([False, True, *[False] * 4]), 0.05, 500), blocks, np.array([1]))[0]
    assert seen[3] > 0.1
    assert known[3] == 0.0


def test_an_instance_of_a_halls_size_costs_no_more() -> None:
    size = np.array([40.0, 45.0, 30.0])
    target = fit_target(np.random.default_rng(0).random((2000, 3)) * size - [20.0, 22.5, 0.0], size, np.zeros(6, dtype=bool), 0.05, 500)
    assert target.field.size < 3_000_000


@given(rectangles, st.integers(0, 3))
def test_four_quarters_are_a_turn(rectangle: tuple, turn: int) -> None:
    back = turned_rectangle(turned_rectangle(rectangle, turn), -turn)
    assert np.allclose(back, rectangle)
    (x0, x1), (y0, y1) = rectangle
    block = turned(np.array([x0, x1, y0, y1, 0.0, 1.0]), turn)
    assert np.allclose(block[:4].reshape(2, 2), turned_rectangle(rectangle, turn))


# Beside other candidates


def color_boxes(boxes: Sequence[Bounds]) -> list[trimesh.Trimesh]:
    meshes = []
    for box in boxes:
        mesh = trimesh.creation.box(bounds=[box[:3], box[3:]])
        mesh.visual.vertex_colors = [90, 120, 60, 255]
        meshes.append(mesh)
    return meshes


def corner_desk() -> list[Bounds]:
    return [
        (-0.75, -0.85, 0.71, -0.1, 0.85, 0.74), (-0.1, 0.3, 0.71, 0.75, 0.85, 0.74), (0.3, 0.32, 0, 0.73, 0.83, 0.71),
        (-0.73, -0.83, 0, -0.15, -0.8, 0.71), (-0.73, -0.8, 0.3, -0.71, 0.83, 0.71),
    ]  # fmt: skip


@pytest.mark.whole
@pytest.mark.parametrize(
    ("category", "boxes"),
    [
        ("sofa", U_SOFA.boxes()),
        ("sofa", DrawnSofa((1,), 1.7, 2.6, 0.8, 0.9, 0.85, 0.42, 0.2, 0.2).boxes()),
        ("desk", corner_desk()),
        ("bookshelf", shelf_boxes((0.06, 0.5, 0.8, 1.15, 1.45))),
    ],
    ids=["U", "L", "desk", "shelf"],
)
def test_it_is_selected_before_slabs_and_crops(category: str, boxes: list[Bounds]) -> None:
    """Ten candidates by default: the one that was fitted is the choice, though the crop is the scan itself."""
    instance, files = scanned(1, category, color_boxes(boxes), 0.6)
    outcome = candidates_of((instance, files))
    blobs = {**files, **outcome.blobs}
    rows = outcome.rows["candidates"]
    assert [(row.provider, row.outcome) for row in rows if row.provider == "parametric"] == [("parametric", "filled")]
    context = Context("test/room", "selection", 3, blobs)
    chosen = selection.run(
        instances=[instance],
        candidates=rows,
        assets=outcome.rows["assets"],
        context=context,
        config=selection.SelectionConfig(provider=Geometric()),
    )
    best = chosen.rows["selections"][0]
    assert best.rank == 1
    assert next(row.provider for row in rows if row.slot == best.slot) == "parametric"


def test_a_slot_without_a_fit_has_the_generators_model() -> None:
    instance, files = scanned(1, "lamp", color_boxes([(-0.1, -0.1, 0, 0.1, 0.1, 0.4)]), 0.0)
    outcome = candidates_of((instance, files))
    row = next(row for row in outcome.rows["candidates"] if row.slot == 4)
    assert (row.provider, row.is_fallback, row.outcome, row.reason) == ("procedural", True, "filled", "no template of a lamp")


@pytest.mark.whole
@pytest.mark.parametrize(
    ("stem", "covered"),
    [
        ("aws_SofaB_01", 0.95),
        ("aws_ChairA_01", 0.95),
        ("aws_BalconyTable_01", 0.95),
        ("aws_ShoeRack_01", 0.9),
        ("aws_ReadingDesk_01", 0.85),
    ],
)
def test_furniture_that_others_modelled_is_met(realdata: Callable[[str], Path], stem: str, covered: float) -> None:
    """Points of a real model lie on what is offered, by the mesh and not by what the search says of itself."""
    from tasks.geometry.proximity import closest_points

    model = next(model for model in models_in(realdata("assets")) if model.stem == stem)
    parts = model.parts()
    crop = crop_of_parts(parts, seed=1, hidden=("bottom",))
    points, _, _ = sample_surface(crop, 4000, np.random.default_rng(0))
    request = request_of(model.category, points, model.extents, 0.5)
    _, fit, _, _ = fit_of(request, Parametric())
    made = parametric_asset(request, Parametric())
    surface = surface_of(load_glb(made.files[made.asset.mesh_blob]))
    apart = closest_points(surface.vertices, surface.faces, turned_back(points, fit.turn)).distance
    assert np.mean(apart <= 0.05) >= covered
