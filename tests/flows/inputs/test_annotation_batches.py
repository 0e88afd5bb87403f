"""An annotation batch from its creation to the scenes: folder, answers, corrections, sample, verdicts, and what reaches a layout."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.inputs.annotation import (
    BatchPlan,
    batch_list,
    conclude,
    create_batch,
    draw_sample,
    import_annotations,
    open_reviews,
    open_work,
    save_answers,
    save_verdicts,
    submit,
)
from flows.run.configuration import configure
from flows.run.plan import annotation_digests
from schemas.annotation import Annotation, AnnotationFigures, AnswerVerdict, Assignment, QualityReview, SampledAnswer, WorkBatch
from schemas.capture import Instance
from schemas.errors import InputError, LakeError
from schemas.record import arrow_to_rows
from schemas.selection import Selection
from tasks.annotation.work import WORK_SCHEMA_FILE
from tasks.optimization.proposals import propose
from tests.annotated import SCENES, annotatable, answer, fill, judged
from warehouse.lake import Lake
from warehouse.tables.reviews import standing_answers

NAMES = ("ada", "bob", "cleo")


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return annotatable(tmp_path / "lake")


def created(lake: Lake, out: Path, batch: str = "b1", overlap: int = 1, **plan: Any) -> dict[str, Any]:
    return create_batch(lake, BatchPlan(batch, NAMES, overlap, **plan), out)


def chosen(lake: Lake, scene: str = SCENES[0]) -> dict[str, str]:
    """Who decides what the optimization proposes for each object."""
    reader = lake.snapshot()
    answers = arrow_to_rows(standing_answers(reader, scene), Annotation)
    selections = reader.rows(Selection, scene)
    proposals, _ = propose(reader.rows(Instance, scene), selections, answers, {row.asset_id for row in selections})
    return {row.instance.instance_id: row.origin for row in proposals}


def state(lake: Lake, batch: str = "b1") -> str:
    (row,) = batch_list(lake, batch)
    return str(row["state"])


def tree(folder: Path) -> dict[str, str]:
    """Hash of every file below a folder."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_folder_holds_all_that_it_takes_to_answer(lake: Lake, tmp_path: Path) -> None:
    said = created(lake, tmp_path / "work", overlap=2)
    assert (said["objects"], said["scenes"], sum(said["assignments"].values())) == (8, 2, 16)
    work = json.loads((tmp_path / "work/work.json").read_text())
    jsonschema.Draft202012Validator(json.loads(WORK_SCHEMA_FILE.read_text())).validate(work)
    named = {name for one in work["objects"] for name in (one["points"], one["mesh"], one["view"]) if name}
    named |= {one[name] for asked in work["objects"] for one in asked["candidates"] for name in ("glb", "thumbnail")}
    named |= {one["answers"] for one in work["annotators"]}
    named |= {f"{tool}/{place:03d}.{ending}" for tool, ending in (("label-studio", "json"), ("cvat", "txt")) for place in (1, 2, 3)}
    named |= {"label-studio/config.xml", "cvat/labels.json"}
    named |= {f"sheets/b1~{one['scene_id'].replace('/', '~')}~{one['instance_id']}.jpg" for one in work["objects"]}
    assert named | {"work.json", "answers.json", "batch.schema.json", "work.schema.json"} == set(tree(tmp_path / "work"))
    assert [path for path in tmp_path.iterdir() if path.name.endswith(".making")] == []
    for one in work["objects"]:
        assert [candidate["slot"] for candidate in one["candidates"]] == [1, 2, 3]
    asset = work["objects"][0]["candidates"][0]
    assert hashlib.sha256((tmp_path / "work" / asset["glb"]).read_bytes()).hexdigest() == asset["asset_id"]
    assert (tmp_path / "work" / asset["thumbnail"]).read_bytes()[:2] == b"\xff\xd8"
    rows = lake.snapshot().rows(Assignment)
    assert {(row.scene_id, row.instance_id, row.annotator) for row in rows} == {
        (asked["scene_id"], asked["instance_id"], one["annotator"]) for one in work["annotators"] for asked in one["objects"]
    }
    again = create_batch(lake, BatchPlan("b1", ()), tmp_path / "again", again=True)
    assert again["assignments"] == said["assignments"]
    assert tree(tmp_path / "again") == tree(tmp_path / "work"), "the same bytes"


def test_a_batch_is_made_whole_or_not_at_all(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="is there already"):
        created(lake, tmp_path)
    dry = create_batch(lake, BatchPlan("b1", NAMES), tmp_path / "work", dry_run=True)
    assert dry["objects"] == 8
    blob = lake.snapshot().rows(Instance)[0].points_blob
    path = lake.blobs.path(blob)
    kept = path.read_bytes()
    path.unlink()
    with pytest.raises(Exception, match=blob[:12]):
        created(lake, tmp_path / "work")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["lake"]
    assert lake.snapshot().rows(Assignment) == []
    path.write_bytes(kept)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", full)
        with pytest.raises(InputError, match="cannot be written"):
            created(lake, tmp_path / "work")
    assert not (tmp_path / "work").exists()
    with pytest.raises(InputError, match="in the lake already"):
        created(lake, tmp_path / "work")
    create_batch(lake, BatchPlan("b1", ()), tmp_path / "work", again=True)
    assert (tmp_path / "work/work.json").is_file()


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        (BatchPlan("a/b", NAMES), "is no name of a batch"),
        (BatchPlan("b", ("ada", "ADA")), "twice"),
        (BatchPlan("b", (" ada",)), "is no name"),
        (BatchPlan("b", ()), "there are 0 annotators"),
        (BatchPlan("b", NAMES, 4), "there are 3 annotators"),
        (BatchPlan("b", NAMES, scenes=("demo/none",)), "is not in the lake"),
    ],
)
def test_what_cannot_be_asked_is_refused(lake: Lake, tmp_path: Path, plan: BatchPlan, why: str) -> None:
    before = lake.snapshot().snapshot_id
    with pytest.raises(InputError, match=why):
        create_batch(lake, plan, tmp_path / "work")
    assert (lake.snapshot().snapshot_id, (tmp_path / "work").exists()) == (before, False)


def test_a_batch_goes_from_its_folder_to_the_scenes(lake: Lake, tmp_path: Path) -> None:
    created(lake, tmp_path / "work")
    right = fill(tmp_path / "work", np.random.default_rng(0))
    assert set(chosen(lake).values()) == {"selection"}
    said = import_annotations(lake, tmp_path / "work/answers.json")
    assert (said["new"], said["already"], said["state"], said["counts"]) == (8, False, "open", False)
    assert import_annotations(lake, tmp_path / "work/answers.json")["already"] is True
    rows = lake.snapshot().rows(Annotation)
    assert {(row.tool, row.is_simulated, row.seconds) for row in rows} == {("simulated crowd", True, 12.5)}
    assert len({row.ranking for row in rows}) == 1
    assert submit(lake, "b1", by="ada")["answers"] == 8
    with pytest.raises(InputError, match="b1 is submitted: one cannot answer now"):
        save_answers(lake, {"batch_id": "b1", "annotations": [answer(*next(iter(right)), 1, at=5)]})
    drawn = draw_sample(lake, "b1")
    assert (drawn["sampled"], "cannot tell 98%: all of them" in drawn["why"]) == (8, True)
    with pytest.raises(InputError, match="is in review: one cannot sample now"):
        draw_sample(lake, "b1")
    with pytest.raises(InputError, match="8 of 8 sampled answers are not judged yet"):
        conclude(lake, "b1")
    assert set(chosen(lake).values()) == {"selection"}, "nobody has judged it"
    half = judged(open_reviews(lake, "b1", "rita"), right, "b1")
    half["verdicts"] = half["verdicts"][:5]
    assert save_verdicts(lake, half)["judged"] == 5
    assert save_verdicts(lake, half)["new"] == 0, "the same verdicts again"
    with pytest.raises(InputError, match="3 of 8 sampled answers are not judged yet"):
        conclude(lake, "b1")
    save_verdicts(lake, judged(open_reviews(lake, "b1", "rita"), right, "b1"))
    done = conclude(lake, "b1")
    assert (done["verdict"], done["pass_low"], done["pass_high"], done["counts"]) == ("accepted", 1.0, 1.0, True)
    for scene in SCENES:
        assert set(chosen(lake, scene).values()) == {"annotation"}
    assert annotation_digests(lake).keys() == set(SCENES)
    with pytest.raises(InputError, match="one cannot answer now"):
        save_answers(lake, {"batch_id": "b1", "annotations": [answer(*next(iter(right)), 1, at=5)]})
    review = lake.snapshot().rows(QualityReview)[0]
    assert (review.review_id, review.sampled, review.wrong, review.answers, review.is_simulated) == ("round-1", 8, 0, 8, True)


def test_a_batch_goes_back_whole_with_its_remarks_and_comes_again(lake: Lake, tmp_path: Path) -> None:
    created(lake, tmp_path / "work")
    right = fill(tmp_path / "work", np.random.default_rng(0), errs=("bob",), share=0.5)
    wrong = [key for key, is_right in right.items() if not is_right]
    import_annotations(lake, tmp_path / "work/answers.json")
    submit(lake, "b1", by="ada")
    draw_sample(lake, "b1")
    save_verdicts(lake, judged(open_reviews(lake, "b1", "rita"), right, "b1"))
    done = conclude(lake, "b1")
    assert (done["verdict"], done["state"], done["counts"]) == ("returned", "returned", False)
    assert annotation_digests(lake) == {}, "not even ada's right answers"
    work = open_work(lake, "b1", "bob")
    assert {(row["scene_id"], row["instance_id"], "bob") for row in work if row["remarks"] == ["round 1, rita: too large"]} == set(wrong)
    assert all(row["is_open"] and row["is_answered"] for row in work)
    with pytest.raises(InputError, match="cannot sample now"):
        draw_sample(lake, "b1")
    for number, key in enumerate(wrong):
        save_answers(lake, {"batch_id": "b1", "annotations": [answer(*key, 2, at=10 + number)]})
    assert (state(lake), annotation_digests(lake)) == ("returned", {}), "corrected, not reviewed"
    assert submit(lake, "b1", by="bob")["round"] == 2
    assert (state(lake), annotation_digests(lake)) == ("submitted", {})
    draw_sample(lake, "b1")
    save_verdicts(lake, judged(open_reviews(lake, "b1", "rita"), dict.fromkeys(right, True), "b1"))
    assert conclude(lake, "b1")["verdict"] == "accepted"
    standing = arrow_to_rows(standing_answers(lake.snapshot()), Annotation)
    assert {(row.scene_id, row.instance_id, row.annotator): row.revision for row in standing} == {key: 1 + (key in wrong) for key in right}
    assert len(lake.snapshot().rows(Annotation)) == 8 + len(wrong), "history"


def test_nobody_judges_their_own_answers(lake: Lake, tmp_path: Path) -> None:
    created(lake, tmp_path / "work")
    right = fill(tmp_path / "work", np.random.default_rng(0))
    import_annotations(lake, tmp_path / "work/answers.json")
    submit(lake, "b1", by="ada")
    draw_sample(lake, "b1")
    own = judged([row for row in open_reviews(lake, "b1", "rita") if row["annotator"] == "ada"], right, "b1", reviewer="Ada")
    with pytest.raises(InputError, match=r"verdicts\[0\]\.annotator: is Ada's own answer"):
        save_verdicts(lake, own)
    assert lake.snapshot().rows(AnswerVerdict) == []
    assert {row["annotator"] for row in open_reviews(lake, "b1", " ADA")} == {"bob", "cleo"}
    stranger = judged(open_reviews(lake, "b1", "rita")[:1], right, "b1")
    stranger["verdicts"][0]["instance_id"] = "0077"
    with pytest.raises(InputError, match=r"verdicts\[0\]\.instance_id: .* is not in the sample"):
        save_verdicts(lake, stranger)


def test_a_seed_draws_the_same_sample_and_a_tenth_of_a_large_batch(tmp_path: Path) -> None:
    drawn = []
    for seed in (0, 0, 1):
        folder = tmp_path / str(len(drawn))
        lake = annotatable(folder / "lake", objects=30)
        told = configure(seed=seed, settings=["annotation.least_sample=5"])
        create_batch(lake, BatchPlan("b1", NAMES, 3), folder / "work", configuration=told)
        fill(folder / "work", np.random.default_rng(0))
        import_annotations(lake, folder / "work/answers.json")
        submit(lake, "b1", by="ada")
        assert draw_sample(lake, "b1")["why"] == "18 of 180 answers are reviewed (10%)"
        rows = lake.snapshot().rows(SampledAnswer)
        drawn.append({(row.scene_id, row.instance_id, row.annotator, row.place) for row in rows})
    assert drawn[0] == drawn[1] != drawn[2]


def test_what_was_not_assigned_is_refused_by_its_field(lake: Lake, tmp_path: Path) -> None:
    created(lake, tmp_path / "work", scenes=(SCENES[0],))
    asked = {row.instance_id: row.annotator for row in lake.snapshot().rows(Assignment)}
    (mine, ada), *_ = asked.items()
    other = next(name for name in NAMES if name != ada)
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


def test_doubtful_ones_come_first_and_new_ones_are_new(lake: Lake, tmp_path: Path) -> None:
    trusted = configure(settings=["annotation.unreviewed_imports_count=true"])
    one = {"batch_id": "b0", "annotations": [answer(SCENES[0], "0001", "ada", 1), answer(SCENES[0], "0001", "bob", 2)]}
    one["annotations"] += [answer(SCENES[0], "0002", "ada", 1)]
    save_answers(lake, one, configuration=trusted)
    created(lake, tmp_path / "doubtful", "doubtful", pick="doubtful", count=1)
    (row,) = [row for row in lake.snapshot().rows(Assignment) if row.batch_id == "doubtful"]
    assert (row.scene_id, row.instance_id, row.reasons) == (SCENES[0], "0001", ("2 annotators chose 2 ways",))
    created(lake, tmp_path / "new", "new", pick="new", scenes=(SCENES[0],))
    asked = {row.instance_id for row in lake.snapshot().rows(Assignment) if row.batch_id == "new"}
    assert asked == {"0003", "0004"}


def test_a_batch_of_others_counts_once_it_is_accepted_or_trusted(lake: Lake, tmp_path: Path) -> None:
    asked = {"batch_id": "b0", "annotations": [answer(SCENES[0], "0001", "ada", 1)]}
    said = save_answers(lake, asked)
    assert (said["state"], said["counts"], annotation_digests(lake)) == ("submitted", False, {})
    trusted = configure(settings=["annotation.unreviewed_imports_count=true"])
    said = save_answers(lake, asked, configuration=trusted)
    assert (said["new"], said["counts"], set(annotation_digests(lake))) == (0, True, {SCENES[0]})
    assert save_answers(lake, asked)["counts"] is False, "trust is taken back"
    more = {"batch_id": "b0", "annotations": [answer(SCENES[0], "0002", "ada", 1)]}
    assert save_answers(lake, more)["new"] == 1
    draw_sample(lake, "b0")
    with pytest.raises(InputError, match="is in review: one cannot answer now"):
        save_answers(lake, {"batch_id": "b0", "annotations": [answer(SCENES[0], "0003", "ada", 1)]})
    right = {(SCENES[0], name, "ada"): True for name in ("0001", "0002")}
    save_verdicts(lake, judged(open_reviews(lake, "b0", "rita"), right, "b0"))
    assert conclude(lake, "b0")["counts"] is True
    assert [row["instance_id"] for row in standing_answers(lake.snapshot()).to_pylist()] == ["0001", "0002"]


@pytest.mark.parametrize("more", [False, True])
def test_what_a_review_demands_of_a_batch_stays_as_it_came_in(lake: Lake, more: bool) -> None:
    """The file again, with another trust and laxer demands, in the middle of a review or with further answers: only the trust changes."""
    asked = {"batch_id": "b0", "annotations": [answer(SCENES[0], name, "ada", 1) for name in ("0001", "0002", "0003")]}
    save_answers(lake, asked)
    (before,) = lake.snapshot().rows(WorkBatch)
    if more:
        asked["annotations"].append(answer(SCENES[0], "0004", "ada", 1))
    else:
        draw_sample(lake, "b0")
    lax = ["pass_share=0.1", "sample_share=0.0", "least_sample=1", "unreviewed_imports_count=true"]
    assert save_answers(lake, asked, configuration=configure(seed=7, settings=[f"annotation.{name}" for name in lax]))["counts"]
    assert lake.snapshot().rows(WorkBatch) == [dataclasses.replace(before, counts_unreviewed=True)]
    if not more:
        right = {(SCENES[0], name, "ada"): name == "0001" for name in ("0001", "0002", "0003")}
        save_verdicts(lake, judged(open_reviews(lake, "b0", "rita"), right, "b0"))
        assert conclude(lake, "b0")["verdict"] == "returned"


def test_a_review_from_elsewhere_does_not_pass_for_a_sample(lake: Lake, tmp_path: Path) -> None:
    created(lake, tmp_path / "work")
    fill(tmp_path / "work", np.random.default_rng(0))
    import_annotations(lake, tmp_path / "work/answers.json")
    submit(lake, "b1", by="ada")
    review = {"review_id": "r1", "reviewer": "eve", "reviewed_at": "2026-05-01T00:00:00Z", "sampled": 8, "wrong": 0, "verdict": "accepted"}
    file = tmp_path / "r.json"
    file.write_text(json.dumps({"batch_id": "b1", "reviews": [review]}))
    refused = CliRunner().invoke(cli, ["annotate", "review", str(file), "--lake", lake.address])
    assert isinstance(refused.exception, InputError)
    assert refused.exception.field == "reviews[0].verdict"
    assert (state(lake), lake.snapshot().rows(QualityReview)) == ("submitted", [])


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


def test_the_commands_lead_through_a_batch(lake: Lake, tmp_path: Path) -> None:
    def told(*words: object, code: int = 0) -> str:
        done = CliRunner().invoke(cli, ["annotate", *(str(word) for word in words), "--lake", lake.address])
        assert done.exit_code == code, (done.output, done.exception)
        return done.output

    work = tmp_path / "work"
    assert "8 objects of 2 scenes" in told("create", "--batch", "b1", "--annotator", "ada", "--annotator", "bob", "--out", work)
    right = fill(work, np.random.default_rng(0))
    assert "next: annotators answer, then `metascenes annotate submit`" in told("import", work / "answers.json")
    assert "8 answers handed in, round 1" in told("submit", "b1", "--by", "ada")
    assert "all of them are reviewed" in told("sample", "b1", "--reviewer", "rita", "--out", tmp_path / "form.json")
    assert "8 answers are being reviewed" in told("sample", "b1")
    form = json.loads((tmp_path / "form.json").read_text())
    assert len(form["verdicts"]) == len(right)
    for one in form["verdicts"]:
        one |= {"passes": True, "reviewed_at": "2026-04-01T00:00:00Z"}
    (tmp_path / "form.json").write_text(json.dumps(form))
    filled = (tmp_path / "form.json").read_bytes()
    refused = CliRunner().invoke(
        cli, ["annotate", "sample", "b1", "--reviewer", "rita", "--out", str(tmp_path / "form.json"), "--lake", lake.address]
    )
    assert isinstance(refused.exception, InputError)
    assert (refused.exception.field, (tmp_path / "form.json").read_bytes()) == ("--out", filled), "what was filled in stays"
    some = json.loads(filled) | {"verdicts": form["verdicts"][:3]}
    (tmp_path / "some.json").write_text(json.dumps(some))
    assert "3 of 8 answers judged" in told("review", tmp_path / "some.json")
    for reviewer, count in (("rita", 3), ("sam", 0)):
        told("sample", "b1", "--reviewer", reviewer, "--out", tmp_path / f"{reviewer}.json")
        again = json.loads((tmp_path / f"{reviewer}.json").read_text())["verdicts"]
        assert sum(row["passes"] is True and row["reviewed_at"].startswith("2026-04-01") for row in again) == count
        assert sum(row["passes"] is None for row in again) == 8 - count
    assert "8 of 8 reviewed answers pass; of all 8 between 100.0% and 100.0% do: accepted" in told("review", tmp_path / "form.json")
    assert "b1  accepted, round 1  ada 4 of 4, bob 4 of 4" in told("list")
    (row,) = json.loads(told("list", "b1", "--json"))["batches"]
    assert (row["state"], row["counts"], row["judged"]) == ("accepted", True, 8)


def test_alignments_of_scan2cad_are_a_batch_of_others(lake: Lake, tmp_path: Path) -> None:
    """The cube of half a metre, aligned to the first object: +Y up in its own frame, its middle at the origin."""
    upright = {"translation": [-2.0, -2.0, 0.25], "rotation": [0.5**0.5, 0.5**0.5, 0.0, 0.0], "scale": [1, 1, 1]}
    model = {"catid_cad": "box", "id_cad": "cube 0.5", "trs": upright, "center": [0, 0, 0], "bbox": [0.25, 0.25, 0.25]}
    identity = {"translation": [0, 0, 0], "rotation": [1, 0, 0, 0], "scale": [1, 1, 1]}
    models = [model, model | {"id_cad": "no such"}]
    file = tmp_path / "full_annotations.json"
    file.write_text(json.dumps([{"id_scan": "room_a", "trs": identity, "aligned_models": models}]))
    words = ["annotate", "import", str(file), "--format", "scan2cad", "--batch", "s2c", "--lake", lake.address]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    assert "batch s2c: 1 answers of 1 annotators on 1 scenes imported (1 new)" in done.output
    assert "left out [0].aligned_models[1]: box/no such: no candidate of demo/room_a 0001 is that model" in done.stderr
    (row,) = lake.snapshot().rows(Annotation)
    assert (row.instance_id, row.annotator, row.tool) == ("0001", "scan2cad", "Scan2CAD")
    assert np.allclose(np.array(row.pose).reshape(4, 4)[:3, 3], [-2.0, -2.0, 0.0])
    assert np.allclose(row.scale, 1.0)
    assert "nothing to do" in CliRunner().invoke(cli, words).output
    assert state(lake, "s2c") == "submitted"
