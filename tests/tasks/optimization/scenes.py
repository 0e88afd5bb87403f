"""Scenes under construction, and what the optimization made of them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, QhullError

from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Shell
from schemas.optimization import Certificate, Contact, Optimization, OptimizationStep, Placement, Support
from schemas.record import check
from schemas.selection import Selection
from tasks.geometry.meshes import dump_glb, load_glb, surface_of
from tasks.geometry.pieces import Hull, PieceConfig, pieces, read_pieces
from tasks.geometry.transforms import flat, matrix, translation, yaw_pose
from tasks.optimization import STAGE, Default, OptimizationConfig, Paper, Released, run
from tasks.stage import Blobs, Context, Outcome, in_turn
from tests.samples import sample

SCENE = "demo/room_a"
SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))
DEEP_M, TOUCH_M = 0.002, 1e-6
RECORDS = {
    "placements": Placement, "supports": Support, "contacts": Contact, "optimization_steps": OptimizationStep,
    "optimizations": Optimization, "certificates": Certificate,
}  # fmt: skip
METHODS = pytest.mark.parametrize("method", [Released(), Default()], ids=["released", "default"])


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

    def run(self, method: Paper | Released | Default | None = None, seed: int = 0, spread: Callable[..., list[Any]] = in_turn) -> Outcome:
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
    """Convex pieces of the placed assets in the world frame, made anew from their GLBs and the rows; as they are in the end from the blobs
    of colliders, where rows name any."""
    poses = poses_of(outcome, phase)
    made = {}
    for row in outcome.rows["placements"]:
        if phase == "optimized" and row.collider_blob is not None:
            own = read_pieces(outcome.blobs[row.collider_blob], row.collider_blob)
            made[row.instance_id] = [hull.transformed(poses[row.instance_id]) for hull in own]
            continue
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


def colliders(outcome: Outcome, scene: Scene) -> dict[str, list[Hull]]:
    """Convex pieces where they stand in the end, from the blobs that rows name alone, or as the stage makes them of an asset."""
    made, poses = {}, poses_of(outcome)
    for row in outcome.rows["placements"]:
        if row.collider_blob is not None:
            hulls = read_pieces(outcome.blobs[row.collider_blob], row.collider_blob)
        else:
            asset = scene.assets[row.asset_id]
            known = load_glb(scene.blobs[asset.pieces_blob]) if asset.pieces_blob else None
            whole = pieces(load_glb(scene.blobs[asset.mesh_blob]), known, PieceConfig()).hulls
            hulls = tuple(hull.transformed(np.eye(4), row.scale) for hull in whole)
        made[row.instance_id] = [hull.transformed(poses[row.instance_id]) for hull in hulls]
    return made


def collider_bounds(outcome: Outcome, scene: Scene) -> dict[str, np.ndarray]:
    """World boxes of colliders where they stand in the end, shape (2, 3) [m]."""
    points = {name: np.concatenate([hull.vertices for hull in hulls]) for name, hulls in colliders(outcome, scene).items()}
    return {name: np.array([each.min(axis=0), each.max(axis=0)]) for name, each in points.items()}


def are_apart(outcome: Outcome, scene: Scene, *names: str) -> bool:
    """Whether no convex piece of one of some objects is in a piece of another by as much as engines mind."""
    every = colliders(outcome, scene)
    pairs = [(a, b) for k, first in enumerate(names) for other in names[k + 1 :] for a in every[first] for b in every[other]]
    return all(penetration_depth(a.vertices, b.vertices) < DEEP_M for a, b in pairs)


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
    for x in (-1.6, -1.31):  # so little in each other that they are moved apart
        scene.add(block(0.3, 0.3, 0.3), translation([x, 1.6, 0.0]), "box")
    return scene


def optimized(scene: Scene, method: Released | Default) -> tuple[Outcome, Optimization]:
    outcome = scene.run(method)
    return outcome, outcome.rows["optimizations"][0]


def remains(outcome: Outcome) -> dict[str, str | None]:
    return {row.instance_id: row.remains for row in outcome.rows["placements"]}


def box(x: float, y: float) -> tuple[tuple[float, float], ...]:
    return (-x / 2, -y / 2), (x / 2, -y / 2), (x / 2, y / 2), (-x / 2, y / 2)
