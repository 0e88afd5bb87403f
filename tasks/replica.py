"""A scene's replica as meshes in the world frame: the room's shell and the assets that were placed in it."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.capture import Room
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.meshes import load_glb
from tasks.settings import LISTED, Config, Whole
from tasks.transforms import matrix

if TYPE_CHECKING:
    import trimesh

Phase = Literal["proposed", "optimized"]


@dataclasses.dataclass(frozen=True)
class ShellConfig(Config):
    """How a room's floor and walls become slabs."""

    thickness_m: float = 0.1  # a partition wall; thick enough that nothing at walking pace passes it in one time step
    floor_color: Annotated[tuple[Whole, Whole, Whole], LISTED] = (196, 186, 172)  # light wood, where the scan shows no floor
    wall_color: Annotated[tuple[Whole, Whole, Whole], LISTED] = (228, 226, 220)  # off-white paint, where the scan shows no wall
    miter_limit: float = 3.0  # sharper corners than about 40 degrees are cut instead of drawn out into spikes


def room_shell(room: Room, config: ShellConfig | None = None) -> list[tuple[str, trimesh.Trimesh]]:
    """Floor and walls of a room as closed slabs in the world frame [m]: `floor`, `wall_00`, ..., `inner_00`, ...

    The floor's top is z = 0. Floor and outer walls lie outside the floor polygon. Every outer wall is a convex prism on
    one edge of the polygon; they meet in miters and stand on the floor slab. Interior walls are boxes that stand on the
    floor inside the room; what is over their openings stays open. Colors are the scan's, where it shows any.

    Raises:
        InputError: the floor polygon has no area or crosses itself, or an interior wall has no size.
    """
    shell = config or ShellConfig()
    ring = floor_ring(room)
    floor_color, wall_color = room.floor_color or shell.floor_color, room.wall_color or shell.wall_color
    named = [("floor", _prism_of_ring(_outer_ring(ring, shell), -shell.thickness_m, 0.0, floor_color))]
    for index, corners in enumerate(_wall_footprints(ring, shell)):
        named.append((f"wall_{index:02d}", _prism_of_ring(corners, 0.0, room.height_m, wall_color)))
    for index, (wall, corners) in enumerate(zip(room.interior_walls, interior_footprints(room), strict=True)):
        named.append((f"inner_{index:02d}", _prism_of_ring(corners, 0.0, wall[5], wall_color)))
    return named


def interior_footprints(room: Room) -> list[NDArray[np.float64]]:
    """Corners of every interior wall seen from above [m], shape (4, 2) each, counter-clockwise.

    Raises:
        InputError: an interior wall has no length, thickness or height.
    """
    footprints = []
    for number, wall in enumerate(room.interior_walls):
        values = np.asarray(wall, dtype=np.float64)
        along = values[2:4] - values[:2] if len(values) == 6 else np.zeros(2)
        length = float(np.linalg.norm(along))
        if length < 1e-3 or values[4] < 1e-3 or values[5] < 1e-3:
            raise InputError("rooms", f"{room.scene_id} interior_walls {number}", "has no size", "capture the scan again")
        side = np.array([-along[1], along[0]]) / length * values[4] / 2
        footprints.append(np.array([values[:2] - side, values[2:4] - side, values[2:4] + side, values[:2] + side]))
    return footprints


def floor_ring(room: Room) -> NDArray[np.float64]:
    """Corners of the room's floor [m], shape (n, 2), counter-clockwise, without repeated and straight corners.

    Raises:
        InputError: the floor polygon has no area or crosses itself.
    """
    from shapely.geometry import Polygon

    points = np.asarray(room.floor_polygon, dtype=np.float64).reshape(-1, 2) if room.floor_polygon else np.zeros((0, 2))
    if len(points) >= 3:
        polygon = Polygon(points)
        if polygon.is_valid and polygon.area > 1e-4:
            simple = polygon.simplify(1e-4, preserve_topology=True)
            ring = np.asarray(simple.exterior.coords)[:-1]
            area = np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1))
            return ring if area > 0 else ring[::-1].copy()
    raise InputError("rooms", f"{room.scene_id} floor_polygon", "has no area or crosses itself", "capture the scan again")


def scaled_parts(glb: bytes, scale: ArrayLike, file: str = "asset.glb") -> list[trimesh.Trimesh]:
    """Parts of a canonical asset, scaled along its own axes, shape (3,), in its own frame [m]; textures kept.

    Raises:
        InputError: the GLB cannot be read.
    """
    stretch = np.diag([*np.asarray(scale, dtype=np.float64), 1.0])
    parts = load_glb(glb, file)
    for part in parts:
        part.apply_transform(stretch)
    return parts


def placed_parts(placement: Placement, glb: bytes, phase: Phase = "optimized") -> list[trimesh.Trimesh]:
    """Parts of a placed asset in the world frame [m]: scale first, then the pose of `phase`; textures kept.

    Raises:
        InputError: the GLB cannot be read.
    """
    pose = matrix(placement.optimized_pose if phase == "optimized" else placement.proposed_pose)
    parts = scaled_parts(glb, placement.scale, f"{placement.asset_id}.glb")
    for part in parts:
        part.apply_transform(pose)
    return parts


def prism(corners: ArrayLike, low: float, high: float) -> trimesh.Trimesh:
    """Closed prism over a convex counter-clockwise ring, shape (n, 2), from height `low` to `high` [m]."""
    import trimesh

    ring = np.asarray(corners, dtype=np.float64)
    n = len(ring)
    vertices = np.concatenate([np.column_stack([ring, np.full(n, low)]), np.column_stack([ring, np.full(n, high)])])
    fan = np.column_stack([np.zeros(n - 2, dtype=np.int64), np.arange(1, n - 1), np.arange(2, n)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    sides = np.concatenate([np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])])
    return trimesh.Trimesh(vertices, np.concatenate([fan[:, ::-1], fan + n, sides]), process=False)


def _prism_of_ring(ring: NDArray[np.float64], low: float, high: float, color: tuple[int, ...]) -> trimesh.Trimesh:
    """Closed, colored, flat-shaded prism over any simple counter-clockwise ring."""
    import trimesh
    from shapely.geometry import Polygon

    if len(ring) <= 4 and Polygon(ring).convex_hull.area - Polygon(ring).area < 1e-9:
        mesh = prism(ring, low, high)
    else:
        mesh = trimesh.creation.extrude_polygon(Polygon(ring), high - low)
        mesh.apply_translation([0, 0, low])
    colors = np.tile(np.array([*color, 255], dtype=np.uint8), (len(mesh.vertices), 1))
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
    return mesh


def _outer_ring(ring: NDArray[np.float64], shell: ShellConfig) -> NDArray[np.float64]:
    """The ring grown by the wall thickness, so that walls stand on the floor slab."""
    from shapely.geometry import Polygon
    from shapely.geometry.polygon import orient

    grown = Polygon(ring).buffer(shell.thickness_m, join_style="mitre", mitre_limit=shell.miter_limit)
    return np.asarray(orient(Polygon(grown.exterior)).exterior.coords)[:-1]


def _wall_footprints(ring: NDArray[np.float64], shell: ShellConfig) -> list[NDArray[np.float64]]:
    """Convex footprint of every wall, counter-clockwise, shape (4, 2) each, outside the ring."""
    from shapely.geometry import Polygon

    room = Polygon(ring)
    footprints = []
    for index in range(len(ring)):
        a, b = ring[index], ring[(index + 1) % len(ring)]
        before, after = ring[index - 1], ring[(index + 2) % len(ring)]
        thickness = shell.thickness_m
        corners = np.array([b, a, _miter(before, a, b, thickness, shell), _miter(a, b, after, thickness, shell)])
        # between two inward corners a short wall's miters may cross, and near a narrow notch a wall may reach back
        # into the room: there the wall is a plain rectangle, as thick as there is place for
        while thickness > 1e-4 and not _fits(corners, room):
            along = (b - a) / np.linalg.norm(b - a)
            out = np.array([along[1], -along[0]]) * thickness
            corners = np.array([b, a, a + out, b + out])
            thickness *= 0.5
        footprints.append(corners)
    return footprints


def _fits(corners: NDArray[np.float64], room: object) -> bool:
    """Whether four corners are a simple convex counter-clockwise ring outside the room."""
    from shapely.geometry import Polygon

    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    return bool((turns > 0).all()) and Polygon(corners).intersection(room).area < 1e-9


def _miter(
    before: NDArray[np.float64], at: NDArray[np.float64], after: NDArray[np.float64], thickness: float, shell: ShellConfig
) -> NDArray[np.float64]:
    """Outer corner [m], shape (2,), where the outsides of the walls before and after a corner of the room meet."""
    first, second = at - before, after - at
    normals = [np.array([d[1], -d[0]]) / np.linalg.norm(d) for d in (first, second)]
    middle = normals[0] + normals[1]
    length = float(np.linalg.norm(middle))
    if length < 1e-9:
        return at + normals[0] * thickness
    reach = min(2.0 / length, shell.miter_limit)
    return np.asarray(at + middle / length * reach * thickness)
