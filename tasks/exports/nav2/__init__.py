"""A replica's floor as a map for nav2: `<stem>/map.yaml` and `map.pgm` for `map_server`, and `objects.json`, which says what stands where.

The map's frame is the world frame of the other formats: the same coordinates on the floor [m]. Occupied is what placed geometry and walls
reach into between two heights, however little of a cell that is; nothing is grown by a robot's radius, which is what costmaps do.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from schemas.navigation import Episode, Navmesh
from tasks.exports.bodies import Body, Replica
from tasks.exports.config import Nav2Config
from tasks.exports.files import Export, File
from tasks.exports.findings import Finding
from tasks.exports.format import Doctor, ExportedScene, ExportFormat, checked
from tasks.exports.mjcf import described
from tasks.exports.nav2.grid import Raster, occupancy
from tasks.exports.nav2.map_files import dump_map
from tasks.exports.nav2.places import OBJECTS
from tasks.geometry.transforms import quaternion_wxyz
from tasks.mounting import mounting

if TYPE_CHECKING:
    import shapely

    from tasks.geometry.meshes import Surface

MAP = "map.yaml"
"""Name of the file that `map_server` opens."""

_IMAGE = "map.pgm"


@dataclasses.dataclass(frozen=True)
class Standing:
    """An object on the floor, seen from above in the world frame [m].

    outline: What it has between the map's heights; empty for an open door. driven_over: What of that some agent of the episodes climbs,
    or passes under. box: Lowest and highest corner of all that is seen of it, shape (2, 3).
    """

    body: Body
    outline: shapely.Geometry
    driven_over: shapely.Geometry
    box: NDArray[np.float64]
    is_open: bool


def nav2_files(replica: Replica, navmeshes: Mapping[str, tuple[Navmesh, float]], episodes: Sequence[Episode], config: Nav2Config) -> Export:
    """Files of one scene, sorted by path, not yet checked, and what is not on the map.

    Args:
        replica: The scene.
        navmeshes: By agent, the row and how high [m] the agent climbs.
        episodes: Whose starts are written beside the map.
        config: Resolution and heights.
    """
    import shapely

    from tasks.shell import floor_ring

    walls, slab = _shell_outlines(replica, config)
    floor = shapely.Polygon(floor_ring(replica.room))
    raster = Raster.around(shapely.union_all([slab, *walls]).bounds, config.resolution_m, config.margin_cells)
    extent = shapely.box(*raster.bounds)
    climb = max((climbed for _, climbed in navmeshes.values()), default=0.0)
    height = min((navmesh.agent_height_m for navmesh, _ in navmeshes.values()), default=np.inf)
    standing, missed, surfaces = [], [], {}
    for body in replica.bodies:
        if body.shape.name not in surfaces:
            surfaces[body.shape.name] = _surface(body)
        made = _standing(body, surfaces[body.shape.name], config, climb, height)
        inside = shapely.intersection(made.outline, extent)
        if not (made.outline.is_empty or shapely.covers(extent, made.outline)):
            missed.append(f"{body.instance_id}: stands beyond the walls, and is on the map of nav2 as far as that reaches")
        standing.append(dataclasses.replace(made, outline=inside))
    cells = occupancy(raster, floor, slab, [*walls, *(placed.outline for placed in standing)])
    settings, image = dump_map(cells, raster, _IMAGE)
    about = _about(replica, standing, floor, navmeshes, episodes, config)
    text = (json.dumps(about, allow_nan=False) + "\n").encode()
    files = [File(_IMAGE, image, "texture"), File(MAP, settings, "root"), File(OBJECTS, text, "scene")]
    return Export([dataclasses.replace(file, path=f"{replica.stem}/{file.path}") for file in files], (), (), tuple(missed))


def _shell_outlines(replica: Replica, config: Nav2Config) -> tuple[list[shapely.Geometry], shapely.Geometry]:
    """Walls and brackets between the map's heights, and the floor's slab, which reaches below them, seen from above, world frame [m]."""
    from tasks.geometry.meshes import surface_of

    walls, slab = [], None
    for name, part in (*replica.shell, *replica.brackets):
        surface = surface_of([part])
        if name == "floor":
            slab = _exact(surface, -np.inf, np.inf)
        else:
            walls.append(_exact(surface, config.lowest_m, config.highest_m))
    assert slab is not None
    return [wall for wall in walls if not wall.is_empty], slab


def _exact(surface: Surface, low: float, high: float) -> shapely.Geometry:
    """The projection of a closed solid between two heights [m], without the seam that footprints grow by: a wall that ends where
    cells meet leaves the cells before it free."""
    from tasks.navigation.obstacles import SEAM_M, footprint

    return footprint(surface, low, high).buffer(-SEAM_M / 2, join_style="mitre", mitre_limit=10.0)


def _surface(body: Body) -> Surface:
    """What is seen of a shape, in its own frame, without colors."""
    from tasks.geometry.meshes import Surface

    vertices = [np.asarray(part.vertices, dtype=np.float64) for part in body.shape.parts]
    starts = np.cumsum([0, *(len(places) for places in vertices)])
    faces = [np.asarray(part.faces, dtype=np.int64) + start for part, start in zip(body.shape.parts, starts[:-1], strict=True)]
    joined = np.concatenate(vertices)
    return Surface(joined, np.concatenate(faces), np.zeros((len(joined), 3), dtype=np.uint8))


def _standing(body: Body, surface: Surface, config: Nav2Config, climb: float, height: float) -> Standing:
    """An object seen from above. climb, height: Between these [m] the agents of the episodes run into it."""
    import shapely

    from tasks.navigation.obstacles import footprints

    placed = surface.transformed(body.pose)
    is_open = not config.closed_doors and is_door(body.category)
    bands = [] if is_open else [(config.lowest_m, config.highest_m)]
    if not is_open and (climb > config.lowest_m or height < config.highest_m):
        bands.append((climb, height))
    nothing = shapely.Polygon()
    outline, *met = footprints(placed, bands) if bands else [nothing]
    driven_over = shapely.difference(outline, met[0]) if met and not outline.is_empty else nothing
    return Standing(body, outline, driven_over, placed.bounds, is_open)


def is_door(category: str) -> bool:
    """Whether objects of a category are leaves that open a way through a wall."""
    return mounting(category).kind == "let_in" and category.lower().replace("_", " ").removesuffix("s").endswith("door")


def _about(
    replica: Replica, standing: Sequence[Standing], floor: shapely.Geometry, navmeshes: Mapping[str, tuple[Navmesh, float]],
    episodes: Sequence[Episode], config: Nav2Config,
) -> dict[str, Any]:  # fmt: skip
    """What a map cannot say."""
    objects = [
        {
            "name": placed.body.name, "position_m": [float(value) + 0.0 for value in placed.body.pose[:3, 3]],
            "rotation_wxyz": list(quaternion_wxyz(placed.body.pose)), "box_m": (np.asarray(placed.box) + 0.0).tolist(),
            "outline_m": _rings(placed.outline), "driven_over_m": _rings(placed.driven_over), "is_open": placed.is_open,
            **described(placed.body),
        }
        for placed in standing
    ]  # fmt: skip
    starts = [
        {
            "episode_id": episode.episode_id, "agent": episode.agent,
            "radius_m": navmeshes[episode.agent][0].agent_radius_m if episode.agent in navmeshes else 0.0,
            "position_m": list(episode.start_position[:2]), "yaw_radians": episode.start_yaw_radians,
        }
        for episode in sorted(episodes, key=lambda row: row.episode_id)
    ]  # fmt: skip
    return {
        "scene_id": replica.scene_id, "license": replica.license, "room_type": replica.room.room_type,
        "frame": "map: x and y of the world frame, +Z up, metres, radians", "lowest_m": config.lowest_m, "highest_m": config.highest_m,
        "floor_m": _rings(floor), "slab_reach_m": _reach(replica), "objects": objects, "starts": starts,
    }  # fmt: skip


def _reach(replica: Replica) -> float:
    """How far the floor's slab reaches over the floor polygon [m]: as far as a doorway in a wall can be free."""
    slab = next(part for name, part in replica.shell if name == "floor")
    from shapely import Polygon, points

    from tasks.shell import floor_ring

    corners = points(np.asarray(slab.vertices, dtype=np.float64)[:, :2])
    distances = [Polygon(floor_ring(replica.room)).distance(corner) for corner in corners]
    return round(max(distances), 6)


def _rings(shape: shapely.Geometry) -> list[list[list[list[float]]]]:
    """The polygons of a shape: for each its outer ring and its holes, as corners (x, y) to a micrometre, the first not repeated."""
    import shapely

    polygons = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon" and not part.is_empty]
    return [
        [(np.round(shapely.get_coordinates(ring)[:-1], 6) + 0.0).tolist() for ring in (polygon.exterior, *polygon.interiors)]
        for polygon in polygons
    ]


def _make(scene: ExportedScene) -> Export:
    """The files, written to a temporary folder and checked there."""
    from tasks.navigation.navmesh import Settings, read_navmesh

    navmeshes = {}
    for navmesh in scene.navmeshes:
        settings = read_navmesh(scene.blobs[navmesh.navmesh_blob]).settings or Settings()
        navmeshes[navmesh.agent] = (navmesh, settings.agent_max_climb)
    try:
        written = nav2_files(scene.replica, navmeshes, scene.episodes, scene.config.nav2)
    except InputError as error:  # the other formats are written all the same
        return Export((), NAV2.rules, (Finding("resolution", MAP, str(error)),))
    made = checked(written.files, NAV2, f"{scene.replica.stem}/{MAP}")
    return dataclasses.replace(made, missed=written.missed)


def _gate() -> ModuleType:
    from tasks.exports.nav2 import rules

    return rules


NAV2 = ExportFormat(
    name="nav2",
    title="Maps for nav2",
    make=_make,
    gate=_gate,
    opened=lambda root: sorted(root.glob(f"*/{MAP}")),
    doctor=Doctor(
        about="Check anybody's map for nav2's map_server: its YAML file and image, and objects.json if it lies beside them.",
        example=f"./replicas/nav2/scannet_scene0000_00/{MAP}",
        names_others=True,
    ),
)
