"""Trainings and rooms of the benchmark one beside the other: results in order, errors as they are, settings that reach the workers."""

from __future__ import annotations

import pickle
from functools import partial
from pathlib import Path

import pytest

from bench.selection.measures import MeasuredMethod
from bench.selection.report import SelectionBench, _measured_room
from bench.selection.trainings import mapped
from tasks.selection.methods.clip import Clip
from tasks.selection.methods.extents import Extents


@pytest.mark.parametrize("processes", [1, 2])
def test_results_come_in_the_order_of_the_items_though_the_first_takes_longest(processes: int) -> None:
    exponents = [300_000, 1, 2, 3]
    with mapped(processes) as spread:
        assert list(spread(partial(pow, 3), exponents)) == [3**exponent for exponent in exponents]


@pytest.mark.parametrize("processes", [1, 2])
def test_an_error_is_the_callers(processes: int) -> None:
    with pytest.raises(ValueError, match="invalid literal"), mapped(processes) as spread:
        list(spread(int, ["1", "x", "2"]))


def test_what_measures_a_room_reaches_a_worker_as_it_is() -> None:
    methods = (Clip(weights="/models/clip"),)
    config = SelectionBench(Path("folder"), methods=methods)
    measure = partial(_measured_room, config, [MeasuredMethod("extents", Extents()), MeasuredMethod("clip", methods[0])])
    again = pickle.loads(pickle.dumps(measure))
    assert again.args == measure.args
    assert [scorer.key for scorer in again.args[1]] == [scorer.key for scorer in measure.args[1]]
