"""Shortest paths and replays the plain way, by nothing that the path finders use: GEOS for sights, networkx for the search."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import shapely

Array = NDArray[np.float64]


class PlainGraph:
    """A visibility graph over all corners of a polygon: corners that see each other are joined."""

    def __init__(self, free: shapely.Geometry) -> None:
        import networkx
        import shapely

        self._grown = shapely.buffer(free, 1e-9)
        shapely.prepare(self._grown)
        self._at = np.unique(shapely.get_coordinates(free), axis=0)
        self._graph = networkx.Graph()
        self._graph.add_nodes_from(range(len(self._at)))
        a, b = np.triu_indices(len(self._at), 1)
        seen = self._sees(self._at[a], self._at[b])
        self._graph.add_weighted_edges_from(zip(a[seen], b[seen], np.hypot(*(self._at[a[seen]] - self._at[b[seen]]).T), strict=True))

    def distance(self, start: Array, goal: Array) -> float:
        """Geodesic distance between two points of the polygon [m], shape (2,) each; infinite without a path."""
        import networkx

        if self._sees(start[None], goal[None])[0]:
            return float(np.hypot(*(goal - start)))
        graph = self._graph.copy()
        for name, point in (("start", start), ("goal", goal)):
            seen = np.flatnonzero(self._sees(np.broadcast_to(point, self._at.shape), self._at))
            graph.add_node(name)
            graph.add_weighted_edges_from((name, int(node), float(np.hypot(*(self._at[node] - point)))) for node in seen)
        try:
            return float(networkx.dijkstra_path_length(graph, "start", "goal"))
        except networkx.NetworkXNoPath:
            return math.inf

    def _sees(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Whether straight lines stay in the polygon, shape (n, 2) each to (n,)."""
        import shapely

        return np.asarray(shapely.covers(self._grown, shapely.linestrings(np.stack([starts, ends], axis=1))))


def replayed(actions: Sequence[str], start: Array, yaw: float, forward_m: float, turn: float) -> Array:
    """Where a sequence of actions leads when nothing stands in the way [m], shape (n, 2): the start and every position after a step.

    `start`: shape (2,). `yaw`, `turn`: [rad].
    """
    places, turns = [np.asarray(start, dtype=np.float64)], 0
    for action in actions:
        if action == "forward":
            heading = yaw + turns * turn
            places.append(places[-1] + forward_m * np.array([math.cos(heading), math.sin(heading)]))
        else:
            turns += {"left": 1, "right": -1, "stop": 0}[action]
    return np.array(places)
