"""Where an agent can go in a scene, and trajectories to learn from (supplementary B.3)."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from schemas.candidates import Asset
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.navigation import Episode, Navmesh, Split, UnreachableTarget
from schemas.optimization import Placement
from tasks.families import member
from tasks.navigation.configuration import Agent, NavigationConfig, PathFinderConfig
from tasks.navigation.episodes import Route, sample_routes
from tasks.navigation.path_finders import PATH_FINDERS
from tasks.navigation.protocol import PathFinder
from tasks.navigation.targets import NavigationTarget, target_of
from tasks.stage import Blobs, Context, Outcome, Stage

if TYPE_CHECKING:
    from tasks.geometry.meshes import Surface

__all__ = ["STAGE", "Agent", "NavigationConfig", "PathFinderConfig", "placed_surfaces", "room_name", "run", "split_of"]


def room_name(room_id: str) -> str:
    """A room by its name alone, without dataset and number of a rescan (`scene0001_02`), which some formats leave in it: rooms of one name
    are on one side of every split, whatever they were read from, and whoever calls them what."""
    name = room_id.rpartition("/")[2]
    rescan = re.fullmatch(r"(scene\d{4})_\d{2}", name)
    return rescan[1] if rescan else name


def split_of(room_id: str, test_share: float) -> str:
    """Split of a room by a stable hash of its name (`room_name`): `test_share` of all rooms are 'test', the others 'train'."""
    # With the name of one dataset before all, that dataset's rooms are on the sides that they always were on.
    text = f"scannet/{room_name(room_id)}"
    number = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
    return "test" if number < test_share * 2**64 else "train"


def placed_surfaces(placements: Sequence[Placement], assets: Sequence[Asset], blobs: Mapping[str, bytes]) -> dict[str, Surface]:
    """Geometry of every placement, world frame [m], without colors, by instance.

    Raises:
        InputError: a placement names an asset that is not among `assets`.
    """
    from tasks.geometry.meshes import Surface, load_glb
    from tasks.geometry.transforms import matrix

    by_id, loaded, placed = {asset.asset_id: asset for asset in assets}, {}, {}
    for placement in sorted(placements, key=lambda p: p.instance_id):
        name = f"placement {placement.instance_id}"
        if placement.asset_id not in by_id:
            raise InputError(placement.scene_id, name, f"asset {placement.asset_id} is not in assets", "run the candidates stage again")
        if placement.asset_id not in loaded:
            blob = by_id[placement.asset_id].mesh_blob
            parts = load_glb(blobs[blob], blob)
            offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
            vertices = np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in parts])
            faces = np.concatenate([np.asarray(part.faces, dtype=np.int64) + offset for part, offset in zip(parts, offsets, strict=False)])
            loaded[placement.asset_id] = Surface(vertices, faces, np.zeros((len(vertices), 3), dtype=np.uint8))
        placed[placement.instance_id] = loaded[placement.asset_id].transformed(matrix(placement.optimized_pose), placement.scale)
    return placed


def run(
    *,
    scenes: Sequence[Scene],
    placements: Sequence[Placement],
    shells: Sequence[Shell],
    instances: Sequence[Instance],
    assets: Sequence[Asset],
    context: Context,
    config: NavigationConfig,
) -> Outcome:
    """Navmesh, episodes and split of one scene.

    Raises:
        InputError: the scene has no room or no row of its own, an interior wall has no size, or a placement names an
            instance or asset that is not there.
    """
    import shapely

    from tasks.shell import interior_footprints, lintel_footprints

    if not scenes or not shells:
        raise InputError(context.scene_id, "shells" if scenes else "scenes", "has no row for this scene", "run the capture stage again")
    by_id = {instance.instance_id: instance for instance in instances}
    unknown = sorted(p.instance_id for p in placements if p.instance_id not in by_id)
    if unknown:
        raise InputError(context.scene_id, f"placement {unknown[0]}", "its instance is not in instances", "run the capture stage again")
    split = split_of(scenes[0].room_id, config.test_share)
    furniture = [p for p in placements if not by_id[p.instance_id].is_structure]
    surfaces = placed_surfaces(furniture, assets, context.blobs)
    agent = config.agent
    in_the_way = lintel_footprints(shells[0], agent.height_m)
    walls = [shapely.Polygon(corners) for corners in (*interior_footprints(shells[0]), *in_the_way)]
    finder = member(PATH_FINDERS, config.path_finder.kind).build(shells[0], list(surfaces.values()), walls, config)
    blobs, degradations = Blobs(), []
    reasons = {i.instance_id: "no asset was placed for it" for i in instances if not i.is_structure and i.instance_id not in surfaces}
    targets: list[NavigationTarget] = []
    if not finder.islands:
        degradations.append(f"no floor is free for an agent of {agent.radius_m:g} m radius: no navmesh and no episodes")
        reasons |= dict.fromkeys(surfaces, "no floor is free for the agent")
    else:
        for instance_id, surface in surfaces.items():
            outline = shapely.MultiPoint(surface.vertices[np.unique(surface.faces), :2]).convex_hull
            target = target_of(instance_id, by_id[instance_id].category, outline, finder, config, walls)
            if isinstance(target, NavigationTarget):
                targets.append(target)
            else:
                reasons[instance_id] = target
    count = config.train_episodes if split == "train" else config.test_episodes
    routes, failed, relaxed = sample_routes(targets, count, finder, config, context.rng("episodes"))
    reasons |= failed
    degradations += relaxed
    if len(routes) < count and finder.islands:
        degradations.append(f"{len(routes)} of {count} episodes: no target has usable starts left")
    return Outcome(
        navmeshes=[_navmesh(finder, blobs, context, config)] if finder.islands else [],
        episodes=[_episode(number, route, split, finder.name, context, config) for number, route in enumerate(routes)],
        unreachable_targets=[UnreachableTarget(scene_id=context.scene_id, instance_id=i, reason=r) for i, r in sorted(reasons.items())],
        splits=[Split(room_id=scenes[0].room_id, split=split)],
        blobs=blobs,
        degradations=degradations,
    )


def _navmesh(finder: PathFinder, blobs: Blobs, context: Context, config: NavigationConfig) -> Navmesh:
    from tasks.navigation.navmesh import dump_navmesh

    agent = config.agent
    data = dump_navmesh(finder.navmesh(config.settings))
    return Navmesh(
        scene_id=context.scene_id,
        agent=agent.name,
        agent_radius_m=agent.radius_m,
        agent_height_m=agent.height_m,
        navmesh_blob=blobs.add(data, "navmesh"),
        area_m2=float(sum(finder.islands)),
        largest_island_m2=finder.islands[0],
        island_count=len(finder.islands),
        path_finder=finder.name,
    )


def _episode(number: int, route: Route, split: str, path_finder: str, context: Context, config: NavigationConfig) -> Episode:
    target, goal = route.target, route.target.view_points[route.path.goal]
    return Episode(
        scene_id=context.scene_id,
        episode_id=f"{number:04d}",
        agent=config.agent.name,
        split=split,
        instance_id=target.instance_id,
        category=target.category,
        instruction=f"Navigate to the {target.category}",
        start_position=(*map(float, route.start), 0.0),
        start_yaw_radians=route.yaw,
        goal_position=(*map(float, goal), 0.0),
        view_points=tuple((float(x), float(y), 0.0, float(yaw)) for (x, y), yaw in zip(target.view_points, target.yaws, strict=True)),
        geodesic_m=float(route.path.length),
        euclidean_m=float(np.hypot(*(goal - route.start))),
        path=tuple((float(x), float(y)) for x, y in route.path.corners),
        actions=route.actions,
        final_position=(*map(float, route.final), 0.0),
        final_distance_m=route.final_distance,
        path_finder=path_finder,
    )


STAGE = Stage(
    name="navigation",
    reads=("scenes", "placements", "shells", "instances", "assets"),
    writes=("navmeshes", "episodes", "unreachable_targets", "splits"),
    config=NavigationConfig,
    run=run,
)
