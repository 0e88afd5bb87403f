"""The views of annotation: agreement, time, quality control, each against a computation of its own in plain Python."""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.annotation import VERDICTS, Annotation, QualityReview
from schemas.candidates import Candidate
from schemas.capture import Instance, Scene
from schemas.runs import StageRun
from schemas.selection import Selection
from tasks.annotation import current
from tests.samples import START, fingerprint, sample, stage_run
from tests.warehouse.questions.view_answers import ASSETS, EXACT, INSTANCES, SCENES, Database, by_key, objects_of, of, quick, same, scenes


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


GONE = fingerprint("asset", "gone")
"""An asset that is no candidate of anything any more."""


@st.composite
def answered(draw: st.DrawFn) -> list[Any]:
    """Candidates and selections of two scenes, and batches of several people's answers."""
    rows: list[Any] = []
    for scene, instance in itertools.product(SCENES[:2], INSTANCES[:3]):
        place = {"scene_id": scene, "instance_id": instance}
        filled = [(slot, draw(st.sampled_from(ASSETS))) for slot in draw(st.lists(st.integers(1, 4), unique=True))]
        rows += [sample(Candidate, **place, slot=slot, asset_id=asset, outcome="filled") for slot, asset in filled]
        if filled:
            rows.append(sample(Selection, **place, rank=1, slot=filled[0][0], asset_id=filled[0][1]))
        for batch, annotator in draw(st.lists(st.tuples(st.sampled_from("pqr"), st.sampled_from(["ada", "bob", "cleo"])), unique=True)):
            rows.append(
                sample(
                    Annotation, **place, batch_id=batch, annotator=annotator, choice=draw(st.sampled_from([None, GONE, *ASSETS])),
                    answered_at=START + timedelta(days=draw(st.integers(0, 3))), seconds=draw(st.none() | EXACT),
                )
            )  # fmt: skip
    return rows


@st.composite
def reviewed(draw: st.DrawFn) -> list[Any]:
    """Answers, and reviews of some batches; one of a batch whose answers are gone."""
    rows = draw(answered())
    for batch in draw(st.lists(st.sampled_from([*"pqr", "erased"]), unique=True)):
        for number in range(draw(st.integers(1, 3))):
            sampled = draw(st.integers(1, 60))
            rows.append(
                sample(
                    QualityReview, batch_id=batch, review_id=f"r{number}", reviewed_at=START + timedelta(hours=draw(st.integers(0, 2))),
                    sampled=sampled, wrong=draw(st.sampled_from([0, 0, 0, 1, sampled])), verdict=draw(st.sampled_from(VERDICTS)),
                    note=draw(st.sampled_from([None, "see 0003"])),
                )
            )  # fmt: skip
    return rows


def counting(rows: list[Any]) -> list[Annotation]:
    """The answers that count, as the annotation stage says, scene by scene: those of a batch whose last review accepted it, with
    less than 2 % of its sample wrong."""
    last = {row.batch_id: row for row in sorted(of(rows, QualityReview), key=lambda row: (row.reviewed_at, row.review_id))}
    good = {name for name, row in last.items() if row.verdict == "accepted" and 50 * row.wrong < row.sampled}
    standing = [row for row in of(rows, Annotation) if row.batch_id in good]
    return [one for scene in SCENES for one in current([row for row in standing if row.scene_id == scene])]


@pytest.mark.whole
@quick
@given(rows=reviewed())
def test_answers_that_count_are_those_that_the_stage_counts(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answer = by_key(database.ask("current_answers"), "scene_id", "instance_id", "annotator")
    expected = {(r.scene_id, r.instance_id, r.annotator): (r.batch_id, r.choice, r.answered_at) for r in counting(rows)}
    assert {key: (row["batch_id"], row["choice"], row["answered_at"]) for key, row in answer.items()} == expected


@pytest.mark.whole
@quick
@given(rows=reviewed())
def test_annotation_agreement_counts_only_the_answer_that_counts(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    best = {(r.scene_id, r.instance_id): r.asset_id for r in of(rows, Selection)}
    by_annotator: dict[str, list[Annotation]] = defaultdict(list)
    for row in counting(rows):
        by_annotator[row.annotator].append(row)
    answer = by_key(database.ask("annotation_agreement"), "annotator")
    assert answer.keys() == by_annotator.keys()
    for name, given_answers in by_annotator.items():
        agreed = sum(r.choice is not None and r.choice == best.get((r.scene_id, r.instance_id)) for r in given_answers)
        comparable = sum(r.choice is not None and (r.scene_id, r.instance_id) in best for r in given_answers)
        same(
            answer[name], answers=len(given_answers), none_fits=sum(r.choice is None for r in given_answers), same_as_selection=agreed,
            agreement=agreed / comparable if comparable else None,
        )  # fmt: skip


@pytest.mark.whole
@quick
@given(rows=reviewed())
def test_agreement_of_two_annotators_and_cohens_kappa(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    slots: dict[tuple[str, str, str], int] = {}
    for one in of(rows, Candidate):
        key = (one.scene_id, one.instance_id, one.asset_id)
        slots[key] = min(one.slot, slots.get(key, 99))
    labels: dict[str, dict[tuple[str, str], Any]] = defaultdict(dict)
    for row in counting(rows):
        label = "none" if row.choice is None else slots.get((row.scene_id, row.instance_id, row.choice), row.choice)
        labels[row.annotator][row.scene_id, row.instance_id] = label
    answer = by_key(database.ask("annotator_agreement"), "annotator_a", "annotator_b")
    expected = {(a, b) for a, b in itertools.combinations(sorted(labels), 2) if labels[a].keys() & labels[b].keys()}
    assert answer.keys() == expected
    for a, b in expected:
        both = sorted(labels[a].keys() & labels[b].keys())
        pairs = [(labels[a][place], labels[b][place]) for place in both]
        names = sorted({label for pair in pairs for label in pair}, key=str)
        confusion = np.zeros((len(names), len(names)))
        for one, other in pairs:
            confusion[names.index(one), names.index(other)] += 1
        agreed = np.trace(confusion) / len(both)
        chance = float(confusion.sum(axis=1) @ confusion.sum(axis=0)) / len(both) ** 2
        same(
            answer[a, b], instances=len(both), same_choice=sum(one == other for one, other in pairs), agreement=float(agreed),
            both_none_fits=pairs.count(("none", "none")), chance_agreement=chance,
        )  # fmt: skip
        kappa = answer[a, b]["cohens_kappa"]
        if chance == 1:
            assert kappa is None
        else:
            assert kappa == pytest.approx((agreed - chance) / (1 - chance), abs=1e-12)


def test_kappa_of_a_textbook_table(database: Database) -> None:
    # 20 both take slot 1, 15 both slot 2, 5 and 10 differ: agreement 0.7, chance 0.5, kappa 0.4
    rows: list[Any] = []
    taken = [(1, 1)] * 20 + [(1, 2)] * 5 + [(2, 1)] * 10 + [(2, 2)] * 15
    for number, (first, second) in enumerate(taken):
        place = {"scene_id": "demo/a", "instance_id": f"{number:04d}"}
        rows += [sample(Candidate, **place, slot=slot, asset_id=ASSETS[slot - 1], outcome="filled") for slot in (1, 2)]
        rows += [
            sample(Annotation, **place, batch_id="b", annotator=name, choice=ASSETS[slot - 1])
            for name, slot in (("ada", first), ("bob", second))
        ]
    database.fill(*rows, sample(QualityReview, batch_id="b", verdict="accepted", wrong=0))
    same(database.ask("annotator_agreement")[0], instances=50, agreement=0.7, chance_agreement=0.5, cohens_kappa=0.4)


@pytest.mark.whole
@quick
@given(rows=answered(), held=scenes(), spent=st.lists(EXACT, min_size=6, max_size=6))
def test_minutes_of_people_and_of_computers(database: Database, rows: list[Any], held: list[Any], spent: list[float]) -> None:
    objects = {scene: len(found) for scene, found in objects_of(held).items()}
    stages = itertools.product(sorted(objects), ("capture", "selection"))
    history = [stage_run(scene, stage, fingerprint(stage), seconds=s) for (scene, stage), s in zip(stages, spent, strict=False)]
    database.fill(*rows, *held, *history)
    by_scene = by_key(database.ask("annotation_timing_by_scene"), "scene_id")
    answers = of(rows, Annotation)
    assert by_scene.keys() == {row.scene_id for row in answers}
    minutes, timed_objects = {}, 0
    for scene, row in by_scene.items():
        here = [r for r in answers if r.scene_id == scene]
        timed = [r for r in here if r.seconds is not None]
        drawn = len({r.instance_id for r in timed})
        timed_objects += drawn
        total = sum(r.seconds for r in timed) / 60 if timed else None
        same(
            row, answers=len(here), timed_answers=len(timed), annotators=len({r.annotator for r in here}), objects=drawn, minutes=total,
            minutes_per_object=total / drawn if timed else None,
        )  # fmt: skip
        if timed:
            minutes[scene] = total
    readings = by_key(database.ask("annotation_timing"), "reading")
    assert list(readings) == ["paper_annotation", "paper_preprocessing", "people", "computation"]
    for reading, each in (("paper_annotation", 2.0), ("paper_preprocessing", 12 / 39)):
        stated = {"minutes_per_scene": 39 * each, "minutes_per_object": each, "minutes_per_39_objects": 39 * each}
        same(readings[reading], scenes=None, times_paper=1.0, **stated)
    each = sum(minutes.values()) / timed_objects if minutes else None
    same(
        readings["people"], scenes=len(minutes), objects=timed_objects, minutes=sum(minutes.values()) if minutes else None,
        minutes_per_scene=sum(minutes.values()) / len(minutes) if minutes else None, minutes_per_object=each,
        median_minutes_per_scene=float(np.median(list(minutes.values()))) if minutes else None,
        minutes_per_39_objects=39 * each if minutes else None, times_paper=each / 2 if minutes else None,
    )  # fmt: skip
    computed = {scene: sum(r.seconds for r in of(history, StageRun) if r.scene_id == scene) / 60 for scene in objects if objects[scene]}
    computed = {scene: total for scene, total in computed.items() if any(r.scene_id == scene for r in history)}
    count = sum(objects[scene] for scene in computed)
    total = sum(computed.values())
    same(
        readings["computation"], scenes=len(computed), objects=count, minutes=total if computed else None,
        minutes_per_scene=total / len(computed) if computed else None, minutes_per_39_objects=39 * total / count if computed else None,
        times_paper=39 * total / count / 12 if computed else None,
    )  # fmt: skip


def test_the_import_of_a_finished_dataset_is_no_computation(database: Database) -> None:
    rows: list[Any] = [sample(Instance, scene_id=SCENES[0], is_structure=False), stage_run(SCENES[0], "capture", fingerprint(1))]
    for segmentation, counted in (("objects", 0), ("file", 1)):
        database.fill(sample(Scene, scene_id=SCENES[0], segmentation=segmentation), *rows)
        same(by_key(database.ask("annotation_timing"), "reading")["computation"], scenes=counted, objects=counted)


def wilson(wrong: int, trials: int) -> tuple[float, float]:
    """Both roots p of (wrong / trials - p)^2 = 1.96^2 p (1 - p) / trials."""
    share, square = wrong / trials, 1.96**2
    roots = np.roots([1 + square / trials, -(2 * share + square / trials), share**2])
    low, high = sorted(float(np.real(root)) for root in roots)
    return max(0.0, low), min(1.0, high)


@pytest.mark.whole
@quick
@given(rows=reviewed())
def test_quality_history_tells_every_review_and_every_batch_without_one(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answers, reviews = of(rows, Annotation), of(rows, QualityReview)
    answer = by_key(database.ask("quality_history"), "batch_id", "review_id")
    unreviewed = {row.batch_id for row in answers} - {row.batch_id for row in reviews}
    assert answer.keys() == {(row.batch_id, row.review_id) for row in reviews} | {(batch, None) for batch in unreviewed}
    held = Counter(row.batch_id for row in answers)
    for row in reviews:
        rounds = sorted((one for one in reviews if one.batch_id == row.batch_id), key=lambda one: (one.reviewed_at, one.review_id))
        low, high = wilson(row.wrong, row.sampled)
        found = answer[row.batch_id, row.review_id]
        same(
            found, answers=held.get(row.batch_id), handed_in_round=row.round, pass_low=row.pass_low, round=rounds.index(row) + 1,
            is_last=row is rounds[-1], sampled=row.sampled,
            wrong=row.wrong, verdict=row.verdict, note=row.note, wrong_share=row.wrong / row.sampled,
            sampled_share=row.sampled / held[row.batch_id] if row.batch_id in held else None,
        )  # fmt: skip
        assert math.isclose(found["wrong_low"], low, abs_tol=1e-9)
        assert math.isclose(found["wrong_high"], high, abs_tol=1e-9)
    for batch in unreviewed:
        same(answer[batch, None], answers=held[batch], round=None, verdict=None, is_last=None, wrong_share=None)
