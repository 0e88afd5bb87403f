"""RoomPlan's USDZ: a layer of groups that refers to a layer for each element, with `customData`, as its exports are described."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.tasks.library.models import as_usdz

Array = NDArray[np.float64]

SURFACES = ("Wall", "Door", "Window", "Opening", "Floor")

THIN = 0.0001
"""Thickness of RoomPlan's walls [m]."""


@dataclasses.dataclass(frozen=True)
class Box:
    """An element. center, size: +Y up [m]. yaw: about y [rad]. category: in `customData`, '' for the name's own."""

    name: str
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0
    category: str = ""

    @property
    def word(self) -> str:
        """Category by the name."""
        return self.name.rstrip("0123456789")


def furnished_room() -> list[Box]:
    """A room of 4 x 3 m with a door, a window, a table, a chair and a washing machine."""
    return [
        Box("Wall0", (0, 1.25, -1.5), (4, 2.5, THIN)),
        Box("Wall1", (0, 1.25, 1.5), (4, 2.5, THIN), np.pi),
        Box("Wall2", (-2, 1.25, 0), (3, 2.5, THIN), np.pi / 2),
        Box("Wall3", (2, 1.25, 0), (3, 2.5, THIN), -np.pi / 2),
        Box("Door0", (0.5, 1.0, -1.5), (0.9, 2.0, THIN)),
        Box("Window0", (2, 1.5, 0.2), (1.2, 1.0, THIN), -np.pi / 2),
        Box("Opening0", (-2, 1.0, 0.3), (1.0, 2.0, THIN), np.pi / 2),
        Box("Floor0", (0, -THIN / 2, 0), (4, THIN, 3)),
        Box("Table0", (0, 0.37, 0), (1.2, 0.74, 0.7), 0.4),
        Box("Chair0", (0, 0.45, 0.8), (0.45, 0.9, 0.45)),
        Box("WasherDryer0", (-1.6, 0.425, -1.1), (0.6, 0.85, 0.6)),
    ]


def write_package(
    path: Path, boxes: Sequence[Box], unit: float | None = 1.0, up: str | None = "Y", group: str = "Parametric_grp", yaw: float = 0.0,
    is_flat: bool = False, more: str = "",
) -> Path:  # fmt: skip
    """A package. unit: meters per unit. up: axis. yaw: heading of the whole room [rad]. is_flat: without groups and layers of elements."""
    head = [f"metersPerUnit = {unit}"] if unit is not None else []
    head += [f'upAxis = "{up}"'] if up is not None else []
    meshes = {box.name: _element(box, _matrix(box, unit or 1.0, up or "Y", yaw)) for box in boxes}
    if is_flat:
        files, layer = {}, "\n".join(meshes.values())
    else:
        files = {f"assets/{name}.usda": f'#usda 1.0\n(defaultPrim = "{name}")\n{mesh}'.encode() for name, mesh in meshes.items()}
        shell, things = ([box for box in boxes if (box.word in SURFACES) == is_shell] for is_shell in (True, False))
        layer = _group(group, _group("Arch_grp", _references(shell)) + _group("Object_grp", _references(things)))
    text = f'#usda 1.0\n(\ndefaultPrim = "Room"\n{chr(10).join(head)}\n)\ndef Xform "Room" {{\n{layer}\n{more}\n}}\n'
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(as_usdz({"Room.usda": text.encode(), **files}))
    return path


def _references(boxes: Sequence[Box]) -> str:
    """A group for each element, which refers to its layer."""
    return "".join(
        _group(f"{box.name}_grp", f'def Xform "{box.name}" (prepend references = @./assets/{box.name}.usda@)\n{{\n}}\n') for box in boxes
    )


def _group(name: str, content: str) -> str:
    return f'def Xform "{name}"\n{{\n{content}}}\n'


def _matrix(box: Box, unit: float, up: str, yaw: float) -> Array:
    """Unit cube to the file's frame, 4x4."""
    scale = np.diag([*box.size, 1.0])
    place = _turn(box.yaw)
    place[:3, 3] = box.center
    world = _turn(yaw) @ place @ scale
    if up == "Z":
        world = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]) @ world
    return np.diag([1 / unit, 1 / unit, 1 / unit, 1.0]) @ world


def _turn(yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])


def _element(box: Box, matrix: Array) -> str:
    """An element: an Xform with `customData`, and a mesh of the same name in it."""
    corners = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    points = ", ".join(f"({x}, {y}, {z})" for x, y, z in corners)
    quads = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
    rows = ", ".join("(" + ", ".join(repr(float(value)) for value in row) + ")" for row in matrix.T)
    return f"""def Xform "{box.name}" (customData = {{ string Category = "{box.category or box.word}"; string UUID = "0-{box.name}" }}) {{
def Mesh "{box.name}" {{
matrix4d xformOp:transform = ({rows})
uniform token[] xformOpOrder = ["xformOp:transform"]
point3f[] points = [{points}]
int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
int[] faceVertexIndices = {quads}
color3f[] primvars:displayColor = [(0.5, 0.25, 0.1)] (interpolation = "constant")
}}
}}
"""
