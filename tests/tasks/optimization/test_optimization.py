"""Optimization: placements that rest, stay apart and follow from their steps, by both methods, whatever comes in."""

from __future__ import annotations

import dataclasses
import hashlib
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, QhullError

from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Shell
from schemas.optimization import APPLIED, Certificate, Contact, Optimization, OptimizationStep, Placement, Support
from schemas.record import arrow_to_rows, check, rows_to_arrow
from schemas.selection import Selection
from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb, load_glb, surface_of
from tasks.geometry.pieces import Hull, PieceConfig, pieces
from tasks.geometry.transforms import flat, matrix, translation, yaw_pose
from tasks.optimization import STAGE, Default, OptimizationConfig, Paper, SupportConfig, replayed_poses, run
from tasks.shell import room_shell
from tasks.stage import Blobs, Context, Outcome, in_turn
from tests.samples import START, sample

SCENE = "demo/room_a"
SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))
DEEP_M, TOUCH_M = 0.002, 1e-6
RECORDS = {
    "placements": Placement, "supports": Support, "contacts": Contact, "optimization_steps": OptimizationStep,
    "optimizations": Optimization, "certificates": Certificate,
}  # fmt: skip
METHODS = pytest.mark.parametrize("method", [Paper(), Default()], ids=["paper", "default"])


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
CHAIR = solid(
    ((0.42, 0.42, 0.04), (0, 0, 0.41)), ((0.04, 0.42, 0.4), (-0.19, 0, 0.45)),
    *[((0.04, 0.04, 0.41), (x, y, 0)) for x in (-0.19, 0.19) for y in (-0.19, 0.19)],
)  # fmt: skip
SOFA = solid(((0.9, 2.0, 0.45), (0, 0, 0)), ((0.2, 2.0, 0.4), (-0.35, 0, 0.45)))


class Scene:
    """A scene under construction: every object is an instance, its caption, an asset and its selection."""

    def __init__(self, polygon: tuple[tuple[float, float], ...] = SQUARE) -> None:
        self.blobs = Blobs()
        self.instances: list[Instance] = []
        self.captions: list[Caption] = []
        self.selections: list[Selection] = []
        self.assets: dict[str, Asset] = {}
        self.annotations: list[Annotation] = []
        self.shells = [sample(Shell, scene_id=SCENE, floor_polygon=polygon, walls=(), interior_walls=(), height_m=2.5)]

    def asset(self, parts: Sequence[trimesh.Trimesh], known: Sequence[trimesh.Trimesh] = ()) -> str:
        """An asset's id. known: the convex pieces that it was made of."""
        data = dump_glb(parts)
        asset_id = hashlib.sha256(data).hexdigest()
        self.assets[asset_id] = sample(
            Asset, asset_id=asset_id, mesh_blob=self.blobs.add(data, "glb"), is_watertight=all(p.is_watertight for p in parts),
            pieces_blob=self.blobs.add(dump_glb(known), "glb") if known else None,
        )  # fmt: skip
        return asset_id

    def add(
        self, parts: Sequence[trimesh.Trimesh], pose: np.ndarray, category: str = "thing", scale: tuple[float, ...] = (1.0, 1.0, 1.0),
        known: Sequence[trimesh.Trimesh] = (),
    ) -> str:  # fmt: skip
        name = f"{len(self.instances):04d}"
        low, high = surface_of(parts).transformed(np.eye(4), scale).bounds
        of = {"scene_id": SCENE, "instance_id": name}
        self.instances.append(
            sample(
                Instance, **of, category=category, is_structure=False, box_pose=flat(pose @ translation((low + high) / 2)),
                box_size=tuple(map(float, high - low)),
            )
        )  # fmt: skip
        mass = max(150.0 * float(np.prod(high - low)), 0.05)
        self.captions.append(sample(Caption, **of, materials=("wood",), mass_kg=mass, friction=0.6))
        self.selections.append(sample(Selection, **of, rank=1, slot=1, asset_id=self.asset(parts, known), pose=flat(pose), scale=scale))
        return name

    def reversed(self) -> Scene:
        for rows in (self.instances, self.captions, self.selections):
            rows.reverse()
        self.assets = dict(reversed(self.assets.items()))
        return self

    def run(self, method: Paper | Default | None = None, seed: int = 0, spread: Callable[..., list[Any]] = in_turn) -> Outcome:
        """What the stage gives; every row passes its schema, and the tables agree with each other."""
        context = Context(scene_id=SCENE, stage="optimization", seed=seed, blobs=self.blobs, spread=spread)
        outcome = run(
            instances=self.instances, captions=self.captions, selections=self.selections, shells=self.shells,
            assets=list(self.assets.values()), annotations=self.annotations, context=context,
            config=OptimizationConfig(method=method or Default()),
        )  # fmt: skip
        assert tuple(outcome.rows) == STAGE.writes
        for table, record in RECORDS.items():
            check(outcome.rows[table], record)
        agree(outcome)
        return outcome


def agree(outcome: Outcome) -> None:
    """What must hold of the rows of any scene: loss and contacts say the same, and what is wrong is said."""
    (summary,) = outcome.rows["optimizations"]
    steps, contacts = outcome.rows["optimization_steps"], outcome.rows["contacts"]
    placements = {row.instance_id: row for row in outcome.rows["placements"]}
    assert {row.instance_id for row in outcome.rows["supports"]} == set(placements)
    assert {row.instance_id for row in outcome.rows["certificates"]} == set(placements)
    assert (summary.object_count, summary.loss_start) == (len(placements), steps[0].loss)
    assert [step.step for step in steps] == sorted({step.step for step in steps})
    losses = [step.smallest_loss for step in steps]
    assert losses == sorted(losses, reverse=True)
    deep = [c for c in contacts if c.phase == "optimized" and c.penetration_m > DEEP_M and not c.is_allowed]
    assert summary.deep_pairs == len(deep)
    if summary.method == "default":
        assert (summary.loss_final == 0.0) == (summary.ended in ("zero_loss", "nothing_to_do"))
        assert not (summary.loss_final == 0.0 and deep), deep
    for contact in deep:
        for name in {contact.instance_a, contact.body_b} & set(placements):
            other = contact.body_b if name == contact.instance_a else contact.instance_a
            assert f" cm in {other}" in (placements[name].remains or ""), contact
    for name, row in placements.items():
        assert row.remains is None or f"{name}: {row.remains}" in summary.remains
    assert all(text in outcome.degradations for text in summary.remains)
    for row in outcome.rows["certificates"]:
        is_unstable = row.problem is not None or not (row.is_stable_1cm and row.is_stable_5cm and row.is_stable_nudged)
        said = [line for line in summary.remains if line.startswith(f"{row.instance_id}: ") and f"({row.engine})" in line]
        assert bool(said or row.problem) == is_unstable, "all that is unstable is named, and nothing else"
        assert not is_unstable or placements[row.instance_id].remains
    settled = {row.instance_id: row for row in outcome.rows["certificates"] if row.engine == "mujoco"}
    for name, row in placements.items():
        assert row.settled_pose == settled[name].settled_pose
        moved = np.linalg.norm(matrix(row.settled_pose)[:3, 3] - matrix(row.optimized_pose)[:3, 3])
        assert settled[name].displacement_m == pytest.approx(moved, abs=1e-9)


def poses_of(outcome: Outcome, phase: str = "optimized") -> dict[str, np.ndarray]:
    return {row.instance_id: matrix(getattr(row, f"{phase}_pose")) for row in outcome.rows["placements"]}


def hulls_of(outcome: Outcome, scene: Scene, phase: str) -> dict[str, list[Hull]]:
    """Convex pieces of the placed assets in the world frame, made anew from their GLBs and the rows."""
    poses = poses_of(outcome, phase)
    made = {}
    for row in outcome.rows["placements"]:
        parts = load_glb(scene.blobs[scene.assets[row.asset_id].mesh_blob])
        hulls = pieces(parts, None, PieceConfig()).hulls
        made[row.instance_id] = [hull.transformed(np.eye(4), row.scale).transformed(poses[row.instance_id]) for hull in hulls]
    return made


def bounds(outcome: Outcome, scene: Scene, phase: str = "optimized") -> dict[str, np.ndarray]:
    """World boxes of the placed assets, from their GLBs and rows alone."""
    boxes, poses = {}, poses_of(outcome, phase)
    for row in outcome.rows["placements"]:
        surface = surface_of(load_glb(scene.blobs[scene.assets[row.asset_id].mesh_blob]))
        boxes[row.instance_id] = surface.transformed(poses[row.instance_id], row.scale).bounds
    return boxes


def penetration_depth(a: np.ndarray, b: np.ndarray) -> float:
    """Depth of two convex point sets in each other [m]: how far the origin lies inside of their Minkowski difference."""
    if (np.minimum(a.max(axis=0), b.max(axis=0)) <= np.maximum(a.min(axis=0), b.min(axis=0))).any():
        return 0.0
    try:
        return max(0.0, float((-ConvexHull((a[:, None] - b[None]).reshape(-1, 3)).equations[:, 3]).min()))
    except QhullError:
        return 0.0


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


def crowded_scene() -> Scene:
    """The same with a second table in the first one."""
    scene = room_scene()
    scene.add(TABLE, yaw_pose(0.1, [0.1, 0.0, 0.0]), "table")
    return scene


# at rest and apart


@pytest.mark.whole
@METHODS
def test_a_room_is_put_to_rest_and_apart(method: Paper | Default) -> None:
    scene = room_scene()
    outcome = scene.run(method)
    rows = {row.instance_id: row for row in outcome.rows["placements"]}
    supports = {row.instance_id: row for row in outcome.rows["supports"]}
    table, mug, cabinet, shelf, book, picture, rug = sorted(rows)
    carried = {name: (row.relation, row.parent_id) for name, row in supports.items()}
    assert carried == {
        table: ("floor", None), mug: ("on", table), cabinet: ("floor", None), shelf: ("floor", None), book: ("inside", shelf),
        picture: ("wall", None), rug: ("floor", None),
    }  # fmt: skip
    assert {name for name, row in supports.items() if row.is_fixed} == {picture}
    assert all(row.is_kept for row in supports.values())
    boxes = bounds(outcome, scene)
    for name, height in ((mug, 0.75), (book, 0.52), (cabinet, 0.0), (table, 0.0), (shelf, 0.0), (rug, 0.0)):
        assert boxes[name][0, 2] == pytest.approx(height, abs=2e-4), name
    assert not [row for row in rows.values() if row.remains]
    (summary,) = outcome.rows["optimizations"]
    assert (summary.ended, summary.loss_final, summary.deep_pairs, summary.remains) == ("zero_loss", 0.0, 0, ())
    assert all(row.is_stable_5cm and row.start_penetration_m < DEEP_M for row in outcome.rows["certificates"])
    assert max(row.displacement_m for row in rows.values()) < 0.4
    assert rows[rug].displacement_m == 0.0
    assert rows[picture].lift_m == 0.0
    if isinstance(method, Paper):
        assert rows[picture].displacement_m == 0.0
        moves = {name: matrix(row.optimized_pose)[:2, 3] - matrix(row.proposed_pose)[:2, 3] for name, row in rows.items()}
        assert all(np.allclose(move, np.round(move / method.step_m) * method.step_m, atol=1e-9) for move in moves.values())
    else:
        assert boxes[picture][1, 0] == pytest.approx(2.0, abs=2e-3), "hung on its wall"


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(2))
def test_the_default_moves_objects_less_than_the_paper(seed: int) -> None:
    scene = crowded_scene()
    away = []
    for method in (Paper(), Default()):
        rows = scene.run(method, seed).rows
        # the last resort, which the paper's method has not, parts the two tables that it leaves in each other
        steps = [step for step in rows["optimization_steps"] if step.outcome != "relocated"]
        poses = replayed_poses(rows["placements"], rows["supports"], steps)
        away.append(np.mean([np.hypot(*(poses[row.instance_id] - matrix(row.proposed_pose))[:2, 3]) for row in rows["placements"]]))
    assert away[1] <= away[0] + 0.01
    assert rows["optimizations"][0].deep_pairs == 0


@METHODS
@pytest.mark.parametrize("height", [0.0, 0.02, 0.1])
def test_what_floats_comes_down_onto_what_carries_it(method: Paper | Default, height: float) -> None:
    scene = Scene()
    scene.add(TABLE, yaw_pose(0.2, [0.0, 0.0, height]), "table")
    scene.add(block(0.1, 0.1, 0.1), translation([0.2, 0.0, 0.75 + height]), "mug")
    scene.add(block(0.3, 0.2, 0.04), translation([-0.3, 0.0, 0.75 + 2 * height]), "book")
    scene.add(CHAIR, yaw_pose(1.0, [-1.3, 1.0, height]), "chair")
    scene.add(block(0.4, 0.4, 0.4), translation([1.3, 1.0, -height]), "box")
    outcome = scene.run(method)
    boxes = bounds(outcome, scene)
    for name, floor in (("0000", 0.0), ("0001", 0.75), ("0002", 0.75), ("0003", 0.0), ("0004", 0.0)):
        assert boxes[name][0, 2] == pytest.approx(floor, abs=2e-4), name
    gaps = {row.instance_id: row.gap_m for row in outcome.rows["supports"]}
    assert [gaps[name] for name in sorted(gaps)] == pytest.approx([height, 0.0, height, height, -height], abs=1e-6)
    assert all(row.displacement_m == 0.0 for row in outcome.rows["placements"])
    assert all(row.is_stable_1cm for row in outcome.rows["certificates"])


def test_a_chair_under_a_table_stays_under_it() -> None:
    scene = Scene()
    scene.add(TABLE, np.eye(4), "table")
    scene.add(CHAIR, yaw_pose(np.pi / 2, [0.1, -0.25, 0.01]), "chair")
    scene.add(CHAIR, yaw_pose(-np.pi / 2, [-0.1, 0.21, 0.0]), "chair")  # its back is in the table's edge
    outcome = scene.run()
    boxes = bounds(outcome, scene)
    (summary,) = outcome.rows["optimizations"]
    assert summary.loss_start > 0.0
    assert summary.loss_final == 0.0
    for row in outcome.rows["placements"]:
        assert row.displacement_m < 0.1
        assert row.remains is None
    for name in ("0001", "0002"):
        under = np.minimum(boxes[name][1], boxes["0000"][1]) - np.maximum(boxes[name][0], boxes["0000"][0])
        assert under.min() > 0.1, "still within the table's box"
        assert {r.instance_id: r.relation for r in outcome.rows["supports"]}[name] == "floor"


def test_what_was_scanned_through_a_wall_is_pulled_in_with_all_it_carries() -> None:
    scene = Scene()
    scene.add(TABLE, yaw_pose(0.3, [1.7, 0.0, 0.0]), "table")
    scene.add(block(0.1, 0.1, 0.1), yaw_pose(1.0, [1.5, 0.1, 0.77]), "mug")
    scene.add(block(0.5, 0.5, 0.9), translation([-0.5, -2.4, 0.0]), "cabinet")
    outcome = scene.run()
    boxes, before, after = bounds(outcome, scene), poses_of(outcome, "proposed"), poses_of(outcome)
    for name, box in boxes.items():
        assert (box[:, :2] > -2.0 - 1e-6).all(), name
        assert (box[:, :2] < 2.0 + 1e-6).all(), name
    ways = {name: after[name][:3, 3] - before[name][:3, 3] for name in after}
    first = bounds(outcome, scene, "proposed")
    assert ways["0000"][:2] == pytest.approx([2.0 - first["0000"][1, 0], 0.0], abs=1e-6), "the shortest way in"
    assert ways["0002"][:2] == pytest.approx([0.0, -2.0 - first["0002"][0, 1]], abs=1e-6)
    assert ways["0001"][:2] == pytest.approx(ways["0000"][:2], abs=1e-9), "the mug came along"
    assert all(row.remains is None for row in outcome.rows["placements"])
    assert {s.instance_id for s in outcome.rows["optimization_steps"] if s.outcome == "pulled_in"} == {"0000", "0002"}


@pytest.mark.whole
@METHODS
def test_what_is_carried_moves_along(method: Paper | Default) -> None:
    """Replaying the carriers' own moves alone takes what they carry with them, rigidly."""
    outcome = crowded_scene().run(method)
    rows = outcome.rows["placements"], outcome.rows["supports"]
    parents = {row.instance_id: row.parent_id for row in rows[1] if row.parent_id is not None}
    steps = [step for step in outcome.rows["optimization_steps"] if step.instance_id not in parents]
    before, after = poses_of(outcome, "proposed"), replayed_poses(*rows, steps)
    assert any(not np.array_equal(before[parent], after[parent]) for parent in parents.values())
    for child, parent in parents.items():
        relative = [np.linalg.inv(poses[parent]) @ poses[child] for poses in (before, after)]
        assert np.allclose(*relative, atol=1e-9)


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(2))
def test_generated_furniture_comes_to_rest_without_collisions(seed: int) -> None:
    """A desk with objects on it, chairs and cabinets, scanned a few centimetres off."""
    rng = np.random.default_rng(seed)
    scene = Scene(((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)))
    desk = generate("desk", (0.7, 1.4, 0.75), rng)
    scene.add(desk.parts, yaw_pose(0.0, [-2.0, 0.0, 0.02]), "desk", known=desk.pieces)
    for category, y in (("monitor", 0.1), ("mug", -0.5), ("keyboard", 0.6)):
        model = generate(category, None, rng)
        pose = yaw_pose(rng.uniform(-0.2, 0.2), [-2.0, y, 0.75 + rng.uniform(-0.04, 0.06)])
        scene.add(model.parts, pose, category, known=model.pieces)
    for category in ("chair", "cabinet", "bookshelf", "sofa", "stool", "bed", "nightstand"):
        model = generate(category, None, rng)
        pose = yaw_pose(rng.uniform(-3, 3), [*rng.uniform(-1.5, 1.5, 2), rng.uniform(-0.05, 0.05)])
        scene.add(model.parts, pose, category, known=model.pieces)
    outcome = scene.run(seed=seed)
    relations = {row.instance_id: (row.relation, row.parent_id) for row in outcome.rows["supports"]}
    assert all(relations[f"{i:04d}"] == ("on", "0000") for i in (1, 2, 3)), relations
    assert all(relations[f"{i:04d}"][0] in ("floor", "on") for i in range(4, 11)), relations
    (summary,) = outcome.rows["optimizations"]
    assert summary.loss_start > 0.1
    assert (summary.loss_final, summary.deep_pairs) == (0.0, 0)
    boxes = bounds(outcome, scene)
    for name in ("0001", "0002", "0003"):
        assert (boxes[name][0, :2] + boxes[name][1, :2] >= 2 * boxes["0000"][0, :2]).all()
        assert (boxes[name][0, :2] + boxes[name][1, :2] <= 2 * boxes["0000"][1, :2]).all()
        assert boxes[name][0, 2] == pytest.approx(boxes["0000"][1, 2], abs=0.03)


# steps, contacts, bytes


@pytest.mark.whole
@METHODS
@pytest.mark.parametrize("seed", range(3))
def test_replaying_the_steps_gives_the_optimized_poses_bit_for_bit(method: Paper | Default, seed: int) -> None:
    outcome = crowded_scene().run(method, seed)
    assert {"start", "rested", "kept"} <= {row.outcome for row in outcome.rows["optimization_steps"]}
    tables = ("placements", "supports", "optimization_steps")
    kept = [arrow_to_rows(rows_to_arrow(outcome.rows[table], RECORDS[table]), RECORDS[table]) for table in tables]
    for given in ([outcome.rows[table] for table in tables], kept, [rows[::-1] for rows in kept]):
        poses = replayed_poses(*given)
        for row in given[0]:
            assert np.array_equal(poses[row.instance_id], matrix(row.optimized_pose))
    moved_by_steps = {row.instance_id for row in kept[2] if row.outcome in APPLIED}
    for row in kept[0]:
        way = matrix(row.optimized_pose)[:3, 3] - matrix(row.proposed_pose)[:3, 3]
        assert row.displacement_m == pytest.approx(np.hypot(*way[:2]), abs=1e-12)
        assert row.lift_m == pytest.approx(way[2], abs=1e-12)
        assert not way.any() or moved_by_steps, row
    # every step counts: without the last one that moved something, something stands elsewhere
    last = max(row.step for row in kept[2] if row.outcome in APPLIED)
    fewer = replayed_poses(kept[0], kept[1], [row for row in kept[2] if row.step != last])
    assert any(not np.array_equal(fewer[row.instance_id], matrix(row.optimized_pose)) for row in kept[0])


@pytest.mark.whole
@METHODS
def test_contacts_are_the_penetrations_of_the_meshes_before_and_after(method: Paper | Default) -> None:
    """Pieces made anew from the GLBs, put where the rows say; depths from Minkowski differences."""
    scene = room_scene()
    scene.add(TABLE, yaw_pose(0.1, [0.6, 0.3, 0.0]), "table")
    scene.add(block(0.4, 0.3, 0.5), yaw_pose(0.5, [1.9, -1.0, -0.01]), "box")
    outcome = scene.run(method)
    room = {name: [mesh.vertices] for name, mesh in room_shell(scene.shells[0]) if name != "floor"}
    for phase in ("proposed", "optimized"):
        objects = {name: [hull.vertices for hull in hulls] for name, hulls in hulls_of(outcome, scene, phase).items()}
        corners = {name: np.concatenate(clouds) for name, clouds in objects.items()}
        expected: dict[tuple[str, str], tuple[float, float]] = {}
        names = sorted(objects)
        for i, a in enumerate(names):
            for b in [*names[i + 1 :], *room]:
                others = objects.get(b) or room[b]
                depth = max(penetration_depth(p, q) for p in objects[a] for q in others)
                sides = np.zeros(3)
                if b in objects:
                    sides = np.minimum(corners[a].max(0), corners[b].max(0)) - np.maximum(corners[a].min(0), corners[b].min(0))
                if depth > TOUCH_M or (sides > TOUCH_M).all():
                    expected[a, b] = depth, float(sides.prod()) if (sides > TOUCH_M).all() else 0.0
            if -corners[a][:, 2].min() > TOUCH_M:
                expected[a, "floor"] = float(-corners[a][:, 2].min()), 0.0
        found = {(c.instance_a, c.body_b): c for c in outcome.rows["contacts"] if c.phase == phase}
        # what only touches may be a hair's breadth on either side
        for pair in set(found) ^ set(expected):
            depth, volume = (found[pair].penetration_m, found[pair].box_overlap_m3) if pair in found else expected[pair]
            assert depth < 2 * TOUCH_M, pair
            assert volume < 4 * 2 * TOUCH_M, pair
        for pair in set(found) & set(expected):
            assert found[pair].penetration_m == pytest.approx(expected[pair][0], abs=2 * TOUCH_M), pair
            assert found[pair].box_overlap_m3 == pytest.approx(expected[pair][1], abs=1e-5), pair
        assert max(c.penetration_m for c in found.values()) > 0.1 or phase == "optimized"


def on_two_processes(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(function, items))


@pytest.mark.whole
@METHODS
def test_the_same_scene_gives_the_same_rows_in_any_order_and_in_any_process(method: Paper | Default) -> None:
    first = crowded_scene().run(method, 1)
    spread = on_two_processes if isinstance(method, Default) else in_turn
    second = crowded_scene().reversed().run(method, 1, spread)
    assert first.rows == second.rows
    assert first.degradations == second.degradations
    for table, record in RECORDS.items():
        assert rows_to_arrow(first.rows[table], record).equals(rows_to_arrow(second.rows[table], record))
    assert crowded_scene().run(method, 2).rows["optimization_steps"] != first.rows["optimization_steps"]


def test_step_zero_of_the_paper_is_the_state_at_rest() -> None:
    outcome = room_scene().run(Paper(max_steps=0))
    steps = outcome.rows["optimization_steps"]
    assert (steps[0].step, steps[0].outcome, steps[0].instance_id) == (0, "start", None)
    assert {step.outcome for step in steps[1:]} == {"rested"}
    assert {step.loss for step in steps} == {steps[0].loss}
    assert steps[0].loss == room_scene().run(Paper()).rows["optimization_steps"][0].loss > 0
    assert outcome.rows["optimizations"][0].ended == "out_of_moves"


@METHODS
def test_nothing_gives_way_to_a_rug_or_to_what_it_stands_in(method: Paper | Default) -> None:
    scene = Scene()
    scene.add(block(1.5, 1.0, 0.02), np.eye(4), "rug")
    scene.add(block(0.4, 0.4, 0.5), translation([0.85, 0.0, 0.0]), "stool")  # a quarter of it on the rug
    scene.add(SHELF, translation([-1.5, 0.0, 0.0]), "shelf")
    scene.add(block(0.1, 0.2, 0.2), translation([-1.5, 0.1, 0.52]), "book")
    outcome = scene.run(method)
    assert {step.loss for step in outcome.rows["optimization_steps"]} == {0.0}
    assert all(row.displacement_m < 0.01 for row in outcome.rows["placements"])
    boxes = {(c.instance_a, c.body_b) for c in outcome.rows["contacts"] if c.box_overlap_m3 > 0 and c.phase == "proposed"}
    assert boxes == {("0000", "0001"), ("0002", "0003")}


# annotations


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
        (broken, "not a readable GLB"),
    ):
        assert any(text.startswith(name) and word in text for text in outcome.degradations), (name, outcome.degradations)


# what cannot be put right is said


def optimized(scene: Scene, method: Paper | Default) -> tuple[Outcome, Optimization]:
    outcome = scene.run(method)
    return outcome, outcome.rows["optimizations"][0]


def remains(outcome: Outcome) -> dict[str, str | None]:
    return {row.instance_id: row.remains for row in outcome.rows["placements"]}


def box(x: float, y: float) -> tuple[tuple[float, float], ...]:
    return (-x / 2, -y / 2), (x / 2, -y / 2), (x / 2, y / 2), (-x / 2, y / 2)


@METHODS
def test_two_sofas_in_a_closet(method: Paper | Default) -> None:
    scene = Scene(box(0.9, 1.6))
    for x in (-0.05, 0.05):
        scene.add(SOFA, yaw_pose(0.0, [x, 0.0, 0.0]), "sofa")
    outcome, summary = optimized(scene, method)
    assert summary.ended in ("no_move_helps", "out_of_moves")
    assert 0.0 < summary.loss_final <= summary.loss_start
    assert summary.deep_pairs > 0
    assert summary.remains
    assert any(remains(outcome).values())
    assert any(f"{summary.loss_final:.3g} m" in text and "left" in text for text in outcome.degradations)
    assert min(step.loss for step in outcome.rows["optimization_steps"]) == pytest.approx(summary.loss_final, abs=1e-9), "the best state"


@METHODS
def test_an_object_larger_than_the_room(method: Paper | Default) -> None:
    scene = Scene()
    big = scene.add(block(9.0, 8.0, 1.0), np.eye(4), "cabinet")
    scene.add(block(0.4, 0.4, 0.4), translation([0.5, 0.5, 0.0]), "box")
    outcome, summary = optimized(scene, method)
    assert summary.loss_final > 0.0
    assert summary.deep_pairs > 0
    text = remains(outcome)[big] or ""
    assert "outside of the room" in text
    assert "cm in wall_" in text


@METHODS
def test_an_object_higher_than_the_room_is_said(method: Paper | Default) -> None:
    scene = Scene()
    high = scene.add(block(0.6, 1.0, 5.0), np.eye(4), "wardrobe")
    outcome, summary = optimized(scene, method)
    assert "2.50 m above the ceiling" in (remains(outcome)[high] or "")
    assert any(line.startswith(high) for line in summary.remains)


def test_what_is_built_in_stays_where_it_is_and_others_give_way() -> None:
    scene = Scene()
    toilet = scene.add(block(0.5, 0.4, 0.7), translation([0.3, 1.0, 0.0]), "toilet")
    sofa = scene.add(block(0.8, 1.6, 0.8), translation([0.9, 1.0, 0.0]), "sofa")
    outcome, summary = optimized(scene, Default())
    after, before = poses_of(outcome), poses_of(outcome, "proposed")
    assert np.array_equal(after[toilet], before[toilet])
    assert after[sofa][0, 3] - before[sofa][0, 3] == pytest.approx(0.05, abs=0.02), "beside the toilet, and no farther"
    assert summary.ended == "zero_loss"
    assert summary.deep_pairs == 0


def test_what_was_pushed_into_another_object_stands_beside_it() -> None:
    scene = Scene()
    table = scene.add(TABLE, np.eye(4), "table")
    pedestal = scene.add(block(0.2, 0.2, 0.08), translation([0.2, 0.0, 0.75]), "sculpture")
    can = scene.add(block(0.07, 0.07, 0.12), translation([0.28, 0.0, 0.75]), "can")
    outcome, summary = optimized(scene, Default())
    supports = {row.instance_id: row for row in outcome.rows["supports"]}
    assert supports[can].parent_id == table
    assert supports[can].is_kept
    assert f"{can}: it stands beside {pedestal}, on {table}" in outcome.degradations
    assert summary.deep_pairs == 0
    moved = {name: np.linalg.norm((poses_of(outcome)[name] - poses_of(outcome, "proposed")[name])[:2, 3]) for name in (can, pedestal)}
    assert sum(moved.values()) == pytest.approx(0.055, abs=0.02), "as far as they overlapped"


@METHODS
def test_too_few_steps_are_said(method: Paper | Default) -> None:
    few = dataclasses.replace(method, **({"max_steps": 3} if isinstance(method, Paper) else {"max_moves": 3, "chains": 2}))  # type: ignore[arg-type]
    scene = Scene(box(1.6, 1.2))  # too small to put one of them elsewhere
    for x in (0.0, 0.1):
        scene.add(block(0.9, 0.9, 0.5), translation([x, 0.0, 0.0]))
    outcome, summary = optimized(scene, few)
    assert summary.ended == "out_of_moves"
    assert summary.moves == 3 * summary.chains
    assert summary.loss_final > 0.0
    assert all(text and " cm in 000" in text for text in remains(outcome).values())


@METHODS
def test_a_table_scanned_upside_down(method: Paper | Default) -> None:
    scene = Scene()
    table = scene.add(TABLE, np.diag([1.0, -1.0, -1.0, 1.0]) + translation([0.0, 0.0, 0.75]) - np.eye(4), "table")
    mug = scene.add(block(0.1, 0.1, 0.1), translation([0.0, 0.0, 0.3]), "mug")
    outcome, summary = optimized(scene, method)
    assert "upside down" in (remains(outcome)[table] or "")
    assert bounds(outcome, scene)[table][0, 2] == pytest.approx(0.0, abs=1e-6)
    assert bounds(outcome, scene)[mug][0, 2] == pytest.approx(0.04, abs=1e-6), "down onto its underside"
    assert any(mug in text and "set down" in text for text in outcome.degradations)
    assert summary.remains


def surface(vertices: Any, faces: Any) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)


def cube() -> trimesh.Trimesh:
    mesh = trimesh.creation.box((0.5, 0.5, 0.5))
    mesh.apply_translation([0.0, 0.0, 0.25])
    return mesh


def open_box() -> trimesh.Trimesh:
    mesh = cube()
    return surface(mesh.vertices, mesh.faces[mesh.face_normals[:, 2] < 0.5])


MESHES = {
    "a triangle": surface([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0]], [[0, 1, 2]]),
    "a plane": surface([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]], [[0, 1, 2], [0, 2, 3]]),
    "an upright plane": surface([[-0.5, 0, 0], [0.5, 0, 0], [0.5, 0, 1], [-0.5, 0, 1]], [[0, 1, 2], [0, 2, 3]]),
    "duplicate faces": surface(cube().vertices, np.concatenate([cube().faces, cube().faces, cube().faces[:, ::-1]])),
    "inside out": surface(cube().vertices, cube().faces[:, ::-1]),
    "a line": surface([[-0.5, 0, 0], [0.5, 0, 0], [0, 0, 0]], [[0, 1, 2]]),
    "a point": surface([[0, 0, 0]] * 3, [[0, 1, 2]]),
}


@METHODS
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_meshes_without_volume_or_with_holes(method: Paper | Default, mesh: trimesh.Trimesh) -> None:
    """They stand, collide and are moved like any other."""
    scene = Scene()
    mesh.visual.vertex_colors = np.full((len(mesh.vertices), 4), 200, dtype=np.uint8)
    scene.add([mesh], translation([0.0, 0.0, 0.02]))
    scene.add(block(0.5, 0.5, 0.5), translation([0.1, 0.0, 0.0]), "box")
    hulls = pieces([mesh], None, PieceConfig())  # what it takes to decompose it is not this stage's time
    assert hulls.properties.volume > 0.0
    scene.run(method)
    outcome, summary = optimized(scene, method)
    assert summary.object_count == 2
    lies = 0.5 * PieceConfig().thickness_m  # a plane without thickness that was laid down is in the middle of its body
    assert bounds(outcome, scene)["0000"][0, 2] == pytest.approx(0.0, abs=lies + 1e-3)
    if isinstance(method, Default):
        assert (summary.loss_final, summary.deep_pairs) == (0.0, 0)
    else:  # of boxes without volume it sees nothing; the contacts do
        assert (summary.deep_pairs > 0) == any(c.penetration_m > DEEP_M for c in outcome.rows["contacts"] if c.phase == "optimized")


@pytest.mark.slow
def test_a_box_without_a_lid() -> None:
    """Decomposing it takes a minute; then what stands in its side is moved out of it, or put elsewhere, and that is said."""
    mesh = open_box()
    mesh.visual.vertex_colors = np.full((len(mesh.vertices), 4), 200, dtype=np.uint8)
    for way, is_put_elsewhere in ((0.45, False), (0.1, True)):
        scene = Scene()
        scene.add([mesh], translation([0.0, 0.0, 0.02]))
        scene.add(block(0.5, 0.5, 0.5), translation([way, 0.0, 0.0]), "box")
        scene.run(Paper())  # the first decomposes
        _, summary = optimized(scene, Default())
        assert (summary.loss_final, summary.deep_pairs) == (0.0, 0)
        assert [("moved by" in line) for line in summary.remains] == [True] * is_put_elsewhere


def wrong_poses() -> dict[str, np.ndarray]:
    nowhere, endless = translation([np.nan, 0.0, 0.0]), translation([0.0, 0.0, np.inf])
    sheared, long = np.eye(4), np.diag([2.0, 1.0, 1.0, 1.0])
    sheared[0, 1] = 0.3
    return {
        "nan": nowhere, "infinite": endless, "sheared": sheared, "stretched": long, "mirrored": np.diag([-1.0, 1.0, 1.0, 1.0]),
        "zero": np.zeros((4, 4)),
    }  # fmt: skip


WRONG = [(pose, (1.0, 1.0, 1.0)) for pose in wrong_poses().values()]
WRONG += [(np.eye(4), scale) for scale in ((0.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, np.nan, 1.0), (1.0, 1.0, np.inf))]


@METHODS
@pytest.mark.parametrize(("pose", "scale"), WRONG, ids=[*wrong_poses(), "zero scale", "negative scale", "nan scale", "infinite scale"])
def test_poses_and_scales_that_are_none(method: Paper | Default, pose: np.ndarray, scale: tuple[float, ...]) -> None:
    """The object is left out, with a word; the others are placed as if it had not been there."""
    scene, without = Scene(), Scene()
    name = scene.add(block(0.5, 0.5, 0.5), np.eye(4), "box")
    scene.selections[0] = dataclasses.replace(scene.selections[0], pose=flat(pose), scale=scale)
    for other in (scene, without):
        for x in (0.1, 0.3):
            other.add(block(0.5, 0.5, 0.5), translation([x, 0.0, 0.0]), "box")
    outcome, summary = optimized(scene, method)
    (text,) = summary.remains
    assert text.startswith(f"{name}: nothing stands for it")
    assert "pose, scale" in text
    assert text in outcome.degradations
    expected = without.run(method)
    assert [row.optimized_pose for row in outcome.rows["placements"]] == [row.optimized_pose for row in expected.rows["placements"]]


@METHODS
def test_a_blob_that_is_missing_or_none(method: Paper | Default) -> None:
    scene = Scene()
    gone, broken, _ = (scene.add(block(0.3, 0.3, 0.3 + i / 10), translation([i - 1.0, 0, 0])) for i in range(3))
    for name, blob in ((gone, "e" * 64 + ".glb"), (broken, scene.blobs.add(b"no mesh", "glb"))):
        asset = next(s.asset_id for s in scene.selections if s.instance_id == name)
        scene.assets[asset] = dataclasses.replace(scene.assets[asset], mesh_blob=blob)
    outcome, summary = optimized(scene, method)
    assert [row.instance_id for row in outcome.rows["placements"]] == ["0002"]
    assert summary.remains[0].startswith(f"{gone}: ")
    assert f"blob {'e' * 64}.glb is missing" in summary.remains[0]
    assert summary.remains[1].startswith(f"{broken}: ")
    assert "not a readable GLB" in summary.remains[1]


@METHODS
def test_an_empty_scene_is_no_error(method: Paper | Default) -> None:
    outcome, summary = optimized(Scene(), method)
    assert {table: len(rows) for table, rows in outcome.rows.items()} == {
        "placements": 0, "supports": 0, "contacts": 0, "optimization_steps": 1, "optimizations": 1, "certificates": 0,
    }  # fmt: skip
    assert (summary.ended, summary.object_count, summary.remains) == ("nothing_to_do", 0, ())


@METHODS
def test_without_a_room_it_is_said_and_done_all_the_same(method: Paper | Default) -> None:
    scene = room_scene()
    scene.shells = []
    outcome, summary = optimized(scene, method)
    assert len(outcome.rows["placements"]) == 7
    assert any("no room is known" in text for text in summary.remains)
    assert summary.loss_final == 0.0


@METHODS
@pytest.mark.parametrize("polygon", [((-2, -2), (2, 2), (2, -2), (-2, 2)), ((0, 0), (1, 0), (2, 0)), ((0, 0), (0, 0), (0, 0))])
def test_a_room_that_crosses_itself_or_has_no_area_is_said(method: Paper | Default, polygon: Any) -> None:
    scene = Scene(tuple((float(x), float(y)) for x, y in polygon))
    for x in (0.0, 0.3):
        scene.add(block(0.5, 0.5, 0.5), translation([x, 0.0, 0.0]))
    outcome, summary = optimized(scene, method)
    (text,) = summary.remains
    assert "floor_polygon" in text
    assert text in outcome.degradations
    assert (summary.ended, summary.loss_final) == ("zero_loss", 0.0)


def test_what_is_far_outside_comes_in() -> None:
    scene = Scene()
    scene.add(block(0.5, 0.5, 0.5), translation([1e6, -1e6, 0.3]))
    outcome, summary = optimized(scene, Default())
    assert bounds(outcome, scene)["0000"] == pytest.approx(np.array([[1.5, -2.0, 0.0], [2.0, -1.5, 0.5]]), abs=1e-6)
    assert summary.remains == ()


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
