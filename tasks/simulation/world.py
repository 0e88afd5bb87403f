"""A scene as an agent meets it: where it can go, how far it is from there, and what it looks like."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.candidates import Asset
from schemas.capture import Instance, RoomSurface, Shell
from schemas.errors import InputError
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement
from tasks.evaluation.measures import onto, path_finder
from tasks.kernels import Kernels, compile_kernels
from tasks.navigation.planar import PlanarPathFinder
from tasks.navigation.points import rows
from tasks.simulation.protocol import NO_OBJECT, AgentView

if TYPE_CHECKING:
    from tasks.navigation.planar import PlanarField
    from tasks.simulation.rasterizer import Pictures

Array = NDArray[np.float64]

_FIELDS = 256
"""Fields of distances that a scene keeps, one per target: more than objects in all but the largest dwellings, and some 10 kB each."""


class SceneCamera(Protocol):
    """What draws a scene (`tasks.simulation.rasterizer.Rasterizer`)."""

    def render(self, poses: Array, width: int, height: int, hfov_radians: float, out: Pictures | None = None) -> Pictures:
        """Pictures from OpenCV cameras, camera-to-world, shape (n, 4, 4); drawn into `out` where it is given."""
        ...


class World:
    """One scene for agents of one shape. Knows nothing of any agent, so that many share it.

    scene_id: Scene. finder: Where agents can go, world frame [m]. camera: What draws it. episodes: Its episodes, by `episode_id`.
    categories: Of the parts that it draws.
    """

    def __init__(
        self, scene_id: str, finder: PlanarPathFinder, camera: SceneCamera, instance_ids: Sequence[str | None], episodes: Sequence[Episode],
        reach_m: float, categories: Sequence[str] = (),
    ) -> None:  # fmt: skip
        """
        Args:
            scene_id: Scene.
            finder: Where agents can go, world frame [m].
            camera: What draws it.
            instance_ids: The instance that each part of the camera's pictures belongs to, None or empty for floor and walls.
            episodes: Its episodes.
            reach_m: So far outside the navmesh a start or view point still counts as on it [m].
            categories: Of each part, empty for what is no object; where anybody is to be told.
        """
        self.scene_id, self.finder, self.camera = scene_id, finder, camera
        self.episodes: Mapping[str, Episode] = {episode.episode_id: episode for episode in episodes}
        # One more, which is what a part of -1 finds: nothing.
        self._numbers = np.array([int(name) if name else NO_OBJECT for name in (*instance_ids, None)], dtype=np.int32)
        self._reach, self.categories = reach_m, tuple(categories)
        self._fields: OrderedDict[bytes, PlanarField] = OrderedDict()

    def start(self, episode: Episode) -> Array:
        """Where an episode starts, on the navmesh, shape (2,) [m].

        Raises:
            InputError: it starts off the navmesh, or without a path to a view point.
        """
        start, near = onto(self.finder, np.array([episode.start_position[:2]]), self._reach)
        problem = None if near[0] else "starts off the navmesh"
        if problem is None and not np.isfinite(self.field(view_points(episode)).distances(start)[0]):
            problem = "has no view point with a path from its start"
        if problem:
            raise InputError(episode.scene_id, f"episode {episode.episode_id}", problem, "run the navigation stage again")
        return np.asarray(start[0])

    def field(self, points: ArrayLike) -> PlanarField:
        """Distances to the nearest of some points, shape (n, 2) [m]; those that are off the navmesh are never reached."""
        goals = rows(points)
        key = goals.tobytes()
        if key not in self._fields:
            snapped, near = onto(self.finder, goals, self._reach)
            self._fields[key] = self.finder.field(snapped[near])
            if len(self._fields) > _FIELDS:
                self._fields.popitem(last=False)
        self._fields.move_to_end(key)
        return self._fields[key]

    def look(self, poses: Array, hfov: float, into: AgentView, rows: NDArray[np.int64], room: Pictures) -> None:
        """Put what OpenCV cameras see, camera-to-world, shape (n, 4, 4), into some rows of pictures of many agents.

        Args:
            poses: Camera to world [m], shape (n, 4, 4).
            hfov: Angle that a picture spans from left to right [rad].
            into: Pictures of all, one behind another.
            rows: Where these belong, shape (n,).
            room: Pictures to draw into, n of them: memory that was used before is a third faster than new one.
        """
        height, width = into.depth.shape[1:]
        drawn = self.camera.render(poses, width, height, hfov, room)
        into.rgb[rows], into.depth[rows] = drawn.rgb, drawn.depth
        _compiled()["_number"](drawn.part.reshape(len(rows), -1), self._numbers, rows, into.semantic.reshape(len(into.semantic), -1))


@cache
def _compiled() -> Kernels:
    return compile_kernels(_number)


def _number(part: NDArray[np.int32], numbers: NDArray[np.int32], rows: NDArray[np.int64], semantic: NDArray[np.int32]) -> None:
    """The number of every pixel's part; the last of `numbers` is that of -1. As an index of NumPy it takes seven times as long."""
    for i in range(len(rows)):
        for pixel in range(part.shape[1]):
            semantic[rows[i], pixel] = numbers[part[i, pixel]]


def view_points(episode: Episode) -> Array:
    """View points of an episode's target on the floor, shape (n, 2) [m]."""
    return np.array(episode.view_points, dtype=np.float64)[:, :2]


def world_of(
    scene_id: str, shell: Shell | None, surfaces: Sequence[RoomSurface], placements: Sequence[Placement], assets: Sequence[Asset],
    instances: Sequence[Instance], navmesh: Navmesh, episodes: Sequence[Episode], blobs: Mapping[str, bytes], reach_m: float,
) -> World:  # fmt: skip
    """A scene from its rows in the lake, and the blobs that they name. What an instance of structure stands for is no object.

    Raises:
        InputError: a mesh or the navmesh cannot be read.
    """
    from tasks.simulation.rasterizer import Rasterizer
    from tasks.simulation.scenery import scenery

    if navmesh.navmesh_blob not in blobs:
        raise InputError(scene_id, "navmesh", f"blob {navmesh.navmesh_blob[:12]} is not in the lake", "run the navigation stage again")
    seen = scenery(shell, surfaces, placements, assets, instances, blobs)
    finder = path_finder(blobs[navmesh.navmesh_blob], f"{scene_id} {navmesh.navmesh_blob[:12]}.navmesh")
    structure = {instance.instance_id for instance in instances if instance.is_structure}
    owners = [None if owner in structure else owner for owner in seen.instance_ids]
    return World(scene_id, finder, Rasterizer(seen.soup), owners, episodes, reach_m, seen.things(instances))
