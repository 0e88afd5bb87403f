"""Neighbors: what fills seen-empty space, or another's points, loses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.geometry.meshes import sample_surface, surface_of
from tasks.geometry.transforms import flat, translation
from tasks.selection.neighbors import cubes, foreign_share
from tests.tasks.selection.rooms import Room, part, scan


def test_a_block_that_fills_the_bend_of_a_corner_sofa_loses_to_the_sofa_that_leaves_it_free() -> None:
    """By what else was seen there: a table in the bend."""
    rng = np.random.default_rng(0)
    solid = [part((1.8, 1.8, 0.7), (0, 0, 0.35), (90, 90, 120))]
    bent = [part((1.8, 0.7, 0.7), (0, 0.55, 0.35), (90, 90, 120)), part((0.7, 1.1, 0.7), (-0.55, -0.35, 0.35), (90, 90, 120))]
    shares = {}
    for with_table in (False, True):
        room = Room()
        sofa = room.instance(*scan(bent, np.eye(4), (1.0, 1.0, 1.0), rng), 0.0, "sofa")
        if with_table:
            table = [part((0.6, 0.6, 0.4), (0.3, -0.45, 0.2), (200, 180, 150))]
            room.instance(*scan(table, np.eye(4), (1.0, 1.0, 1.0), rng), 0.0, "coffee table")
        for slot, parts in enumerate((solid, bent), start=1):
            room.candidate(sofa, slot, room.asset(parts, f"sofa{slot}", watertight=True))
        rows, _ = room.select()
        by_slot = {row.slot: row for row in rows if row.instance_id == sofa.instance_id}
        shares[with_table] = by_slot[1].foreign_share, by_slot[2].foreign_share
        if with_table:
            assert by_slot[2].rank == 1
    assert shares[False] == (0.0, 0.0)
    assert shares[True][0] > 0.03
    assert shares[True][1] < 0.5 * shares[True][0]


def test_free_floor_is_foreign_and_a_wall_or_a_rug_is_not() -> None:
    rng = np.random.default_rng(1)
    solid = [part((1.6, 1.6, 0.7), (0, 0, 0.35), (90, 90, 120))]
    bent = [part((1.6, 0.6, 0.7), (0, 0.5, 0.35), (90, 90, 120))]
    flat_on_floor = rng.uniform([-0.7, -0.75, 0.0], [0.7, 0.1, 0.005], (4000, 3))
    shares = {}
    for category, structure in (("floor", True), ("wall", True), ("rug", False), ("box", False)):
        room = Room()
        sofa = room.instance(*scan(bent, np.eye(4), (1.0, 1.0, 1.0), rng), 0.0, "sofa")
        sheet = flat_on_floor + np.array([0.0, 0.0, 0.0 if category == "floor" else 0.1])  # well within the solid
        room.instance(sheet, np.full(sheet.shape, 99, dtype=np.uint8), 0.0, category, structure)
        room.instances[-1] = dataclasses.replace(room.instances[-1], nyu40_label=category if structure else "unlabeled")
        room.instances[0] = dataclasses.replace(sofa, box_size=(1.6, 1.6, 0.7), box_pose=flat(translation([0.0, 0.0, 0.35])))
        room.candidate(sofa, 1, room.asset(solid, "solid", watertight=True))
        rows, _ = room.select()
        shares[category] = next(row.foreign_share for row in rows if row.instance_id == sofa.instance_id)
    assert shares["wall"] == shares["rug"] == 0.0
    assert shares["floor"] > 0.1, "above a floor that was seen there is nothing"
    assert shares["box"] > 0.1, "and the same sheet counts where it is neither"


def test_a_tablecloth_has_a_place_of_its_own() -> None:
    rng = np.random.default_rng(2)
    room = Room()
    cloth = [part((1.0, 1.0, 0.4), (0, 0, 0.2), (200, 200, 200))]
    row = room.instance(*scan(cloth, np.eye(4), (1.0, 1.0, 1.0), rng), 0.0, "tablecloth")
    room.instance(rng.uniform([-0.2, -0.2, 0.1], [0.2, 0.2, 0.3], (50, 3)), np.full((50, 3), 9, dtype=np.uint8), 0.0, "box")
    room.candidate(row, 1, room.asset(cloth, "cloth", watertight=True))
    rows, _ = room.select()
    (share,) = [found.foreign_share for found in rows if found.instance_id == row.instance_id]
    assert share is not None
    assert 0.0 < share < 0.2


@given(st.integers(0, 2**16), st.integers(1, 1500))
def test_foreign_space_is_the_same_in_any_order(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    placed, _, normals = sample_surface(surface_of([part((1.0, 1.0, 1.0), (0, 0, 0.5))]), 256, np.random.default_rng(0))
    foreign = cubes(rng.uniform(-1.0, 1.0, (count, 3)))
    share = foreign_share(foreign, 10, placed, normals)
    assert share == foreign_share(rng.permutation(foreign), 10, placed, normals)
    out = np.abs(foreign - [0.0, 0.0, 0.5]).max(axis=1)
    least, most = (int((out < bound).sum()) for bound in (0.42, 0.5))
    assert least / (least + 10) - 0.05 <= share <= most / (most + 10) + 0.25  # few samples: their normals reach around edges


def test_a_single_sheet_has_nothing_in_it() -> None:
    """A table's top without an underside looks up everywhere: what is below it is not in it."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.5, 0.5, 20), np.linspace(-0.5, 0.5, 20)))
    placed, normals = np.column_stack([x, y, np.full(400, 0.74)]), np.tile([0.0, 0.0, 1.0], (400, 1))
    chairs = cubes(np.random.default_rng(0).uniform([-0.4, -0.4, 0.0], [0.4, 0.4, 0.5], (500, 3)))
    assert foreign_share(chairs, 10, placed, normals) == 0.0


def test_foreign_space_is_a_share_of_what_was_seen() -> None:
    surface = surface_of([part((1.0, 1.0, 1.0), (0, 0, 0.5))])
    placed, _, normals = sample_surface(surface, 1024, np.random.default_rng(0))
    inside = np.array([[0.0, 0.0, 0.5], [0.3, 0.3, 0.4]])
    outside = np.array([[0.6, 0.0, 0.5], [0.0, 0.0, 1.1], [0.49, 0.0, 0.5]])
    assert foreign_share(outside, 10, placed, normals) == 0.0
    assert foreign_share(np.concatenate([inside, outside]), 2, placed, normals) == 0.5
    assert foreign_share(np.zeros((0, 3)), 5, placed, normals) == 0.0
    many = np.tile(inside, (2000, 1))
    assert foreign_share(many, 4000, placed, normals) == pytest.approx(0.5, abs=0.01)
