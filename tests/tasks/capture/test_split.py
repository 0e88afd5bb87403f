"""One body that was annotated in two parts is one instance again; what stands beside or under another stays apart."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.instances.rows import InstancePoints
from tasks.capture.instances.split import rejoined
from tasks.capture.labels import Label, label_map
from tasks.capture.reading import Group

Array = np.ndarray


def box(low: tuple[float, ...], high: tuple[float, ...], step: float = 0.05) -> Array:
    """Points all through a box [m], shape (n, 3)."""
    axes = [np.linspace(a, b, max(round((b - a) / step), 1) + 1) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def scan_of(*objects: tuple[str, Array]) -> tuple[tuple[Group, ...], list[Label], list[InstancePoints]]:
    groups, solids, first = [], [], 0
    for number, (category, points) in enumerate(objects):
        vertices = np.arange(first, first + len(points))
        groups.append(Group(str(number), category, vertices, np.array([10 * number, 10 * number + 1])))
        solids.append(InstancePoints(points, np.zeros((len(points), 3), dtype=np.uint8), groups[-1].faces, is_exact=False))
        first += len(points)
    return tuple(groups), [label_map()[category] for category, _ in objects], solids


LOWER, UPPER = box((0.62, 3.36, 0.44), (0.68, 3.92, 1.2)), box((0.61, 3.35, 0.85), (0.69, 3.95, 1.75))


@given(order=st.permutations(range(4)))
def test_two_parts_of_a_refrigerator_are_one_however_they_are_ordered(order: list[int]) -> None:
    objects = [
        ("refrigerator", LOWER), ("refrigerator", UPPER), ("chair", box((2.0, 2.0, 0.0), (2.5, 2.5, 0.9))),
        ("refrigerator", box((0.6, 4.2, 0.0), (1.2, 4.8, 1.7))),
    ]  # fmt: skip
    scan = scan_of(*(objects[i] for i in order))
    groups, meanings, notes = rejoined(*scan)
    assert len(groups) == len(meanings) == 3
    assert len(notes) == 1
    assert sorted(np.concatenate([group.vertices for group in groups]).tolist()) == sorted(
        np.concatenate([group.vertices for group in scan[0]]).tolist()
    )
    whole = max(groups, key=lambda group: len(group.faces))
    assert len(whole.faces) == 4
    assert whole.source_id == str(order.index(1)), "named as its larger part"
    assert [label.category for label in meanings].count("refrigerator") == 2


def test_a_table_whose_top_is_in_two_parts_is_one() -> None:
    left = np.concatenate([box((0.0, 0.0, 0.77), (0.7, 0.8, 0.8)), box((0.0, 0.0, 0.5), (1.1, 0.04, 0.8))])
    groups, _, notes = rejoined(*scan_of(("folding table", left), ("kitchen table", box((0.5, 0.0, 0.77), (1.3, 0.8, 0.8)))))
    assert (len(groups), len(notes)) == (1, 1)


@pytest.mark.parametrize("slope", [0.5, 1.0, -0.7])
def test_a_table_that_is_cut_askew_is_one(slope: float) -> None:
    table = np.concatenate(
        [
            box((0.0, 0.0, 0.72), (1.6, 0.9, 0.76), 0.02),
            *(box((x, y, 0.0), (x + 0.05, y + 0.05, 0.72)) for x in (0, 1.55) for y in (0, 0.85)),
        ]
    )
    is_left = table[:, 0] < 0.8 + slope * (table[:, 1] - 0.45)
    groups, _, notes = rejoined(*scan_of(("dining table", table[is_left]), ("table", table[~is_left])))
    assert (len(groups), len(notes)) == (1, 1)


@pytest.mark.parametrize("gap", [0.01, 0.03, 0.045])
@pytest.mark.parametrize(("width", "depth", "arm"), [(1.6, 1.1, 0.5), (2.0, 1.1, 0.6), (1.4, 1.2, 0.5)])
def test_what_stands_in_the_bend_of_a_small_table_stays_apart(gap: float, width: float, depth: float, arm: float) -> None:
    """Both are together as large as one, and no line parts them."""
    bent = np.concatenate([box((0.0, 0.0, 0.72), (width, arm, 0.76), 0.02), box((0.0, arm, 0.72), (arm, depth, 0.76), 0.02)])
    inside = box((arm + gap, arm + gap, 0.72), (width, depth, 0.76), 0.02)
    for category, other in (("desk", "desk"), ("table", "side table")):
        assert len(rejoined(*scan_of((category, bent), (other, inside)))[0]) == 2, category


def test_what_fits_into_the_bend_of_a_desk_stays_apart_though_it_touches_it() -> None:
    bent = np.concatenate([box((0.0, 0.0, 0.0), (2.0, 0.6, 0.75)), box((0.0, 0.6, 0.0), (0.6, 2.0, 0.75))])
    assert len(rejoined(*scan_of(("desk", bent), ("desk", box((0.63, 0.63, 0.0), (1.9, 1.5, 0.75)))))[0]) == 2


@pytest.mark.parametrize("slope", [0.0, 0.3, -0.6])
@pytest.mark.parametrize("word", ["rug", "carpet", "mat"])
def test_a_rug_in_two_parts_is_one(slope: float, word: str) -> None:
    """Their boxes overlap where it was cut askew; stacked, one would lift what stands on the other."""
    whole = box((0.0, 0.0, 0.0), (2.9, 1.7, 0.02), 0.04)
    is_left = whole[:, 0] <= 1.2 + slope * (whole[:, 1] - 0.85)
    groups, _, notes = rejoined(
        *scan_of((word, whole[is_left]), ("rug", whole[~is_left]), ("table", box((0.5, 0.5, 0.7), (2.0, 1.2, 0.74))))
    )
    assert (len(groups), len(notes)) == (2, 1)


@pytest.mark.parametrize(("step", "height"), [(0.03, 0.02), (0.04, 0.02), (0.04, 0.0)])
def test_a_large_rug_in_halves_is_one_however_coarse_or_flat(step: float, height: float) -> None:
    whole = box((0.0, 0.0, 0.0), (4.0, 3.0, height), step)
    is_left = whole[:, 0] <= 2.0
    assert len(rejoined(*scan_of(("rug", whole[is_left]), ("rug", whole[~is_left])))[0]) == 1


@pytest.mark.parametrize(
    "points",
    [
        box((0.5, 0.4, 0.02), (1.5, 1.2, 0.04)),  # on the other
        box((1.6, 0.9, 0.02), (2.8, 2.6, 0.04)),  # over its corner
        box((2.02, 0.6, 0.0), (2.6, 1.0, 0.02)),  # a doormat before it
        box((2.4, 0.0, 0.0), (3.6, 1.7, 0.02)),  # apart
    ],
)
def test_two_rugs_stay_two(points: Array) -> None:
    groups, _, _ = rejoined(*scan_of(("rug", box((0.0, 0.0, 0.0), (2.0, 1.7, 0.02))), ("rug", points)))
    assert len(groups) == 2


def test_two_parts_of_a_table_are_one_and_a_nest_of_tables_is_several() -> None:
    top, apron = box((1.0, 1.0, 0.755), (2.3, 1.8, 0.805), 0.02), box((1.1, 1.0, 0.535), (2.2, 1.75, 0.805))
    groups, _, notes = rejoined(*scan_of(("table", apron), ("dining table", top), ("mug", box((1.2, 1.2, 0.8), (1.3, 1.3, 0.9)))))
    assert len(groups) == 2
    assert len(notes) == 1
    nest = [("side table", box((1.0, 1.0, 0.0), (1.5, 1.5, 0.6))), ("side table", box((1.05, 1.05, 0.0), (1.45, 1.45, 0.45)))]
    assert len(rejoined(*scan_of(*nest))[0]) == 2


@pytest.mark.parametrize(
    ("category", "other", "points"),
    [
        ("cabinet", "cabinet", box((0.0, 0.59, 0.0), (0.6, 1.2, 0.86))),  # beside it, a little in it
        ("cabinet", "cabinet", box((0.0, 0.0, 1.4), (0.35, 0.6, 2.1))),  # above it
        ("cabinet", "dishwasher", box((0.0, 0.0, 0.0), (0.6, 0.6, 0.8))),  # of another kind
        ("chair", "chair", box((0.1, 0.1, 0.0), (0.6, 0.6, 0.86))),  # pushed together
        ("wall", "wall", box((0.0, 0.0, 0.0), (0.6, 0.6, 0.8))),  # of the room
    ],
)
def test_what_is_no_part_stays_as_it_was_annotated(category: str, other: str, points: Array) -> None:
    scan = scan_of((category, box((0.0, 0.0, 0.0), (0.6, 0.6, 0.86))), (other, points))
    groups, meanings, notes = rejoined(*scan)
    assert (groups, meanings, notes) == (scan[0], scan[1], [])


@pytest.mark.parametrize(
    ("category", "part", "other"),
    [
        ("plant", box((0.0, 0.0, 0.0), (0.3, 0.26, 0.39)), box((0.05, 0.0, 0.42), (0.2, 0.3, 0.95))),  # its leaves on its pot
        ("bedside lamp", box((0.0, 0.0, 0.5), (0.2, 0.2, 0.7)), box((-0.05, -0.05, 0.73), (0.25, 0.25, 0.95))),
        ("bed", box((0.0, 0.0, 0.0), (1.42, 0.57, 0.73)), box((0.0, 0.6, 0.0), (1.42, 2.1, 0.59))),  # its head and its foot
        ("armchair", box((0.0, 0.0, 0.0), (0.8, 0.8, 0.45)), box((0.0, 0.5, 0.3), (0.8, 0.8, 0.9))),
        ("bookshelf", box((0.0, 0.0, 0.0), (0.9, 0.3, 1.2)), box((0.0, 0.0, 0.8), (0.9, 0.3, 1.9))),
        ("nightstand", box((0.0, 0.0, 0.0), (0.44, 0.36, 0.28)), box((0.0, 0.3, 0.0), (0.44, 0.41, 0.49), 0.02)),
    ],
)  # fmt: skip
def test_the_parts_of_what_nobody_piles_are_one(category: str, part: Array, other: Array) -> None:
    groups, _, notes = rejoined(*scan_of((category, part), (category, other), ("wall", box((3.0, 0.0, 0.0), (3.05, 3.0, 2.5)))))
    assert len(groups) == 2
    assert len(notes) == 1


def test_parts_by_two_words_for_one_thing_are_one() -> None:
    pot, leaves = box((0.0, 0.0, 0.0), (0.3, 0.26, 0.39)), box((0.05, 0.0, 0.36), (0.2, 0.3, 0.9))
    groups, meanings, _ = rejoined(*scan_of(("flowers", pot), ("plant", leaves)))
    assert [label.category for label in meanings] == ["flowers"]
    assert len(groups) == 1


@pytest.mark.parametrize(
    ("category", "part", "other"),
    [
        ("bed", box((0.0, 0.0, 0.0), (0.95, 2.0, 0.6)), box((0.98, 0.0, 0.0), (1.93, 2.0, 0.6))),  # twin beds
        ("sofa", box((0.0, 0.0, 0.0), (0.9, 2.0, 0.8)), box((0.92, 1.2, 0.0), (2.9, 2.0, 0.8))),  # around a corner
        ("plant", box((0.0, 0.0, 0.0), (0.3, 0.3, 0.8)), box((0.31, 0.0, 0.0), (0.7, 0.3, 0.9))),  # side by side
        ("plant", box((0.0, 0.0, 0.0), (0.3, 0.3, 0.5)), box((0.0, 0.0, 1.2), (0.3, 0.3, 1.6))),  # on a shelf above it
        ("pillow", box((0.0, 0.0, 0.0), (0.5, 0.2, 0.4)), box((0.1, 0.1, 0.0), (0.5, 0.3, 0.4))),  # leaned on it
        ("chair", box((0.0, 0.0, 0.0), (0.5, 0.5, 0.9)), box((0.0, 0.0, 0.1), (0.5, 0.5, 1.0))),  # stacked
        ("monitor", box((0.0, 0.0, 0.8), (0.6, 0.05, 1.2)), box((0.62, 0.0, 0.8), (1.2, 0.05, 1.2))),
        ("bookshelf", box((0.0, 0.0, 0.0), (0.8, 0.3, 1.8)), box((0.82, 0.0, 0.0), (1.62, 0.3, 1.8))),
    ],
)  # fmt: skip
def test_two_of_a_kind_stay_two(category: str, part: Array, other: Array) -> None:
    assert len(rejoined(*scan_of((category, part), (category, other)))[0]) == 2


def test_what_stands_in_the_bend_of_another_is_in_its_box_alone() -> None:
    bent = np.concatenate([box((0.0, 0.0, 0.0), (2.0, 0.6, 0.75)), box((0.0, 0.6, 0.0), (0.6, 2.0, 0.75))])
    inside = box((0.8, 0.8, 0.0), (1.95, 1.6, 0.75))
    for category, other in (("desk", "desk"), ("table", "side table"), ("kitchen counter", "kitchen counter"), ("cabinet", "cabinet")):
        groups, _, notes = rejoined(*scan_of((category, bent), (other, inside)))
        assert len(groups) == 2, category
        assert notes == []
