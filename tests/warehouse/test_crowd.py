"""A simulated crowd: batches with careless annotators are caught as often as the sample predicts, and nothing that was returned gets on."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from schemas.annotation import Annotation, AnswerVerdict, QualityReview, SampledAnswer, Submission, WorkBatch
from schemas.capture import Instance
from schemas.record import arrow_to_rows
from schemas.selection import Selection
from tasks.annotation.picking import Task, assigned
from tasks.annotation.quality import drawn
from tasks.optimization.proposals import propose
from tests.annotated import chance_of_return
from tests.samples import START, sample, stage_run
from warehouse.lake import Lake
from warehouse.tables.gate import batch_states, handed_in_hashes, passes, sample_size
from warehouse.tables.reviews import standing_answers

TRIALS, OBJECTS, PEOPLE, CARELESS, ERRS = 200, 40, 10, 2, 0.3
SHARE, LEAST, PASS_SHARE = 0.1, 50, 0.98
RIGHT, WRONG = "a" * 64, "c" * 64


@dataclasses.dataclass(frozen=True)
class Trial:
    """A batch of the crowd as rows of the lake, how many of its answers are wrong, and what became of it."""

    rows: dict[str, list[object]]
    wrong: int
    answers: int
    is_returned: bool


def trial(number: int, careless: int = CARELESS, overlap: int = 2) -> Trial:
    """Ten annotators, of whom some err on 30 % of their objects; a sample judged by somebody who sees every mistake."""
    rng = np.random.default_rng([7, number])
    batch, scene = f"crowd-{number:03d}", f"demo/room_{number:03d}"
    names = [f"simulated {index}" for index in range(PEOPLE)]
    tasks = [Task(scene, f"{index:04d}", 0.5, (), None) for index in range(OBJECTS)]
    asked = assigned(tasks, names, overlap, rng)
    is_wrong = {}
    for name in names:
        own = [task.instance_id for task, who, _ in asked if who == name]
        erring = set(rng.permutation(len(own))[: round(ERRS * len(own))]) if name in names[:careless] else set()
        is_wrong |= {(scene, instance, name): index in erring for index, instance in enumerate(own)}
    keys = sorted(is_wrong)
    count = sample_size(len(keys), SHARE, LEAST)
    sampled = drawn(keys, count, rng)
    failed = sum(is_wrong[key] for key in sampled)
    is_returned = not passes(count - failed, count, PASS_SHARE)
    of = [{"batch_id": batch, "scene_id": key[0], "instance_id": key[1], "annotator": key[2]} for key in keys]
    answers = [
        sample(Annotation, **place, choice=WRONG if is_wrong[key] else RIGHT, is_simulated=True, answered_at=START)
        for place, key in zip(of, keys, strict=True)
    ]
    verdicts = [
        sample(
            AnswerVerdict, batch_id=batch, scene_id=key[0], instance_id=key[1], annotator=key[2], round=1, number=1,
            reviewer="simulated rita", passes=not is_wrong[key], is_simulated=True,
        )
        for key in sampled
    ]  # fmt: skip
    rows: dict[str, list[object]] = {
        "annotation_batches": [
            sample(WorkBatch, batch_id=batch, origin="created", sample_share=SHARE, least_sample=LEAST, pass_share=PASS_SHARE)
        ],
        "annotations": answers,
        "submissions": [sample(Submission, **place, round=1, revision=1, answers=len(keys)) for place in of],
        "review_samples": [
            sample(
                SampledAnswer, batch_id=batch, scene_id=key[0], instance_id=key[1], annotator=key[2], round=1, revision=1, place=place,
                sampled=count,
            )
            for place, key in enumerate(sampled, 1)
        ],
        "answer_verdicts": verdicts,
        "quality_reviews": [
            sample(
                QualityReview, batch_id=batch, verdict="returned" if is_returned else "accepted", sampled=count, wrong=failed,
                handed_in_hashes=handed_in_hashes(dict.fromkeys(keys, 1)), is_simulated=True, round=1,
            )
        ],
    }  # fmt: skip
    return Trial(rows, sum(is_wrong.values()), len(keys), is_returned)


def band(chances: list[float], mass: float = 0.99) -> tuple[int, int]:
    """Least and greatest number of successes that independent trials with these chances stay between with at least `mass`."""
    exact = np.ones(1)
    for chance in chances:
        exact = np.convolve(exact, [1 - chance, chance])
    total = np.cumsum(exact)
    return int(np.searchsorted(total, (1 - mass) / 2)), int(np.searchsorted(total, 1 - (1 - mass) / 2))


@pytest.mark.whole
@pytest.mark.parametrize(("careless", "overlap"), [(CARELESS, 2), (1, 2), (CARELESS, 10), (0, 2)])
def test_batches_are_caught_as_often_as_the_sample_predicts(careless: int, overlap: int) -> None:
    trials = [trial(number, careless, overlap) for number in range(TRIALS)]
    chances = [chance_of_return(one.wrong, sample_size(one.answers, SHARE, LEAST), one.answers, PASS_SHARE) for one in trials]
    caught = sum(one.is_returned for one in trials)
    low, high = band(chances)
    assert low <= caught <= high, f"{caught} of {TRIALS} caught, {low} to {high} predicted"
    assert {one.wrong > 0 for one in trials} == {careless > 0}
    if careless == CARELESS:
        assert caught > 0.9 * TRIALS
    if careless == 0:
        assert caught == 0


@pytest.mark.slow
@pytest.mark.whole
def test_nothing_that_was_returned_is_placed(tmp_path: Path) -> None:
    """Two hundred batches, one careless annotator in half of them, on one lake; what the optimization would read of every scene."""
    lake = Lake.open(tmp_path / "lake")
    trials = [trial(number, careless=number % 2) for number in range(TRIALS)]
    for number, one in enumerate(trials):
        lake.stage_rows(stage_run(f"crowd-{number:03d}", "annotation", f"{number:064x}"), one.rows)
    lake.commit("the crowd")
    reader = lake.snapshot()
    states = batch_states(reader)
    assert [states[f"crowd-{number:03d}"].state for number in range(TRIALS)] == [
        "returned" if one.is_returned else "accepted" for one in trials
    ]
    assert 40 < sum(one.is_returned for one in trials) < 160, "both kinds are there"
    whole = standing_answers(reader)
    assert set(whole.column("is_simulated").to_pylist()) == {True}
    for number, one in enumerate(trials):
        scene = f"demo/room_{number:03d}"
        answers = arrow_to_rows(standing_answers(reader, scene), Annotation)
        assert len(answers) == (0 if one.is_returned else one.answers)
        instances = [sample(Instance, scene_id=scene, instance_id=f"{index:04d}", is_structure=False) for index in range(OBJECTS)]
        first = [sample(Selection, scene_id=scene, instance_id=row.instance_id, rank=1, asset_id="b" * 64) for row in instances]
        chosen = [sample(Selection, scene_id=scene, instance_id=row.instance_id, rank=2, asset_id=RIGHT) for row in instances]
        chosen += [dataclasses.replace(row, rank=3, asset_id=WRONG) for row in chosen]
        proposals, _ = propose(instances, [*first, *chosen], answers, {RIGHT, WRONG, "b" * 64})
        origins = {proposal.origin for proposal in proposals}
        assert origins == ({"selection"} if one.is_returned else {"annotation"})
