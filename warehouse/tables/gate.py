"""The gate between annotators and scenes: what a batch is at, and which of its answers count, from its rows alone.

A review alone lets nothing through: a batch that was created here is accepted only if the rows of its sample and of the verdicts on it
bear that out, and only the revisions that were handed in then count. Whoever may write all of these rows can write that somebody reviewed.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections import defaultdict
from collections.abc import Collection, Mapping
from typing import Any

from schemas.annotation import TRANSITIONS, AnswerVerdict, QualityReview, SampledAnswer, Submission, WorkBatch
from schemas.errors import InputError
from warehouse.tables.snapshot import Reader

Key = tuple[str, str, str]
"""Scene, instance and annotator: what an answer of a batch goes by."""

ROUNDING = 1e-9
"""Shares times counts are compared with this much to spare: 0.98 of 50 is 49, whatever floats make of it."""

SHARE, LEAST_SAMPLE, PASS_SHARE = 0.1, 50, 0.98
"""What batches without a row of their own are held against: a tenth is reviewed, at least fifty answers (below that one that fails is
more than 2 %), and more than 98 % must pass."""


@dataclasses.dataclass(frozen=True)
class BatchState:
    """What a batch is at.

    `round`: how often it was handed in; 0 while it never was. `handed_in`: the revisions that were, by answer; none for what was
    imported before there were submissions. `sample`: answers that were drawn. `verdicts`: the last one on each of them. `counts`: its
    answers reach scenes. `review`: how the round was concluded; None while it was not.
    """

    batch_id: str
    batch: WorkBatch | None
    state: str
    round: int
    counts: bool
    handed_in: dict[Key, int]
    sample: tuple[SampledAnswer, ...]
    verdicts: dict[Key, AnswerVerdict]
    review: QualityReview | None

    @property
    def origin(self) -> str:
        """Where the batch comes from; what the lake does not know of was made elsewhere."""
        return self.batch.origin if self.batch is not None else "elsewhere"

    @property
    def passed(self) -> int:
        """Sampled answers that pass."""
        return sum(verdict.passes for verdict in self.verdicts.values())

    @property
    def failed(self) -> int:
        """Sampled answers that do not pass."""
        return len(self.verdicts) - self.passed

    def after(self, act: str, file: str = "", field: str = "batch_id") -> str:
        """The state that the batch has once something was done to it.

        Raises:
            InputError: it may not be done now.
        """
        allowed = TRANSITIONS[self.origin]
        if (self.state, act) not in allowed:
            acts = sorted({name for state, name in allowed if state == self.state})
            problem = f"{self.batch_id} is {self.state.replace('_', ' ')}: one cannot {act} now"
            raise InputError(file or self.batch_id, field, problem, f"what one can: {', '.join(acts) or 'nothing any more'}")
        return allowed[self.state, act]


@dataclasses.dataclass(frozen=True)
class BatchRows:
    """The rows of one batch that say what it is at."""

    batch: WorkBatch | None = None
    submissions: tuple[Submission, ...] = ()
    samples: tuple[SampledAnswer, ...] = ()
    verdicts: tuple[AnswerVerdict, ...] = ()
    reviews: tuple[QualityReview, ...] = ()


def person(name: str) -> str:
    """What tells a person from another: the name but for case and spaces around it."""
    return name.strip().lower()


def sample_size(answers: int, share: float, least: int) -> int:
    """How many of so many answers are reviewed: a share of them, at least `least`, at most all."""
    return min(answers, max(math.ceil(share * answers - ROUNDING), least))


def passes(passed: int, sampled: int, share: float) -> bool:
    """Whether more than a share of the sampled answers passed."""
    return passed - share * sampled > ROUNDING


def state_of(batch_id: str, rows: BatchRows) -> BatchState:
    """What a batch is at, from its rows."""
    created = rows.batch is not None and rows.batch.origin == "created"
    number = max((row.round for row in rows.submissions), default=0 if created else 1)
    handed_in = {key_of(row): row.revision for row in rows.submissions if row.round == number}
    sample = tuple(sorted((row for row in rows.samples if row.round == number), key=lambda row: row.place))
    verdicts: dict[Key, AnswerVerdict] = {}
    for verdict in sorted(rows.verdicts, key=lambda row: row.number):
        if verdict.round == number and person(verdict.reviewer) != person(verdict.annotator):
            verdicts[key_of(verdict)] = verdict
    verdicts = {key: verdicts[key] for key in map(key_of, sample) if key in verdicts}
    reviews = sorted((row for row in rows.reviews if row.round == number), key=lambda row: (row.reviewed_at, row.review_id))
    last = reviews[-1] if reviews else None
    if created and any(row.verdict == "returned" for row in reviews):
        last = next(row for row in reversed(reviews) if row.verdict == "returned")
    before = "open" if number == 0 else "in_review" if sample else "submitted"
    state = BatchState(batch_id, rows.batch, before, number, False, handed_in, sample, verdicts, last)
    if last is not None and number > 0 and (last.verdict == "returned" or _is_borne_out(rows, last, state)):
        state = dataclasses.replace(state, state=last.verdict)
    trusted = rows.batch is not None and not created and rows.batch.counts_unreviewed
    trusted = trusted and not any(row.verdict == "returned" for row in rows.reviews)
    return dataclasses.replace(state, counts=state.state == "accepted" or (trusted and state.state in ("submitted", "in_review")))


def demands(batch: WorkBatch | None) -> tuple[float, int, float]:
    """Share that is reviewed of a batch, answers that are at least, share of which more must pass."""
    return (batch.sample_share, batch.least_sample, batch.pass_share) if batch is not None else (SHARE, LEAST_SAMPLE, PASS_SHARE)


def handed_in_hashes(handed_in: Mapping[Key, int]) -> tuple[str, ...]:
    """Hashes of what was handed in of each scene, answers and their revisions, sorted: a scene that is erased takes its own with it."""
    lines: dict[str, list[str]] = defaultdict(list)
    for scene, instance, annotator in sorted(handed_in):
        lines[scene].append(f"{scene}|{instance}|{annotator}|{handed_in[scene, instance, annotator]}")
    return tuple(sorted(hashlib.sha256("\n".join(of_scene).encode()).hexdigest() for of_scene in lines.values()))


def key_of(row: Submission | SampledAnswer | AnswerVerdict) -> Key:
    """What the answer that a row is about goes by."""
    return row.scene_id, row.instance_id, row.annotator


def batch_states(reader: Reader, batches: Collection[str] | None = None) -> dict[str, BatchState]:
    """What batches are at, by name; of all batches that any of the tables knows of when none are named.

    Named batches that the lake knows nothing about are 'submitted': they were made elsewhere, and nobody accepted them.
    """
    if batches is not None and not batches:
        return {}
    kept: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    records: tuple[type[Any], ...] = (WorkBatch, Submission, SampledAnswer, AnswerVerdict, QualityReview)
    for record in records:
        for row in reader.rows(record) if batches is None else reader.rows_by_key(record, batches):
            kept[row.batch_id][record.__name__].append(row)
    names = set(kept) if batches is None else set(batches)
    if batches is None:
        names |= set(reader.matching("annotations", {}, ["batch_id"]).column("batch_id").unique().to_pylist())
    return {name: state_of(name, _gathered(kept[name])) for name in sorted(names)}


def _gathered(parts: dict[str, list[Any]]) -> BatchRows:
    return BatchRows(
        batch=next(iter(parts["WorkBatch"]), None),
        submissions=tuple(parts["Submission"]),
        samples=tuple(parts["SampledAnswer"]),
        verdicts=tuple(parts["AnswerVerdict"]),
        reviews=tuple(parts["QualityReview"]),
    )


def _is_borne_out(rows: BatchRows, review: QualityReview, state: BatchState) -> bool:
    """Whether a review that accepts a batch is about what was handed in, and a sample of that is large enough, was judged to the end and
    passed. Of what was made elsewhere, the review may have been made there, too: then there is no sample, and its own count must pass.

    Of what was erased since, the review's own count is all that is left: as much of the sample, at most, as of what was handed in.
    """
    elsewhere = state.origin == "elsewhere"
    if review.handed_in_hashes is None:
        if not elsewhere:
            return False
    elif not set(handed_in_hashes(state.handed_in)) <= set(review.handed_in_hashes):
        return False
    share, least, pass_share = demands(rows.batch)
    if elsewhere and not state.sample:
        return passes(review.sampled - review.wrong, review.sampled, pass_share)
    answers = max((row.answers for row in rows.submissions if row.round == state.round), default=0)
    sampled = max((row.sampled for row in state.sample), default=0)
    if sampled < max(1, sample_size(answers, share, least)) or len(state.verdicts) < len(state.sample):
        return False
    if any(state.handed_in.get(key_of(row)) != row.revision for row in state.sample):
        return False
    if len(state.sample) == sampled:
        return passes(state.passed, sampled, pass_share)
    if not 0 < sampled - len(state.sample) <= answers - len(state.handed_in):
        return False
    return review.sampled == sampled and state.failed <= review.wrong and passes(sampled - review.wrong, sampled, pass_share)
