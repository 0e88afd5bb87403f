"""The path finder `recast`: navmeshes as habitat-sim bakes and searches them, by Recast and Detour in a library of our own.

`make native` builds the library from `native/recast.cpp`. A baked file is habitat-sim's bytes, a distance its number.
"""

from __future__ import annotations

import ctypes
import dataclasses
import math
import struct
from collections.abc import Sequence
from functools import cache
from pathlib import Path as File
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.errors import InputError
from tasks.navigation.detour import ON_MESH_M, DetourPathFinder, from_above, space
from tasks.navigation.navmesh import Settings, dump_navmesh, read_navmesh
from tasks.navigation.points import rows
from tasks.navigation.protocol import NO_PATH, Path, PathFinderKind
from tasks.navigation.triangles import scene_triangles
from tasks.navigation.voxels import Voxels

if TYPE_CHECKING:
    import shapely

    from schemas.capture import Shell
    from tasks.geometry.meshes import Surface
    from tasks.navigation.configuration import NavigationConfig

Array = NDArray[np.float64]

LIBRARY = File(__file__).resolve().parents[2] / "native" / "build" / "libmetascenes_recast.so"

_VERSION = 1
"""Version of `native/recast.cpp` that this code is written for: part of the code, so that rows of another are made anew."""

_LONGEST = 256
"""Corners that a path can have."""

_FAILED, _EMPTY = 1, 2
"""What a bake says when there is no navmesh."""

_MOST_CELLS = 5e7
"""Cells seen from above that a bake may have: 350 m square at 5 cm, a gigabyte."""

_SAFETY_M = 1e-4
"""A blocked step ends this far before the edge [m]: farther than single precision rounds."""


def bake(vertices: ArrayLike, faces: ArrayLike, settings: Settings) -> bytes:
    """The .navmesh of a triangle soup, byte for byte as habitat-sim's PathFinder bakes it; no bytes when nothing is walkable.

    Args:
        vertices: Corners in the glTF frame [m], shape (n, 3).
        faces: Triangles, outward counter-clockwise, shape (m, 3).
        settings: Of voxels and agent; they become the file's header.

    Raises:
        InputError: the library is not built, or Recast fails.
    """
    library = _library()
    points = np.ascontiguousarray(vertices, dtype=np.float32).reshape(-1, 3)
    corners = np.ascontiguousarray(faces, dtype=np.int32).reshape(-1, 3)
    if not len(corners):
        return b""
    if corners.min() < 0 or corners.max() >= len(points) or not np.isfinite(points).all():
        raise InputError("navmesh", "triangles", "name vertices that are not there or not finite", "mend the geometry")
    wide, _, deep = np.ptp(points[corners], axis=(0, 1)) / settings.cell_size
    if wide * deep > _MOST_CELLS:
        problem = f"{wide:.0f} x {deep:.0f} cells are too many"
        raise InputError("navmesh", "cell_size", problem, "check the geometry's units, or give larger cells")
    header = struct.pack("<13f4B", *dataclasses.astuple(settings))
    status = ctypes.c_int()
    handle = library.recast_bake(header, _pointer(points), len(points), _pointer(corners), len(corners), ctypes.byref(status))
    if status.value == _EMPTY:
        return b""
    if not handle:
        raise InputError("navmesh", "bake", f"Recast failed on {len(corners)} triangles", "give it fewer triangles or a larger cell_size")
    return RecastMesh(library, handle).save()


class RecastMesh:
    """A Detour navmesh in the library, glTF frame [m]."""

    def __init__(self, library: ctypes.CDLL, handle: int) -> None:
        self._library, self.handle = library, handle

    @classmethod
    def load(cls, data: bytes, file: str = "scene.navmesh") -> RecastMesh:
        """The navmesh of a .navmesh file.

        Raises:
            InputError: the library is not built, or the bytes are no sound file.
        """
        library = _library()
        read_navmesh(data, file)  # Detour itself believes every index
        handle = library.recast_load(data, len(data))
        if not handle:
            raise InputError(file, "tiles", "Detour refuses them", "bake the navmesh again")
        return cls(library, handle)

    def __del__(self) -> None:
        self._library.recast_free(self.handle)

    def save(self) -> bytes:
        """The bytes of its .navmesh file."""
        out = ctypes.create_string_buffer(self._library.recast_save(self.handle, None))
        self._library.recast_save(self.handle, out)
        return out.raw

    @property
    def islands(self) -> NDArray[np.int32]:
        """Connected part of every polygon, shape (n,); a closed polygon is a part of its own."""
        out = np.zeros(self._library.recast_polygon_count(self.handle), dtype=np.int32)
        self._library.recast_islands(self.handle, _pointer(out))
        return out

    def snap(self, points: ArrayLike) -> tuple[Array, NDArray[np.int32]]:
        """The place nearest to each point, shape (n, 3), and its polygon, shape (n,): NaN and -1 farther than 2 m aside or 4 m up."""
        p = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        places, polygons = np.zeros_like(p), np.zeros(len(p), dtype=np.int32)
        self._library.recast_snap(self.handle, _pointer(p), len(p), _pointer(places), _pointer(polygons))
        return places, polygons

    def path(self, start: ArrayLike, goal: ArrayLike) -> tuple[float, NDArray[np.float32]]:
        """Length in space of the path between two points, shape (3,) each [m], and its corners, shape (n, 3).

        The length is habitat-sim's geodesic distance to the last bit. Without a path it is infinite, and there are no corners.
        """
        a, b = (np.ascontiguousarray(p, dtype=np.float32).reshape(3) for p in (start, goal))
        corners, count = np.zeros((_LONGEST, 3), dtype=np.float32), ctypes.c_int()
        length = self._library.recast_path(self.handle, _pointer(a), _pointer(b), _pointer(corners), ctypes.byref(count))
        return float(length), corners[: count.value]

    def clear_share(self, start: Array, end: Array) -> float:
        """Share of a straight move over the floor that meets no edge, 0 to 1. Ends seen from above, world frame [m], shape (2,)."""
        (ax, ay), (bx, by) = start.tolist(), end.tolist()
        return float(self._library.recast_clear_share(self.handle, ax, -ay, bx, -by))


@dataclasses.dataclass(frozen=True)
class RecastConfig(Voxels):
    """Navmesh and paths as habitat-sim makes them, by the library that `make native` builds."""

    kind: ClassVar[str] = "recast"


class RecastPathFinder(DetourPathFinder):
    """Detour's shortest paths on the polygons of a .navmesh, from the floor (z = 0), world frame [m].

    Detour looks for the shortest corridor of polygons by the middles of their edges and draws a string through it:
    a path is as habitat-sim's, and a few percent longer than the exact one where the corridor is another.
    """

    name = RecastConfig.kind

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._mesh = RecastMesh.load(dump_navmesh(self.floor)) if self.floor else None

    def _places(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        if self._mesh is None:
            return np.full((len(points), 2), np.nan), np.full(len(points), -1, dtype=np.int64)
        places, polygons = self._mesh.snap(space(points))
        return from_above(places), polygons.astype(np.int64)

    def field(self, goals: ArrayLike) -> RecastField:
        """Distances and paths to the nearest of `goals`, shape (n, 2). Goals that are not navigable are never reached."""
        return RecastField(self._mesh, rows(goals))

    def is_clear(self, start: ArrayLike, end: ArrayLike) -> bool:
        """Whether a straight move from a navigable point to anywhere, shape (2,) each, meets no edge of the navmesh."""
        return self._mesh is not None and self._mesh.clear_share(rows(start)[0], rows(end)[0]) >= 1

    def try_step(self, position: ArrayLike, offset: ArrayLike) -> Array:
        """Where a straight move of `offset` from a navigable point ends, shape (2,): short of the first edge; no sliding."""
        start = rows(position)[0]
        way = rows(offset)[0]
        share = self._mesh.clear_share(start, start + way) if self._mesh else 0.0
        if share >= 1:
            return np.asarray(start + way)
        stop = start + way * max(0.0, share - _SAFETY_M / max(math.hypot(way[0], way[1]), _SAFETY_M))
        return stop if self.is_navigable(stop)[0] and self.is_clear(start, stop) else start


class RecastField:
    """Geodesic distance to the nearest of a set of goals on a Detour navmesh, measured on the floor."""

    def __init__(self, mesh: RecastMesh | None, goals: Array) -> None:
        self._mesh, self._goals = mesh, goals
        points = space(goals)
        self._handle = mesh and mesh._library.recast_goals(mesh.handle, _pointer(points), len(points), ON_MESH_M)
        self._corners = np.zeros((_LONGEST, 3))
        self._count, self._goal = ctypes.c_int(), ctypes.c_int()
        self._out = (_pointer(self._corners), ctypes.byref(self._count), ctypes.byref(self._goal))

    def __del__(self) -> None:
        if self._mesh is not None:
            self._mesh._library.recast_free_goals(self._handle)

    def distances(self, points: ArrayLike) -> Array:
        """Geodesic distances from points, shape (n, 2), to the nearest goal [m], shape (n,); infinite without a path."""
        p = rows(points).tolist()
        if self._mesh is None:
            return np.full(len(p), np.inf)
        distance = self._mesh._library.recast_goal_distance
        return np.array([distance(self._handle, x, -y) for x, y in p], dtype=np.float64)

    def path(self, start: ArrayLike) -> Path:
        """Shortest path from `start`, shape (2,), to the nearest goal."""
        if self._mesh is None:
            return NO_PATH
        point = rows(start)[0]
        x, y = point.tolist()
        length = self._mesh._library.recast_goal_path(self._handle, x, -y, *self._out)
        if self._goal.value < 0:
            return NO_PATH
        corners = from_above(self._corners[: self._count.value])
        corners[0], corners[-1] = point, self._goals[self._goal.value]
        return Path(length, corners, self._goal.value)


def _pointer(array: NDArray[np.generic]) -> int:
    return array.ctypes.data


@cache
def _library() -> ctypes.CDLL:
    """The library that `make native` builds.

    Raises:
        InputError: it is not built, or cannot be loaded.
    """
    remedy = "install librecast-dev and g++ and run make native in a checkout of the repository"
    if not LIBRARY.is_file():
        raise InputError(LIBRARY.name, "path_finder", "recast needs this library, and it is not built", remedy)
    try:
        library = ctypes.CDLL(str(LIBRARY))
    except OSError as error:
        raise InputError(LIBRARY.name, "path_finder", f"recast needs this library, and it does not load: {error}", remedy) from error
    if not hasattr(library, "recast_version") or library.recast_version() != _VERSION:
        raise InputError(LIBRARY.name, "path_finder", "the library is of another version than this code", "run make native again")
    pointer, whole, number = ctypes.c_void_p, ctypes.c_int, ctypes.c_double
    for name, returns, takes in (
        ("bake", pointer, (ctypes.c_char_p, pointer, whole, pointer, whole, pointer)),
        ("load", pointer, (ctypes.c_char_p, ctypes.c_int64)),
        ("free", None, (pointer,)),
        ("save", ctypes.c_int64, (pointer, pointer)),
        ("polygon_count", whole, (pointer,)),
        ("islands", None, (pointer, pointer)),
        ("snap", None, (pointer, pointer, whole, pointer, pointer)),
        ("path", number, (pointer, pointer, pointer, pointer, pointer)),
        ("clear_share", number, (pointer, number, number, number, number)),
        ("goals", pointer, (pointer, pointer, whole, number)),
        ("free_goals", None, (pointer,)),
        ("goal_distance", number, (pointer, number, number)),
        ("goal_path", number, (pointer, number, number, pointer, pointer, pointer)),
    ):
        function = getattr(library, f"recast_{name}")
        function.restype, function.argtypes = returns, takes
    return library


def _build(room: Shell, surfaces: Sequence[Surface], walls: Sequence[shapely.Geometry], config: NavigationConfig) -> RecastPathFinder:
    return RecastPathFinder(bake(*scene_triangles(room, surfaces, config.settings), config.settings))


RECAST = PathFinderKind(name="recast", config=RecastConfig, build=_build)
