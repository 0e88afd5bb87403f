"""Regions of a surface and what frames see apart of them: nothing is lost, nothing is in two, and what was cut out is whole."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.segmentation.refinement import RefinementConfig, refined

CONFIG = RefinementConfig()
TABLE, CUPBOARD = np.arange(100), np.arange(100, 160)
EVEN = np.ones(200)
"""Of 200 vertices, 40 of them in no region."""


def cut(*seen: np.ndarray) -> list[tuple[list[int], int]]:
    parts, numbers = refined([TABLE, CUPBOARD], seen, EVEN, CONFIG)
    return [(members.tolist(), number) for members, number in zip(parts, numbers, strict=True)]


def test_a_plate_leaves_its_table_whole() -> None:
    assert cut(np.arange(20)) == [(list(range(20, 100)), -1), (CUPBOARD.tolist(), -1), (list(range(20)), 0)]


def test_what_frames_see_of_most_of_a_region_is_that_region() -> None:
    assert cut(np.arange(40), CUPBOARD) == [(TABLE.tolist(), -1), (CUPBOARD.tolist(), -1)]


def test_what_reaches_over_two_regions_joins_and_parts_none() -> None:
    assert cut(np.arange(90, 115)) == [(TABLE.tolist(), -1), (CUPBOARD.tolist(), -1)]


def test_what_the_surface_missed_is_added_without_what_it_has() -> None:
    assert cut(np.arange(150, 180))[-1] == (list(range(160, 180)), 0)
    assert refined([], [np.arange(5)], EVEN, CONFIG)[1] == [0], "also where it has no region at all"


def test_areas_count_and_not_vertices() -> None:
    """A fifth of a region's vertices that are most of its surface is no part of it."""
    areas = EVEN.copy()
    areas[:20] = 10.0
    assert refined([TABLE], [np.arange(20)], areas, CONFIG)[1] == [-1]


@given(st.integers(0, 2**32 - 1))
def test_no_vertex_is_lost_or_doubled(seed: int) -> None:
    rng = np.random.default_rng(seed)
    region, instance = rng.integers(-1, 5, 300), rng.integers(-1, 8, 300)
    region = np.sort(region)  # large pieces, so that instances lie within some
    instance = np.where(rng.random(300) < 0.7, np.repeat(rng.integers(-1, 8, 20), 15), instance)
    regions, seen = ([np.flatnonzero(of == k) for k in range(int(of.max()) + 1)] for of in (region, instance))
    parts, numbers = refined(regions, seen, rng.uniform(0.5, 2.0, 300), CONFIG)
    whole = np.concatenate([*parts, np.zeros(0, dtype=np.int64)])
    assert len(np.unique(whole)) == len(whole)
    assert set(np.flatnonzero(region >= 0)) <= set(whole.tolist())
    for members, number in zip(parts, numbers, strict=True):
        assert len(members)
        if number < 0:
            assert len(set(region[members].tolist())) == 1
        else:
            own = set(seen[number].tolist())
            assert set(members.tolist()) in (own, {k for k in own if region[k] < 0})
