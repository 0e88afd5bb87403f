"""Answers of a batch: to what was asked, in parts, corrected, taken back, one change after the other, and their figures."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.inputs.annotation import (
    save_answers,
    submit,
)
from schemas.annotation import Annotation, AnnotationFigures, Assignment
from schemas.errors import InputError, LakeError
from tests.annotated import ANNOTATORS, SCENES, annotatable, answer, created
from warehouse.lake import Lake


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return annotatable(tmp_path / "lake")


def test_what_was_not_assigned_is_refused_by_its_field(lake: Lake, tmp_path: Path) -> None:
    created(lake, tmp_path / "work", scenes=(SCENES[0],))
    asked = {row.instance_id: row.annotator for row in lake.snapshot().rows(Assignment)}
    (mine, ada), *_ = asked.items()
    other = next(name for name in ANNOTATORS if name != ada)
    sound = answer(SCENES[0], mine, ada, 1)
    wrong = {
        "annotator": answer(SCENES[0], mine, "eve", 1), "scene_id": answer(SCENES[1], mine, ada, 1),
        "instance_id": answer(SCENES[0], mine, other, 1),
    }  # fmt: skip
    for field, one in wrong.items():
        with pytest.raises(InputError) as caught:
            save_answers(lake, {"batch_id": "b1", "annotations": [sound, one]})
        assert (caught.value.field, "assigned" in str(caught.value)) == (f"annotations[1].{field}", True)
    assert lake.snapshot().rows(Annotation) == [], "nothing by half"
    assert save_answers(lake, {"batch_id": "b1", "annotations": [sound]})["new"] == 1


def test_answers_come_in_parts_are_corrected_and_taken_back(lake: Lake, tmp_path: Path) -> None:
    created(lake, tmp_path / "work")
    keys = [(row.scene_id, row.instance_id, row.annotator) for row in lake.snapshot().rows(Assignment)]
    first = {"batch_id": "b1", "annotations": [answer(*key, 1) for key in keys[:3]]}
    assert save_answers(lake, first)["new"] == 3
    with pytest.raises(InputError, match="5 of 8 assigned answers are missing"):
        submit(lake, "b1", by="ada")
    second = {"batch_id": "b1", "annotations": [answer(*keys[0], 2, at=1), answer(*keys[3], None, at=1), answer(*keys[1], 1)]}
    said = save_answers(lake, second)
    assert (said["new"], said["corrected"]) == (1, 1)
    assert save_answers(lake, first)["already"] is True, "an older file again changes nothing"
    with pytest.raises(InputError, match=r"annotations\[0\]\.answered_at: is not later"):
        save_answers(lake, {"batch_id": "b1", "annotations": [answer(*keys[0], 3, at=0.5)]})
    back = answer(*keys[1], None, at=2, withdrawn=True)
    assert save_answers(lake, {"batch_id": "b1", "annotations": [back]})["withdrawn"] == 1
    assert submit(lake, "b1", by="ada", partial=True)["answers"] == 3
    assert len(lake.snapshot().rows(Annotation)) == 6


def test_two_changes_of_a_batch_come_one_after_the_other(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flows.inputs.annotation.acts.WAIT_SECONDS", 0.2)
    asked = {"batch_id": "b0", "annotations": [answer(SCENES[0], "0001", "ada", 1)]}
    with lake.claims() as claims:
        assert claims.claim("b0")
        with pytest.raises(LakeError, match="another process has been changing it"):
            save_answers(lake, asked)
    assert save_answers(lake, asked)["new"] == 1


def test_who_holds_a_batch_no_more_changes_nothing(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after a process was stopped for longer than a claim lives, and another took the batch over."""
    asked = {"batch_id": "b0", "annotations": [answer(SCENES[0], "0001", "ada", 1)]}
    before = lake.snapshot().snapshot_id
    with monkeypatch.context() as patched:
        patched.setattr("warehouse.sharing.claims.Claims.held", lambda self: set())
        with pytest.raises(LakeError, match="nothing was saved, try again"):
            save_answers(lake, asked)
    assert lake.snapshot().snapshot_id == before
    assert save_answers(lake, asked)["new"] == 1


@pytest.mark.parametrize("error", [LakeError("the lease is held"), OSError("disk full"), KeyboardInterrupt()])
def test_what_was_refused_never_takes_effect_later(
    lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    created(lake, tmp_path / "work", overlap=1)
    mine = [(row.scene_id, row.instance_id) for row in lake.snapshot().rows(Assignment) if row.annotator == ANNOTATORS[0]]

    def refuse(*_: object, **__: object) -> None:
        raise error

    def answered(key: tuple[str, str]) -> object:
        return save_answers(lake, {"batch_id": "b1", "annotations": [answer(*key, ANNOTATORS[0], 1)]})["state"]

    assert answered(mine[0]) == "open"
    with monkeypatch.context() as patched:
        patched.setattr(Lake, "commit", refuse)
        with pytest.raises(type(error)):
            submit(lake, "b1", by=ANNOTATORS[0], partial=True)
    assert not lake.has_staged("b1")
    assert answered(mine[1]) == "open", "and the batch was not handed in"
    assert submit(lake, "b1", by=ANNOTATORS[0], partial=True)["answers"] == 2


def test_figures_say_how_an_answer_keeps_to_the_guidelines(lake: Lake) -> None:
    far = {"position": [-2.0, -2.0, 0.1], "yaw_degrees": 0, "scale": [1, 1, 1]}
    beyond = {"position": [-3.0, -1.6, 0.0], "yaw_degrees": 0, "scale": [2, 1, 1]}
    answers = [
        answer(SCENES[0], "0001", "ada", 2, transform=far),
        answer(SCENES[0], "0002", "ada", 1),
        answer(SCENES[0], "0003", "ada", None),
    ]
    answers += [answer(SCENES[1], "0001", "bob", 2, transform=beyond)]
    save_answers(lake, {"batch_id": "b0", "annotations": answers})
    rows = {(row.scene_id, row.instance_id): row for row in lake.snapshot().rows(AnnotationFigures)}
    assert rows.keys() == {(SCENES[0], "0001"), (SCENES[0], "0002"), (SCENES[1], "0001")}, "none of what chooses nothing"
    high, small, out = rows[SCENES[0], "0001"], rows[SCENES[0], "0002"], rows[SCENES[1], "0001"]
    assert high.is_category_match
    assert high.size_ratio == pytest.approx(1.0)
    assert small.size_ratio == pytest.approx((0.4 / 0.5) ** 3)
    assert out.size_ratio == pytest.approx(2.0)
    assert high.floating_m == pytest.approx(0.1, abs=1e-6)
    assert small.floating_m == pytest.approx(0.0, abs=1e-6)
    assert out.outside_share == pytest.approx(0.5, abs=1e-6)
    assert high.outside_share == 0.0
    assert (high.lookalikes, high.lookalikes_alike, small.lookalikes_alike) == (3, 2, 0)
    assert high.scan_distance_m is not None
    assert 0.005 < high.scan_distance_m < 0.1
    (work,) = [row for row in [*open_work_of(lake, "b0")] if row.instance_id == "0001" and row.annotator == "ada"]
    assert work.revision == 1


def test_figures_take_no_neighbor_for_what_the_same_import_takes_back(lake: Lake) -> None:
    """Look-alikes that stand as the same asset, after corrections to none that fits and a withdrawal in one file with the answer."""
    names = ("0001", "0002", "0003", "0004")
    save_answers(lake, {"batch_id": "b0", "annotations": [answer(SCENES[0], name, "ada", 3) for name in names]})
    later = [answer(SCENES[0], "0001", "ada", 3, at=1, seconds=5), answer(SCENES[0], "0002", "ada", None, at=1)]
    later.append(answer(SCENES[0], "0003", "ada", None, at=1, withdrawn=True))
    save_answers(lake, {"batch_id": "b0", "annotations": later})
    rows = {(row.instance_id, row.revision): row for row in lake.snapshot().rows(AnnotationFigures)}
    assert rows.keys() == {*((name, 1) for name in names), ("0001", 2)}
    assert (rows["0001", 1].lookalikes_alike, rows["0001", 2].lookalikes_alike) == (3, 1)


def open_work_of(lake: Lake, batch: str) -> list[AnnotationFigures]:
    return [row for row in lake.snapshot().rows(AnnotationFigures) if row.batch_id == batch]
