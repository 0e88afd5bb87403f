"""A release in the MetaScenes layout, made of scenes of ours, with what the lake must say of it.

It follows the facts in docs/ingestion.md: meshes lie where people put them (+Z up, metres), `Physical_simu` moves each
about the center of its box, `Layout/Heuristic` is the rectangle around the objects, `Layout/RoomFormer` is a quarter turn
away and not centered.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.replicas import Object

Array = NDArray[np.float64]

HEIGHT = 2.6
FLOOR = ((-3.0, -2.0), (3.0, -2.0), (3.0, 2.0), (-3.0, 2.0))
"""Corners of the room's floor in the frame of the objects, counter-clockwise."""


@dataclasses.dataclass(frozen=True)
class Truth:
    """An object of the release: its vertices where people put it, and where the physics engine left it (None: nowhere) [m]."""

    name: str
    label: str
    annotated: Array
    simulated: Array | None


def write_release(root: Path, scans: Mapping[str, Sequence[Object]], seed: int = 0, layouts: bool = True) -> dict[str, list[Truth]]:
    """Write a release; what is in it by scan. The last object of every scan with more than two has no transformation."""
    rng = np.random.default_rng(seed)
    found: dict[str, list[Truth]] = {}
    for scan, objects in scans.items():
        found[scan] = [_write_object(root, scan, _name(index), obj, rng) for index, obj in enumerate(objects)]
        matrices = {}
        for index, truth in enumerate(found[scan]):
            if len(objects) > 2 and index == len(objects) - 1:
                found[scan][index] = dataclasses.replace(truth, simulated=None)
                continue
            matrices[truth.name] = _matrix(truth).tolist()
        _write_json(root / "Physical_simu" / f"{scan}.json", {"matrix": matrices})
        _write_json(root / "instance_id_to_name" / f"{scan}.json", {truth.name: truth.label for truth in found[scan]})
        if layouts:
            _write_layouts(root, scan, found[scan], rng)
    return found


def _name(index: int) -> str:
    """Ids as releases have them: numbers, and small objects with a dash."""
    return str(3 * index + 2) if index % 4 != 3 else f"{3 * index - 1}-{index}"


def _write_object(root: Path, scan: str, name: str, obj: Object, rng: np.random.Generator) -> Truth:
    parts = []
    for part in obj.parts:
        mesh = part.copy()
        mesh.apply_transform(obj.pose @ np.diag([*obj.scale, 1.0]))
        parts.append(mesh)
    whole = trimesh.util.concatenate(parts)
    folder = root / "Annotation_scenes" / scan / name
    folder.mkdir(parents=True)
    # Written number by number, so that nothing of what is read was written by what is tested.
    lines = ["mtllib material.mtl", "usemtl paint"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in whole.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in whole.faces.tolist()]
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    (folder / "material.mtl").write_text("newmtl paint\nKd 0.8 0.2 0.1\n")
    annotated = np.asarray(whole.vertices, dtype=np.float64)
    center = (annotated.min(axis=0) + annotated.max(axis=0)) / 2
    turn = Rotation.from_rotvec(rng.normal(0, 0.2, 3)).as_matrix()
    simulated = (annotated - center) @ turn.T + center + rng.normal(0, 0.05, 3)
    return Truth(name, obj.category, annotated, simulated)


def _matrix(truth: Truth) -> Array:
    """The matrix that takes the mesh, moved so that the center of its box is the origin, to where it was left."""
    assert truth.simulated is not None
    center = (truth.annotated.min(axis=0) + truth.annotated.max(axis=0)) / 2
    local = np.column_stack([truth.annotated - center, np.ones(len(truth.annotated))])
    solution = np.linalg.lstsq(local, truth.simulated, rcond=None)[0]
    matrix = np.eye(4)
    matrix[:3] = solution.T
    return matrix


def _write_layouts(root: Path, scan: str, truths: Sequence[Truth], rng: np.random.Generator) -> None:
    points = np.concatenate([truth.annotated for truth in truths])
    (x0, y0, _), (x1, y1, _) = points.min(axis=0), points.max(axis=0)
    heuristic = {"vert": [[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]], "quads": [[0, 1, 2, 3]]}
    _write_json(root / "Layout" / "Heuristic" / f"{scan}.json", heuristic)
    # What viewers turn by a quarter, (x, y) to (-y, x), after centering it: so here it is turned back, and moved anywhere.
    offset = rng.uniform(1, 6, 2)
    corners = [(y + offset[0], -x + offset[1]) for x, y in FLOOR]
    verts = [[x, y, 0.0] for x, y in corners] + [[x, y, HEIGHT] for x, y in corners]
    quads = [[0, 1, 2, 3], *([i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4] for i in range(4))]
    _write_json(root / "Layout" / "RoomFormer" / f"{scan}.json", {"verts": verts, "quads": quads})


def _write_json(path: Path, value: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value))
