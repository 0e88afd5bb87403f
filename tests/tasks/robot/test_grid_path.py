"""Ways around things: free, connected wherever the free floor is, and as cheap as an independent search finds."""

from __future__ import annotations

import itertools

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.robot.clearances import CELL_M, Clearances
from tasks.robot.grid_path import SHY_M, STRIDE, _kernels, grid_path
from tests.tasks.robot.floors import bare_floor, random_boxes

RADIUS = 0.22


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_a_way_is_free_and_there_is_one_where_the_floor_is_connected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    floor = bare_floor(random_boxes(rng, 14, clear=[(0.5, 0.5), (5.5, 5.5)]))
    clearances = Clearances.of(floor)
    way = grid_path(clearances, (0.5, 0.5), (5.5, 5.5), RADIUS, 0.5)
    ends = [shapely.Point(0.5, 0.5), shapely.Point(5.5, 5.5)]
    narrow, wide = floor.free(RADIUS - 0.005), floor.free(RADIUS + 0.06)
    if way is None:
        assert not any(all(part.contains(end) for end in ends) for part in wide.geoms)
        return
    assert any(all(part.contains(end) for end in ends) for part in narrow.geoms)
    whole = np.vstack([[0.5, 0.5], way])
    assert np.allclose(way[-1], [5.5, 5.5])
    assert np.hypot(*np.diff(whole, axis=0).T).max() <= 0.5 + 1e-9
    assert shapely.LineString(whole).distance(shapely.union_all(list(floor.obstacles.values()))) >= RADIUS - 0.011
    assert min(clearances.least_along(a, b) for a, b in itertools.pairwise(whole)) >= RADIUS - 0.002


def test_its_cost_is_that_of_an_independent_search() -> None:
    rng = np.random.default_rng(3)
    clearances = Clearances.of(bare_floor(random_boxes(rng, 8, clear=[(0.5, 0.5), (5.5, 5.5)])))
    cells = _kernels()["_cheapest"](clearances.nodes, clearances.origin, clearances.points, 0.5, 0.5, 5.5, 5.5, RADIUS)
    step = STRIDE * CELL_M
    columns, rows = clearances.nodes.shape[0] // STRIDE, clearances.nodes.shape[1] // STRIDE
    column, row = np.indices((columns, rows))
    clear = clearances.distances(clearances.origin + step * np.column_stack([column.ravel(), row.ravel()])).reshape(columns, rows)
    charge = np.where(clear >= RADIUS, 1.0 + (SHY_M / (SHY_M + clear - RADIUS)) ** 2, np.inf)
    starts, ends, costs = [], [], []
    for right, up in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        inside = (column + right >= 0) & (column + right < columns) & (row + up >= 0) & (row + up < rows)
        start = (column * rows + row)[inside]
        end = ((column + right) * rows + row + up)[inside]
        cost = step * np.hypot(right, up) * charge.ravel()[end]
        open_ways = np.isfinite(cost)
        starts.append(start[open_ways])
        ends.append(end[open_ways])
        costs.append(cost[open_ways])
    graph = scipy.sparse.csr_matrix((np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends))), shape=(columns * rows,) * 2)
    numbers = cells[:, 0] * rows + cells[:, 1]
    least = scipy.sparse.csgraph.dijkstra(graph, indices=numbers[0])[numbers[-1]]
    taken = sum(graph[a, b] for a, b in itertools.pairwise(numbers))
    assert np.isclose(taken, least, rtol=1e-12)


def test_a_start_in_the_way_leads_out_of_it_and_a_walled_goal_nowhere() -> None:
    clearances = Clearances.of(bare_floor([shapely.box(2.9, 0.0, 3.1, 6.0)]))
    assert grid_path(clearances, (1.0, 1.0), (5.0, 1.0), RADIUS, 0.5) is None
    way = grid_path(clearances, (2.75, 1.0), (1.0, 1.0), RADIUS, 0.5)
    assert way is not None
    assert np.allclose(way[-1], [1.0, 1.0])
    blocked = clearances.with_points(np.column_stack([np.full(121, 2.0), np.linspace(0, 6, 121)]))
    assert grid_path(blocked, (2.5, 1.0), (1.0, 1.0), RADIUS, 0.5) is None
