"""Storeys of houses: how many there are, whatever else is level and high in them."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.storeys.levels import ONE, Levels, StoreyConfig, advice, levels
from tasks.geometry.meshes import Surface
from tests.tasks.capture.storeys.houses import (
    SINGLE,
    SIZES,
    House,
    flat_roof,
    half_storeys,
    house_of,
    mezzanine,
    partial_cover,
    raised,
    scanned,
)

scans = st.fixed_dictionaries({
    "noise": st.floats(0.0, 0.012), "tilt": st.tuples(st.floats(-0.004, 0.004), st.floats(-0.004, 0.004)),
    "holes": st.floats(0.0, 0.15), "seed": st.integers(0, 10**6),
})  # fmt: skip


NO_STOREYS = {
    "mezzanine": mezzanine((8.0, 9.0), 0.5, 2.6), "mezzanine, no ceiling": mezzanine((8.0, 9.0), 0.4, 2.6, has_ceiling=False),
    "platform": raised((6.0, 8.0), 1.4), "sunken floor": raised((6.0, 8.0), -1.4), "half-storeys": half_storeys((6.0, 8.0), 1.4),
    "flat roof": flat_roof((7.0, 7.0)), "low rooms in a hall": partial_cover((8.0, 8.0)), "hall": house_of(1, (9.0, 9.0), 6.0, 0.3),
}  # fmt: skip


def levels_of(house: House) -> Levels:
    return levels(house.surface, StoreyConfig())


@pytest.mark.parametrize("storeys", [1, 2, 3])
@pytest.mark.parametrize("has_ceilings", [True, False])
def test_a_house_has_its_storeys(storeys: int, has_ceilings: bool) -> None:
    house = scanned(house_of(storeys, (7.0, 9.0), 2.5, 0.3, has_ceilings=has_ceilings), 0.006, (0.003, -0.002), 0.1, storeys)
    found = levels_of(house)
    assert len(found.floors) == storeys
    assert all(low - 0.04 < cut < high + 0.04 for cut, (low, high) in zip(found.cuts, house.slabs, strict=True))


@pytest.mark.parametrize("kind", NO_STOREYS)
def test_what_is_level_and_high_is_no_storey_by_that(kind: str) -> None:
    assert levels_of(NO_STOREYS[kind]).cuts == ()
    assert levels_of(scanned(NO_STOREYS[kind], 0.006, (0.003, -0.002), 0.1, 0)).cuts == ()


@pytest.mark.whole
@given(
    storeys=st.integers(1, 4), size=SIZES, height=st.floats(2.2, 3.4), slab=st.floats(0.2, 0.5), has_ceilings=st.booleans(), scan=scans,
)  # fmt: skip
def test_storeys_are_as_many_as_were_built_and_are_cut_within_their_slabs(storeys, size, height, slab, has_ceilings, scan) -> None:
    house = house_of(storeys, size, height, slab, has_ceilings=has_ceilings)
    found = levels_of(scanned(house, **scan))
    assert len(found.floors) == storeys
    slack = 0.004 * sum(size) + 3 * scan["noise"]
    assert np.allclose(found.floors, house.floors, atol=slack + 0.02) or storeys == 1
    for cut, (low, high) in zip(found.cuts, house.slabs, strict=True):
        assert low - slack < cut < high + slack


@pytest.mark.whole
@pytest.mark.parametrize("kind", SINGLE)
@given(data=st.data(), scan=scans)
def test_what_is_no_storey_is_none(kind: str, data: st.DataObject, scan) -> None:
    assert levels_of(scanned(SINGLE[kind](data.draw), **scan)).cuts == ()


@pytest.mark.whole
@given(storeys=st.integers(2, 3), yaw=st.floats(0, 6.3), shift=st.tuples(*[st.floats(-50, 50)] * 3), flipped=st.booleans())
def test_storeys_hang_neither_on_where_a_house_stands_nor_on_how_its_faces_are_turned(storeys, yaw, shift, flipped) -> None:
    house = house_of(storeys, (7.0, 9.0), 2.5, 0.3)
    plain = levels_of(house)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    surface = house.surface
    moved = Surface(surface.vertices @ turn.T + shift, surface.faces[:, ::-1] if flipped else surface.faces, surface.colors)
    found = levels(moved, StoreyConfig())
    assert np.array(found.floors) - shift[2] == pytest.approx(plain.floors, abs=0.03)
    assert np.array(found.cuts) - shift[2] == pytest.approx(plain.cuts, abs=0.05)


def test_the_storey_of_a_height_is_that_between_its_cuts() -> None:
    found = Levels((0.0, 3.0, 6.0), (2.8, 5.8))
    assert found.storey_of(np.array([-1.0, 0.0, 2.7, 2.9, 5.7, 5.9, 99.0])).tolist() == [0, 0, 0, 1, 1, 2, 2]


def test_a_mesh_without_faces_and_one_that_is_low_are_of_one_storey() -> None:
    nothing = Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3), dtype=np.uint8))
    assert levels(nothing, StoreyConfig()) == ONE
    assert levels_of(house_of(1, (6.0, 6.0), 2.5, 0.3)) == ONE


def test_settings_say_how_much_of_the_floor_below_a_storey_covers() -> None:
    house = mezzanine((8.0, 8.0), 0.5, 2.6)
    assert levels(house.surface, StoreyConfig(min_cover=0.3)).floors == pytest.approx([0.0, 2.6], abs=0.01)
    assert levels(house.surface, StoreyConfig()).cuts == ()


def test_the_advice_is_a_command_that_a_shell_takes() -> None:
    (line,) = advice(Levels((0.1, 3.0), (2.8,)), Path("/scans/our house.glb"))
    assert line.startswith("2 storeys, floors at 0.00 and 2.90 m, but a scene is of one")
    command = line.partition(": ")[2].removesuffix(" makes a scan of each")
    assert shlex.split(command) == ["metascenes", "storeys", "--scans", "/scans/our house.glb", "--out", "storeys"]
    assert advice(ONE, Path("flat.glb")) == []
