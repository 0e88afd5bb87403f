"""Batches by their pure parts: whom to ask about what, answers that come again, samples and what they say, verdicts, documents."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from datetime import timedelta
from fractions import Fraction
from itertools import combinations
from math import comb
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from schemas.annotation import Annotation, Assignment, WorkBatch
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Shell
from schemas.errors import InputError
from schemas.optimization import Certificate
from schemas.selection import Selection
from tasks.annotation.batch import read_answers
from tasks.annotation.picking import Task, assigned, doubts, picked
from tasks.annotation.quality import drawn, in_words, pass_interval
from tasks.annotation.revisions import key_of, latest, revised
from tasks.annotation.verdicts import VERDICTS_SCHEMA_FILE, load_review_file, read_verdicts
from tasks.annotation.work import WORK_SCHEMA_FILE, work_document
from tasks.geometry.transforms import flat, yaw_pose
from tests.annotated import chance_of_return
from tests.samples import START, sample

PLACE = {"scene_id": "demo/a"}


def tasks(count: int) -> list[Task]:
    return [Task("demo/a", f"{number:04d}", 0.5, (), None) for number in range(count)]


@given(count=st.integers(1, 60), people=st.integers(1, 9), data=st.data())
def test_every_object_goes_to_as_many_annotators_and_nobody_gets_more_than_one_extra(count: int, people: int, data: st.DataObject) -> None:
    overlap = data.draw(st.integers(1, people))
    seed = data.draw(st.integers(0, 10**6))
    names = [f"annotator {number}" for number in range(people)]
    rows = assigned(tasks(count), names, overlap, np.random.default_rng(seed))
    by_task = Counter(task.instance_id for task, _, _ in rows)
    assert set(by_task.values()) == {overlap}
    assert len({(task.instance_id, name) for task, name, _ in rows}) == len(rows)
    loads = Counter(dict.fromkeys(names, 0))
    loads.update(name for _, name, _ in rows)
    assert max(loads.values()) - min(loads.values()) <= 1
    for name in names:
        assert [place for _, who, place in rows if who == name] == list(range(1, loads[name] + 1))
    assert rows == assigned(tasks(count), names[::-1], overlap, np.random.default_rng(seed)), "whatever the order of the names"


def test_any_two_annotators_share_objects() -> None:
    rows = assigned(tasks(100), ["a", "b", "c", "d"], 2, np.random.default_rng(0))
    by_task: dict[str, set[str]] = {}
    for task, name, _ in rows:
        by_task.setdefault(task.instance_id, set()).add(name)
    shared = Counter(pair for names in by_task.values() for pair in combinations(sorted(names), 2))
    assert len(shared) == 6
    assert min(shared.values()) >= 8, "of 100 / 6 each on average"


@pytest.mark.parametrize(("names", "overlap", "why"), [(["a", "A "], 1, "twice"), (["a"], 2, "there are 1"), ([], 1, "there are 0")])
def test_an_assignment_that_cannot_be_is_refused(names: list[str], overlap: int, why: str) -> None:
    with pytest.raises(InputError, match=why):
        assigned(tasks(3), names, overlap, np.random.default_rng(0))


def test_the_most_doubtful_comes_first() -> None:
    names = ("0001", "0002", "0003", "0004", "0005", "0009")
    instances = [sample(Instance, **PLACE, instance_id=name, is_structure=name == "0009") for name in names]
    scores = {"0001": 0.9, "0002": 0.3, "0003": 0.9, "0004": 0.9, "0009": 0.1}
    selections = [sample(Selection, **PLACE, instance_id=name, rank=1, score=score) for name, score in scores.items()]
    selections += [sample(Selection, **PLACE, instance_id=name, rank=2, score=0.0) for name in scores]
    answers = [
        sample(Annotation, **PLACE, instance_id=name, annotator=who, choice=choice * 64)
        for name, who, choice in [
            ("0001", "ada", "a"),
            ("0001", "bob", "a"),
            ("0002", "ada", "a"),
            ("0003", "ada", "a"),
            ("0003", "bob", "b"),
        ]
    ]
    certificates = [sample(Certificate, **PLACE, instance_id=name, is_stable_5cm=name != "0003") for name in names]
    found = doubts(instances, selections, answers, certificates)
    assert [task.instance_id for task in found] == ["0003", "0002", "0004", "0001"], "0005 has no candidates, 0009 is a wall"
    by_name = {task.instance_id: task for task in found}
    assert by_name["0003"].reasons == ("2 annotators chose 2 ways", "unstable")
    assert by_name["0002"].reasons == ("low score 0.30",)
    assert by_name["0004"].reasons == ("never answered",)
    assert by_name["0001"].doubt == pytest.approx(0.1)
    assert by_name["0003"].doubt == pytest.approx(1 - 0.9 * 0.5 * 0.5)
    answered = {("demo/a", name) for name in ("0001", "0002", "0003")}
    assert [task.instance_id for task in picked(found, "new", answered, None)] == ["0004"]
    assert [task.instance_id for task in picked(found, "all", answered, 3)] == ["0001", "0002", "0003"]
    assert [task.instance_id for task in picked(found, "doubtful", answered, 2)] == ["0003", "0002"]
    with pytest.raises(InputError, match="no object is left"):
        picked(found, "new", {("demo/a", task.instance_id) for task in found}, None)


# --- answers that come again ---


def given_answer(day: float, **values: Any) -> Annotation:
    usual = {"annotator": "ada", "instance_id": "0001", "choice": "a" * 64, "answered_at": START + timedelta(days=day)}
    row: Annotation = sample(Annotation, **PLACE, **usual | values)
    return row


def places(*rows: Annotation) -> dict[tuple[str, str, str], tuple[str, str]]:
    return {key_of(row): ("b.json", f"annotations[{index}]") for index, row in enumerate(rows)}


def test_a_later_answer_corrects_an_earlier_one_and_the_same_one_is_known() -> None:
    first, second, third = given_answer(1), given_answer(2, choice="b" * 64), given_answer(3, choice=None, is_withdrawn=True)
    kept: list[Annotation] = []
    for row, revision in ((first, 1), (second, 2), (third, 3), (given_answer(4), 4)):
        new = revised(kept, [row], places(row))
        assert [one.revision for one in new] == [revision]
        kept += new
        before = latest(kept)
        assert before == ({} if row.is_withdrawn else {key_of(row): new[0]})
        for known in kept:  # files are imported again, in any order, from anywhere
            again = dataclasses.replace(known, revision=1, source_file="copy.json", box_size=(9.0, 9.0, 9.0))
            assert revised(kept, [again], places(again)) == []
    assert len(kept) == 4, "history"


@given(
    acts=st.lists(st.tuples(st.sampled_from(["CVAT", "metascenes"]), st.sampled_from(["a" * 64, "b" * 64, None])), min_size=1, max_size=8)
)
def test_an_undated_answer_is_new_only_where_its_tool_says_something_else(acts: list[tuple[str, str | None]]) -> None:
    """Whatever was corrected elsewhere meanwhile."""
    kept: list[Annotation] = []
    last: dict[str, str | None] = {}
    for day, (tool, choice) in enumerate(acts):
        row = given_answer(day, choice=choice, tool=tool)
        new = revised(kept, [row], places(row), is_dated=tool != "CVAT")
        assert bool(new) == (tool != "CVAT" or tool not in last or last[tool] != choice)
        last[tool] = choice
        kept += new


def test_what_cannot_be_told_to_be_later_is_refused() -> None:
    first = given_answer(1)
    for late in (given_answer(1, choice=None), given_answer(0.5, choice=None)):
        with pytest.raises(InputError, match=r"^b\.json: annotations\[0\]\.answered_at: is not later"):
            revised([first], [late], places(late))
    early = given_answer(1, choice=None, is_withdrawn=True)
    with pytest.raises(InputError, match=r"annotations\[0\]\.withdrawn: ada has not answered"):
        revised([], [early], places(early))


def document(**values: Any) -> dict[str, Any]:
    usual = {"scene_id": "demo/a", "instance_id": "0001", "annotator": "ada", "answered_at": "2026-03-01T14:05:00Z"}
    return {"batch_id": "b", "tool": "page", "annotations": [{key: v for key, v in (usual | values).items() if v is not ...}]}


def test_withdrawals_tools_and_programs_are_read() -> None:
    (row,) = read_answers(document(withdrawn=True, simulated=True), "x").annotations
    assert (row.is_withdrawn, row.choice, row.tool, row.is_simulated) == (True, None, "page", True)
    (row,) = read_answers(document(choice=3, tool="blender"), "x").annotations
    assert (row.is_withdrawn, row.choice, row.tool, row.is_simulated) == (False, 3, "blender", False)


@pytest.mark.parametrize(
    ("values", "field", "why"),
    [
        ({}, "annotations[0]", "lacks 'choice'"),
        ({"withdrawn": False}, "annotations[0]", "lacks 'choice'"),
        ({"withdrawn": True, "choice": 1}, "annotations[0].withdrawn", "there is an answer"),
        ({"withdrawn": True, "ranking": [1]}, "annotations[0].withdrawn", "there is an answer"),
        ({"withdrawn": "yes", "choice": 1}, "annotations[0].withdrawn", "must be"),
        ({"choice": 1, "tool": "a\nb"}, "annotations[0].tool", "not allowed"),
        ({"choice": 1, "simulated": 1}, "annotations[0].simulated", "must be"),
    ],
)
def test_what_contradicts_itself_is_refused(values: dict[str, Any], field: str, why: str) -> None:
    with pytest.raises(InputError) as caught:
        read_answers(document(**values), "x")
    assert caught.value.field == field
    assert why in str(caught.value)


# --- samples ---


def test_every_choice_of_a_sample_is_equally_likely() -> None:
    counts = Counter(tuple(sorted(drawn(range(5), 2, np.random.default_rng(seed)))) for seed in range(4000))
    assert len(counts) == 10
    assert all(abs(count - 400) < 5 * np.sqrt(400) for count in counts.values())
    assert drawn([], 0, np.random.default_rng(0)) == []


def tail(passed: int, right: int, sampled: int, answers: int, at_most: bool) -> Fraction:
    """Chance that at most, or at least, so many of a sample are right, by counting."""
    possible = range(passed + 1) if at_most else range(passed, sampled + 1)
    return Fraction(sum(comb(right, k) * comb(answers - right, sampled - k) for k in possible), comb(answers, sampled))


@given(answers=st.integers(1, 60), data=st.data())
def test_the_interval_is_what_both_tails_leave(answers: int, data: st.DataObject) -> None:
    sampled = data.draw(st.integers(1, answers))
    passed = data.draw(st.integers(0, sampled))
    low, high = pass_interval(passed, sampled, answers)
    left = [
        right
        for right in range(passed, answers - (sampled - passed) + 1)
        if min(tail(passed, right, sampled, answers, True), tail(passed, right, sampled, answers, False)) >= Fraction(25, 1000)
    ]
    assert (low, high) == (left[0] / answers, left[-1] / answers)
    assert low <= passed / sampled <= high or sampled < answers
    if sampled == answers:
        assert low == high == passed / answers


@given(answers=st.integers(2, 60), data=st.data())
def test_the_chance_of_a_return_is_that_of_the_draw(answers: int, data: st.DataObject) -> None:
    sampled = data.draw(st.integers(1, answers))
    wrong = data.draw(st.integers(0, answers))
    share = data.draw(st.sampled_from([0.5, 0.9, 0.98]))
    kept = sum(
        Fraction(comb(wrong, failed) * comb(answers - wrong, sampled - failed), comb(answers, sampled))
        for failed in range(min(wrong, sampled) + 1)
        if sampled - failed - share * sampled > 1e-9
    )
    assert chance_of_return(wrong, sampled, answers, share) == pytest.approx(float(1 - kept), abs=1e-9)


def test_a_small_sample_says_that_it_is_too_small() -> None:
    assert in_words(60, 600, 0.1, 50, 0.98) == "60 of 600 answers are reviewed (10%)"
    assert in_words(50, 120, 0.1, 50, 0.98) == "10% of 120 answers are 12, and under 50 answers cannot tell 98%: 50 are reviewed"
    assert in_words(30, 30, 0.1, 50, 0.98).endswith("all of them are reviewed")
    low, high = pass_interval(12, 12, 120)
    assert low < 0.98 < high, "all of twelve pass, and yet fewer than 98 % may be right"


# --- verdicts ---


def verdicts(*given_verdicts: dict[str, Any], **values: Any) -> dict[str, Any]:
    usual = {"scene_id": "demo/a", "instance_id": "0001", "annotator": "ada", "passes": True, "reviewed_at": "2026-03-02T00:00:00Z"}
    rows = [{key: v for key, v in (usual | one).items() if v is not ...} for one in given_verdicts]
    return {"batch_id": "b", "reviewer": " rita ", "verdicts": rows} | values


def test_verdicts_are_read(tmp_path: Path) -> None:
    given_file = tmp_path / "v.json"
    given_file.write_text(json.dumps(verdicts({}, {"instance_id": "0002", "passes": False, "remark": " too low "})))
    batch = read_verdicts(load_review_file(given_file), "v.json")
    assert (batch.batch_id, batch.reviewer, batch.is_simulated) == ("b", "rita", False)
    assert [(row.key, row.passes, row.remark) for row in batch.verdicts] == [
        (("demo/a", "0001", "ada"), True, None), (("demo/a", "0002", "ada"), False, "too low")
    ]  # fmt: skip
    jsonschema.Draft202012Validator.check_schema(json.loads(VERDICTS_SCHEMA_FILE.read_text()))
    with pytest.raises(InputError, match="is no file"):
        load_review_file(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"passes": None}, "verdicts[1].passes"),
        ({"passes": False}, "verdicts[1].remark"),
        ({"passes": False, "remark": " "}, "verdicts[1].remark"),
        ({"instance_id": "0001"}, "verdicts[1]"),
        ({"reviewed_at": ""}, "verdicts[1].reviewed_at"),
        ({"annotator": " "}, "verdicts[1].annotator"),
        ({"remark": 1}, "verdicts[1].remark"),
        ({"annotator": ...}, "verdicts[1]"),
        ({"more": 1}, "verdicts[1]"),
    ],
)
def test_a_wrong_verdict_is_refused_with_its_place(wrong: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        read_verdicts(verdicts({}, {"instance_id": "0002"} | wrong), "v.json")
    assert (caught.value.file, caught.value.field) == ("v.json", field)


# --- the document of a batch ---


@given(st.integers(1, 3), st.integers(1, 3))
def test_the_document_says_what_is_asked_of_whom(count: int, people: int) -> None:
    names = [f"{number:04d}" for number in range(1, count + 1)]
    assume(people >= 1)
    instances = [
        sample(Instance, **PLACE, instance_id=name, is_structure=False, box_pose=flat(yaw_pose(0.5, [1, 2, 0.4])), box_size=(1.0, 2.0, 3.0))
        for name in names
    ]
    candidates = [
        sample(Candidate, **PLACE, instance_id=name, slot=slot, asset_id="a" * 64, outcome="filled") for name in names for slot in (1, 2)
    ]
    candidates += [sample(Candidate, **PLACE, instance_id=name, slot=3, asset_id=None, outcome="empty") for name in names]
    selections = [
        sample(Selection, **PLACE, instance_id=name, rank=1, slot=2, asset_id="a" * 64, pose=flat(yaw_pose(0.1))) for name in names
    ]
    assignments = [
        sample(Assignment, batch_id="b", **PLACE, instance_id=name, annotator=f"Jo/{number}", place=place, doubt=0.5)
        for number in range(people)
        for place, name in enumerate(names, 1)
    ]
    batch = sample(WorkBatch, batch_id="b", origin="created", pick="all", overlap=people)
    made = work_document(
        batch, assignments, instances, [], candidates, selections, [sample(Shell, **PLACE)], [sample(Asset, asset_id="a" * 64)]
    )
    jsonschema.Draft202012Validator(json.loads(WORK_SCHEMA_FILE.read_text())).validate(json.loads(json.dumps(made)))
    assert [one["instance_id"] for one in made["objects"]] == names
    assert [one["annotator"] for one in made["annotators"]] == [f"Jo/{number}" for number in range(people)]
    assert all([one["instance_id"] for one in of["objects"]] == names for of in made["annotators"])
    assert len({of["answers"] for of in made["annotators"]}) == people
    first = made["objects"][0]
    assert first["box"]["yaw_degrees"] == pytest.approx(np.degrees(0.5))
    assert first["box"]["center"] == pytest.approx([1, 2, 0.4])
    assert [(one["slot"], one["rank"]) for one in first["candidates"]] == [(1, None), (2, 1)]
