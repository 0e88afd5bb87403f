"""A composed USD stage as parts: meshes and solids of what is drawn, instances flattened, colors and textures of preview surfaces."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import is_there, read_file, stays_in
from tasks.geometry.colors import bytes_of_linear, display_of
from tasks.library.format import MOST_FACES
from tasks.library.usd.looks import display_colors, is_see_through, look_of, uv_of
from tasks.library.usd.rooms import RoomPrim, is_room, room_prim
from tasks.library.usd.shapes import polygons_of, subsets
from tasks.unpacking import image_pixels

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

GRAY = (0.18, 0.18, 0.18)
"""Linear color of what has none: USD's own fallback."""


class Flattened:
    """What is drawn of a stage, in its units and axes.

    unit_m, up: Metres per unit [m] and the axis that points up, where the file states them. notes: What was left out, a line each.
    elements: of a captured room, if `rooms` asks for them and the file is one; parts are then those of one element each.

    Raises:
        InputError: it is broken or larger than the budget.
    """

    def __init__(self, path: Path, root: Path, rooms: bool = False) -> None:
        from pxr import Usd, UsdGeom

        stage = Usd.Stage.Open(str(path))
        outside = [layer.realPath for layer in stage.GetUsedLayers() if layer.realPath and not stays_in(Path(layer.realPath), root)]
        if outside:
            raise InputError(path.name, "reference", "leads out of the folder", "flatten it into one file")
        self.unit_m = float(UsdGeom.GetStageMetersPerUnit(stage)) if stage.HasAuthoredMetadata("metersPerUnit") else None
        self.up = str(UsdGeom.GetStageUpAxis(stage)).lower() if stage.HasAuthoredMetadata("upAxis") else None
        self.notes: list[str] = []
        self._root, self._name = root, path.name
        self._places = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
        self.elements: list[RoomPrim] = []
        self.part_elements: list[int] = []
        self._rooms, self._numbers = rooms, dict[str, int]()
        self._plain: dict[int, list[tuple[Array, Integers, NDArray[np.uint8]]]] = {}
        self._textured: dict[tuple[int, Path, tuple[float, ...], bool], list[tuple[Array, Integers, Array]]] = {}
        self._faces = self._prims = self._see_through = 0
        # Count first: geometry takes longer than a refusal.
        prims = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())
        if next(itertools.islice(prims, BUDGET.nodes, None), None):
            raise InputError(self._name, "prims", f"are more than {BUDGET.nodes}", "join the meshes, or split the file")
        self._add(stage.GetPseudoRoot(), np.eye(4)[None], np.eye(4))
        if self._see_through:
            self.notes.append(f"meshes that let light through are read as solid: {self._see_through}")
        if rooms and not is_room(self.elements):
            self._forget_elements()

    def parts(self) -> list[trimesh.Trimesh]:
        """One part of all that has colors alone, and one for every texture; of a captured room, those of each element.

        `part_elements` then names the element of each part, -1 in other files.

        Raises:
            InputError: nothing is drawn, or textures are larger than the budget or cannot be decoded.
        """
        import trimesh
        from PIL import Image

        if not self._plain and not self._textured:
            raise InputError(self._name, "meshes", "holds no triangles that are drawn", "export it with its geometry")
        parts = []
        self.part_elements = [*sorted(self._plain), *(key[0] for key in sorted(self._textured))]
        for _, groups in sorted(self._plain.items()):
            vertices, faces, colors = _joined(groups)
            mesh = trimesh.Trimesh(vertices, faces, process=False)
            mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
            parts.append(mesh)
        pixels = 0
        for (_, file, factor, is_linear), textured in sorted(self._textured.items()):
            data = read_file(file, file.name, BUDGET.image_bytes)
            size = image_pixels(data)
            pixels += size or 0
            if size is None or size > BUDGET.pixels or pixels > BUDGET.all_pixels:
                problem = "cannot be decoded" if size is None else f"are {pixels} pixels, more than {BUDGET.pixels} or {BUDGET.all_pixels}"
                raise InputError(self._name, "textures", f"{file.name} {problem}", "shrink them")
            image = Image.open(io.BytesIO(data)).convert("RGB")
            if is_linear:
                image = Image.fromarray(bytes_of_linear(np.asarray(image) / 255.0))
            vertices, faces, uv = _joined(textured)
            material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, baseColorFactor=[*display_of(factor), 1.0])
            parts.append(trimesh.Trimesh(vertices, faces, process=False, visual=trimesh.visual.TextureVisuals(uv=uv, material=material)))
        return parts

    def _add(self, start: Any, placed: Array, inverse: Array) -> None:
        """Everything below a prim, once for each of `placed`, 4x4 (rows act from the left), after `inverse` took it to its own frame."""
        from pxr import Usd, UsdGeom

        prims = Usd.PrimRange(start, Usd.TraverseInstanceProxies())
        walk = iter(prims)
        for prim in walk:
            self._prims += 1
            if self._prims > BUDGET.nodes:
                raise InputError(self._name, "prims", f"are more than {BUDGET.nodes}", "join the meshes, or split the file")
            if prim.IsA(UsdGeom.PointInstancer):
                walk.PruneChildren()
                self._add_instances(prim, placed, inverse)
                continue
            if not prim.IsA(UsdGeom.Gprim) or not self._is_drawn(prim):
                continue
            here = np.array(self._places.GetLocalToWorldTransform(prim)) @ inverse
            element = self._element(prim) if self._rooms else -1
            for group in self._groups(prim):
                self._place(group, here, placed, element)

    def _element(self, prim: Any) -> int:
        """Number of the element that a prim belongs to."""
        element = room_prim(prim)
        if element.path not in self._numbers:
            self._numbers[element.path] = len(self.elements)
            self.elements.append(element)
        return self._numbers[element.path]

    def _forget_elements(self) -> None:
        """Make the parts those of a mesh that names nothing."""
        plain, textured = self._plain, self._textured
        self.elements, self._plain, self._textured = [], {}, {}
        for _, groups in sorted(plain.items()):
            self._plain.setdefault(-1, []).extend(groups)
        for (_, *look), looks in sorted(textured.items()):
            self._textured.setdefault((-1, *look), []).extend(looks)  # type: ignore[arg-type]

    def _is_drawn(self, prim: Any) -> bool:
        from pxr import UsdGeom

        image = UsdGeom.Imageable(prim)
        purposes = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
        return image.ComputePurpose() in purposes and image.ComputeVisibility() != UsdGeom.Tokens.invisible

    def _add_instances(self, prim: Any, placed: Array, inverse: Array) -> None:
        """The prototypes of a point instancer, at every point; of instancers in prototypes nothing is taken twice."""
        from pxr import Usd, UsdGeom

        time = Usd.TimeCode.EarliestTime()
        instancer = UsdGeom.PointInstancer(prim)
        if not self._is_drawn(prim):
            return
        numbers = np.array(instancer.GetProtoIndicesAttr().Get(time) or [], dtype=np.int64)
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        if len(numbers) * max(len(placed), 1) > BUDGET.nodes:
            raise InputError(self._name, "instances", f"are {len(numbers)}, more than {BUDGET.nodes}", "thin them out")
        poses = np.array(instancer.ComputeInstanceTransformsAtTime(time, time, applyMask=UsdGeom.PointInstancer.IgnoreMask)).reshape(
            -1, 4, 4
        )
        if len(poses) != len(numbers) or (len(numbers) and not 0 <= int(numbers.min()) <= int(numbers.max()) < len(targets)):
            raise InputError(self._name, "instances", "name prototypes that are not there", "export it again")
        here = np.array(self._places.GetLocalToWorldTransform(prim)) @ inverse
        for number, target in enumerate(targets):
            chosen = poses[numbers == number] @ here
            prototype = prim.GetStage().GetPrimAtPath(target)
            if prototype and len(chosen):
                if prototype.GetPath().HasPrefix(prim.GetPath()) or not prim.GetPath().HasPrefix(prototype.GetPath()):
                    out = np.linalg.inv(np.array(self._places.GetLocalToWorldTransform(prototype)))
                    self._add(prototype, np.einsum("aij,bjk->abik", chosen, placed).reshape(-1, 4, 4), out)
                else:
                    raise InputError(self._name, "instances", f"{target} instances what it lies in", "export it again")

    def _place(self, group: tuple[Array, Integers, Any, Any], here: Array, placed: Array, element: int) -> None:
        vertices, faces, look, texture = group
        self._faces += len(faces) * len(placed)
        if self._faces > MOST_FACES:
            raise InputError(self._name, "faces", f"are more than {MOST_FACES}, as often as they are placed", "decimate it, or split it")
        for pose in placed:
            matrix = here @ pose
            moved = vertices @ matrix[:3, :3] + matrix[3, :3]
            turned = faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0 else faces
            if texture is None:
                self._plain.setdefault(element, []).append((moved, turned, look))
            else:
                self._textured.setdefault((element, *texture), []).append((moved, turned, look))

    def _groups(self, prim: Any) -> Iterator[tuple[Array, Integers, Any, Any]]:
        """A gprim as meshes of one look each: vertices, triangles, then colors (n, 3) uint8 and None, or uv (n, 2) and which texture."""
        shape = polygons_of(prim, self._name)
        if shape is None or not len(shape.triangles):
            return
        self.notes += [f"{prim.GetPath()}: {note}" for note in shape.notes]
        for bound, chosen in subsets(prim, shape):
            color, file, is_linear = look_of(bound)
            if is_see_through(bound):
                self._see_through += 1
            vertices, faces = shape.points[shape.point_of], shape.triangles[chosen]
            uv = uv_of(prim, shape) if file is not None else None
            if file is not None and uv is not None and self._is_usable(file):
                yield vertices, faces, uv, (file, color or (1.0, 1.0, 1.0), is_linear)
                continue
            linear = display_colors(prim, shape) if color is None else None
            yield vertices, faces, bytes_of_linear(np.tile(color or GRAY, (len(vertices), 1)) if linear is None else linear), None

    def _is_usable(self, file: Path) -> bool:
        if is_there(file) and stays_in(file, self._root):
            return True
        self.notes.append(f"{file.name} is missing, drawn without it")
        return False


def _joined(groups: list[tuple[Array, Integers, Any]]) -> tuple[Array, Integers, Any]:
    """Meshes as one, without the vertices that no triangle has."""
    vertices, faces, looks, at = [], [], [], 0
    for points, triangles, look in groups:
        used, mine = np.unique(triangles, return_inverse=True)
        vertices.append(points[used])
        faces.append(mine.reshape(-1, 3) + at)
        looks.append(look[used])
        at += len(used)
    return np.concatenate(vertices), np.concatenate(faces), np.concatenate(looks)
