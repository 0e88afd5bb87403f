"""What is fastened to the room: what hangs, what is built in, worktops and what is below them."""

from __future__ import annotations

import pytest

from tasks.mounting import BUILT_IN
from tasks.optimization.support.fastening import is_fixed
from tasks.optimization.support.supports import (
    Carrier,
    find_carriers,
)
from tests.tasks.optimization.support.furnishings import (
    CHAIR,
    CONFIG,
    FRAME,
    at,
    block,
    room,
    small,
)


@pytest.mark.parametrize("category", [*BUILT_IN, "chair", "mug", "picture", "cabinet", "refrigerator", "kitchen counter", "stove", "piano"])
def test_what_hangs_and_what_is_built_in_is_fixed(category: str) -> None:
    for relation in ("wall", "ceiling"):
        assert is_fixed(Carrier(relation, None, 0.0, 0.0), category)
    for relation in ("floor", "on", "inside", "none"):
        assert is_fixed(Carrier(relation, None, 0.0, 0.0), category) == (category in BUILT_IN)


@pytest.mark.parametrize(
    ("category", "is_held"), [("object", True), ("thingamajig", True), ("ball", False), ("chair", False), ("shelf", False)]
)
def test_what_nothing_carries_is_held_where_its_name_does_not_say_that_it_stands(category: str, is_held: bool) -> None:
    (carrier,) = find_carriers([at(0, block(0.2, 0.2, 0.2), 0, 0, 1.2, category)], room(), CONFIG).values()
    assert (carrier.relation, carrier.is_fixed) == ("none", is_held)


def test_carriers_say_whether_they_are_fixed() -> None:
    objects = [at(0, block(0.5, 0.4, 0.8), 0, 0, 0, "toilet"), at(1, FRAME, -1.95, 0, 1.2, "picture"), at(2, CHAIR, 1, 1, 0, "chair")]
    assert {name: c.is_fixed for name, c in find_carriers(objects, room(), CONFIG).items()} == {"0000": True, "0001": True, "0002": False}


def test_a_slab_along_a_kitchen_wall_is_a_worktop_whatever_it_is_called() -> None:
    """It is fastened, as its sink is; a table's top in the middle of the room, a thick island and a low bench are not."""
    for category, size, place, fastened in (
        ("kitchen island", (0.6, 2.0, 0.05), (-1.69, 0.0, 0.86), True),
        ("table", (0.6, 2.0, 0.05), (-1.69, 0.0, 0.86), True),
        ("sideeboard counter", (0.6, 2.0, 0.05), (-1.69, 0.0, 0.86), True),
        ("kitchen island", (0.6, 2.0, 0.05), (0.5, 0.0, 0.86), False),
        ("bench", (0.6, 2.0, 0.05), (-1.69, 0.0, 0.4), False),
        ("chair", (0.6, 2.0, 0.05), (-1.69, 0.0, 0.86), False),
    ):
        x, y, z = place
        objects = [at(i, block(0.6, 0.6, z), x, 0.65 * i - 0.65, 0.0, "dishwasher") for i in range(3)]
        slab = at(3, block(*size), x, y, z + 0.01, category)
        carrier = find_carriers([*objects, slab], room(), CONFIG)["0003"]
        assert carrier.relation == "on", category
        assert carrier.is_fixed == fastened, (category, place)


def test_what_a_worktop_lies_on_is_built_in_and_over_a_table_it_hangs_on_its_wall() -> None:
    worktop = at(1, block(0.6, 2.0, 0.05), -1.69, 0.0, 0.87, "kitchen counter")
    mug = at(2, block(0.08, 0.08, 0.1), -1.69, 0.3, 0.92, "mug")
    for category, relation, below in (("dishwasher", "on", True), ("table", "wall", False)):
        carriers = find_carriers([at(0, block(0.6, 0.9, 0.86), -1.69, 0.0, 0.0, category), worktop, mug], room(), CONFIG)
        assert carriers["0001"].is_fixed
        assert carriers["0001"].relation == relation
        assert carriers["0000"].is_fixed == below
        assert not carriers["0002"].is_fixed
        assert carriers["0002"].parent_id == "0001"
        assert carriers["0002"].lift == pytest.approx(carriers["0001"].lift - carriers["0002"].gap)


def test_all_that_stands_below_a_worktop_is_built_in_whichever_carries_it() -> None:
    """Appliances beside the only cabinet, one of them a little too high; the refrigerator beside the worktop is not, nor is a stool or a
    bin below it. In the middle of the room nothing holds the worktop."""
    for middle, expected in ((-1.69, {"0000", "0001", "0002", "0003"}), (0.0, set())):
        objects = [
            at(0, block(0.62, 2.4, 0.04), middle, 0.0, 0.86, "kitchen counter"),
            at(1, block(0.56, 1.2, 0.86), middle - 0.03, 0.0, 0.0, "kitchen cabinet"),
            at(2, block(0.56, 0.58, 0.88), middle - 0.03, -0.9, 0.0, "dishwasher"),
            at(3, block(0.56, 0.58, 0.8), middle - 0.03, 0.9, 0.0, "oven"),
            at(4, block(0.6, 0.6, 1.7), middle, 1.52, 0.0, "refrigerator"),
            at(5, block(0.3, 0.3, 0.8), middle, -1.1, 0.0, "stool"),
            at(6, block(0.3, 0.3, 0.3), middle, 1.0, 0.0, "trash can"),
        ]
        carriers = find_carriers(objects, room(), CONFIG)
        assert carriers["0000"].relation == "on"
        assert {name for name, carrier in carriers.items() if carrier.is_fixed} == expected


def test_what_is_fitted_is_fastened_where_it_stands_against_a_wall() -> None:
    for x, is_fitted in ((-1.69, True), (0.0, False)):
        cabinet = small(x, 0, 0.0, block(0.6, 1.5, 0.8), "kitchen cabinet")
        worktop = at(1, block(0.62, 1.5, 0.04), x, 0, 0.8, "kitchen counter")
        mug = at(2, block(0.1, 0.1, 0.1), x, 0, 0.84, "mug")
        carriers = find_carriers([cabinet, worktop, mug], room(), CONFIG)
        assert [carriers[name].is_fixed for name in ("0000", "0001", "0002")] == [is_fitted, is_fitted, False]
        assert (carriers["0001"].relation, carriers["0002"].parent_id) == ("on", "0001")


def test_a_thin_thing_on_a_dresser_fixes_neither() -> None:
    for category in ("tv stand", "bench", "desk", "console table"):
        objects = [at(0, block(0.45, 1.3, 0.8), -1.77, 0.0, 0.0, "dresser"), at(1, block(0.4, 1.2, 0.15), -1.77, 0.0, 0.8, category)]
        carriers = find_carriers(objects, room(), CONFIG)
        assert not carriers["0000"].is_fixed, category
        assert not carriers["0001"].is_fixed, category
