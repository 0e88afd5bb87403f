"""Distances to the nearest thing against exact ones."""

from __future__ import annotations

import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.robot.clearances import FAR_M, POINT_M, Clearances
from tests.tasks.robot.floors import bare_floor, random_boxes


def exact(floor, places: np.ndarray) -> np.ndarray:
    points = shapely.points(places)
    things = shapely.union_all(list(floor.obstacles.values()))
    return np.minimum(shapely.distance(points, things), shapely.distance(points, floor.polygon.exterior))


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_a_distance_is_never_too_large_and_hardly_too_small(seed: int) -> None:
    rng = np.random.default_rng(seed)
    floor = bare_floor(random_boxes(rng, 6))
    places = rng.uniform(-0.5, 6.5, (4000, 2))
    found, inside = Clearances.of(floor).distances(places), floor.covers(places)
    true = np.minimum(exact(floor, places), FAR_M)
    open_places = inside & (true > 0.05)
    assert (found[open_places] <= true[open_places] + 1e-9).all()
    assert (found[open_places] >= true[open_places] - 0.012).all()  # beside a ridge, where two things are equally near, most
    assert (found[~inside & (true > 0.03)] == 0.0).all()


def test_at_nodes_the_distance_is_exact() -> None:
    floor = bare_floor([shapely.box(2.0, 2.0, 3.0, 3.0)])
    clearances = Clearances.of(floor)
    columns, rows = np.indices(clearances.nodes.shape)
    places = clearances.origin + 0.02 * np.column_stack([columns.ravel(), rows.ravel()])
    inside = floor.covers(places)
    assert np.allclose(clearances.nodes.ravel()[inside], np.minimum(exact(floor, places), FAR_M)[inside], atol=1e-12)


def test_points_take_their_place_and_replace_earlier_ones() -> None:
    floor = bare_floor()
    clearances = Clearances.of(floor)
    near = clearances.with_points([[3.0, 3.0]])
    assert np.isclose(near.distances([[3.0, 3.5]])[0], 0.5 - POINT_M)
    assert near.distances([[3.0, 3.01]])[0] == 0.0
    assert np.array_equal(near.with_points(np.zeros((0, 2))).distances([[3.0, 3.5]]), clearances.distances([[3.0, 3.5]]))


def test_points_that_are_drawn_into_the_nodes_are_as_far_away() -> None:
    rng = np.random.default_rng(1)
    clearances = Clearances.of(bare_floor(random_boxes(rng, 5))).with_points(rng.uniform(0, 6, (40, 2)))
    places = rng.uniform(0, 6, (3000, 2))
    asked, drawn = clearances.distances(places), clearances.flattened().distances(places)
    assert (drawn <= asked + 2e-3)[asked > 0.05].all()
    assert np.abs(drawn - asked).max() < 0.02


def test_a_straight_way_is_as_clear_as_its_narrowest_place() -> None:
    clearances = Clearances.of(bare_floor([shapely.box(2.9, 0.0, 3.1, 2.0), shapely.box(2.9, 3.0, 3.1, 6.0)]))
    assert np.isclose(clearances.least_along((1.0, 2.5), (5.0, 2.5)), 0.5, atol=2e-3)
    assert clearances.least_along((1.0, 1.0), (5.0, 1.0)) == 0.0


def test_around_segments_nothing_is_inside() -> None:
    clearances = Clearances.around([[1.0, 1.0, 2.0, 1.0]], (0.0, 0.0), (3.0, 3.0))
    assert np.allclose(clearances.distances([[1.5, 1.4], [1.5, 0.6], [2.5, 1.0]]), [0.4, 0.4, 0.5], atol=1.1e-3)
