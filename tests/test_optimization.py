"""Optimization: boxes, what carries what, Algorithm 1 against a plain reading of it, and placements that follow."""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.capture import Instance, Room
from schemas.optimization import Contact, OptimizationStep, Placement, Support
from schemas.record import check
from schemas.selection import Selection
from tasks.boxes import aabb_iou, aabb_overlaps, aabb_penetrations, oriented_iou, oriented_overlap
from tasks.furniture import generate
from tasks.meshes import dump_glb, load_glb, surface_of
from tasks.optimization import MOVES, OptimizationConfig, Paper, collision_loss, replay, run
from tasks.optimization.collisions import Crowd, descend, outline, room_triangles, stacked
from tasks.optimization.heights import plan_view, underside
from tasks.optimization.supports import PlacedAsset, SupportConfig, allowed_shifts, find_carriers
from tasks.stage import Blobs, Context, Outcome
from tasks.transforms import flat, matrix, translation, yaw_pose
from tests.samples import START, sample

SCENE = "demo/room_a"
SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))
L_SHAPE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 0.0), (0.0, 0.0), (0.0, 2.0), (-2.0, 2.0))


def solid(*boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> list[trimesh.Trimesh]:
    """Boxes of (size, bottom center)."""
    parts = []
    for size, (x, y, z) in boxes:
        part = trimesh.creation.box(size)
        part.apply_translation([x, y, z + size[2] / 2])
        part.visual.vertex_colors = np.full((8, 4), 200, dtype=np.uint8)
        parts.append(part)
    return parts


def block(x: float, y: float, z: float) -> list[trimesh.Trimesh]:
    return solid(((x, y, z), (0, 0, 0)))


TABLE = solid(((1.2, 0.8, 0.04), (0, 0, 0.71)), *[((0.06, 0.06, 0.71), (x, y, 0)) for x in (-0.55, 0.55) for y in (-0.35, 0.35)])
SHELF = solid(*[((0.3, 0.8, 0.02), (0, 0, z)) for z in (0.02, 0.5, 1.0, 1.48)], *[((0.3, 0.02, 1.5), (0, y, 0)) for y in (-0.41, 0.41)])


class Scene:
    """A scene under construction: every object is an instance, an asset and its selection."""

    def __init__(self, polygon: tuple[tuple[float, float], ...] = SQUARE) -> None:
        self.blobs = Blobs()
        self.instances: list[Instance] = []
        self.selections: list[Selection] = []
        self.assets: dict[str, Asset] = {}
        self.annotations: list[Annotation] = []
        self.rooms = [sample(Room, scene_id=SCENE, floor_polygon=polygon, walls=(), interior_walls=(), height_m=2.5)]

    def asset(self, parts: Sequence[trimesh.Trimesh]) -> str:
        data = dump_glb(parts)
        asset_id = hashlib.sha256(data).hexdigest()
        self.assets[asset_id] = sample(
            Asset, asset_id=asset_id, mesh_blob=self.blobs.add(data, "glb"), is_watertight=all(p.is_watertight for p in parts)
        )
        return asset_id

    def add(
        self, parts: Sequence[trimesh.Trimesh], pose: np.ndarray, category: str = "thing", scale: tuple[float, ...] = (1.0, 1.0, 1.0)
    ) -> str:
        name = f"{len(self.instances):04d}"
        low, high = surface_of(parts).transformed(np.eye(4), scale).bounds
        box = pose @ translation((low + high) / 2)
        self.instances.append(
            sample(
                Instance,
                scene_id=SCENE,
                instance_id=name,
                category=category,
                is_structure=False,
                box_pose=flat(box),
                box_size=tuple(map(float, high - low)),
            )
        )
        self.selections.append(
            sample(Selection, scene_id=SCENE, instance_id=name, rank=1, slot=1, asset_id=self.asset(parts), pose=flat(pose), scale=scale)
        )
        return name

    def run(self, seed: int = 0, **method: Any) -> Outcome:
        context = Context(scene_id=SCENE, stage="optimization", seed=seed, blobs=self.blobs)
        outcome = run(
            instances=self.instances, selections=self.selections, rooms=self.rooms, assets=list(self.assets.values()),
            annotations=self.annotations, context=context, config=OptimizationConfig(method=Paper(**method)),
        )  # fmt: skip
        for table, record in (
            ("placements", Placement),
            ("supports", Support),
            ("contacts", Contact),
            ("optimization_steps", OptimizationStep),
        ):
            check(outcome.rows[table], record)
        return outcome


def placed(name: str, parts: Sequence[trimesh.Trimesh], pose: np.ndarray, category: str = "thing") -> PlacedAsset:
    return PlacedAsset.of(name, category, surface_of(parts).transformed(pose), watertight=True)


def bounds(outcome: Outcome, scene: Scene, phase: str) -> dict[str, np.ndarray]:
    """World boxes of the placed assets, from their GLBs and rows alone."""
    boxes = {}
    for row in outcome.rows["placements"]:
        pose = matrix(row.optimized_pose if phase == "optimized" else row.proposed_pose)
        boxes[row.instance_id] = surface_of(load_glb(scene.blobs[scene.assets[row.asset_id].mesh_blob])).transformed(pose, row.scale).bounds
    return boxes


# boxes


turns, sides, places = st.floats(-4, 4), st.floats(0.05, 3), st.floats(-1.5, 1.5)
oriented = st.tuples(turns, st.tuples(places, places, places), st.tuples(sides, sides, sides)).map(
    lambda b: (yaw_pose(b[0], b[1]), np.array(b[2]))
)


@given(a=oriented, b=oriented)
@settings(max_examples=150, deadline=None)
def test_oriented_iou_equals_clipping_by_another_library(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> None:
    from shapely import Polygon

    def ring(pose: np.ndarray, size: np.ndarray) -> Polygon:
        half = size[:2] / 2
        return Polygon([(pose @ [sx * half[0], sy * half[1], 0, 1])[:2] for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))])

    (pose_a, size_a), (pose_b, size_b) = a, b
    tops, bottoms = ([p[2, 3] + s * z[2] / 2 for p, z in (a, b)] for s in (1, -1))
    shared = ring(*a).intersection(ring(*b)).area * max(min(tops) - max(bottoms), 0)
    expected = shared / (size_a.prod() + size_b.prod() - shared)
    found = oriented_iou(pose_a, size_a, pose_b, size_b)
    assert found == pytest.approx(expected, abs=1e-9)
    assert found == pytest.approx(oriented_iou(pose_b, size_b, pose_a, size_a), abs=1e-12)
    assert 0.0 <= found <= 1.0
    assert oriented_iou(pose_a, size_a, pose_a, size_a) == pytest.approx(1.0)
    far = translation([300.0, -200.0, 10.0])
    assert oriented_iou(far @ pose_a, size_a, far @ pose_b, size_b) == pytest.approx(found, abs=1e-9)


@given(a=oriented, b=oriented)
@settings(max_examples=50, deadline=None)
def test_boxes_without_turn_have_the_same_overlap_as_axis_aligned_ones(a: Any, b: Any) -> None:
    flat_boxes = [(translation(pose[:3, 3]), size) for pose, size in (a, b)]
    corners = [(pose[:3, 3] - size / 2, pose[:3, 3] + size / 2) for pose, size in flat_boxes]
    low, high = (np.array([c[i] for c in corners]) for i in (0, 1))
    volume = oriented_overlap(*flat_boxes[0], *flat_boxes[1])
    assert aabb_overlaps(low, high)[0, 1] == pytest.approx(volume, abs=1e-9)
    assert oriented_iou(*flat_boxes[0], *flat_boxes[1]) == pytest.approx(aabb_iou(low[0], high[0], low[1], high[1]), abs=1e-9)
    depth = aabb_penetrations(low, high)[0, 1]
    assert (depth > 0) == (volume > 0)
    # moving one box by the penetration along the right axis parts them
    parted = [aabb_overlaps(np.array([low[0], low[1] + s * step]), np.array([high[0], high[1] + s * step]))[0, 1]
              for step in np.eye(3) * (depth + 1e-9) for s in (1, -1)]  # fmt: skip
    assert min(parted) == 0.0


def test_a_leaning_box_is_refused() -> None:
    leaning = matrix([1, 0, 0, 0, 0, 0.8, -0.6, 0, 0, 0.6, 0.8, 0, 0, 0, 0, 1])
    with pytest.raises(ValueError, match="about \\+Z"):
        oriented_iou(leaning, (1, 1, 1), np.eye(4), (1, 1, 1))


# Algorithm 1


def crowd_of(rng: np.random.Generator, n: int, polygon: tuple[tuple[float, float], ...] = (), spread: float = 1.8) -> Crowd:
    center, size = rng.uniform(-spread, spread, (n, 3)), rng.uniform(0.2, 1.0, (n, 3))
    center[:, 2] = size[:, 2] / 2
    low, high = center - size / 2, center + size / 2
    rings = [np.array([[a[0], a[1]], [b[0], a[1]], [b[0], b[1]], [a[0], b[1]]]) for a, b in zip(low, high, strict=True)]
    outlines, corners = stacked(rings)
    room = room_triangles(np.array(polygon)) if polygon else np.zeros((0, 3, 2))
    return Crowd(
        low=low, high=high, counted=~np.eye(n, dtype=bool), movable=np.ones(n, dtype=bool), carries=np.eye(n, dtype=bool),
        outlines=outlines, corners=corners, room=room, carrier=np.full(n, -1), shifts=np.ones((n, 1, 1), dtype=bool),
    )  # fmt: skip


def plain_descent(crowd: Crowd, polygon: Any, step: float, max_steps: int, rng: np.random.Generator) -> list[tuple[int, float, float, str]]:
    """Algorithm 1 as a person would write it down, with the whole loss computed anew at every step."""
    from shapely import Polygon

    room = Polygon(polygon) if polygon else None
    boxes = [(low.copy(), high.copy()) for low, high in zip(crowd.low, crowd.high, strict=True)]

    def loss() -> float:
        total = 0.0
        for i in range(len(boxes)):
            for j in range(i + 1, len(boxes)):
                overlap = [min(boxes[i][1][k], boxes[j][1][k]) - max(boxes[i][0][k], boxes[j][0][k]) for k in range(3)]
                if crowd.counted[i, j] and min(overlap) > 1e-6:
                    total += overlap[0] * overlap[1] * overlap[2]
        return total

    def outside(i: int) -> float:
        (x0, y0, _), (x1, y1, _) = boxes[i]
        return Polygon([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]).difference(room).area if room else 0.0

    movable = np.flatnonzero(crowd.movable)
    things, directions = movable[rng.integers(0, len(movable), max_steps)], rng.integers(0, 4, max_steps)
    smallest, trace = loss(), []
    for thing, direction in zip(things, directions, strict=True):
        if smallest == 0:
            break
        before = [(low.copy(), high.copy()) for low, high in boxes]
        was_outside = [outside(j) for j in range(len(boxes))]
        for j in np.flatnonzero(crowd.carries[thing]):
            boxes[j][0][:2] += MOVES[direction] * step
            boxes[j][1][:2] += MOVES[direction] * step
        if any(outside(j) > was_outside[j] + 1e-9 for j in np.flatnonzero(crowd.carries[thing])):
            boxes, outcome, now = before, "left_room", smallest
        else:
            now = loss()
            outcome = "kept" if now < smallest - 1e-12 else "reverted"
            boxes = boxes if outcome == "kept" else before
        smallest = min(smallest, now) if outcome == "kept" else smallest
        trace.append((int(thing), now, smallest, outcome))
    return trace


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("polygon", [(), SQUARE, L_SHAPE])
def test_the_compiled_loop_does_what_the_plain_one_does(seed: int, polygon: Any) -> None:
    rng = np.random.default_rng(seed)
    crowd = crowd_of(rng, 9, polygon)
    crowd.carries[0, 1] = crowd.carries[0, 2] = True  # thing 0 carries things 1 and 2
    crowd.counted[0, 1] = crowd.counted[1, 0] = False
    crowd.movable[3] = False
    trace = descend(crowd, 0.05, 400, np.random.default_rng(seed))
    plain = plain_descent(crowd, polygon, 0.05, 400, np.random.default_rng(seed))
    names = ("start", "kept", "reverted", "left_room", "left_support")
    found = list(zip(trace.things.tolist(), trace.loss.tolist(), trace.smallest.tolist(), [names[c] for c in trace.outcome], strict=True))
    assert len(found) > 20
    assert len(found) == len(plain) or trace.exhausted
    for one, other in zip(found, plain, strict=False):
        assert one[0] == other[0]
        assert one[3] == other[3]
        assert one[1:3] == pytest.approx(other[1:3], abs=1e-9)
    # what the compiled loop leaves out would have changed nothing
    assert all(outcome != "kept" for *_, outcome in plain[len(found) :])


@given(seed=st.integers(0, 10**6), n=st.integers(2, 15))
@settings(max_examples=40, deadline=None)
def test_the_loss_falls_and_is_that_of_the_poses(seed: int, n: int) -> None:
    crowd = crowd_of(np.random.default_rng(seed), n, L_SHAPE, spread=1.0)
    trace = descend(crowd, 0.05, 3000, np.random.default_rng(seed))
    levels = np.concatenate([[trace.start], trace.smallest])
    assert (np.diff(levels) <= 0).all()
    assert (np.diff(levels)[trace.outcome == 1] < 0).all()
    assert (np.diff(levels)[trace.outcome != 1] == 0).all()
    offset = np.column_stack([trace.moved * 0.05, np.zeros(n)])
    assert collision_loss(crowd.low + offset, crowd.high + offset, crowd.counted) == pytest.approx(trace.final, abs=1e-9)
    assert trace.final == 0 or trace.exhausted or len(trace.loss) == 3000
    if trace.exhausted:
        for i in range(n):
            for move in MOVES:
                tried = offset.copy()
                tried[i, :2] += move * 0.05
                low, high = crowd.low + tried, crowd.high + tried
                inside = _outside(low[i], high[i]) <= _outside(crowd.low[i] + offset[i], crowd.high[i] + offset[i]) + 1e-9
                assert not inside or collision_loss(low, high, crowd.counted) >= trace.final - 1e-9


def _outside(low: np.ndarray, high: np.ndarray) -> float:
    from shapely import Polygon, box

    return float(box(*low[:2], *high[:2]).difference(Polygon(L_SHAPE)).area)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_nothing_gets_farther_out_of_the_room(seed: int) -> None:
    crowd = crowd_of(np.random.default_rng(seed), 8, L_SHAPE)
    trace = descend(crowd, 0.05, 3000, np.random.default_rng(seed))
    for i, shift in enumerate(trace.moved * 0.05):
        before, after = _outside(crowd.low[i], crowd.high[i]), _outside(crowd.low[i] + [*shift, 0], crowd.high[i] + [*shift, 0])
        assert after <= before + 1e-8


def test_it_stops_at_zero_and_does_not_start_there() -> None:
    two = crowd_of(np.random.default_rng(0), 2)
    apart = dataclasses.replace(two, low=np.array([[0.0, 0, 0], [1, 0, 0]]), high=np.array([[1.0, 1, 1], [2, 1, 1]]))
    assert len(descend(apart, 0.05, 100, np.random.default_rng(0)).loss) == 0  # they only touch
    close = dataclasses.replace(apart, low=np.array([[0.0, 0, 0], [0.93, 0, 0]]))
    trace = descend(close, 0.05, 1000, np.random.default_rng(0))
    assert trace.loss[-1] == 0.0
    assert trace.final == 0.0
    assert (trace.loss[:-1] > 0).all()
    assert (trace.outcome == 1).sum() >= 2


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=3, max_size=60))
@settings(max_examples=40, deadline=None)
def test_outlines_are_hulls(points: list[tuple[float, float]]) -> None:
    from shapely import MultiPoint, Polygon

    ring = outline(np.array(points))
    hull = MultiPoint(points).convex_hull
    assert 3 <= len(ring) <= 32
    if hull.area > 1e-3:
        assert Polygon(ring).area == pytest.approx(hull.area, rel=0.02)
        assert Polygon(ring).exterior.is_ccw
    assert sum(np.linalg.det([t[1] - t[0], t[2] - t[0]]) / 2 for t in room_triangles(np.array(L_SHAPE))) == pytest.approx(12.0)


def test_a_full_room_takes_milliseconds() -> None:
    crowd = crowd_of(np.random.default_rng(3), 39, L_SHAPE, spread=2.5)
    descend(crowd, 0.05, 10, np.random.default_rng(0))
    clock = time.process_time()
    trace = descend(crowd, 0.05, 10_000, np.random.default_rng(0))
    assert len(trace.loss) > 1000
    assert time.process_time() - clock < 0.25  # 10 to 20 ms where nothing else runs


# plan views and supports


@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.3, 0.3), ceiling=st.floats(-0.1, 2.0))
@settings(max_examples=40, deadline=None)
def test_a_plan_view_equals_rays_from_above(x: float, y: float, ceiling: float) -> None:
    """The highest surface below the ceiling, board by board."""
    surface = surface_of(SHELF)
    view = plan_view(surface, [x - 0.02, y - 0.02], [x + 0.02, y + 0.02], ceiling, 0.01)
    cells = np.argwhere(np.ones(view.heights.shape)) + np.array(view.first)
    for cell, height in zip(cells, view.at(cells), strict=True):
        cx, cy = (cell + 0.5) * 0.01
        on_board, on_side = abs(cx) < 0.15 and abs(cy) < 0.4, abs(cx) < 0.15 and abs(abs(cy) - 0.41) < 0.01
        if min(abs(abs(cx) - 0.15), abs(abs(cy) - 0.4), abs(abs(cy) - 0.42)) < 1e-6:
            continue
        levels = [z for b in (0.02, 0.5, 1.0, 1.48) for z in (b, b + 0.02)] if on_board else [0.0, 1.5] if on_side else []
        assert (
            height == pytest.approx(max([z for z in levels if z <= ceiling], default=-np.inf), abs=1e-9)
            or min(abs(z - ceiling) for z in levels) < 1e-6
        )


def test_the_underside_of_a_table_is_its_feet_and_its_top() -> None:
    _, heights = underside(surface_of(TABLE), 0.01)
    assert (heights < 0.01).sum() == pytest.approx(4 * 36, abs=30)
    assert (np.abs(heights - 0.71) < 0.01).sum() == pytest.approx(120 * 80 - 4 * 36, rel=0.03)
    assert len(underside(surface_of(block(0.001, 0.001, 0.001)), 0.01)[0]) == 1


SMALL, STOOL, MAT, FRAME = block(0.1, 0.1, 0.1), block(0.4, 0.4, 0.5), block(1.5, 1, 0.02), block(0.04, 0.5, 0.5)
SOFA = placed("0001", block(0.9, 2, 0.8), translation([-1.5, 0, 0]))
BELOW = placed("0001", TABLE, np.eye(4))


def small(x: float, y: float, z: float, parts: Sequence[trimesh.Trimesh] = SMALL, category: str = "thing") -> PlacedAsset:
    return placed("0000", parts, translation([x, y, z]), category)


CARRIED: dict[str, tuple[list[PlacedAsset], tuple[str, str | None, float]]] = {
    "on the floor, a little above it": ([small(0, 0, 0.04, TABLE)], ("floor", None, 0.04)),
    "in the floor": ([small(0, 0, -0.06, TABLE)], ("floor", None, -0.06)),
    "on a table": ([small(0.3, 0, 0.8), BELOW], ("on", "0001", 0.05)),
    "sunk into a table": ([small(0.3, 0, 0.7), BELOW], ("on", "0001", -0.05)),
    "on a board of a shelf": ([small(0, 0.2, 1.05), placed("0001", SHELF, np.eye(4))], ("on", "0001", 0.03)),
    "over the edge of a table": ([small(0.64, 0, 0.75), BELOW], ("none", None, 0.75)),
    "on a table that is too high": ([small(0, 0, 0.83), placed("0001", TABLE, translation([0, 0, 0.05]))], ("on", "0001", 0.03)),
    "under a table": ([small(0, 0, 0, STOOL), BELOW], ("floor", None, 0.0)),
    "on a rug with all feet": ([small(0, 0, 0, STOOL), placed("0001", MAT, np.eye(4))], ("on", "0001", -0.02)),
    "on a rug with a third": ([small(0.82, 0, 0, STOOL), placed("0001", MAT, np.eye(4))], ("floor", None, 0.0)),
    "the larger of two flat things carries": (
        [small(0, 0, 0.01, block(0.4, 0.3, 0.03)), placed("0001", block(0.6, 0.5, 0.03), np.eye(4))],
        ("on", "0001", -0.02),
    ),
    "deep in a block": ([small(0, 0, 0.9), placed("0001", block(1, 1, 0.6), translation([0, 0, 0.8]))], ("none", None, 0.9)),
    "on legs that were not scanned": ([small(0, 0, 0.3)], ("floor", None, 0.3)),
    "on the wall": ([small(-1.95, 0, 1.2, FRAME, "picture")], ("wall", None, 0.0)),
    "on the wall above a sofa's back": ([small(-1.95, 0, 0.85, FRAME, "picture"), SOFA], ("wall", None, 0.0)),
    "a picture that stands": ([small(-1.95, 0, 0.81, FRAME, "picture"), SOFA], ("on", "0001", 0.01)),
    "under the ceiling": ([small(0, 0, 2.15, block(0.4, 0.4, 0.3), "lamp")], ("ceiling", None, 0.0)),
    "in the air": ([small(0, 0, 1.0, block(0.4, 0.4, 0.3))], ("none", None, 1.0)),
}


@pytest.mark.parametrize("name", CARRIED)
def test_what_carries_a_thing(name: str) -> None:
    things, (relation, parent, gap) = CARRIED[name]
    room = sample(Room, scene_id=SCENE, floor_polygon=SQUARE, walls=(), interior_walls=(), height_m=2.5)
    for order in (things, things[::-1]):
        found = find_carriers(order, room, SupportConfig())["0000"]
        assert (found.relation, found.parent_id) == (relation, parent)
        assert found.gap == pytest.approx(gap, abs=1e-6)
    below = find_carriers(things, room, SupportConfig()).get(parent or "")
    expected = (-gap if relation in ("on", "floor") else 0.0) + (below.lift if below else 0.0)
    assert find_carriers(things, room, SupportConfig())["0000"].lift == pytest.approx(expected, abs=1e-6)


@given(seed=st.integers(0, 10**6), n=st.integers(1, 8))
@settings(max_examples=40, deadline=None)
def test_nothing_carries_itself_and_what_is_carried_rests(seed: int, n: int) -> None:
    """Piles of flat blocks, thrown together: no circle, and every rested bottom is at its carrier's top or on the floor."""
    rng = np.random.default_rng(seed)
    pile = []
    for i in range(n):
        pose = yaw_pose(rng.uniform(0, 3), [*rng.uniform(-0.3, 0.3, 2), rng.uniform(0, 0.3)])
        pile.append(placed(f"{i:04d}", block(*rng.uniform(0.1, 0.6, 2), rng.uniform(0.02, 0.15)), pose))
    carriers = find_carriers(pile, None, SupportConfig())
    by_id = {p.instance_id: p for p in pile}
    for name, carrier in carriers.items():
        seen, above = {name}, carrier.parent_id
        while above is not None:
            assert above not in seen
            seen.add(above)
            above = carriers[above].parent_id
        rested = by_id[name].low[2] + carrier.lift
        if carrier.relation == "floor":
            assert rested == pytest.approx(0.0, abs=1e-9)
        if carrier.relation == "on":
            assert rested == pytest.approx(by_id[carrier.parent_id].high[2] + carriers[carrier.parent_id].lift, abs=1e-9)


def test_a_carried_thing_may_go_where_its_carrier_is_and_nowhere_else() -> None:
    mug, table = placed("0000", block(0.1, 0.1, 0.1), translation([0, 0, 0.75])), placed("0001", TABLE, np.eye(4))
    allowed = allowed_shifts(mug, table, 0.0, 0.05, 16, SupportConfig())
    for i, j in np.ndindex(allowed.shape):
        x, y = (i - 16) * 0.05, (j - 16) * 0.05
        if min(abs(abs(x) - 0.6), abs(abs(y) - 0.4)) > 0.06:
            assert allowed[i, j] == (abs(x) < 0.6 and abs(y) < 0.4)
    book, shelf = placed("0000", block(0.1, 0.1, 0.2), translation([0, 0.1, 1.02])), placed("0001", SHELF, np.eye(4))
    inside = allowed_shifts(book, shelf, 0.0, 0.05, 16, SupportConfig())
    assert inside[16, 16 - 8 : 16 + 5].all()  # along the board, up to its sides
    assert not inside[16, 16 + 6]  # not into the side
    assert not inside[16 + 5].any()  # not off the board


# the stage


def room_scene() -> Scene:
    """A table that a cabinet was scanned into, with a mug on it; a shelf with a book in it; a picture; a rug."""
    scene = Scene()
    scene.add(TABLE, yaw_pose(0.0, [0.0, 0.0, 0.03]), "table")
    scene.add(block(0.1, 0.08, 0.12), yaw_pose(0.4, [0.3, 0.1, 0.81]), "mug")
    scene.add(block(0.5, 0.5, 0.9), yaw_pose(0.0, [0.7, 0.1, 0.0]), "cabinet")
    scene.add(SHELF, yaw_pose(0.0, [-1.8, 0.0, 0.0]), "shelf")
    scene.add(block(0.1, 0.2, 0.2), yaw_pose(0.0, [-1.8, 0.2, 0.56]), "book")
    scene.add(block(0.03, 0.5, 0.5), yaw_pose(0.0, [1.97, 0.0, 1.3]), "picture")
    scene.add(block(2.0, 1.0, 0.01), yaw_pose(0.1, [0.0, -1.2, 0.0]), "rug")
    return scene


def test_a_room_is_put_to_rest_and_apart() -> None:
    scene = room_scene()
    outcome = scene.run()
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    supports = {row.instance_id: (row.relation, row.parent_id) for row in outcome.rows["supports"]}
    table, mug, cabinet, shelf, book, picture, rug = sorted(rows)
    assert supports[mug] == ("on", table)
    assert supports[book] == ("on", shelf)
    assert supports[picture] == ("wall", None)
    assert supports[cabinet][0] == "floor"
    assert supports[rug] == ("floor", None)
    boxes = bounds(outcome, scene, "optimized")
    assert boxes[mug][0, 2] == pytest.approx(boxes[table][1, 2], abs=1e-6)
    assert boxes[book][0, 2] == pytest.approx(0.52, abs=1e-6)
    assert boxes[cabinet][0, 2] == pytest.approx(0.0, abs=1e-9)
    assert boxes[table][0, 2] == pytest.approx(0.0, abs=1e-9)
    assert rows[picture].lift_m == rows[picture].displacement_m == rows[rug].displacement_m == 0.0
    assert outcome.rows["optimization_steps"][-1].smallest_loss == 0.0
    assert not [text for text in outcome.degradations if "loss" in text]
    moves = {name: matrix(row.optimized_pose)[:2, 3] - matrix(row.proposed_pose)[:2, 3] for name, row in rows.items()}
    relative = moves[mug] - moves[table]
    assert np.allclose(relative, np.round(relative / 0.05) * 0.05, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_replaying_the_kept_moves_gives_the_optimized_poses(seed: int) -> None:
    scene = room_scene()
    scene.add(TABLE, yaw_pose(0.1, [0.1, 0.0, 0.0]), "table")
    outcome = scene.run(seed)
    poses = replay(outcome.rows["placements"], outcome.rows["supports"], outcome.rows["optimization_steps"])
    assert any(row.outcome == "kept" for row in outcome.rows["optimization_steps"])
    for row in outcome.rows["placements"]:
        assert np.allclose(poses[row.instance_id], matrix(row.optimized_pose), atol=1e-9)
        moved = matrix(row.optimized_pose)[:3, 3] - matrix(row.proposed_pose)[:3, 3]
        assert row.displacement_m == pytest.approx(np.hypot(*moved[:2]), abs=1e-9)
        assert row.lift_m == pytest.approx(moved[2], abs=1e-9)


def test_contacts_are_the_overlaps_of_the_boxes_before_and_after() -> None:
    scene = room_scene()
    outcome = scene.run()
    for phase in ("proposed", "optimized"):
        boxes = bounds(outcome, scene, phase)
        names = sorted(boxes)
        expected = {}
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                reach = np.minimum(boxes[a][1], boxes[b][1]) - np.maximum(boxes[a][0], boxes[b][0])
                if reach.min() > 2e-6:
                    expected[a, b] = reach.prod()
        found = {(c.instance_a, c.instance_b): c.overlap_m3 for c in outcome.rows["contacts"] if c.phase == phase}
        assert set(found) == set(expected)
        assert all(found[pair] == pytest.approx(volume, rel=1e-3, abs=1e-6) for pair, volume in expected.items())


def test_the_same_scene_gives_the_same_rows_in_any_order_and_other_seeds_others() -> None:
    scene = room_scene()
    scene.add(TABLE, yaw_pose(0.1, [0.1, 0.0, 0.0]), "table")
    first = scene.run(1)
    for rows in (scene.instances, scene.selections):
        rows.reverse()
    scene.assets = dict(reversed(scene.assets.items()))
    second = scene.run(1)
    assert first.rows == second.rows
    assert first.degradations == second.degradations
    assert scene.run(2).rows["optimization_steps"] != first.rows["optimization_steps"]


def test_step_zero_is_the_state_at_rest() -> None:
    scene = room_scene()
    steps = scene.run(max_steps=0).rows["optimization_steps"]
    assert [(s.step, s.outcome, s.instance_id) for s in steps] == [(0, "start", None)]
    assert steps[0].loss == scene.run().rows["optimization_steps"][0].loss > 0


def test_nothing_gives_way_to_a_rug_or_to_what_it_stands_in() -> None:
    scene = Scene()
    scene.add(block(1.5, 1.0, 0.02), np.eye(4), "rug")
    scene.add(block(0.4, 0.4, 0.5), translation([0.85, 0.0, 0.0]), "stool")  # a quarter of it on the rug
    scene.add(SHELF, translation([-1.5, 0.0, 0.0]), "shelf")
    scene.add(block(0.1, 0.2, 0.2), translation([-1.5, 0.1, 0.52]), "book")
    outcome = scene.run()
    assert [step.loss for step in outcome.rows["optimization_steps"]] == [0.0]
    assert {(c.instance_a, c.instance_b) for c in outcome.rows["contacts"]} == {("0000", "0001"), ("0002", "0003")}


def test_what_cannot_be_parted_is_said() -> None:
    scene = Scene(((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)))
    for _ in range(2):
        scene.add(block(0.9, 0.9, 0.5), np.eye(4))
    assert any("no single move lowers it" in text for text in scene.run().degradations)
    assert any("3 steps were not enough" in text for text in scene.run(max_steps=3).degradations)


def test_an_empty_scene_is_no_error() -> None:
    outcome = Scene().run()
    assert [len(rows) for rows in outcome.rows.values()] == [0, 0, 0, 1]


def annotated(scene: Scene, name: str, parts: Sequence[trimesh.Trimesh] | None, **values: Any) -> Annotation:
    instance = next(i for i in scene.instances if i.instance_id == name)
    given = {
        "scene_id": SCENE, "instance_id": name, "annotator": "ada", "answered_at": START, "batch_id": "b1", "ranking": (),
        "pose": None, "scale": None,
        "choice": scene.asset(parts) if parts is not None else None, "box_pose": instance.box_pose, "box_size": instance.box_size,
    }  # fmt: skip
    scene.annotations.append(sample(Annotation, **(given | values)))
    return scene.annotations[-1]


def test_a_persons_choice_comes_first() -> None:
    scene = Scene()
    name = scene.add(block(0.5, 0.5, 0.5), yaw_pose(0.3, [1, 0, 0]))
    pose = yaw_pose(1.0, [0.9, 0.1, 0.02])
    annotated(scene, name, TABLE, pose=flat(pose), scale=(1.0, 0.9, 1.0))
    row = scene.run().rows["placements"][0]
    assert (row.origin, row.annotator, row.annotation_match) == ("annotation", "ada", "same_box")
    assert row.asset_id == scene.annotations[0].choice
    assert np.allclose(row.proposed_pose, flat(pose))
    assert row.scale == (1.0, 0.9, 1.0)
    assert matrix(row.optimized_pose)[2, 3] == pytest.approx(0.0, abs=1e-9)


def test_a_choice_without_a_transform_is_placed_as_aligned() -> None:
    scene = Scene()
    name = scene.add(block(0.5, 0.5, 0.5), yaw_pose(0.3, [1, 0, 0]))
    other = scene.asset(TABLE)
    aligned = sample(
        Selection,
        scene_id=SCENE,
        instance_id=name,
        rank=2,
        slot=2,
        asset_id=other,
        pose=flat(yaw_pose(0.7, [1.1, 0, 0])),
        scale=(0.5, 0.5, 0.7),
    )
    scene.selections.append(aligned)
    annotated(scene, name, TABLE)
    row = scene.run().rows["placements"][0]
    assert (row.origin, row.asset_id, row.proposed_pose, row.scale) == ("annotation", other, aligned.pose, aligned.scale)


def test_annotations_are_found_again_after_a_recapture_or_orphaned() -> None:
    """Instances are numbered anew: what was 0000 is 0001 now, its box a little off; the other one is gone."""
    scene = Scene()
    for x in (-1.0, 1.0):
        scene.add(block(0.5, 0.5, 0.5), translation([x, 0, 0]))
    row = annotated(scene, "0000", TABLE, pose=flat(translation([1, 0, 0])), scale=(0.5, 0.5, 0.5))
    moved = flat(matrix(scene.instances[1].box_pose) @ yaw_pose(0.1, [0.03, 0.02, 0.01]))
    scene.annotations = [
        dataclasses.replace(row, box_pose=moved),
        dataclasses.replace(row, batch_id="b2", annotator="bob", box_pose=flat(translation([0, 1.5, 0.2]))),
    ]
    outcome = scene.run()
    first, second = outcome.rows["placements"]
    assert (first.origin, first.annotator, first.annotation_match) == ("selection", None, None)
    assert (second.origin, second.annotator, second.annotation_match) == ("annotation", "ada", "box_iou")
    assert [text for text in outcome.degradations if "orphaned" in text and "bob" in text and "b2" in text]
    assert len([text for text in outcome.degradations if "orphaned" in text]) == 1


def test_what_stands_in_is_said() -> None:
    scene = Scene()
    kept, gone, bare, broken = (scene.add(block(0.3, 0.3, 0.3 + i / 10), translation([i - 1.5, 0, 0])) for i in range(4))
    annotated(scene, kept, None)
    annotated(scene, gone, None, choice="e" * 64, pose=flat(np.eye(4)), scale=(1.0, 1.0, 1.0))
    scene.selections = [s for s in scene.selections if s.instance_id != bare]
    asset = next(s.asset_id for s in scene.selections if s.instance_id == broken)
    scene.assets[asset] = dataclasses.replace(scene.assets[asset], mesh_blob=scene.blobs.add(b"no mesh", "glb"))
    outcome = scene.run()
    assert [(row.instance_id, row.origin) for row in outcome.rows["placements"]] == [(kept, "selection"), (gone, "selection")]
    for name, word in (
        (kept, "no candidate fits"),
        (gone, "no candidate any more"),
        (bare, "no candidate could be used"),
        (broken, "cannot be read"),
    ):
        assert any(text.startswith(name) and word in text for text in outcome.degradations), (name, outcome.degradations)


def test_without_a_room_it_is_said_and_done_all_the_same() -> None:
    scene = room_scene()
    scene.rooms = []
    outcome = scene.run()
    assert len(outcome.rows["placements"]) == 7
    assert any("no room is known" in text for text in outcome.degradations)


@pytest.mark.parametrize("seed", range(2))
def test_generated_furniture_comes_to_rest_without_collisions(seed: int) -> None:
    """A desk with things on it, chairs and cabinets, scanned a few centimetres off."""
    rng = np.random.default_rng(seed)
    scene = Scene(((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)))
    desk = generate("desk", (0.7, 1.4, 0.75), rng)
    scene.add(desk.parts, yaw_pose(0.0, [-2.0, 0.0, 0.02]), "desk")
    for category, y in (("monitor", 0.1), ("mug", -0.5), ("keyboard", 0.6)):
        model = generate(category, None, rng)
        scene.add(model.parts, yaw_pose(rng.uniform(-0.2, 0.2), [-2.0, y, 0.75 + rng.uniform(-0.04, 0.06)]), category)
    for category in ("chair", "cabinet", "bookshelf", "sofa", "stool", "bed", "nightstand"):
        model = generate(category, None, rng)
        scene.add(model.parts, yaw_pose(rng.uniform(-3, 3), [*rng.uniform(-1.5, 1.5, 2), rng.uniform(-0.05, 0.05)]), category)
    outcome = scene.run(seed)
    relations = {row.instance_id: (row.relation, row.parent_id) for row in outcome.rows["supports"]}
    assert all(relations[f"{i:04d}"] == ("on", "0000") for i in (1, 2, 3)), relations
    assert all(relations[f"{i:04d}"][0] in ("floor", "on") for i in range(4, 11)), relations
    steps = outcome.rows["optimization_steps"]
    assert steps[-1].smallest_loss < 0.25 * steps[0].loss
    boxes = bounds(outcome, scene, "optimized")
    for name in ("0001", "0002", "0003"):
        assert (boxes[name][0, :2] + boxes[name][1, :2] >= 2 * boxes["0000"][0, :2]).all()
        assert (boxes[name][0, :2] + boxes[name][1, :2] <= 2 * boxes["0000"][1, :2]).all()
        assert boxes[name][0, 2] == pytest.approx(boxes["0000"][1, 2], abs=0.03)


@pytest.mark.parametrize("values", [{"step_m": 0.0}, {"step_m": -0.05}, {"step_m": float("nan")}, {"max_steps": -1}, {"shift_reach": -1}])
def test_a_method_that_cannot_be_is_refused(values: dict[str, float]) -> None:
    (field,) = values
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        Paper(**values)  # type: ignore[arg-type]
    assert Paper(max_steps=0, shift_reach=0).max_steps == 0


@pytest.mark.parametrize("values", [{"cell_m": 0.0}, {"base_m": 0.0}, {"reach_m": -0.1}, {"share": 1.5}, {"rest_quantile": float("nan")}])
def test_supports_that_cannot_be_are_refused(values: dict[str, float]) -> None:
    (field,) = values
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        SupportConfig(**values)  # type: ignore[arg-type]
