"""The floor plan of a scene: where an agent can go, what stands in its way, and the paths of its episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from schemas.navigation import Episode

if TYPE_CHECKING:
    import trimesh

    from schemas.capture import Shell
    from tasks.stats.style import Picture


def floor_plan(
    navmesh: bytes,
    episodes: Sequence[Episode],
    objects: Mapping[str, Sequence[trimesh.Trimesh]],
    names: Mapping[str, str],
    room: Shell,
    scene_id: str,
) -> Picture:
    """A scene from above: navmesh, footprints of what blocks its agent, interior walls, paths.

    Args:
        navmesh: A .navmesh file.
        episodes: Those of the navmesh's agent.
        objects: Parts of every placed object in the world frame [m], by instance.
        names: What to write on them, by instance.
        room: For its outline and its interior walls.
    """
    import shapely

    from tasks.geometry.meshes import surface_of
    from tasks.navigation.navmesh import read_navmesh
    from tasks.navigation.obstacles import footprint
    from tasks.navigation.plan import draw_plan
    from tasks.navigation.planar import PlanarPathFinder
    from tasks.shell import interior_footprints

    file = read_navmesh(navmesh)
    climb, height = (file.settings.agent_max_climb, file.settings.agent_height) if file.settings else (0.0, np.inf)
    prints = {names[instance]: footprint(surface_of(parts), climb, height) for instance, parts in sorted(objects.items())}
    walls = [shapely.Polygon(corners) for corners in interior_footprints(room)]
    return draw_plan(
        PlanarPathFinder.from_navmesh(file).free, prints, episodes, room.floor_polygon, walls=walls, name=f"plan_{scene_id}", of=scene_id
    )
