"""An annotation batch from its creation to the scenes: folder, sample, verdicts, and what reaches a layout."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.inputs.annotation import (
    BatchPlan,
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
from schemas.annotation import Annotation, AnswerVerdict, Assignment, QualityReview, SampledAnswer
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.record import arrow_to_rows
from schemas.selection import Selection
from tasks.annotation.work import WORK_SCHEMA_FILE
from tasks.optimization.proposals import propose
from tests.annotated import ANNOTATORS, SCENES, annotatable, answer, created, fill, judged, state
from warehouse.lake import Lake
from warehouse.tables.reviews import standing_answers


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return annotatable(tmp_path / "lake")


def chosen(lake: Lake, scene: str = SCENES[0]) -> dict[str, str]:
    """Who decides what the optimization proposes for each object."""
    reader = lake.snapshot()
    answers = arrow_to_rows(standing_answers(reader, scene), Annotation)
    selections = reader.rows(Selection, scene)
    proposals, _ = propose(reader.rows(Instance, scene), selections, answers, {row.asset_id for row in selections})
    return {row.instance.instance_id: row.origin for row in proposals}


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
    dry = create_batch(lake, BatchPlan("b1", ANNOTATORS), tmp_path / "work", dry_run=True)
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
        (BatchPlan("a/b", ANNOTATORS), "is no name of a batch"),
        (BatchPlan("b", ("ada", "ADA")), "twice"),
        (BatchPlan("b", (" ada",)), "is no name"),
        (BatchPlan("b", ()), "there are 0 annotators"),
        (BatchPlan("b", ANNOTATORS, 4), "there are 3 annotators"),
        (BatchPlan("b", ANNOTATORS, scenes=("demo/none",)), "is not in the lake"),
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
        create_batch(lake, BatchPlan("b1", ANNOTATORS, 3), folder / "work", configuration=told)
        fill(folder / "work", np.random.default_rng(0))
        import_annotations(lake, folder / "work/answers.json")
        submit(lake, "b1", by="ada")
        assert draw_sample(lake, "b1")["why"] == "18 of 180 answers are reviewed (10%)"
        rows = lake.snapshot().rows(SampledAnswer)
        drawn.append({(row.scene_id, row.instance_id, row.annotator, row.place) for row in rows})
    assert drawn[0] == drawn[1] != drawn[2]


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
