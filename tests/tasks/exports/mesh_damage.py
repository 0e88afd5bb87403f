"""Damage to meshes that colliders name, for the tests of every format that writes OBJ files, and folders of these as gates take them."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import trimesh

from schemas.files import HeldPath


def held(folder: Path) -> HeldPath:
    """A folder as it lies on disk, links to folders followed, held in memory."""
    files = [Path(place) / name for place, _, names in os.walk(folder, followlinks=True) for name in names]
    return HeldPath.folder({file.relative_to(folder).as_posix(): file.read_bytes() for file in files})


def edited(hull_file: Callable[[Path], Path], change: Callable[[trimesh.Trimesh], None]) -> Callable[[Path], None]:
    """What changes the vertices of the hull that `hull_file` finds from what was exported."""

    def damage(exported: Path) -> None:
        file = hull_file(exported)
        mesh: Any = trimesh.load_mesh(file, process=False)
        change(mesh)
        lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
        file.write_text("\n".join(lines))

    return damage


def dent(mesh: trimesh.Trimesh) -> None:
    mesh.vertices[0] = 0.7 * mesh.vertices.mean(axis=0) + 0.3 * mesh.vertices[0]


def flatten(mesh: trimesh.Trimesh) -> None:
    mesh.vertices[:, 2] = 0.1


def lose_image(folder: Path) -> None:
    """A material file that names an image that is not there."""
    material = sorted(folder.glob("meshes/*.mtl"))[0]
    material.write_text(material.read_text() + "map_Kd lost.png\n")
