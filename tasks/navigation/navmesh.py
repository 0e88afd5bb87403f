"""habitat-sim's .navmesh files as plain arrays: read, written, and made from convex polygons.

The format is habitat-sim's PathFinder container (version 1 or 2) around raw Detour tiles (version 7), little-endian,
in the glTF frame (+Y up). A file that is read and written again is the same bytes.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.navigation.convex import ConvexCover

MAGIC = 0x4D534554
TILE_MAGIC, TILE_VERSION = 0x444E4156, 7
CORNERS = 6
"""Corners that a Detour polygon can have."""

_HEAD, _PARAMS, _SETTINGS, _TILE = struct.Struct("<iii"), struct.Struct("<5f2i"), struct.Struct("<13f4B"), struct.Struct("<Ii")
_HEADER = struct.Struct("<5iI9i10f")

POLYGON = np.dtype(
    [
        ("first_link", "<u4"),
        ("vertices", "<u2", CORNERS),
        ("neighbors", "<u2", CORNERS),
        ("flags", "<u2"),
        ("count", "u1"),
        ("area_and_type", "u1"),
    ]
)
LINK = np.dtype([("reference", "<u4"), ("next", "<u4"), ("edge", "u1"), ("side", "u1"), ("low", "u1"), ("high", "u1")])
DETAIL = np.dtype([("vertex_base", "<u4"), ("triangle_base", "<u4"), ("vertex_count", "u1"), ("triangle_count", "u1"), ("padding", "<u2")])
BOX_NODE = np.dtype([("low", "<u2", 3), ("high", "<u2", 3), ("index", "<i4")])
OFF_MESH = np.dtype([("positions", "<f4", 6), ("radius", "<f4"), ("polygon", "<u2"), ("flags", "u1"), ("side", "u1"), ("user", "<u4")])

_WALKABLE = 1  # habitat-sim's polygon flag for "can be walked on"
_GROUND = 0  # Detour's type of a polygon; the other is a connection between two points
_TYPE_SHIFT = 6  # the type's place in `area_and_type`
_EDGE_OF_POLYGON = 1  # Detour's flag for a detail triangle's edge that is an edge of its polygon
_MOST = 0x7FFF
"""Polygons and vertices that a tile can number: the sixteenth bit of a neighbor means another tile."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """What the navmesh was made for. habitat-sim bakes anew, silently, unless its own settings equal these.

    The defaults are habitat-sim's, but for the agent and `include_static_objects`.
    """

    cell_size: float = 0.05
    cell_height: float = 0.2
    agent_height: float = 0.88
    agent_radius: float = 0.18
    agent_max_climb: float = 0.2
    agent_max_slope: float = 45.0
    region_min_size: float = 20.0
    region_merge_size: float = 20.0
    edge_max_length: float = 12.0
    edge_max_error: float = 1.3
    vertices_per_polygon: float = 6.0
    detail_sample_distance: float = 6.0
    detail_sample_max_error: float = 1.0
    filter_low_hanging_obstacles: bool = True
    filter_ledge_spans: bool = True
    filter_walkable_low_height_spans: bool = True
    include_static_objects: bool = True  # furniture is an object there; without it an equal navmesh would ignore it


@dataclasses.dataclass(frozen=True)
class Tile:
    """A Detour tile, glTF frame [m]. The arrays have the format's own types.

    vertices: Shape (n, 3) float32. polygons, links, details, box_nodes, off_mesh: Records as declared above.
    detail_vertices: Shape (k, 3) float32. detail_triangles: Three corners and edge flags, shape (t, 4) uint8.
    place: Column, row and layer. bounds: Lowest and highest corner, 6 numbers.
    """

    reference: int
    place: tuple[int, int, int]
    user_id: int
    off_mesh_base: int
    walkable: tuple[float, float, float]
    bounds: tuple[float, ...]
    box_quantization: float
    vertices: NDArray[np.float32]
    polygons: NDArray[np.void]
    links: NDArray[np.void]
    details: NDArray[np.void]
    detail_vertices: NDArray[np.float32]
    detail_triangles: NDArray[np.uint8]
    box_nodes: NDArray[np.void]
    off_mesh: NDArray[np.void]


@dataclasses.dataclass(frozen=True)
class NavmeshFile:
    """A whole .navmesh file. `origin`, `tile_size`, `most_tiles` and `most_polygons` are Detour's parameters."""

    version: int
    origin: tuple[float, float, float]
    tile_size: tuple[float, float]
    most_tiles: int
    most_polygons: int
    settings: Settings | None
    tiles: tuple[Tile, ...]


def read_navmesh(data: bytes, file: str = "scene.navmesh") -> NavmeshFile:
    """A .navmesh file, version 1 or 2.

    Raises:
        InputError: the bytes are no such file, are cut short or run on, or name polygons or vertices that are not there.
    """
    reader = _Reader(data, file)
    magic, version, count = reader.take(_HEAD, "header")
    if magic != MAGIC:
        raise InputError(file, "magic", f"is {magic & 0xFFFFFFFF:#x}, not {MAGIC:#x}", "this is no .navmesh file of habitat-sim")
    if version not in (1, 2):
        raise InputError(file, "version", f"is {version}, known are 1 and 2", "save it with habitat-sim 0.2 or later")
    if not 0 <= count <= len(data):
        raise InputError(file, "tiles", f"count of {count} cannot be", "the file is damaged")
    *numbers, most_tiles, most_polygons = reader.take(_PARAMS, "parameters")
    settings = None
    if version == 2:
        values = reader.take(_SETTINGS, "settings")
        settings = Settings(*values[:13], *(bool(v) for v in values[13:]))
    tiles = tuple(_read_tile(reader, number) for number in range(count))
    if reader.offset != len(data):
        raise InputError(file, "end", f"{len(data) - reader.offset} bytes follow the last tile", "the file is damaged")
    return NavmeshFile(version, (numbers[0], numbers[1], numbers[2]), (numbers[3], numbers[4]), most_tiles, most_polygons, settings, tiles)


def dump_navmesh(navmesh: NavmeshFile) -> bytes:
    """The bytes of a .navmesh file; inverse of `read_navmesh`."""
    out = [_HEAD.pack(MAGIC, navmesh.version, len(navmesh.tiles))]
    out.append(_PARAMS.pack(*navmesh.origin, *navmesh.tile_size, navmesh.most_tiles, navmesh.most_polygons))
    if navmesh.version == 2:
        out.append(_SETTINGS.pack(*dataclasses.astuple(navmesh.settings or Settings())))
    for tile in navmesh.tiles:
        body = _tile_bytes(tile)
        out += [_TILE.pack(tile.reference, len(body)), body]
    return b"".join(out)


def navmesh_from_polygons(cover: ConvexCover, settings: Settings, floor_y: float = 0.0) -> NavmeshFile:
    """A navmesh of convex polygons on a flat floor, world frame (x, y) [m], turned into the glTF frame (x, floor_y, -y).

    Counter-clockwise polygons keep their order: seen from above, in glTF's frame, they run as Detour wants them.
    Detail meshes are fans. There is no bounding volume tree, which Detour allows, and links are left for it to build.

    Raises:
        ValueError: there is no polygon, or more than a tile can number.
    """
    count, sizes = len(cover.polygons), [len(ring) for ring in cover.polygons]
    if not 0 < count < _MOST or len(cover.vertices) > 2 * _MOST or max(sizes) > CORNERS:
        raise ValueError(f"navmesh: {count} polygons of up to {max(sizes, default=0)} corners do not fit a tile")
    vertices = np.column_stack([cover.vertices[:, 0], np.full(len(cover.vertices), floor_y), -cover.vertices[:, 1]]).astype("<f4")
    polygons = np.zeros(count, dtype=POLYGON)
    polygons["first_link"], polygons["flags"], polygons["count"] = 0xFFFFFFFF, _WALKABLE, sizes
    triangles = []
    for number, (ring, beyond) in enumerate(zip(cover.polygons, cover.neighbors, strict=True)):
        polygons["vertices"][number, : len(ring)] = ring
        polygons["neighbors"][number, : len(ring)] = [n + 1 for n in beyond]
        triangles += _fan(len(ring))
    details = np.zeros(count, dtype=DETAIL)
    details["triangle_count"] = np.array(sizes) - 2
    details["triangle_base"][1:] = np.cumsum(details["triangle_count"], dtype=np.uint32)[:-1]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    high[1] = np.float32(floor_y + settings.agent_height)
    tile = Tile(
        reference=1 << (count - 1).bit_length(),  # salt 1 above the bits that number polygons; one tile takes no bits
        place=(0, 0, 0),
        user_id=0,
        off_mesh_base=count,
        walkable=(settings.agent_height, settings.agent_radius, settings.agent_max_climb),
        bounds=(*map(float, low), *map(float, high)),
        box_quantization=1.0 / settings.cell_size,
        vertices=vertices,
        polygons=polygons,
        links=np.zeros(sum(sizes), dtype=LINK),
        details=details,
        detail_vertices=np.zeros((0, 3), dtype="<f4"),
        detail_triangles=np.array(triangles, dtype=np.uint8).reshape(-1, 4),
        box_nodes=np.zeros(0, dtype=BOX_NODE),
        off_mesh=np.zeros(0, dtype=OFF_MESH),
    )
    size = (float(high[0] - low[0]), float(high[2] - low[2]))
    return NavmeshFile(2, (float(low[0]), float(low[1]), float(low[2])), size, 1, count, settings, (tile,))


def walkable_polygons(tile: Tile) -> NDArray[np.bool_]:
    """Polygons that an agent may walk on, shape (n,)."""
    ground = tile.polygons["area_and_type"] >> _TYPE_SHIFT == _GROUND
    return np.asarray(ground & (tile.polygons["flags"] & _WALKABLE > 0))


def polygon_areas(tile: Tile) -> NDArray[np.float64]:
    """Area of every polygon seen from above [m2], shape (n,)."""
    areas = np.zeros(len(tile.polygons))
    for number, polygon in enumerate(tile.polygons):
        x, _, z = tile.vertices[polygon["vertices"][: polygon["count"]]].astype(np.float64).T
        areas[number] = -0.5 * float(np.sum(x * np.roll(z, -1) - np.roll(x, -1) * z))
    return areas


def polygon_islands(tile: Tile, open_to_agents: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Connected part of every polygon, walking over the neighbors that the file names, shape (n,).

    `open_to_agents`: Polygons that can be walked on, shape (n,); the others belong to no part, which is -1. None: all can.
    """
    island = np.full(len(tile.polygons), -1, dtype=np.int64)
    is_open = np.ones(len(island), dtype=np.bool_) if open_to_agents is None else open_to_agents
    for seed in np.flatnonzero(is_open):
        if island[seed] >= 0:
            continue
        island[seed], front = island.max() + 1, [int(seed)]
        while front:
            polygon = tile.polygons[front.pop()]
            for beyond in polygon["neighbors"][: polygon["count"]].astype(int) - 1:
                if 0 <= beyond < len(island) and is_open[beyond] and island[beyond] < 0:
                    island[beyond] = island[seed]
                    front.append(beyond)
    return island


def _fan(count: int) -> list[tuple[int, int, int, int]]:
    """Triangles of a convex polygon around its first corner, with flags for the edges that are the polygon's."""
    flags = [(int(k == 1) << 0 | 1 << 2 | int(k == count - 2) << 4) * _EDGE_OF_POLYGON for k in range(1, count - 1)]
    return [(0, k, k + 1, flag) for k, flag in zip(range(1, count - 1), flags, strict=True)]


class _Reader:
    """Takes a file apart from front to back."""

    def __init__(self, data: bytes, file: str) -> None:
        self.data, self.file, self.offset = data, file, 0

    def take(self, layout: struct.Struct, field: str) -> tuple[Any, ...]:
        self._need(layout.size, field)
        values = layout.unpack_from(self.data, self.offset)
        self.offset += layout.size
        return values

    def array(self, dtype: np.dtype[np.void] | str, count: int, width: int, field: str) -> Any:
        kind = np.dtype(dtype)
        if count < 0:
            raise InputError(self.file, field, f"count of {count} cannot be", "the file is damaged")
        self._need(kind.itemsize * count * width, field)
        rows = np.frombuffer(self.data, kind, count * width, self.offset)
        self.offset += kind.itemsize * count * width
        return rows.reshape(count, width) if width > 1 else rows

    def _need(self, size: int, field: str) -> None:
        if self.offset + size > len(self.data):
            problem = f"needs {size} bytes at {self.offset}, the file ends at {len(self.data)}"
            raise InputError(self.file, field, problem, "the file is cut short")


def _read_tile(reader: _Reader, number: int) -> Tile:
    file, name = reader.file, f"tile {number}"
    reference, size = reader.take(_TILE, name)
    begin = reader.offset
    head = reader.take(_HEADER, f"{name} header")
    magic, version, x, y, layer, user = head[:6]
    if (magic, version) != (TILE_MAGIC, TILE_VERSION):
        raise InputError(file, f"{name} header", f"is not a Detour tile of version {TILE_VERSION}", "the file is damaged")
    polygon_count, vertex_count, links, details, detail_vertices, detail_triangles, nodes, off_mesh, base = head[6:15]
    tile = Tile(
        reference=reference,
        place=(x, y, layer),
        user_id=user,
        off_mesh_base=base,
        walkable=head[15:18],
        bounds=head[18:24],
        box_quantization=head[24],
        vertices=reader.array("<f4", vertex_count, 3, f"{name} vertices"),
        polygons=reader.array(POLYGON, polygon_count, 1, f"{name} polygons"),
        links=reader.array(LINK, links, 1, f"{name} links"),
        details=reader.array(DETAIL, details, 1, f"{name} details"),
        detail_vertices=reader.array("<f4", detail_vertices, 3, f"{name} detail vertices"),
        detail_triangles=reader.array("u1", detail_triangles, 4, f"{name} detail triangles"),
        box_nodes=reader.array(BOX_NODE, nodes, 1, f"{name} bounding boxes"),
        off_mesh=reader.array(OFF_MESH, off_mesh, 1, f"{name} off-mesh connections"),
    )
    if reader.offset - begin != size:
        raise InputError(file, f"{name} size", f"says {size} bytes, its parts take {reader.offset - begin}", "the file is damaged")
    _check_tile(tile, file, name)
    return tile


def _check_tile(tile: Tile, file: str, name: str) -> None:
    """Refuse indices that point nowhere: Detour itself would read beyond its arrays."""
    counts = tile.polygons["count"]
    if (counts > CORNERS).any():
        raise InputError(file, f"{name} polygons", f"a polygon has {counts.max()} corners", "the file is damaged")
    if ((counts < 3) & (tile.polygons["area_and_type"] >> _TYPE_SHIFT == _GROUND)).any():
        raise InputError(file, f"{name} polygons", f"a polygon has {counts.min()} corners", "the file is damaged")
    used = np.arange(CORNERS) < counts[:, None]
    if (used & (tile.polygons["vertices"] >= len(tile.vertices))).any():
        raise InputError(file, f"{name} polygons", "a corner names a vertex that does not exist", "the file is damaged")
    inner = used & (tile.polygons["neighbors"] < 0x8000)
    if (inner & (tile.polygons["neighbors"] > len(tile.polygons))).any():
        raise InputError(file, f"{name} polygons", "a neighbor does not exist", "the file is damaged")
    if not np.isfinite(tile.vertices).all():
        raise InputError(file, f"{name} vertices", "are not all finite", "the file is damaged")


def _tile_bytes(tile: Tile) -> bytes:
    header = _HEADER.pack(
        TILE_MAGIC, TILE_VERSION, *tile.place, tile.user_id,
        len(tile.polygons), len(tile.vertices), len(tile.links), len(tile.details), len(tile.detail_vertices),
        len(tile.detail_triangles), len(tile.box_nodes), len(tile.off_mesh), tile.off_mesh_base,
        *tile.walkable, *tile.bounds, tile.box_quantization,
    )  # fmt: skip
    parts: Sequence[NDArray[np.generic]] = (
        tile.vertices, tile.polygons, tile.links, tile.details, tile.detail_vertices, tile.detail_triangles, tile.box_nodes, tile.off_mesh,
    )  # fmt: skip
    return header + b"".join(part.tobytes() for part in parts)
