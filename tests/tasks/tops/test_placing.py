"""Tops: nothing overlaps, all rests on what carries it and within its edges, by polygons that the generator does not use."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon, box

from tasks.furniture import tops
from tasks.furniture.storage import BOARD_M, shelf_levels

NEIGHBORS_M, EDGE_M, ROUNDING_M = 0.005, 0.002, 1e-9


def footprint(center, size, yaw) -> Polygon:
    corners = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * size[:2]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return Polygon(corners @ turn.T + center[:2])


def rests(word: str, size) -> list[float]:
    """Heights at which something can rest on a large object [m]."""
    if word == "bookshelf":
        return shelf_levels(size)
    return [{"bed": 0.52, "sofa": 0.48}.get(word, 1.0) * size[2]]


def assert_stands(word: str, size, top: tops.Top) -> None:
    feet = [footprint(c, s, yaw) for c, s, yaw in zip(top.centers, top.sizes, top.yaws, strict=True)]
    bottoms = top.centers[:, 2] - 0.5 * top.sizes[:, 2]
    tops_of = top.centers[:, 2] + 0.5 * top.sizes[:, 2]
    own = box(-0.5 * size[0], -0.5 * size[1], 0.5 * size[0], 0.5 * size[1])
    levels = rests(word, size)
    assert (top.sizes > 0).all()
    assert (np.abs(top.yaws) <= np.pi).all()
    for index, parent in enumerate(top.parents):
        carrier = own if parent < 0 else feet[parent]
        assert carrier.buffer(ROUNDING_M - EDGE_M, join_style="mitre").covers(feet[index]), top.words[index]
        if parent >= 0:
            assert parent < index
            assert top.parents[parent] == -1
            assert top.relations[index] == "on"
            assert bottoms[index] == pytest.approx(tops_of[parent], abs=1e-12)
            continue
        assert top.relations[index] == ("inside" if word == "bookshelf" else "on")
        assert min(abs(bottoms[index] - level) for level in levels) < 1e-12
        if word == "bookshelf":
            roof = min([level for level in levels if level > bottoms[index] + 1e-9], default=size[2])
            highest = max([tops_of[index], *tops_of[top.parents == index]])
            assert highest < roof - min(BOARD_M, 0.04 * size[2]) + ROUNDING_M
    for a in range(len(top)):
        for b in range(a):
            if a == top.parents[b] or b == top.parents[a]:
                continue
            is_beside = min(tops_of[a], tops_of[b]) - max(bottoms[a], bottoms[b]) > ROUNDING_M
            if is_beside:
                assert feet[a].distance(feet[b]) >= NEIGHBORS_M - ROUNDING_M, (top.words[a], top.words[b])


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(tops.PAIRS), st.integers(0, 2**32 - 1))
def test_what_stands_on_usual_tops_neither_overlaps_nor_reaches_over(pair, seed):
    rng = np.random.default_rng(seed)
    size = tops.typical_size(pair[0], rng)
    assert_stands(pair[0], size, tops.draw(pair[0], size, pair[1], rng))


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(tops.PAIRS), st.integers(0, 2**32 - 1), st.tuples(*[st.floats(0.2, 2.5)] * 3))
def test_tops_of_any_size_take_all(pair, seed, size):
    assert_stands(pair[0], size, tops.draw(pair[0], size, pair[1], np.random.default_rng(seed)))


def test_every_pair_stands_with_most_objects():
    rng = np.random.default_rng(3)
    for word, room_type in tops.PAIRS:
        drawn = [(size := tops.typical_size(word, rng), tops.draw(word, size, room_type, rng)) for _ in range(15)]
        assert_stands(word, *max(drawn, key=lambda one: len(one[1])))


def test_tops_are_a_pure_function_of_the_generator_and_cannot_be_changed():
    first, other = (tops.draw("desk", (0.7, 1.4, 0.74), "office", np.random.default_rng(5)) for _ in range(2))
    for name in ("words", "relations"):
        assert getattr(first, name) == getattr(other, name)
    for name in ("parents", "centers", "sizes", "yaws"):
        assert (getattr(first, name) == getattr(other, name)).all()
        with pytest.raises(ValueError, match="read-only"):
            getattr(first, name)[0] = 0
    unlike = tops.draw("desk", (0.7, 1.4, 0.74), "office", np.random.default_rng(6))
    assert first.words != unlike.words or (first.centers != unlike.centers).any()


def test_keyboards_lie_before_monitors_mice_right_of_them_and_pillows_at_the_head():
    rng = np.random.default_rng(0)
    before, right, pillows = [], [], []
    for _ in range(300):
        top = tops.draw("desk", (0.75, 1.5, 0.74), "office", rng)
        if {"monitor", "keyboard", "mouse"} <= set(top.words):
            at = {word: top.centers[top.words.index(word)] for word in ("monitor", "keyboard", "mouse")}
            before.append(at["keyboard"][0] > at["monitor"][0])
            right.append(at["mouse"][1] > at["keyboard"][1])
        top = tops.draw("bed", (2.0, 1.5, 0.95), "bedroom", rng)
        pillows += [top.centers[i, 0] for i, word in enumerate(top.words) if word == "pillow"]
    assert len(before) > 80
    assert np.mean(before) > 0.9
    assert np.mean(right) > 0.9
    assert np.median(pillows) < -0.25


@pytest.mark.parametrize("size", [(0.1, 1.0, 0.7), (np.nan, 1.0, 0.7), (np.inf, 1.0, 0.7)])
def test_sizes_without_a_top_are_refused(size):
    with pytest.raises(ValueError, match="extents"):
        tops.draw("table", size, "office", np.random.default_rng(0))
