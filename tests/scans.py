"""Tiny ScanNet folders of boxes in a room, without frames: whole scans that go through every stage in seconds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

STEP = 0.08
"""Distance of the mesh's vertices [m]."""

Box = tuple[str, tuple[float, float, float], tuple[float, float, float], tuple[int, int, int]]
OBJECTS: tuple[Box, ...] = (
    ("table", (1.2, 1.0, 0.36), (1.2, 0.7, 0.72), (150, 110, 70)),
    ("cabinet", (3.4, 2.5, 0.5), (0.8, 0.45, 1.0), (200, 200, 190)),
    ("chair", (2.6, 0.9, 0.45), (0.45, 0.45, 0.9), (60, 60, 160)),
    ("box", (1.1, 1.0, 0.82), (0.3, 0.25, 0.2), (180, 140, 60)),
)


def patch(origin, u, v, color):
    """A flat grid from `origin` along `u` and `v` [m]: vertices, faces, colors."""
    origin, u, v = (np.asarray(x, dtype=float) for x in (origin, u, v))
    n, m = (max(2, round(np.linalg.norm(x) / STEP) + 1) for x in (u, v))
    a, b = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, m), indexing="ij")
    vertices = origin + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v
    i = (np.arange(n - 1)[:, None] * m + np.arange(m - 1)).reshape(-1)
    faces = np.concatenate([np.stack([i, i + m, i + m + 1], 1), np.stack([i, i + m + 1, i + 1], 1)])
    return vertices, faces, np.tile(np.asarray(color, dtype=np.uint8), (len(vertices), 1))


def box(center, size, color):
    """The six sides of a box as grids."""
    c, s = np.asarray(center, dtype=float), np.asarray(size, dtype=float)
    patches = []
    for axis in range(3):
        for sign in (-1, 1):
            u, v = np.zeros(3), np.zeros(3)
            u[(axis + 1) % 3], v[(axis + 2) % 3] = s[(axis + 1) % 3], s[(axis + 2) % 3]
            normal = np.zeros(3)
            normal[axis] = sign * s[axis]
            start = c + normal / 2 - u / 2 - v / 2
            patches.append(patch(start, u if sign > 0 else v, v if sign > 0 else u, color))
    return patches


def write_scan(folder: Path, name: str, size=(4.4, 3.2, 2.5), objects=OBJECTS, shift=(0.0, 0.0)) -> Path:
    """A scan folder `<folder>/<name>`: mesh, segments, aggregation and text file, aligned, without frames."""
    w, d, h = size
    groups = [("floor", [patch((0, 0, 0), (w, 0, 0), (0, d, 0), (120, 100, 80))])]
    corners = [(0, 0), (w, 0), (w, d), (0, d)]
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        groups.append(("wall", [patch((x0, y0, 0), (0, 0, h), (x1 - x0, y1 - y0, 0), (225, 220, 210))]))
    for label, center, extents, color in objects:
        moved = (center[0] + shift[0], center[1] + shift[1], center[2])
        groups.append((label, box(moved, extents, color)))
    vertices, faces, colors, segments, offset = [], [], [], [], 0
    for index, (_, patches) in enumerate(groups):
        for points, triangles, paint in patches:
            vertices.append(points)
            faces.append(triangles + offset)
            colors.append(paint)
            segments += [index] * len(points)
            offset += len(points)
    scan = folder / name
    scan.mkdir(parents=True)
    write_ply(scan / f"{name}_vh_clean_2.ply", np.concatenate(vertices), np.concatenate(faces), np.concatenate(colors))
    (scan / f"{name}_vh_clean_2.0.010000.segs.json").write_text(json.dumps({"sceneId": name, "segIndices": segments}))
    aggregation = [{"id": i, "objectId": i, "segments": [i], "label": label} for i, (label, _) in enumerate(groups)]
    (scan / f"{name}.aggregation.json").write_text(
        json.dumps({"sceneId": name, "segmentsId": f"{name}_vh_clean_2.0.010000.segs.json", "segGroups": aggregation})
    )
    matrix = " ".join(str(v) for v in np.eye(4).reshape(-1))
    (scan / f"{name}.txt").write_text(f"axisAlignment = {matrix}\nsceneType = Office\n")
    return scan


def write_ply(path: Path, vertices, faces, colors) -> None:
    """A binary PLY with colors, as ScanNet has it."""
    rows = np.empty(len(vertices), dtype=[("p", "<f4", 3), ("c", "u1", 4)])
    rows["p"], rows["c"][:, :3], rows["c"][:, 3] = vertices, colors, 255
    triangles = np.empty(len(faces), dtype=[("n", "u1"), ("i", "<i4", 3)])
    triangles["n"], triangles["i"] = 3, faces
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    head += [f"property float {a}" for a in "xyz"] + [f"property uchar {a}" for a in ("red", "green", "blue", "alpha")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    path.write_bytes(("\n".join(head) + "\n").encode() + rows.tobytes() + triangles.tobytes())


def write_scans(folder: Path, count: int) -> Path:
    """`count` scans of different rooms, `scene0000_00` and on."""
    for index in range(count):
        write_scan(folder, f"scene{index:04d}_00", size=(4.4 + 0.1 * index, 3.2, 2.5), shift=(0.01 * index, 0.0))
    return folder
