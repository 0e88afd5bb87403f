"""Answers and reviews of simulated annotators for the rooms of a data set, through the gate that people's go through."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from flows.inputs.annotation.acts import STAGE, changing
from flows.inputs.annotation.reviewing import conclude, draw_sample, save_verdicts, submit
from flows.run.configuration import configure
from schemas.annotation import Annotation, Assignment, WorkBatch
from schemas.candidates import Candidate
from schemas.capture import Instance
from tasks.annotation import BatchActs
from tasks.annotation.batch import read_answers
from tasks.annotation.simulation import FIRST_MOMENT, TOOL, AnnotatorRule, answer, order
from tasks.stage import Context
from warehouse.lake import Lake
from warehouse.tables.gate import batch_states

ANNOTATORS = ("simulated-1", "simulated-2", "simulated-3")
"""Who answers, each for a third of the instances."""

REVIEWER = "simulated-reviewer"

ROOMS_PER_BATCH = 50

TOLERATED = 1.0
"""The reviewer lets a choice pass that differs by less than so much more than the best candidate, by the rule without noise."""

PASS_SHARE = 0.9
"""Of the sampled answers must pass: the rule's own mistakes are 3 %, and people's 98 % would return every batch of them."""


def batch_of(first: str) -> str:
    """What the batch that begins with a room is called."""
    return f"simulated-{first.rpartition('/')[2]}"


def answers_of(truth: Mapping[str, Any], rule: AnnotatorRule, seed: int, number: int) -> list[dict[str, Any]]:
    """Answers for a room, as a batch file has them. number: of the first in its batch."""
    answers: list[dict[str, Any]] = []
    for instance_id, known in sorted(truth["instances"].items()):
        text = f"{seed}|{truth['scene_id']}|{instance_id}|simulated annotator"
        rng = np.random.default_rng(list(hashlib.sha256(text.encode()).digest()))
        annotator = ANNOTATORS[int(rng.integers(len(ANNOTATORS)))]
        ranked, _ = order([slot["total"] for slot in known["slots"]], rule, rng)
        slots = [k + 1 for k in ranked[: rule.ranked]]
        answers.append(answer(truth["scene_id"], instance_id, annotator, slots, number + len(answers)))
    return answers


def annotate(lake: Lake, truths: Sequence[Mapping[str, Any]], rule: AnnotatorRule, seed: int) -> Iterator[str]:
    """Answer for every committed room that no batch has, hand in, review and conclude; what was begun and killed is gone on with."""
    reader = lake.snapshot()
    have = {row.scene_id for row in reader.rows(Assignment)}
    for name, state in batch_states(reader).items():
        if name.startswith("simulated-") and state.state in ("open", "submitted", "in_review"):
            yield carried_on(lake, name, truths)
    waiting = [truth for truth in truths if truth["scene_id"] not in have and truth["instances"]]
    for at in range(0, len(waiting), ROOMS_PER_BATCH):
        chosen = waiting[at : at + ROOMS_PER_BATCH]
        name = batch_of(chosen[0]["scene_id"])
        given: list[dict[str, Any]] = []
        for truth in chosen:
            given += answers_of(truth, rule, seed, len(given))
        give(lake, name, given, seed)
        yield carried_on(lake, name, truths)


def give(lake: Lake, name: str, given: list[dict[str, Any]], seed: int) -> None:
    """Create a batch with its assignments and its answers. No figures of them are computed: nobody placed anything."""
    configuration = configure()
    batch = read_answers({"batch_id": name, "tool": TOOL, "annotations": given}, name)
    with changing(lake, name) as change:
        instances = [row for scene in batch.scene_ids for row in change.reader.rows(Instance, scene)]
        candidates = [row for scene in batch.scene_ids for row in change.reader.rows(Candidate, scene)]
        rows: list[Annotation] = STAGE.run(
            annotation_batch=batch, review_batch=None, batch_acts=None, instances=instances, candidates=candidates,
            context=Context(name, STAGE.name, seed, {}), config=configuration.stages[STAGE.name],
        ).rows["annotations"]  # fmt: skip
        config = configuration.stages[STAGE.name]
        made = WorkBatch(
            batch_id=name, origin="created", created_at=FIRST_MOMENT, pick="all", overlap=1, seed=seed, sample_share=config.sample_share,
            least_sample=config.least_sample, pass_share=PASS_SHARE, counts_unreviewed=False,
        )  # fmt: skip
        assignments = tuple(
            Assignment(
                batch_id=name, scene_id=row.scene_id, instance_id=row.instance_id, annotator=row.annotator, place=place, doubt=1.0,
                reasons=("never answered",), proposed=None,
            )
            for place, row in enumerate(rows, start=1)
        )  # fmt: skip
        change.commit(BatchActs((made,), assignments, tuple(rows)), f"annotation batch {name}", configuration)


def carried_on(lake: Lake, name: str, truths: Sequence[Mapping[str, Any]]) -> str:
    """A batch handed in, reviewed and concluded, from wherever it is."""
    state = batch_states(lake.snapshot(), [name])[name]
    if state.state == "open":
        submit(lake, name, by=ANNOTATORS[0])
    if state.state in ("open", "submitted"):
        draw_sample(lake, name)
    reader = lake.snapshot()
    state = batch_states(reader, [name])[name]
    slots = {(truth["scene_id"], instance_id): known["slots"] for truth in truths for instance_id, known in truth["instances"].items()}
    given = {(row.scene_id, row.instance_id, row.annotator): row for row in reader.rows_by_key(Annotation, [name])}
    verdicts = []
    for sampled in state.sample:
        row = given[sampled.scene_id, sampled.instance_id, sampled.annotator]
        totals = {slot["asset_id"]: slot["total"] for slot in slots[sampled.scene_id, sampled.instance_id]}
        least = min(totals.values())
        passes = row.choice is not None and totals[row.choice] <= least + TOLERATED
        verdict = {"scene_id": sampled.scene_id, "instance_id": sampled.instance_id, "annotator": sampled.annotator, "passes": passes,
                   "reviewed_at": FIRST_MOMENT.isoformat()}  # fmt: skip
        remark = f"another candidate differs by {least:.2f} from what was scanned"
        verdicts.append(verdict if passes else verdict | {"remark": remark})
    save_verdicts(lake, {"batch_id": name, "reviewer": REVIEWER, "simulated": True, "verdicts": verdicts}, name)
    summary = conclude(lake, name)
    return f"{name}: {summary['answers']} answers, {summary['passed']} of {summary['sampled']} sampled pass: {summary['verdict']}"
