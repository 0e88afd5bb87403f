"""What every path finder can do, whichever navigable region it searches."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import shapely

    from schemas.capture import Shell
    from tasks.geometry.meshes import Surface
    from tasks.navigation.configuration import NavigationConfig
    from tasks.navigation.navmesh import NavmeshFile, Settings
    from tasks.settings import Config


@dataclasses.dataclass(frozen=True)
class Path:
    """A shortest path on the floor.

    length: Its length [m], infinite when there is none.
    corners: Corners in the world frame [m], start first, goal last, shape (n, 2); shape (0, 2) when there is none.
    goal: Index of the goal that it ends at, -1 when there is none.
    """

    length: float
    corners: NDArray[np.float64]
    goal: int

    @property
    def exists(self) -> bool:
        """Whether there is a path at all."""
        return self.goal >= 0


NO_PATH = Path(float("inf"), np.zeros((0, 2)), -1)
"""What a search gives back when start and goal are not connected."""


class DistanceField(Protocol):
    """Geodesic distance to the nearest of a set of goals, from anywhere."""

    def distances(self, points: ArrayLike) -> NDArray[np.float64]:
        """Geodesic distances from points, world frame, shape (n, 2), to the nearest goal [m], shape (n,); infinite without a path."""
        ...

    def path(self, start: ArrayLike) -> Path:
        """Shortest path from `start`, world frame [m], shape (2,), to the nearest goal."""
        ...


class PathFinder(Protocol):
    """Where an agent can go and how far it is. All points lie on the floor (z = 0), world frame [m]."""

    name: str
    """Name of the kind of path finder, as rows hold it."""

    @property
    def islands(self) -> tuple[float, ...]:
        """Area of every connected part [m2], largest first. An island's number is its place in this tuple."""
        ...

    def island_of(self, points: ArrayLike) -> NDArray[np.int64]:
        """Island of each point, shape (n, 2) to (n,); -1 where the agent cannot be."""
        ...

    def is_navigable(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether the agent's center can be at each point, shape (n, 2) to (n,)."""
        return self.island_of(points) >= 0

    def snap(self, points: ArrayLike) -> NDArray[np.float64]:
        """The navigable point nearest to each point, shape (n, 2)."""
        ...

    def random_point(self, rng: np.random.Generator, island: int | None = None) -> NDArray[np.float64]:
        """A navigable point, uniform over the area of one island or of all, shape (2,)."""
        ...

    def field(self, goals: ArrayLike) -> DistanceField:
        """Distances and paths to the nearest of `goals`, shape (n, 2)."""
        ...

    def geodesic(self, start: ArrayLike, goal: ArrayLike) -> Path:
        """Shortest path between two points, shape (2,) each."""
        return self.field(np.reshape(goal, (-1, 2))).path(start)

    def is_clear(self, start: ArrayLike, end: ArrayLike) -> bool:
        """Whether a straight move from a navigable point to anywhere, shape (2,) each, meets no obstacle."""
        ...

    def try_step(self, position: ArrayLike, offset: ArrayLike) -> NDArray[np.float64]:
        """Where a straight move of `offset` ends, shape (2,): at the first obstacle when it meets one. There is no sliding."""
        ...

    def navmesh(self, settings: Settings) -> NavmeshFile:
        """The navigable region as habitat-sim stores it, glTF frame.

        Raises:
            ValueError: the region is empty, or too intricate for the format.
        """
        ...


@dataclasses.dataclass(frozen=True)
class PathFinderKind:
    """A member of the family `schemas.families.path_finders`.

    config: What it can be told; its `kind` is the name. build: The path finder of a room with furniture, as surfaces in the world
    frame [m], and footprints of interior walls. It raises InputError where something that it needs is not installed: there is no
    silent fallback. is_exact: Its paths are the shortest there are on the polygons of its navmesh.
    """

    name: str
    config: type[Config]
    build: Callable[[Shell, Sequence[Surface], Sequence[shapely.Geometry], NavigationConfig], PathFinder]
    is_exact: bool = False
