"""The way of a batch through its gate: handed in, a sample drawn, judged by others than who answered, concluded."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from flows.inputs.annotation.acts import changing, known_state, now, rows_of, state_in
from flows.run.configuration import Configuration, configure
from schemas.annotation import Annotation, AnswerVerdict, Assignment, QualityReview, SampledAnswer, Submission
from schemas.errors import InputError
from schemas.wording import counted, noun
from tasks.annotation import BatchActs
from tasks.annotation.quality import drawn, in_words, pass_interval
from tasks.annotation.revisions import latest
from tasks.annotation.verdicts import read_verdicts
from warehouse.lake import Lake
from warehouse.tables.gate import (
    BatchState,
    demands,
    handed_in_hashes,
    key_of,
    passes,
    person,
    sample_size,
)


def submit(lake: Lake, batch_id: str, by: str, partial: bool = False, configuration: Configuration | None = None) -> dict[str, Any]:
    """Hand a batch in: from now on its answers are as they are, until it is returned.

    Raises:
        InputError: the batch takes no submission now, has no answers, or lacks some of what was assigned and is not `partial`.
    """
    with changing(lake, batch_id) as change:
        state = known_state(change.reader, batch_id)
        state.after("submit")
        answers = latest(rows_of(change.reader, Annotation, batch_id))
        asked = {(row.scene_id, row.instance_id, row.annotator) for row in rows_of(change.reader, Assignment, batch_id)}
        missing = sorted(asked - answers.keys())
        if not answers:
            raise InputError(batch_id, "annotations", "the batch has no answers", "import them first")
        if missing and not partial:
            scene, instance, annotator = missing[0]
            problem = (
                f"{len(missing)} of {counted(len(asked), 'assigned answer')} "
                f"{noun(len(missing), 'is', 'are')} missing, {annotator}'s for {scene} {instance} first"
            )
            raise InputError(batch_id, "annotations", problem, "hand in what there is with --partial")
        moment = now()
        rows = tuple(
            Submission(
                batch_id=batch_id, round=state.round + 1, scene_id=scene, instance_id=instance, annotator=annotator,
                revision=row.revision, answers=len(answers), submitted_by=by, submitted_at=moment,
            )
            for (scene, instance, annotator), row in answers.items()
        )  # fmt: skip
        note = f"annotation batch {batch_id} handed in"
        change.commit(BatchActs(submissions=rows), note, configuration or configure())
    return {"batch_id": batch_id, "round": state.round + 1, "answers": len(rows), "missing": len(missing), "state": "submitted"}


def draw_sample(lake: Lake, batch_id: str, configuration: Configuration | None = None) -> dict[str, Any]:
    """Draw the answers that are to be reviewed: the same ones of the same batch and seed, whoever asks.

    Raises:
        InputError: the batch has not been handed in, or is being reviewed already.
    """
    with changing(lake, batch_id) as change:
        state = known_state(change.reader, batch_id)
        state.after("sample")
        keys = sorted(state.handed_in)
        if not keys:
            problem = "was imported before answers were handed in"
            raise InputError(batch_id, "batch_id", problem, "import its file again, with a corrected answer, or import a review of it")
        share, least, pass_share = demands(state.batch)
        count = sample_size(len(keys), share, least)
        seed = state.batch.seed if state.batch is not None else 0
        entropy = hashlib.sha256(f"{seed}|{batch_id}|{state.round}|sample".encode()).digest()
        moment = now()
        rows = tuple(
            SampledAnswer(
                batch_id=batch_id, round=state.round, scene_id=scene, instance_id=instance, annotator=annotator,
                revision=state.handed_in[scene, instance, annotator], place=place, sampled=count, drawn_at=moment,
            )
            for place, (scene, instance, annotator) in enumerate(drawn(keys, count, np.random.default_rng(list(entropy))), 1)
        )  # fmt: skip
        note = f"sample of annotation batch {batch_id}"
        change.commit(BatchActs(review_samples=rows), note, configuration or configure())
    return {
        "batch_id": batch_id,
        "round": state.round,
        "answers": len(keys),
        "sampled": len(rows),
        "why": in_words(len(rows), len(keys), share, least, pass_share),
        "state": "in_review",
    }


def save_verdicts(lake: Lake, document: Any, name: str = "verdicts", configuration: Configuration | None = None) -> dict[str, Any]:
    """What a reviewer says of sampled answers, as a JSON value of `verdicts.schema.json`. A later verdict on an answer replaces an
    earlier one; one that says the same again is known.

    Raises:
        InputError: the document cannot be used; the batch is not being reviewed; an answer is not in the sample, or is the reviewer's
            own. Nothing is saved then.
    """
    batch = read_verdicts(document, name)
    with changing(lake, batch.batch_id) as change:
        state = known_state(change.reader, batch.batch_id)
        state.after("judge", name)
        sampled = {key_of(row) for row in state.sample}
        numbers: dict[tuple[str, str, str], int] = {}
        for row in rows_of(change.reader, AnswerVerdict, batch.batch_id):
            if row.round == state.round:
                numbers[key_of(row)] = max(row.number, numbers.get(key_of(row), 0))
        rows = []
        for given in batch.verdicts:
            if given.key not in sampled:
                problem = f"{given.annotator}'s answer for {given.scene_id} {given.instance_id} is not in the sample"
                raise InputError(name, f"{given.where}.instance_id", problem, "judge what was drawn: `metascenes annotate sample`")
            if person(given.annotator) == person(batch.reviewer):
                raise InputError(name, f"{given.where}.annotator", f"is {batch.reviewer}'s own answer", "let somebody else judge it")
            before = state.verdicts.get(given.key)
            stated = (batch.reviewer, given.passes, given.remark)
            if before is not None and (before.reviewer, before.passes, before.remark) == stated:
                continue
            rows.append(
                AnswerVerdict(
                    batch_id=batch.batch_id, round=state.round, scene_id=given.scene_id, instance_id=given.instance_id,
                    annotator=given.annotator, number=numbers.get(given.key, 0) + 1, reviewer=batch.reviewer,
                    reviewed_at=given.reviewed_at, passes=given.passes, remark=given.remark, source_file=batch.source_file,
                    is_simulated=batch.is_simulated,
                )
            )  # fmt: skip
        if rows:
            note = f"verdicts on annotation batch {batch.batch_id}"
            change.commit(BatchActs(answer_verdicts=tuple(rows)), note, configuration or configure(), name)
    after = state_in(lake.snapshot(), batch.batch_id)
    return {"batch_id": batch.batch_id, "verdicts": len(batch.verdicts), "new": len(rows)} | progress(after)


def conclude(lake: Lake, batch_id: str, configuration: Configuration | None = None) -> dict[str, Any]:
    """Accept a batch of whose sample more than the demanded share passed, or give the whole of it back with the remarks.

    Raises:
        InputError: the batch is not being reviewed, or some of the sample was not judged yet.
    """
    with changing(lake, batch_id) as change:
        state = known_state(change.reader, batch_id)
        left = len(state.sample) - len(state.verdicts)
        state.after("judge")  # a batch that was made elsewhere may be accepted from other states too, by a review of its own
        if left or not state.sample:
            problem = (
                f"{left} of {counted(len(state.sample), 'sampled answer')} {noun(left, 'is', 'are')} not judged yet"
                if state.sample
                else "no sample was drawn"
            )
            raise InputError(batch_id, "verdicts", problem, "judge all of them first")
        sampled, answers = len(state.sample), len(state.handed_in)
        low, high = pass_interval(state.passed, sampled, answers)
        share = demands(state.batch)[2]
        verdict = "accepted" if passes(state.passed, sampled, share) else "returned"
        verdicts = list(state.verdicts.values())
        review = QualityReview(
            batch_id=batch_id,
            review_id=f"round-{state.round}",
            reviewer=", ".join(sorted({row.reviewer for row in verdicts})),
            reviewed_at=max(now(), *(row.reviewed_at for row in verdicts)),
            sampled=sampled,
            wrong=state.failed,
            verdict=verdict,
            note="; ".join(remarks(state).values())[:2000] or None,
            source_file="verdicts",
            round=state.round,
            answers=answers,
            handed_in_hashes=handed_in_hashes(state.handed_in),
            pass_low=low,
            pass_high=high,
            is_simulated=any(row.is_simulated for row in verdicts),
        )
        note = f"annotation batch {batch_id} {verdict}"
        change.commit(BatchActs(quality_reviews=(review,)), note, configuration or configure())
    after = state_in(lake.snapshot(), batch_id)
    return {
        "batch_id": batch_id, "round": state.round, "answers": answers, "sampled": sampled, "passed": state.passed,
        "pass_share": state.passed / sampled, "pass_low": low, "pass_high": high, "demanded": share, "verdict": verdict,
        "state": after.state, "counts": after.counts,
    }  # fmt: skip


def remarks(state: BatchState) -> Mapping[tuple[str, str, str], str]:
    """What reviewers remarked in the last round, by answer."""
    return {key: f"{key[0]} {key[1]} ({key[2]}): {verdict.remark}" for key, verdict in state.verdicts.items() if verdict.remark is not None}


def progress(state: BatchState) -> dict[str, Any]:
    """How far a review is."""
    return {
        "round": state.round, "state": state.state, "sampled": len(state.sample), "judged": len(state.verdicts),
        "passed": state.passed, "failed": state.failed,
    }  # fmt: skip
