"""What annotators and reviewers have before them, and how batches stand; nothing here changes the lake."""

from __future__ import annotations

from typing import Any

from flows.inputs.annotation.acts import known_state, rows_of
from schemas.annotation import Annotation, AnnotationFigures, AnswerVerdict, Assignment
from schemas.record import rows_to_arrow
from tasks.annotation.revisions import key_of as key_of_answer
from tasks.annotation.revisions import latest
from warehouse.lake import Lake
from warehouse.tables.gate import BatchState, batch_states, key_of, person

NEXT = {
    "open": "annotators answer, then `metascenes annotate submit`",
    "submitted": "`metascenes annotate sample` draws what is reviewed",
    "in_review": "reviewers judge the sample: `metascenes annotate review`",
    "accepted": "the next run places what was chosen",
    "returned": "annotators correct their answers, then `metascenes annotate submit`",
}
"""What comes next, by state."""


def open_work(lake: Lake, batch_id: str, annotator: str) -> list[dict[str, Any]]:
    """What an annotator is asked in a batch, in the order of their list: whether it is answered, how, and what reviewers remarked.

    `answer` is the last revision as a row of `annotations`, `figures` its row of `annotation_figures`; None where there is none, and
    where the answer was withdrawn.

    Raises:
        InputError: there is no such batch.
    """
    reader = lake.snapshot()
    state = known_state(reader, batch_id)
    revisions = rows_of(reader, Annotation, batch_id)
    answers, given = latest(revisions), {key_of_answer(row) for row in revisions}
    figures = {(row.scene_id, row.instance_id, row.annotator, row.revision): row for row in rows_of(reader, AnnotationFigures, batch_id)}
    asked = [row for row in rows_of(reader, Assignment, batch_id) if row.annotator == annotator]
    remarked = _remarks(rows_of(reader, AnswerVerdict, batch_id))
    work = []
    for row in sorted(asked, key=lambda row: row.place):
        key = (row.scene_id, row.instance_id, row.annotator)
        answer = answers.get(key)
        work.append(
            {
                "scene_id": row.scene_id, "instance_id": row.instance_id, "place": row.place, "doubt": row.doubt,
                "reasons": list(row.reasons), "is_open": state.state in ("open", "returned"), "is_answered": answer is not None,
                "is_withdrawn": answer is None and key in given,
                "answer": plain(answer), "figures": plain(figures.get((*key, answer.revision))) if answer is not None else None,
                "remarks": remarked.get(key, []),
            }
        )  # fmt: skip
    return work


def open_reviews(lake: Lake, batch_id: str, reviewer: str) -> list[dict[str, Any]]:
    """The sampled answers of a batch that a reviewer may judge, in the order in which they were drawn, with the verdict so far.

    Raises:
        InputError: there is no such batch.
    """
    reader = lake.snapshot()
    state = known_state(reader, batch_id)
    answers = {(*key_of_answer(row), row.revision): row for row in rows_of(reader, Annotation, batch_id)}
    figures = {(row.scene_id, row.instance_id, row.annotator, row.revision): row for row in rows_of(reader, AnnotationFigures, batch_id)}
    reviews = []
    for row in state.sample:
        if person(row.annotator) == person(reviewer):
            continue
        key = (*key_of(row), row.revision)
        reviews.append(
            {
                "scene_id": row.scene_id, "instance_id": row.instance_id, "annotator": row.annotator, "place": row.place,
                "is_open": state.state == "in_review", "answer": plain(answers.get(key)), "figures": plain(figures.get(key)),
                "verdict": plain(state.verdicts.get(key_of(row))),
            }
        )  # fmt: skip
    return reviews


def batch_list(lake: Lake, batch_id: str | None = None) -> list[dict[str, Any]]:
    """How batches stand, by name: state, answers, sample, and what comes next; of one when it is named."""
    reader = lake.snapshot()
    states = batch_states(reader) if batch_id is None else {batch_id: known_state(reader, batch_id)}
    rows = []
    for name, state in states.items():
        answers = latest(rows_of(reader, Annotation, name))
        assignments = rows_of(reader, Assignment, name)
        asked = {(row.scene_id, row.instance_id, row.annotator) for row in assignments}
        people = sorted({row.annotator for row in assignments} | {annotator for _, _, annotator in answers})
        rows.append(
            {
                "batch_id": name, "origin": state.origin, "state": state.state, "round": state.round, "counts": state.counts,
                "assigned": len(asked), "answers": len(answers), "handed_in": len(state.handed_in), "sampled": len(state.sample),
                "judged": len(state.verdicts), "passed": state.passed,
                "by_annotator": {
                    person_: {
                        "assigned": sum(key[2] == person_ for key in asked),
                        "answered": sum(key[2] == person_ for key in answers),
                    }
                    for person_ in people
                },
                "next": next_step(state),
            }
        )  # fmt: skip
    return rows


def next_step(state: BatchState) -> str:
    """What comes next for a batch, for people."""
    if state.origin == "elsewhere" and state.state == "submitted":
        if state.counts:
            return "its answers count until a review returns it (annotation.unreviewed_imports_count)"
        return "its answers count once it is accepted: `metascenes annotate sample`, or `metascenes annotate review` with a review of it"
    if state.origin == "elsewhere" and state.state == "returned":
        return "its corrected answers are imported again"
    return NEXT[state.state]


def _remarks(verdicts: list[AnswerVerdict]) -> dict[tuple[str, str, str], list[str]]:
    """What reviewers remarked on answers, in all rounds; of a round the last verdict."""
    last: dict[tuple[tuple[str, str, str], int], AnswerVerdict] = {}
    for row in sorted(verdicts, key=lambda row: row.number):
        last[key_of(row), row.round] = row
    remarks: dict[tuple[str, str, str], list[str]] = {}
    for (key, number), row in sorted(last.items()):
        if row.remark is not None:
            remarks.setdefault(key, []).append(f"round {number}, {row.reviewer}: {row.remark}")
    return remarks


def plain(row: Any) -> dict[str, Any] | None:
    """A row as plain values, times in ISO 8601; None of None."""
    if row is None:
        return None
    values: dict[str, Any] = rows_to_arrow([row], type(row)).to_pylist()[0]
    return {name: value.isoformat() if hasattr(value, "isoformat") else value for name, value in values.items()}
