"""A place in a texture for every corner of a mesh: by xatlas in this process, or by Blender's Smart UV in a process of its own.

The paper takes Smart UV, as its layouts have fewer fragments than those of the tool that it textures with (supplementary A.1). Blender's
module is under the GPL: it is run, with files in between, and never imported.
"""

from __future__ import annotations

import dataclasses
import math
import shutil
import time
from collections.abc import Hashable
from pathlib import Path
from typing import Annotated, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from schemas.errors import InputError
from schemas.files import read_file
from schemas.machine.scratch import temporary_folder
from tasks.calls.command import run_apart
from tasks.geometry.triangles import distinct_rows, face_areas, welded
from tasks.settings import Config, Count, Natural, Positive, Share
from tasks.texturing.charts import flat_faces

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SCRIPT = Path(__file__).with_name("smart_uv_script.py")

Degrees = Annotated[float, Field(gt=0, le=89)]


@dataclasses.dataclass(frozen=True)
class Unwrapped:
    """A mesh with places in a texture: the same triangles in the same order, vertices split where the texture is cut.

    source: The vertex of the original that each vertex is at, shape (k,). vertices: [m], shape (k, 3), equal to the original's bit for
    bit. faces: shape (m, 3). uv: shape (k, 2), single precision, origin at the lower left. by: who made the layout, with its version.
    """

    source: Integers
    vertices: Array
    faces: Integers
    uv: Array
    by: str
    seconds: float


class Unwrapper(Hashable, Protocol):
    """A config that unwraps."""

    kind: ClassVar[str]

    @property
    def max_faces(self) -> int:
        """Meshes of more faces are refused."""

    def corner_places(self, vertices: Array, faces: Integers) -> tuple[Array, str]:
        """A place for every corner of every face, shape (m, 3, 2), and the version of who says so. The mesh is welded: [m], shape
        (n, 3); faces, shape (m, 3), have an area, and no two have the same corners.

        Raises:
            InputError: no layout was found.
        """


@dataclasses.dataclass(frozen=True)
class XatlasUnwrapper(Config):
    """Charts grown over the surface and flattened, by xatlas (MIT)."""

    kind: ClassVar[str] = "xatlas"
    max_faces: Count = 50_000  # it has no limit of time: so many take minutes where every face is a chart
    padding_px: Natural = 4  # between charts, so that two levels of smaller textures keep them apart
    atlas_px: Count = 1024  # the side that the padding is meant at

    def corner_places(self, vertices: Array, faces: Integers) -> tuple[Array, str]:
        """As the protocol says."""
        import importlib.metadata

        import xatlas

        atlas, pack = xatlas.Atlas(), xatlas.PackOptions()
        pack.padding, pack.resolution = self.padding_px, self.atlas_px
        # it takes triangles below 1e-7 for none, whatever the unit: here a usual one has an area of 1
        scale = 1.0 / math.sqrt(float(np.median(face_areas(vertices, faces))))
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        atlas.add_mesh(((vertices - middle) * scale).astype(np.float32), faces.astype(np.uint32))
        atlas.generate(xatlas.ChartOptions(), pack)
        origin, corners, places = atlas[0]
        if (origin[corners] != faces).any():
            raise InputError("mesh", "faces", "xatlas gave them back in another order", "unwrap it by another tool")
        # it divides columns by the width and lines by the height: texels would not be square
        square = np.array([atlas.width, atlas.height]) / max(atlas.width, atlas.height, 1)
        return places[corners].astype(np.float64) * square, f"xatlas {importlib.metadata.version('xatlas')}"


@dataclasses.dataclass(frozen=True)
class SmartUvUnwrapper(Config):
    """Blender's Smart UV Project: faces of similar normals are projected along their mean."""

    kind: ClassVar[str] = "smart_uv"
    program: str = ""  # an interpreter that has bpy, or a blender binary; without one it is not asked
    max_faces: Count = 200_000  # of which it takes a minute
    angle_limit_degrees: Degrees = 66.0  # Blender's default, by which the paper goes
    island_margin: Share = 0.004  # between charts: 4 texels of a texture of 1024
    timeout_s: Positive = 300.0  # start and all

    def corner_places(self, vertices: Array, faces: Integers) -> tuple[Array, str]:
        """As the protocol says."""
        field, remedy = "smart_uv.program", "name an interpreter that has bpy 4.5, or a blender binary"
        program = shutil.which(self.program) if self.program else None
        if program is None:
            raise InputError(self.program or "smart_uv", field, "is no program that can be run", remedy)
        before = ["-I", str(SCRIPT.resolve())]
        if Path(program).name.lower().startswith("blender"):
            before = ["--background", "--factory-startup", "--python-exit-code", "3", "--python", str(SCRIPT.resolve()), "--"]
        with temporary_folder() as folder:
            vertices.astype("<f8").tofile(folder / "vertices.f8")
            faces.astype("<i8").tofile(folder / "faces.i8")
            np.array([math.radians(self.angle_limit_degrees), self.island_margin], dtype="<f8").tofile(folder / "settings.f8")
            try:
                ending = run_apart([str(Path(program).absolute()), *before, str(folder)], folder, self.timeout_s)
            except (OSError, ValueError) as error:
                raise InputError(self.program, field, f"cannot be run: {error}", remedy) from error
            if ending.problem:
                raise InputError(self.program, field, f"Smart UV {ending.problem}", remedy if ending.code else "raise timeout_s")
            places = read_file(folder / "uv.f4", "uv.f4 of Smart UV", 24 * len(faces), remedy)
            version = read_file(folder / "version.txt", "version.txt of Smart UV", 100, remedy).decode(errors="replace")
        if len(places) != 24 * len(faces):
            raise InputError(self.program, field, f"left {len(places)} bytes for {len(faces)} faces", remedy)
        return np.frombuffer(places, dtype="<f4").reshape(-1, 3, 2).astype(np.float64), f"Blender {version} Smart UV"


def unwrapped(unwrapper: Unwrapper, vertices: ArrayLike, faces: ArrayLike) -> Unwrapped:
    """A mesh with places in a texture. vertices: [m], shape (n, 3). faces: shape (m, 3), in any winding.

    Vertices at one place count as one, whatever split them. Triangles without area get a single place.

    Raises:
        InputError: the mesh has too many faces, none with an area or coordinates that are not finite, or the tool failed; says why.
    """
    clock = time.monotonic()
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    if len(corners) > unwrapper.max_faces:
        problem = f"has {len(corners)} faces, more than {unwrapper.max_faces}"
        raise InputError("mesh", "faces", problem, f"decimate it, or raise {unwrapper.kind}.max_faces")
    if not len(corners) or not np.isfinite(points[corners]).all():
        raise InputError("mesh", "vertices", "has no faces, or coordinates that are not finite", "export it again")
    first, place = welded(points)
    solid = np.flatnonzero(~flat_faces(points[first], place[corners]))
    if not len(solid):
        raise InputError("mesh", "faces", "has no triangle with an area", "export it again, in metres")
    at, joined = _without_twins(points[first], place[corners[solid]])
    own, version = unwrapper.corner_places(at, joined)
    if own.shape != (len(solid), 3, 2) or not np.isfinite(own).all():
        raise InputError("mesh", "uv", f"{version} left places that are not finite", "unwrap it by another tool")
    places = np.zeros((len(corners), 3, 2))
    places[solid] = own
    _settle_flat(places, place[corners], solid)
    rows = np.column_stack([corners.ravel(), places.astype(np.float32).reshape(-1, 2).astype(np.float64)])
    kept, row = distinct_rows(rows)
    source = corners.ravel()[kept]
    return Unwrapped(source, points[source], row.reshape(-1, 3), np.asarray(rows[kept, 1:], np.float64), version, time.monotonic() - clock)


def _without_twins(points: Array, corners: Integers) -> tuple[Array, Integers]:
    """The mesh with vertices of its own for every face whose corners an earlier one has: sheets with two sides are two."""
    first, which = distinct_rows(np.sort(corners, axis=1))
    twins = np.flatnonzero(first[which] != np.arange(len(corners)))
    own = corners.copy()
    own[twins] = len(points) + np.arange(3 * len(twins)).reshape(-1, 3)
    return np.concatenate([points, points[corners[twins].ravel()]]), own


def _settle_flat(places: Array, corners: Integers, solid: Integers) -> None:
    """Put triangles without area where the texture has one of their corners, if any: all three corners there."""
    is_flat = np.ones(len(corners), dtype=bool)
    is_flat[solid] = False
    known = np.full(int(corners.max()) + 1, -1, dtype=np.int64)
    known[corners[solid].ravel()[::-1]] = np.arange(3 * len(solid))[::-1]
    of = known[corners[is_flat]].max(axis=1)
    places[is_flat] = np.where((of >= 0)[:, None], places[solid].reshape(-1, 2)[of], 0.0)[:, None]
