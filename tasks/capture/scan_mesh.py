"""The mesh of a scan as the lake keeps it: a GLB in the world frame."""

from __future__ import annotations

import numpy as np

from tasks.capture.reading import Reading
from tasks.capture.rooms.alignment import Alignment
from tasks.geometry.meshes import Surface, dump_glb


def scan_mesh(reading: Reading, world: Surface, alignment: Alignment, max_faces: int) -> tuple[bytes, list[str]]:
    """GLB of the whole scan in the world frame, thinned when it has more than `max_faces` faces; and a note on that."""
    if reading.glb is not None and alignment.source == "identity":
        return reading.glb, []
    if reading.parts:
        parts = []
        for part in reading.parts:
            moved = part.copy()
            moved.apply_transform(alignment.pose)
            parts.append(moved)
        return dump_glb(parts, [str(part.metadata["name"]) for part in reading.parts]), []
    if len(world.faces) <= max_faces:
        return dump_glb([world.to_trimesh()], ["scan"]), []
    thin = _thinned(world, max_faces)
    return dump_glb([thin.to_trimesh()], ["scan"]), [f"scan mesh thinned from {len(world.faces)} to {len(thin.faces)} faces"]


def _thinned(surface: Surface, faces: int) -> Surface:
    """A surface of about so many faces; colors are those of the nearest vertices."""
    import fast_simplification
    from scipy.spatial import cKDTree

    points, triangles = fast_simplification.simplify(
        surface.vertices.astype(np.float32), surface.faces.astype(np.int32), target_count=faces
    )
    nearest = cKDTree(surface.vertices).query(points)[1]
    return Surface(points.astype(np.float64), triangles.astype(np.int64), surface.colors[nearest])
