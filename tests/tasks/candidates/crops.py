"""What a scan has of objects of known shape: crops of parts, instances of them, and their candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from schemas.candidates import Asset, Candidate, TextureCharts
from schemas.capture import Instance
from schemas.record import check
from tasks import captions
from tasks.candidates import CandidatesConfig, run
from tasks.furniture import generate
from tasks.geometry.meshes import Surface, dump_glb, dump_points, sample_surface, surface_of
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import flat, yaw_pose
from tasks.stage import Blobs, Context, Outcome, in_turn

Array = NDArray[np.float64]
OPEN_BACK, OPEN_BOTTOM = "back", "bottom"


def crop_of_parts(
    parts: list[trimesh.Trimesh], seed: int = 0, hidden: tuple[str, ...] = (OPEN_BACK, OPEN_BOTTOM), noise: float = 0.003
) -> Surface:
    """What a scan has of parts: triangles of 3 cm, noisy vertices, nothing from within, no faces that look back (-x) or down."""
    surface = surface_of(parts)
    vertices, faces = trimesh.remesh.subdivide_to_size(surface.vertices, surface.faces, 0.03)
    rng = np.random.default_rng(seed)
    samples, paint, _ = sample_surface(surface, 4000, rng)
    from scipy.spatial import cKDTree

    colors = paint[cKDTree(samples).query(vertices)[1]]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    seen = is_visible(surface, (a + b + c) / 3, normal)
    if OPEN_BACK in hidden:
        seen &= normal[:, 0] > -0.7
    if OPEN_BOTTOM in hidden:
        seen &= normal[:, 2] > -0.7
    used = np.unique(faces[seen])
    number = np.full(len(vertices), -1)
    number[used] = np.arange(len(used))
    return Surface(vertices[used] + rng.normal(0, noise, (len(used), 3)), number[faces[seen]], colors[used])


def is_visible(surface: Surface, centers: Array, normals: Array) -> NDArray[np.bool_]:
    """Whether anything outside sees faces with these centers (n, 3) and normals (n, 3): one of 60 directions is free."""

    scene = RayScene([surface.to_trimesh()])
    visible = np.zeros(len(centers), dtype=bool)
    for direction in trimesh.creation.icosphere(subdivisions=1).vertices:
        asked = np.flatnonzero(~visible & (normals @ direction > 0.15))
        rays = np.column_stack([centers[asked] + 1e-3 * normals[asked], np.tile(direction, (len(asked), 1))])
        visible[asked] = ~np.isfinite(scene.cast(rays.astype(np.float32))["t_hit"])
    return visible


def scanned(number: int, category: str, parts: list[trimesh.Trimesh], yaw: float, **changes: object) -> tuple[Instance, dict[str, bytes]]:
    """An instance of parts (canonical frame) that stand at some place in the world, turned by `yaw`."""
    extents = np.ptp(surface_of(parts).bounds, axis=0)
    position = np.array([1.0 + number, 2.0, 0.0])
    world = crop_of_parts(parts, number).transformed(yaw_pose(yaw, position))
    points, colors, _ = sample_surface(world, 1500, np.random.default_rng(number))
    files = Blobs()
    values = {
        "scene_id": "test/room", "instance_id": f"{number:04d}", "source_id": str(number), "raw_label": category,
        "category": category, "nyu40_id": 0, "nyu40_label": "unlabeled", "is_structure": False,
        "box_pose": flat(yaw_pose(yaw, position + np.array([0, 0, extents[2] / 2]))), "box_size": tuple(map(float, extents)),
        "box_volume_m3": float(np.prod(extents)), "hidden_m": None,
        "point_count": len(points), "points_blob": files.add(dump_points(points, colors), "ply"),
        "mesh_blob": files.add(dump_glb([world.to_trimesh()]), "glb"), "view_blob": None, "best_frames": (), "room_index": None,
        "found_by": "file", "category_probability": None,
    }  # fmt: skip
    return Instance(**{**values, **changes}), dict(files)  # type: ignore[arg-type]


def furniture(
    number: int, category: str, extents: tuple[float, float, float], yaw: float, **changes: object
) -> tuple[Instance, dict[str, bytes]]:
    return scanned(number, category, generate(category, extents, np.random.default_rng(number)).parts, yaw, **changes)


Spread = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]


def candidates_of(
    *pairs: tuple[Instance, dict[str, bytes]],
    library: Path | None = None,
    config: CandidatesConfig | None = None,
    seed: int = 3,
    spread: Spread = in_turn,
) -> Outcome:
    blobs = {name: data for _, files in pairs for name, data in files.items()}
    instances = [instance for instance, _ in pairs]
    words = captions.run(
        instances=instances, frames=[], masks=[], context=Context("test/room", "captions", seed, blobs), config=captions.CaptionsConfig()
    )
    context = Context("test/room", "candidates", seed, blobs, spread=spread)
    outcome = run(
        instances=instances,
        frames=[],
        masks=[],
        captions=words.rows["captions"],
        library=library,
        scan=None,
        context=context,
        config=config or CandidatesConfig(),
    )
    check(outcome.rows["candidates"], Candidate)
    check(outcome.rows["assets"], Asset)
    check(outcome.rows["texture_charts"], TextureCharts)
    return outcome


def cabinet_parts(extents: tuple[float, float, float]) -> list[trimesh.Trimesh]:
    box = trimesh.creation.box(extents)
    box.apply_translation([0, 0, extents[2] / 2])
    box.visual.vertex_colors = [150, 100, 60, 255]
    return [box]


def signed_distance(mesh: trimesh.Trimesh, points: Array) -> Array:
    """Distance of points (n, 3) to a closed mesh [m], negative inside; shape (n,)."""
    from tasks.geometry.proximity import closest_points

    # Of three directions through no edge of the grid, most must meet a back first.
    directions = np.array([[0.31, 0.22, 0.92], [-0.83, 0.41, 0.37], [0.27, -0.9, -0.34]])
    votes = np.zeros(len(points), dtype=int)
    for direction in directions:
        hits = RayScene([mesh]).cast(np.column_stack([points, np.tile(direction, (len(points), 1))]).astype(np.float32))
        votes += np.isfinite(hits["t_hit"]) & (hits["primitive_normals"] @ direction > 0)
    return np.where(votes >= 2, -1.0, 1.0) * closest_points(mesh.vertices, mesh.faces, points).distance
