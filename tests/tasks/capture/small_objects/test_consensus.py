"""Masks of many views as instances: true masks give the true objects, some wrong ones do no harm, names join nothing that is apart."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.models.lifting import corrupted, instances_of, matched_pairs, overlaps
from bench.models.tabletops import Tabletop, tabletop
from tasks.capture.small_objects.consensus import ConsensusConfig, associate
from tasks.capture.small_objects.lifting import DepthView, FrameMasks, LiftedFrame, LiftingConfig, lift

LENS = (120.0, 120.0, 31.5, 23.5)


def board(count: int) -> tuple[DepthView, np.ndarray]:
    """A frame that looks straight at tiles in a row, and the tile of each pixel, -1 for none."""
    owner = np.full((48, 64), -1)
    width = 60 // count
    for tile in range(count):
        owner[8:40, 2 + tile * width : 2 + (tile + 1) * width - 2] = tile
    depth = np.full((48, 64), 1.0, np.float32)
    return DepthView("", depth, np.zeros((48, 64, 3), np.uint8), LENS, np.eye(4)), owner


def frames(tiles: list[list[tuple[set[int], str]]], count: int = 3) -> list[LiftedFrame]:
    """Frames from one place, each with masks that cover sets of tiles under names."""
    view, owner = board(count)
    made = []
    for seen in tiles:
        areas = np.array([np.isin(owner, list(own)) for own, _ in seen]).reshape(len(seen), 48, 64)
        made.append(lift(view, FrameMasks(areas, tuple(name for _, name in seen), np.ones(len(seen))), LiftingConfig()))
    return made


def found(tiles: list[list[tuple[set[int], str]]]) -> list[tuple[str, int]]:
    """Names of instances, and in how many frames they are."""
    return sorted((i.label, len(i.masks)) for i in associate(frames(tiles), ConsensusConfig()).instances)


A, B, C = {0}, {1}, {2}


def test_what_all_views_see_is_an_instance_with_a_mask_in_each() -> None:
    assert found([[(A, "cup"), (B, "book"), (C, "pen")]] * 4) == [("book", 4), ("cup", 4), ("pen", 4)]


def test_a_mask_that_other_views_divide_is_dropped_and_told() -> None:
    whole = associate(frames([[(A, ""), (B, ""), (C, "")]] * 5 + [[(A | B, ""), (C, "")]]), ConsensusConfig())
    assert len(whole.instances) == 3
    assert whole.under_segmented == ((5, 0),)


def test_masks_of_one_frame_never_become_one() -> None:
    """One frame divides what all others have as one: a half joins, the other half is none of its own."""
    half = associate(frames([[(A | B, ""), (C, "")]] * 5 + [[(A, ""), (B, ""), (C, "")]]), ConsensusConfig())
    assert len(half.instances) == 2
    assert all(len(numbers) == 1 for instance in half.instances for numbers in instance.masks.values())


def test_names_that_differ_are_joined_where_they_cover_the_same_points() -> None:
    assert found([[(A, "mug")]] * 3 + [[(A, "cup")]] * 2) == [("mug", 5)]


def test_of_names_the_heaviest_wins_and_says_by_how_much() -> None:
    (instance,) = associate(frames([[(A, "mug")]] * 3 + [[(A, "cup")]]), ConsensusConfig()).instances
    assert (instance.label, instance.label_share) == ("mug", 0.75)


def test_one_view_alone_is_no_instance() -> None:
    assert found([[(A, "cup")], [(B, "book")], [(C, "")]]) == []
    assert found([[], []]) == []
    assert associate([], ConsensusConfig()).instances == ()


@pytest.mark.parametrize("order", [[4, 3, 2, 1, 0], [2, 0, 4, 1, 3]])
def test_the_order_of_frames_does_not_matter(order: list[int]) -> None:
    tiles = [[(A, "cup"), (B, "")], [(A, "mug"), (C, "pen")], [(B, "book"), (C, "pen")], [(A | B, ""), (C, "")], [(A, "cup"), (B, "book")]]
    assert found([tiles[i] for i in order]) == found(tiles)


@pytest.fixture(scope="module")
def desk() -> Tabletop:
    return tabletop("desk", False, 1)


def test_true_masks_give_the_true_objects(desk: Tabletop) -> None:
    instances = instances_of(desk, "true masks", np.random.default_rng(0)).instances
    pairs = matched_pairs(overlaps(desk, [instance.points for instance in instances]))
    assert {obj for obj, _ in pairs} >= set(desk.counted)
    assert len(instances) == len(pairs)
    assert [len(i.points) for i in instances] == sorted((len(i.points) for i in instances), reverse=True)


def test_the_same_masks_give_the_same_bytes(desk: Tabletop) -> None:
    first, second = (instances_of(desk, "corrupted masks", np.random.default_rng(3)).instances for _ in range(2))
    assert [i.points.tobytes() for i in first] == [i.points.tobytes() for i in second]
    assert [i.masks for i in first] == [i.masks for i in second]


@given(st.integers(0, 10**6), st.floats(0, 1))
def test_corruption_keeps_every_pixel(seed: int, share: float) -> None:
    view, owner = board(3)
    masks = np.array([owner == tile for tile in range(3)])
    wrong = corrupted(masks, view.points(), share, np.random.default_rng(seed))
    assert (wrong.sum(axis=0) == masks.sum(axis=0)).all()
    if share == 0:
        assert (wrong == masks).all()
