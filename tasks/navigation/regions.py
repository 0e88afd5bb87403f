"""The walkable polygons of a .navmesh seen from above, and the parts that they are connected to by the file's own links."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.navigation.navmesh import NavmeshFile, Settings, Tile, polygon_areas, polygon_islands, walkable_polygons

Array = NDArray[np.float64]

CLOSED = 4
"""habitat-sim's flag of polygons that are switched off."""


@dataclasses.dataclass(frozen=True)
class Region:
    """Walkable polygons, world frame, counter-clockwise, by connected part.

    numbers: Place of each polygon in the file, shape (n,). rings: Its corners [m], shape (k, 2) each.
    islands: Its connected part, shape (n,), numbered by area, largest first. areas: Area of every part [m2].
    """

    numbers: NDArray[np.int64]
    rings: tuple[Array, ...]
    islands: NDArray[np.int64]
    areas: tuple[float, ...]


def walkable_region(navmesh: NavmeshFile, floor_only: bool = False, file: str = "scene.navmesh") -> Region:
    """Polygons that an agent may walk on.

    Args:
        navmesh: A file of one tile, as habitat-sim bakes them.
        floor_only: Leave out the parts that no agent on the floor (z = 0) can climb to: tops of tables and cupboards.
        file: Name for messages.

    Raises:
        InputError: the file has several tiles, or for `floor_only` heights that cannot be.
    """
    if len(navmesh.tiles) != 1:
        raise InputError(file, "tiles", f"are {len(navmesh.tiles)}, habitat-sim bakes one", "bake the whole scene as one tile")
    (tile,) = navmesh.tiles
    polygons = tile.polygons
    label, sizes = polygon_islands(tile, walkable_polygons(tile)), polygon_areas(tile)
    lowest = np.array([tile.vertices[p["vertices"][: p["count"]], 1].min(initial=np.inf) for p in polygons], dtype=np.float64)
    rings = [tile.vertices[p["vertices"][: p["count"]]][:, [0, 2]].astype(np.float64) * (1.0, -1.0) for p in polygons]
    reach = _reach(navmesh, tile, file) if floor_only else math.inf
    kept = []
    for part in range(int(label.max(initial=-1)) + 1):
        members = np.flatnonzero(label == part)
        if lowest[members].min() <= reach:
            kept.append((-float(sizes[members].sum()), int(members[0]), members))
    kept.sort(key=lambda island: island[:2])
    numbers = np.concatenate([members for _, _, members in kept]) if kept else np.zeros(0, dtype=np.int64)
    return Region(
        numbers=numbers,
        rings=tuple(rings[number] for number in numbers),
        islands=np.repeat(np.arange(len(kept)), [len(members) for _, _, members in kept]),
        areas=tuple(-area for area, _, _ in kept),
    )


def closed_but_for(navmesh: NavmeshFile, region: Region) -> NavmeshFile:
    """The same navmesh with every polygon outside the region closed to agents."""
    (tile,) = navmesh.tiles
    polygons = tile.polygons.copy()
    outside = np.ones(len(polygons), dtype=np.bool_)
    outside[region.numbers] = False
    polygons["flags"][outside] = CLOSED
    return dataclasses.replace(navmesh, tiles=(dataclasses.replace(tile, polygons=polygons),))


def _reach(navmesh: NavmeshFile, tile: Tile, file: str) -> float:
    """Height that an agent on the floor climbs to in one go, glTF frame [m]: one climb above the top of the floor's voxel."""
    settings = navmesh.settings or Settings()
    bottom, step, climb = tile.bounds[1], settings.cell_height, settings.agent_max_climb
    if not (math.isfinite(bottom) and math.isfinite(climb) and 0 < step < math.inf):
        problem = f"begin at {bottom:g} m in layers of {step:g} m, of which {climb:g} m are climbed"
        raise InputError(file, "heights", problem, "the file is damaged: bake it again")
    floor = bottom + step * max(1, math.ceil(-bottom / step - 1e-4))
    return floor + climb + 0.25 * step
