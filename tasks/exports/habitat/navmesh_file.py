"""What a .navmesh file says, read for checking only and on purpose independent of what writes it (`tasks/navigation`).

habitat-sim's container (version 1 or 2) around Detour tiles (version 7), little-endian, glTF frame.
"""

from __future__ import annotations

import dataclasses
import struct
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

SETTINGS = (
    "cellSize", "cellHeight", "agentHeight", "agentRadius", "agentMaxClimb", "agentMaxSlope", "regionMinSize", "regionMergeSize",
    "edgeMaxLen", "edgeMaxError", "vertsPerPoly", "detailSampleDist", "detailSampleMaxError",
    "filterLowHangingObstacles", "filterLedgeSpans", "filterWalkableLowHeightSpans", "includeStaticObjects",
)  # fmt: skip
"""Settings in the order of the file's header."""

DEFAULTS: dict[str, float] = dict(
    zip(SETTINGS, (0.05, 0.2, 1.5, 0.1, 0.2, 45.0, 20.0, 20.0, 12.0, 1.3, 6.0, 6.0, 1.0, 1.0, 1.0, 1.0, 0.0), strict=True)
)
"""habitat-sim's defaults. habitat-lab changes those of the agent and includeStaticObjects, and bakes anew unless all are equal."""

NEAR = 0.05
"""A point this far beside a polygon still counts as on it [m]: one cell of habitat-sim's default bake."""

_OTHER_TILE = 0x8000  # from here on a neighbor lies in another tile
_TOUCHING = 1e-3  # metres in plan
_NEIGHBORS, _AT_ONCE = 256, 16  # polygons that touch one in plan, on all floors; those that are asked about at once
_FAR = 1e5  # metres: 32-bit numbers no longer tell centimetres apart there


@dataclasses.dataclass(frozen=True)
class NavmeshPolygons:
    """Settings (None in version 1) and walkable polygons, corners in the glTF frame [m], shape (k, 3) each.

    islands: Connected part of every polygon, over the neighbors that the file names, shape (n,).
    """

    version: int
    settings: dict[str, float] | None
    polygons: list[NDArray[np.float64]]
    islands: NDArray[np.int64]

    def distance(self, point: NDArray[np.float64]) -> tuple[float, float]:
        """Horizontal distance [m] from a point (3,) to the walkable area, and how far [m] it lies above or below there.

        Where floors lie above one another, the nearest in height of those that it stands on, or less than `NEAR` beside.
        """
        if not self.polygons:
            return np.inf, np.inf
        rings, heights = self._rings
        place = point[[0, 2]]
        a, b = rings, np.roll(rings, -1, axis=1)
        edge, to = b - a, place - a
        side = edge[..., 0] * to[..., 1] - edge[..., 1] * to[..., 0]
        inside = (side >= 0).all(axis=1) | (side <= 0).all(axis=1)
        length = np.maximum((edge * edge).sum(axis=2), 1e-18)
        along = np.clip((to * edge).sum(axis=2) / length, 0.0, 1.0)
        gaps = np.where(inside, 0.0, np.linalg.norm(to - along[..., None] * edge, axis=2).min(axis=1))
        above = np.where(gaps <= max(gaps.min(), NEAR), np.abs(heights - point[1]), np.inf)
        nearest = int(np.lexsort((gaps, above))[0])
        return float(gaps[nearest]), float(above[nearest])

    @cached_property
    def _rings(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners in plan, shape (n, 6, 2), the last one repeated, and mean height [m], shape (n,)."""
        padded = [corners[np.minimum(np.arange(6), len(corners) - 1)] for corners in self.polygons]
        return np.array(padded)[:, :, [0, 2]], np.array([corners[:, 1].mean() for corners in self.polygons])


def read_polygons(data: bytes) -> NavmeshPolygons:
    """Read a .navmesh.

    Raises:
        ValueError: what is wrong with the file, in one line.
    """
    try:
        magic, version, tiles = struct.unpack_from("<4sii", data, 0)
        if magic != b"TESM":
            raise ValueError(f"magic is {magic!r}, not b'TESM'")
        if version not in (1, 2):
            raise ValueError(f"version is {version}, not 1 or 2")
        offset, settings = 40, None
        if version == 2:
            values = struct.unpack_from("<13f4B", data, offset)
            settings = {name: float(value) for name, value in zip(SETTINGS, values, strict=True)}
            offset += 56
        polygons: list[NDArray[np.float64]] = []
        links: list[tuple[int, int]] = []
        for _ in range(tiles):
            _, size = struct.unpack_from("<Ii", data, offset)
            offset += 8
            if size < 100 or offset + size > len(data):
                raise ValueError(f"a tile of {size} bytes does not fit into the {len(data)} bytes of the file")
            _tile(data[offset : offset + size], polygons, links)
            offset += size
    except struct.error as error:
        raise ValueError(f"is cut off ({error})") from error
    if offset != len(data):
        raise ValueError(f"has {len(data) - offset} bytes too many")
    return NavmeshPolygons(version, settings, polygons, _parts(polygons, links + (_across(polygons) if tiles > 1 else [])))


def _parts(polygons: list[NDArray[np.float64]], links: list[tuple[int, int]]) -> NDArray[np.int64]:
    """Number of the connected part of every polygon."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(polygons)
    pairs = np.array(links, dtype=np.int64).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _across(polygons: list[NDArray[np.float64]]) -> list[tuple[int, int]]:
    """Pairs of polygons that touch in plan. Detour links tiles by their borders when it loads them; no file names such links."""
    import shapely

    flat = [shapely.Polygon(corners[:, [0, 2]]) for corners in polygons]
    tree, pairs = shapely.STRtree(flat), list[tuple[int, int]]()
    for start in range(0, len(flat), _AT_ONCE):
        near = tree.query(flat[start : start + _AT_ONCE], predicate="dwithin", distance=_TOUCHING)
        if near.shape[1] > _NEIGHBORS * _AT_ONCE:
            raise ValueError(f"has polygons that lie on one another, more than {_NEIGHBORS} on each")
        pairs += [(start + int(a), int(b)) for a, b in near.T]
    return pairs


def _tile(data: bytes, polygons: list[NDArray[np.float64]], links: list[tuple[int, int]]) -> None:
    """Append the corners of the walkable polygons of a Detour tile, and pairs of neighbors among them by position in `found`."""
    magic, version = struct.unpack_from("<ii", data, 0)
    if magic != 0x444E4156 or version != 7:
        raise ValueError(f"a tile has magic {magic:#x} and version {version}, not Detour's 0x444e4156 and 7")
    polygon_count, vertex_count = struct.unpack_from("<ii", data, 24)
    if min(polygon_count, vertex_count) < 0 or 100 + 12 * vertex_count + 32 * polygon_count > len(data):
        raise ValueError(f"a tile of {len(data)} bytes cannot hold {vertex_count} vertices and {polygon_count} polygons")
    vertices = np.frombuffer(data, "<f4", 3 * vertex_count, 100).reshape(-1, 3).astype(np.float64)
    if not (np.abs(vertices) < _FAR).all():
        raise ValueError(f"a vertex is not finite or lies {_FAR:g} m away")
    place: dict[int, int] = {}
    named: list[tuple[int, int]] = []
    for index in range(polygon_count):
        start = 100 + 12 * vertex_count + 32 * index
        corners = struct.unpack_from("<6H", data, start + 4)
        flags, count, area_and_type = struct.unpack_from("<HBB", data, start + 28)
        if not 3 <= count <= 6 or max(corners[:count]) >= vertex_count:
            raise ValueError(f"polygon {index} names vertices that do not exist")
        if flags & 1 and area_and_type >> 6 == 0:
            place[index] = len(polygons)
            polygons.append(vertices[list(corners[:count])])
            beyond = struct.unpack_from("<6H", data, start + 16)[:count]
            named += [(index, other - 1) for other in beyond if 0 < other < _OTHER_TILE]
    if any(other >= polygon_count for _, other in named):
        raise ValueError("a polygon names a neighbor that does not exist")
    links += [(place[a], place[b]) for a, b in named if b in place]
