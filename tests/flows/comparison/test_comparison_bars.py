"""One bar at a time: of each training, and then of the scenes that are to be done."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import pytest

from flows.comparison.flow import with_bar
from flows.progress import Progress, current, listen


@pytest.fixture
def progress() -> Iterator[Progress]:
    with Progress("scenes", 0, shown=False, lines=True) as made:
        listen(made)
        yield made
        listen(None)


def test_nothing_is_shown_of_scenes_before_policies_act_in_them(progress: Progress, capsys: pytest.CaptureFixture[str]) -> None:
    def act_in(scenes: Sequence[Any]) -> Iterable[Any]:
        for scene in scenes:
            current().advance(scene)
            yield scene

    acted = with_bar(act_in)
    assert capsys.readouterr().err == ""
    assert list(acted(["gamma/one", "gamma/two"])) == ["gamma/one", "gamma/two"]
    assert capsys.readouterr().err.splitlines() == ["scenes: 0 of 2", "scenes: 2 of 2, gamma/two"]
    assert list(acted(["gamma/two"])) == ["gamma/two"], "after a pause since a store was away there are fewer left"
    assert capsys.readouterr().err.splitlines() == ["scenes: 0 of 1", "scenes: 1 of 1, gamma/two"]


def test_a_bar_has_the_number_of_scenes_that_are_to_be_done(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("scenes", 0, shown=True) as bar:
        assert bar._bar is None, "trainings have theirs now"
        bar.begin(3)
        first = bar._bar
        assert [task.total for task in first.tasks] == [3]
        bar.begin(2)
        assert not first.live.is_started, "two would write into each other"
        bar.advance()
        assert [(task.total, task.completed) for task in bar._bar.tasks] == [(2, 1)]
    assert bar._bar is None
