"""New objects beside those of a scan: none twice, none changed, ids that go on."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.small_objects.joining import ExistingInstance, FoundObject, JoiningConfig, joined


def block(x: float, width: float = 0.1, seed: int = 0) -> np.ndarray:
    """Points on a block from x on [m]."""
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 12)] * 3), -1).reshape(-1, 3)
    return grid * [width, 0.1, 0.1] + [x, 0, 0.8] + np.random.default_rng(seed).normal(0, 0.002, (len(grid), 3))


def new(points: np.ndarray) -> FoundObject:
    return FoundObject(points, np.zeros((len(points), 3), np.uint8), "box", 0.7, "classical", "0001", {"000003": np.ones((2, 2), bool)})


DESK = ExistingInstance("0001", np.concatenate([block(0.0, 2.0), block(0.0, 2.0, 1)]))


def test_what_is_there_is_not_added_again() -> None:
    result = joined([DESK, ExistingInstance("0004", block(0.5))], [new(block(0.5, seed=5)), new(block(1.0))], JoiningConfig())
    assert result.known == {0: "0004"}
    assert [(obj.instance_id, obj.found_by, obj.support_id) for obj in result.added] == [("0005", "classical", "0001")]
    assert result.under_segmented == {}
    assert result.added[0].masks.keys() == {"000003"}


def test_what_carries_an_object_is_another() -> None:
    """A desk may have points at those of what stands on it; a microwave that carries things may be what was found on a counter."""
    assert len(joined([ExistingInstance("0001", block(0.5))], [new(block(0.5, seed=2))], JoiningConfig()).added) == 1
    assert joined([DESK, ExistingInstance("0002", block(0.5))], [new(block(0.5, seed=2))], JoiningConfig()).known == {0: "0002"}


def test_a_part_of_the_wall_is_wall_and_what_leans_on_it_is_not() -> None:
    wall = ExistingInstance("0000", block(0.5), is_structure=True)
    result = joined([wall, DESK], [new(block(0.5, seed=2)), new(block(0.55, seed=3))], JoiningConfig())
    assert result.known == {0: "0000"}
    assert result.under_segmented == {}


def test_an_instance_of_few_points_is_known_by_them() -> None:
    """A mesh has few vertices of a bowl, which depth shows with thousands of points: most of these have no vertex near."""
    few = ExistingInstance("0003", block(0.5)[::60])
    assert joined([DESK, few], [new(block(0.5, seed=2))], JoiningConfig()).known == {0: "0003"}


def test_an_instance_that_holds_several_is_told_and_stays() -> None:
    both = ExistingInstance("0002", np.concatenate([block(0.3), block(0.5)]))
    result = joined([DESK, both], [new(block(0.3, seed=3)), new(block(0.5, seed=4)), new(block(0.9))], JoiningConfig())
    assert result.under_segmented == {"0002": (0, 1)}
    assert result.notes == ("instance 0002 holds 2 objects, as classical sees it; it stays as it is",)
    assert [obj.instance_id for obj in result.added] == ["0003"]


def test_of_two_found_with_the_same_points_one_is_kept() -> None:
    result = joined([], [new(block(0.3)[::2]), new(block(0.3))], JoiningConfig())
    assert [len(obj.points) for obj in result.added] == [len(block(0.3))]
    assert result.added[0].instance_id == "0000"


@given(st.lists(st.integers(0, 12), unique=True, max_size=6), st.lists(st.integers(0, 12), unique=True, max_size=6))
def test_whatever_is_there_nothing_is_doubled_and_ids_go_on(old: list[int], fresh: list[int]) -> None:
    """Blocks apart from each other: those that are found and not there are added, in their order."""
    existing = [ExistingInstance(f"{7 * n:04d}", block(0.3 * place)) for n, place in enumerate(old)]
    result = joined(existing, [new(block(0.3 * place, seed=9)) for place in fresh], JoiningConfig())
    assert {fresh[i] for i in result.known} == set(old) & set(fresh)
    assert [obj.points[0, 0] for obj in result.added] == [block(0.3 * p, seed=9)[0, 0] for p in fresh if p not in old]
    start = 7 * (len(old) - 1) + 1 if old else 0
    assert [int(obj.instance_id) for obj in result.added] == list(range(start, start + len(result.added)))
