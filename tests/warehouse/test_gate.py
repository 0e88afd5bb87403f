"""The gate of annotation batches: what rows make of it, in Python and in SQL alike, and what no row can talk it into."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.annotation import (
    ACTS,
    ORIGINS,
    STATES,
    TRANSITIONS,
    Annotation,
    AnswerVerdict,
    QualityReview,
    SampledAnswer,
    Submission,
    WorkBatch,
)
from schemas.errors import InputError
from schemas.record import rows_to_arrow
from tests.samples import START, sample
from tests.warehouse.questions.view_answers import Database, by_key, of
from warehouse.tables.gate import BatchRows, BatchState, handed_in_hashes, key_of, passes, sample_size, state_of
from warehouse.tables.reviews import _standing

KEYS = [(scene, instance, annotator) for scene in ("demo/a", "demo/b") for instance in ("0001", "0002") for annotator in ("Ada", "bob")]


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


def answer(batch: str, key: tuple[str, str, str], revision: int = 1, **values: Any) -> Annotation:
    scene, instance, annotator = key
    named = {"batch_id": batch, "scene_id": scene, "instance_id": instance, "annotator": annotator, "revision": revision}
    row: Annotation = sample(Annotation, **named, **values)
    return row


def about(record: type, batch: str, key: tuple[str, str, str], **values: Any) -> Any:
    scene, instance, annotator = key
    return sample(record, batch_id=batch, scene_id=scene, instance_id=instance, annotator=annotator, **values)


@st.composite
def batches(draw: st.DrawFn) -> list[Any]:
    """Rows of batches in all sorts of states, some of which no command would leave."""
    rows: list[Any] = []
    for batch in draw(st.lists(st.sampled_from("pqr"), unique=True, min_size=1)):
        origin = draw(st.sampled_from([None, *ORIGINS]))
        least = draw(st.integers(1, 4))
        if origin is not None:
            rows.append(
                sample(
                    WorkBatch, batch_id=batch, origin=origin, counts_unreviewed=draw(st.booleans()), sample_share=0.1, least_sample=least,
                    pass_share=draw(st.sampled_from([0.5, 0.98])),
                )
            )  # fmt: skip
        handed: dict[tuple[str, str, str], int] = {}
        for number in range(1, draw(st.integers(0, 2)) + 1):
            handed = {key: draw(st.integers(1, 2)) for key in draw(st.lists(st.sampled_from(KEYS), unique=True, min_size=1))}
            total = len(handed) + draw(st.sampled_from([0, 0, 0, 1]))
            rows += [about(Submission, batch, key, round=number, revision=handed[key], answers=total) for key in handed]
            drawn = draw(st.lists(st.sampled_from(sorted(handed)), unique=True))
            count = max(1, len(drawn) + draw(st.sampled_from([0, 0, 0, 1])))
            for place, key in enumerate(drawn, 1):
                revision = handed[key] if draw(st.integers(0, 5)) else 3
                rows.append(about(SampledAnswer, batch, key, round=number, revision=revision, place=place, sampled=count))
                for turn in range(1, draw(st.sampled_from([1, 1, 1, 0, 2])) + 1):
                    who = draw(st.sampled_from(["rita", "rita", "rita", " ADA", "bob"]))
                    passed = draw(st.sampled_from([True, True, True, False]))
                    rows.append(about(AnswerVerdict, batch, key, round=number, number=turn, reviewer=who, passes=passed))
            for review in range(draw(st.integers(0, 2))):
                hashes = draw(st.sampled_from([handed_in_hashes(handed), handed_in_hashes(handed), None, ("0" * 64,)]))
                rows.append(
                    sample(
                        QualityReview, batch_id=batch, review_id=f"r{number}{review}", round=number,
                        reviewed_at=START + timedelta(hours=draw(st.integers(0, 2))), handed_in_hashes=hashes, sampled=count,
                        wrong=draw(st.sampled_from([0, 0, 1])),
                        verdict=draw(st.sampled_from(["accepted", "accepted", "accepted", "returned"])),
                    )
                )  # fmt: skip
        for key in draw(st.lists(st.sampled_from(KEYS), unique=True)):
            for revision in range(1, draw(st.integers(1, 3)) + 1):
                rows.append(answer(batch, key, revision, is_withdrawn=draw(st.integers(0, 4)) == 0))
    return rows


PARTS = (Submission, SampledAnswer, AnswerVerdict, QualityReview)


def states(rows: list[Any]) -> dict[str, BatchState]:
    """What the batches that any row names are at."""
    made = {}
    for name in sorted({row.batch_id for row in rows}):
        batch = next((row for row in of(rows, WorkBatch) if row.batch_id == name), None)
        parts = [tuple(row for row in of(rows, record) if row.batch_id == name) for record in PARTS]
        made[name] = state_of(name, BatchRows(batch, *parts))
    return made


@pytest.mark.whole
@settings(max_examples=150, deadline=None)
@given(rows=batches())
def test_sql_sees_the_gate_as_it_is(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    seen = by_key(database.ask("annotation_batch_states"), "batch_id")
    expected = states(rows)
    assert seen.keys() == expected.keys()
    for name, state in expected.items():
        row = seen[name]
        facts = (row["state"], row["round"], row["counts"], row["handed_in"], row["sampled"], row["judged"], row["passed"], row["origin"])
        assert facts == (
            state.state, state.round, state.counts, len(state.handed_in), len(state.sample), len(state.verdicts), state.passed, state.origin
        )  # fmt: skip
    table = rows_to_arrow(of(rows, Annotation), Annotation)
    names = ("batch_id", "scene_id", "instance_id", "annotator", "revision")
    standing = table.take(pa.array(_standing(table, expected), pa.int64())).select(names).to_pylist()
    assert [tuple(row[name] for name in names) for row in database.ask("standing_answers")] == [tuple(row.values()) for row in standing]


def reviewed(judged: int = 50, failed: int = 0, answers: int = 60) -> list[Any]:
    """A batch that was created, handed in, sampled, judged and accepted."""
    keys = [("demo/a", f"{number:04d}", "ada") for number in range(answers)]
    handed = dict.fromkeys(keys, 1)
    batch = sample(WorkBatch, batch_id="b", origin="created", counts_unreviewed=True, sample_share=0.1, least_sample=50, pass_share=0.98)
    rows: list[Any] = [batch]
    rows += [about(Submission, "b", key, round=1, revision=1, answers=answers) for key in keys]
    rows += [about(SampledAnswer, "b", key, round=1, revision=1, place=n, sampled=judged) for n, key in enumerate(keys[:judged], 1)]
    rows += [about(AnswerVerdict, "b", key, round=1, number=1, reviewer="rita", passes=n >= failed) for n, key in enumerate(keys[:judged])]
    rows += [answer("b", key) for key in keys]
    review = sample(QualityReview, batch_id="b", verdict="accepted", sampled=judged, wrong=0, handed_in_hashes=handed_in_hashes(handed))
    return [*rows, review]


def from_elsewhere(wrong: int = 1, sampled: int = 60, **values: Any) -> list[Any]:
    """A batch that was made elsewhere, imported, and accepted by a review that was made there, too."""
    keys = [("demo/a", f"{number:04d}", "ada") for number in range(60)]
    usual = {"origin": "elsewhere", "counts_unreviewed": False, "sample_share": 0.1, "least_sample": 50, "pass_share": 0.98}
    rows: list[Any] = [sample(WorkBatch, batch_id="b", **usual | values)]
    rows += [about(Submission, "b", key, round=1, revision=1, answers=60) for key in keys]
    hashes = handed_in_hashes(dict.fromkeys(keys, 1))
    return [*rows, sample(QualityReview, batch_id="b", verdict="accepted", sampled=sampled, wrong=wrong, handed_in_hashes=hashes)]


def stands(database: Database, rows: list[Any]) -> tuple[str, bool]:
    """State of the batch and whether it counts, in Python and in SQL alike."""
    database.fill(*rows)
    (row,) = database.ask("annotation_batch_states")
    state = states(rows)["b"]
    assert (row["state"], row["counts"]) == (state.state, state.counts)
    return state.state, state.counts


def changed(rows: list[Any], record: type, **values: Any) -> list[Any]:
    """The rows, the first one of a record changed."""
    first = of(rows, record)[0]
    return [dataclasses.replace(row, **values) if row is first else row for row in rows]


def test_a_batch_is_accepted_by_what_bears_it_out_and_by_nothing_less() -> None:
    sound = reviewed()
    assert (states(sound)["b"].state, states(sound)["b"].counts) == ("accepted", True)
    forged = {
        "a sample too small": reviewed(judged=49),
        "one of fifty fails": reviewed(failed=1),
        "a sampled answer that nobody judged": [row for row in sound if row is not of(sound, AnswerVerdict)[3]],
        "who answered judges": changed(sound, AnswerVerdict, reviewer=" ADA "),
        "a revision that was not drawn": changed(sound, SampledAnswer, revision=2),
        "a revision that was handed in later": changed(sound, Submission, revision=2),
        "an answer that was handed in later": [*sound, about(Submission, "b", ("demo/b", "0001", "ada"), round=1, revision=1, answers=60)],
        "a round that nobody reviewed": [*sound, about(Submission, "b", ("demo/a", "0001", "ada"), round=2, revision=2, answers=1)],
        "a review without what it was of": changed(sound, QualityReview, handed_in_hashes=None),
        "no sample": [row for row in sound if not isinstance(row, SampledAnswer)],
        "no verdicts": [row for row in sound if not isinstance(row, AnswerVerdict)],
        "no submission": [row for row in sound if not isinstance(row, Submission)],
        "no review": [row for row in sound if not isinstance(row, QualityReview)],
        "a return": [
            *sound,
            sample(QualityReview, batch_id="b", review_id="r2", verdict="returned", reviewed_at=START - timedelta(days=1)),
        ],
    }
    for why, rows in forged.items():
        state = states(rows)["b"]
        assert (state.state != "accepted", state.counts) == (True, False), why


def test_what_is_erased_takes_nothing_else_along() -> None:
    """A scene of an accepted batch is erased, with sampled answers of it: the others count on."""
    rows = reviewed(answers=60)
    other = [
        dataclasses.replace(row, scene_id="demo/b") if getattr(row, "instance_id", "") in ("0002", "0055") else row
        for row in rows
    ]  # fmt: skip
    handed = {key_of(row): row.revision for row in of(other, Submission)}
    other = [
        dataclasses.replace(row, handed_in_hashes=handed_in_hashes(handed)) if isinstance(row, QualityReview) else row for row in other
    ]
    assert states(other)["b"].state == "accepted"
    left = [row for row in other if getattr(row, "scene_id", "") != "demo/b"]
    assert (len(of(left, SampledAnswer)), states(left)["b"].state) == (49, "accepted")
    assert states(changed(left, AnswerVerdict, passes=False))["b"].state != "accepted"


@pytest.mark.parametrize(
    ("wrong", "sampled", "share", "accepted"),
    [(1, 60, 0.98, True), (2, 60, 0.98, False), (1, 1, 0.98, False), (0, 1, 0.98, True), (1, 50, 0.98, False), (29, 60, 0.5, True)],
)
def test_a_review_from_elsewhere_must_pass_as_well(database: Database, wrong: int, sampled: int, share: float, accepted: bool) -> None:
    expected = ("accepted", True) if accepted else ("submitted", False)
    assert stands(database, from_elsewhere(wrong, sampled, pass_share=share)) == expected


def test_where_nothing_was_erased_a_sample_with_gaps_accepts_nothing(database: Database) -> None:
    """One row is left of a sample of fifty, and one verdict: only where as many answers are gone are the others believed to be erased."""
    sound = reviewed()
    drawn, verdict = of(sound, SampledAnswer)[0], of(sound, AnswerVerdict)[0]
    gaps = [row for row in sound if not isinstance(row, SampledAnswer | AnswerVerdict)] + [drawn, verdict]
    assert stands(database, sound) == ("accepted", True)
    assert stands(database, gaps) == ("in_review", False)
    one_less = [row for row in gaps if row is not of(gaps, Submission)[-1]]
    hashes = handed_in_hashes({key_of(row): row.revision for row in of(one_less, Submission)})
    assert stands(database, changed(one_less, QualityReview, handed_in_hashes=hashes)) == ("in_review", False)


def test_what_was_returned_counts_unreviewed_no_more(database: Database) -> None:
    *trusted, accepted = from_elsewhere(counts_unreviewed=True)
    assert stands(database, trusted) == ("submitted", True)
    returned = sample(QualityReview, batch_id="b", review_id="r0", verdict="returned", reviewed_at=START - timedelta(days=1))
    keys = [key_of(row) for row in of(trusted, Submission)]
    second = [about(Submission, "b", key, round=2, revision=1 + (key == keys[0]), answers=60) for key in keys]
    assert stands(database, [*trusted, returned]) == ("returned", False)
    assert stands(database, [*trusted, returned, *second]) == ("submitted", False)
    hashes = handed_in_hashes({key_of(row): row.revision for row in second})
    anew = dataclasses.replace(accepted, round=2, handed_in_hashes=hashes)
    assert stands(database, [*trusted, returned, *second, anew]) == ("accepted", True)


def test_transitions_are_of_known_states_and_acts_and_lead_everywhere() -> None:
    for origin, allowed in TRANSITIONS.items():
        assert {state for state, _ in allowed} | set(allowed.values()) <= set(STATES)
        assert {act for _, act in allowed} <= set(ACTS)
        start = "open" if origin == "created" else "submitted"
        reached = {start}
        for _ in STATES:
            reached |= {after for (state, _), after in allowed.items() if state in reached}
        assert reached == (set(STATES) if origin == "created" else set(STATES) - {"open"})
    assert all(act not in ("answer", "submit") for state, act in TRANSITIONS["created"] if state in ("submitted", "in_review", "accepted"))
    for origin, state, act in ((o, s, a) for o in ORIGINS for s in STATES for a in ACTS):
        batch = dataclasses.replace(states(reviewed())["b"], state=state, batch=sample(WorkBatch, origin=origin))
        if (state, act) in TRANSITIONS[origin]:
            assert batch.after(act) == TRANSITIONS[origin][state, act]
        else:
            with pytest.raises(InputError, match=f"one cannot {act} now"):
                batch.after(act)


@given(answers=st.integers(0, 5000), share=st.floats(0, 1), least=st.integers(1, 100))
def test_a_sample_is_the_share_and_the_least_and_all_there_is(answers: int, share: float, least: int) -> None:
    size = sample_size(answers, share, least)
    assert size <= answers
    assert size == answers or size >= least
    assert size == answers or size >= share * answers - 1e-6


@pytest.mark.parametrize(
    ("passed", "sampled", "accepted"), [(49, 50, False), (50, 50, True), (98, 100, False), (99, 100, True), (147, 150, False)]
)
def test_more_than_98_percent_must_pass(passed: int, sampled: int, accepted: bool) -> None:
    assert passes(passed, sampled, 0.98) is accepted
