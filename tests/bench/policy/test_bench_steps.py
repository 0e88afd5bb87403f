"""The benchmark of environments, of one small room: steps are counted for every way to take them, and held against the goal."""

from __future__ import annotations

import pytest

from bench.policy.steps import STEPS_PER_SECOND, StepsBench, measure_steps


@pytest.mark.whole
def test_every_way_to_step_is_timed_and_the_first_is_held_against_the_goal() -> None:
    report = measure_steps(StepsBench(agents=2, scenes=1, objects=10, sizes=(16, 24), steps=5, rounds=1))
    assert {name: set(report[name]) for name in ("batched", "copied", "single")} == {
        "batched": {"16", "24"}, "copied": {"16", "24"}, "single": {"16"},
    }  # fmt: skip
    assert min(min(report[name].values()) for name in ("batched", "copied", "single")) > 0
    (goal,) = report["goals"]
    assert (goal["found"], goal["met"]) == (report["batched"]["16"], report["batched"]["16"] >= STEPS_PER_SECOND)
