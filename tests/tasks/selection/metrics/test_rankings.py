"""Places of the truth and their intervals, held against second computations."""

from __future__ import annotations

import random
import statistics

import numpy as np
import pytest

from tasks.selection.metrics.bootstrap import difference, interval
from tasks.selection.metrics.rankings import hits, place_of, ranking_of


def test_rankings_are_by_score_then_by_slot() -> None:
    assert ranking_of([0.2, 0.9, 0.2 + 1e-12, 0.5], [4, 2, 3, 1]) == [2, 1, 3, 4]
    assert ranking_of([], []) == []


def test_places_of_a_random_order_are_those_of_chance() -> None:
    rng = np.random.default_rng(0)
    places = [place_of(ranking_of(rng.random(10), range(1, 11)), {int(rng.integers(1, 11))}) for _ in range(20000)]
    assert float(np.nanmean(hits(places, 1))) == pytest.approx(0.1, abs=0.01)
    assert float(np.nanmean(hits(places, 5))) == pytest.approx(0.5, abs=0.015)


def test_who_does_not_compete_takes_no_place() -> None:
    ranking = [7, 3, 1, 5]
    assert place_of(ranking, {1}) == 3
    assert place_of(ranking, {1}, without={7}) == 2
    assert place_of(ranking, {1, 5}) == 3
    assert place_of(ranking, {7}, without={7}) is None
    assert place_of(ranking, {9}) is None
    assert np.array_equal(hits([1, 3, None], 1), [1.0, 0.0, np.nan], equal_nan=True)
    assert np.array_equal(hits([1, 3, None], 3), [1.0, 1.0, np.nan], equal_nan=True)


def sample_of_rooms(seed: int, rooms: int = 12) -> tuple[list[float], list[str]]:
    draw = random.Random(seed)
    values, names = [], []
    for room in range(rooms):
        level = draw.gauss(0, 1)
        for _ in range(draw.randrange(1, 9)):
            values.append(level + draw.gauss(0, 0.2))
            names.append(f"room {room:02d}")
    return values, names


def test_an_interval_is_that_of_plain_loops() -> None:
    """Each draw anew: rooms with repetition, then the mean over all that is in them, then its quantiles."""
    values, rooms = sample_of_rooms(0)
    by_room: dict[str, list[float]] = {}
    for value, room in zip(values, rooms, strict=True):
        by_room.setdefault(room, []).append(value)
    names = sorted(by_room)
    drawn = np.random.default_rng(5).integers(len(names), size=(2000, len(names)))
    means = [statistics.fmean([value for place in row for value in by_room[names[place]]]) for row in drawn.tolist()]
    found = interval(values, rooms, 5)
    assert found.value == pytest.approx(statistics.fmean(values))
    assert (found.low, found.high) == pytest.approx(tuple(np.quantile(means, [0.025, 0.975])))
    assert found.examples == len(values)


def test_the_order_of_values_changes_nothing() -> None:
    values, rooms = sample_of_rooms(1)
    pairs = list(zip(values, rooms, strict=True))
    random.Random(0).shuffle(pairs)
    assert interval(*map(list, zip(*pairs, strict=True)), 3) == interval(values, rooms, 3)  # type: ignore[arg-type]


def test_what_is_missing_counts_for_nothing() -> None:
    values, rooms = sample_of_rooms(2)
    assert interval([*values, np.nan], [*rooms, "another"], 1) == interval(values, rooms, 1)
    nothing = interval([np.nan], ["a"], 1)
    assert nothing.examples == 0
    assert np.isnan([nothing.value, nothing.low, nothing.high]).all()
    one = interval([0.3, 0.5], ["a", "a"], 1)
    assert (one.low, one.high) == pytest.approx((0.4, 0.4)), "one room says nothing of others"


def test_intervals_over_rooms_are_wider_than_over_instances() -> None:
    values, rooms = sample_of_rooms(3)
    clustered, single = interval(values, rooms, 0), interval(values, list(range(len(values))), 0)
    assert clustered.high - clustered.low > 1.5 * (single.high - single.low)


@pytest.mark.whole
def test_intervals_hold_what_they_promise() -> None:
    """Of 400 samples of 40 rooms about 95 % of the intervals hold the true mean, 0; few rooms make them a little short."""
    held = 0
    for seed in range(400):
        found = interval(*sample_of_rooms(seed, 40), seed, 500)
        held += found.low <= 0.0 <= found.high
    assert 0.90 <= held / 400 <= 0.98


def test_a_difference_is_paired() -> None:
    values, rooms = sample_of_rooms(4)
    shifted = [value - 0.1 for value in values]
    found = difference(values, shifted, rooms, 0)
    assert (found.value, found.low, found.high) == pytest.approx((0.1, 0.1, 0.1))
