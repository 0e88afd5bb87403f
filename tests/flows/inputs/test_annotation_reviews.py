"""Reviews of annotation batches: files that are refused, and the way of a review into the lake."""

from __future__ import annotations

import dataclasses
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.cli import cli
from flows.run.fingerprints import annotations_digest
from flows.run.plan import annotation_digests
from flows.worker import Job, RowsGone, history_rows
from schemas import record as record_module
from schemas.annotation import Annotation, QualityReview
from schemas.candidates import Candidate
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.tables import TABLES
from tasks.annotation import REVIEW_SCHEMA_FILE, ReviewBatch, check_reviews, read_reviews
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.tables.reviews import standing_answers

SCENE, ASSET = "demo/room_a", "a" * 64


def review(**values: Any) -> dict[str, Any]:
    usual = {
        "review_id": "r1", "reviewer": "rita", "reviewed_at": "2026-03-02T10:30:00+01:00", "sampled": 2, "wrong": 1, "verdict": "returned"
    }  # fmt: skip
    return {key: value for key, value in (usual | values).items() if value is not ...}


def write(path: Path, *reviews: dict[str, Any], **values: Any) -> Path:
    path.write_text(json.dumps({"batch_id": "batch-1", "reviews": list(reviews)} | values))
    return path


def test_a_review_is_read(tmp_path: Path) -> None:
    batch = read_reviews(write(tmp_path / "r.json", review(), review(review_id="r2", wrong=0, verdict="accepted", note=" better ")))
    assert (batch.batch_id, batch.source_file) == ("batch-1", "r.json")
    first, second = batch.reviews
    assert first.reviewed_at == datetime(2026, 3, 2, 9, 30, tzinfo=UTC)
    assert (first.sampled, first.wrong, first.verdict, first.note) == (2, 1, "returned", None)
    assert (second.wrong, second.verdict, second.note) == (0, "accepted", "better")


WRONG: list[tuple[dict[str, Any], str, str]] = [
    (review(review_id=...), "reviews[1]", "review_id"),
    (review(review_id="a/b"), "reviews[1].review_id", "not allowed"),
    (review(review_id="r0"), "reviews[1].review_id", "twice"),
    (review(reviewer=" "), "reviews[1].reviewer", "not allowed"),
    (review(reviewed_at="2026-03-02T10:30:00"), "reviews[1].reviewed_at", "zone"),
    (review(sampled=0, wrong=0), "reviews[1].sampled", "at least 1"),
    (review(sampled=1.5), "reviews[1].sampled", "whole number"),
    (review(wrong=-1), "reviews[1].wrong", "at least 0"),
    (review(wrong=3), "reviews[1].wrong", "3 of 2"),
    (review(verdict="rejected"), "reviews[1].verdict", "not allowed"),
    (review(note="x" * 2001), "reviews[1].note", "at most 2000"),
    (review(note="a\u0000b"), "reviews[1].note", "not allowed"),
    (review(comment="nice"), "reviews[1]", "unknown field"),
]


@pytest.mark.parametrize(("wrong", "where", "why"), WRONG, ids=[f"{w[1]}: {w[2]}" for w in WRONG])
def test_a_wrong_review_is_refused_with_its_place(tmp_path: Path, wrong: dict[str, Any], where: str, why: str) -> None:
    with pytest.raises(InputError) as caught:
        read_reviews(write(tmp_path / "r.json", review(review_id="r0"), wrong))
    assert (caught.value.file, caught.value.field) == ("r.json", where)
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_without_reviews_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="reviews"):
        read_reviews(write(tmp_path / "r.json"))
    with pytest.raises(InputError, match="batch_id"):
        read_reviews(write(tmp_path / "r.json", review(), batch_id=""))
    with pytest.raises(InputError, match="is no file"):
        read_reviews(tmp_path / "none.json")
    jsonschema.Draft202012Validator.check_schema(json.loads(REVIEW_SCHEMA_FILE.read_text()))


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["sampled", "x"]), inner, max_size=3),
    max_leaves=6,
)


@given(field=st.sampled_from([*review(), "note", "other"]), value=values)
@settings(max_examples=100, deadline=None)
def test_whatever_a_field_holds_the_review_is_taken_or_refused_with_one_line(
    tmp_path_factory: pytest.TempPathFactory, field: str, value: Any
) -> None:
    path = write(tmp_path_factory.mktemp("reviews") / "r.json", review() | {field: value})
    valid = jsonschema.Draft202012Validator(json.loads(REVIEW_SCHEMA_FILE.read_text())).is_valid(json.loads(path.read_text()))
    batch, refused = None, None
    try:
        batch = read_reviews(path)
    except InputError as error:
        refused = error
    if batch is not None:
        assert valid
        assert batch.reviews[0].wrong <= batch.reviews[0].sampled
    else:
        assert "\n" not in str(refused)
        assert (
            str(refused).startswith("r.json: reviews[0]")
            or "JSON does not have" in str(refused)
            or "which JSON does not have" in str(refused)
        )


def test_a_review_samples_no_more_than_there_is(tmp_path: Path) -> None:
    batch = read_reviews(write(tmp_path / "r.json", review(sampled=3)))
    check_reviews(batch, 3)
    with pytest.raises(InputError, match="the batch has 2 answers"):
        check_reviews(batch, 2)
    with pytest.raises(InputError, match="not in the lake"):
        check_reviews(ReviewBatch("other", batch.reviews, "r.json"), 0)


def annotated(folder: Path) -> Lake:
    """A lake with a batch of two answers."""
    lake = Lake.open(folder)
    points = lake.blobs.put(b"points", "ply")
    objects = [sample(Instance, scene_id=SCENE, instance_id=f"{n:04d}", is_structure=False, points_blob=points) for n in (1, 2)]
    filled = [sample(Candidate, scene_id=SCENE, instance_id=f"{n:04d}", slot=1, asset_id=ASSET, outcome="filled") for n in (1, 2)]
    lake.stage_rows(stage_run(SCENE, "capture", fingerprint(1)), {"instances": objects})
    lake.stage_rows(stage_run(SCENE, "candidates", fingerprint(2)), {"candidates": filled})
    lake.commit()
    return lake


def metascenes(*arguments: object) -> Any:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def test_reviews_enter_the_lake_once_and_change_no_answer(tmp_path: Path) -> None:
    lake = annotated(tmp_path / "lake")
    file = write(tmp_path / "r.json", review())
    missing = metascenes("annotate", "review", file, "--lake", tmp_path / "lake")
    assert isinstance(missing.exception, InputError)
    assert "batch-1 is not in the lake" in str(missing.exception)
    assert lake.snapshot().snapshot_id == 1
    answers = [
        {"scene_id": SCENE, "instance_id": f"{n:04d}", "annotator": "ada", "answered_at": "2026-03-01T10:00:00Z", "choice": 1}
        | {"seconds": 9 * n}
        for n in (1, 2)
    ]
    (tmp_path / "b.json").write_text(json.dumps({"batch_id": "batch-1", "annotations": answers}))
    assert metascenes("annotate", "import", tmp_path / "b.json", "--lake", tmp_path / "lake").exit_code == 0
    before = lake.snapshot().arrow("annotations")
    assert before.column("seconds").to_pylist() == [9.0, 18.0]
    dry = metascenes("annotate", "review", file, "--lake", tmp_path / "lake", "--dry-run")
    assert (dry.exit_code, "would be imported" in dry.output, lake.snapshot().snapshot_id) == (0, True, 2)
    done = metascenes("annotate", "review", file, "--lake", tmp_path / "lake", "--json")
    assert json.loads(done.output) == {"batch_id": "batch-1", "reviews": 1, "already": 0, "sampled": 2, "wrong": 1, "returned": 1}
    assert "nothing to do" in metascenes("annotate", "review", file, "--lake", tmp_path / "lake").output
    assert lake.snapshot().snapshot_id == 3
    write(file, review(), review(review_id="r2", wrong=0, verdict="accepted", note="better"))
    assert "1 known already" in metascenes("annotate", "review", file, "--lake", tmp_path / "lake").output
    kept = lake.snapshot().rows(QualityReview)
    assert [(row.batch_id, row.review_id, row.verdict) for row in kept] == [("batch-1", "r1", "returned"), ("batch-1", "r2", "accepted")]
    assert lake.snapshot().arrow("annotations").equals(before)
    write(file, review(wrong=2))
    other = metascenes("annotate", "review", file, "--lake", tmp_path / "lake")
    assert "says something else" in str(other.exception)
    assert lake.snapshot().rows(QualityReview) == kept
    assert "already" in metascenes("annotate", "import", tmp_path / "b.json", "--lake", tmp_path / "lake").output


def imported(lake: Lake, folder: Path, batch: str, day: int, *answers: dict[str, Any]) -> None:
    """Import a batch of answers that count until a review returns them."""
    rows = [{"scene_id": SCENE, "annotator": "ada", "answered_at": f"2026-03-{day:02d}T10:00:00Z", "choice": 1} | one for one in answers]
    (folder / f"{batch}.json").write_text(json.dumps({"batch_id": batch, "annotations": rows}))
    trusted = ("--set", "annotation.unreviewed_imports_count=true")
    assert metascenes("annotate", "import", folder / f"{batch}.json", "--lake", lake.address, *trusted).exit_code == 0


def reviewed(lake: Lake, folder: Path, batch: str, name: str, day: int, verdict: str) -> None:
    """Review a batch."""
    one = review(review_id=name, reviewed_at=f"2026-04-{day:02d}T10:00:00Z", sampled=1, wrong=0, verdict=verdict)
    file = write(folder / "r.json", one, batch_id=batch)
    assert metascenes("annotate", "review", file, "--lake", lake.address).exit_code == 0


def test_the_last_review_says_whether_a_batch_counts(tmp_path: Path) -> None:
    lake = annotated(tmp_path / "lake")
    imported(lake, tmp_path, "old", 1, {"instance_id": "0001"})
    imported(lake, tmp_path, "new", 2, {"instance_id": "0001"}, {"instance_id": "0002"})

    def standing() -> list[str]:
        rows = standing_answers(lake.snapshot(), SCENE).to_pylist()
        assert sorted(row["batch_id"] for row in lake.snapshot().arrow("annotations").to_pylist()) == ["new", "new", "old"], "history"
        return sorted(row["batch_id"] for row in rows)

    first = annotation_digests(lake)[SCENE]
    assert standing() == ["new", "new", "old"]
    reviewed(lake, tmp_path, "new", "r1", 3, "accepted")
    assert (standing(), annotation_digests(lake)[SCENE]) == (["new", "new", "old"], first), "what is accepted changes nothing"
    reviewed(lake, tmp_path, "new", "r2", 5, "returned")
    assert (standing(), annotation_digests(lake)[SCENE] != first) == (["old"], True)
    reviewed(lake, tmp_path, "new", "r3", 4, "accepted")
    assert standing() == ["old"], "a review that was finished before the last one and comes later decides nothing"
    reviewed(lake, tmp_path, "new", "r4", 6, "accepted")
    assert (standing(), annotation_digests(lake)[SCENE]) == (["new", "new", "old"], first)
    reviewed(lake, tmp_path, "old", "r1", 6, "returned")
    reviewed(lake, tmp_path, "new", "r5", 7, "returned")
    assert standing() == []
    assert annotation_digests(lake) == {}, "as where nobody answered"


REFUSED: list[tuple[dict[str, Any], str, str]] = [
    (review(verdict="accepted", sampled=1, wrong=1), "verdict", "0 of 1 sampled answer pass, and more than 98% must"),
    (review(verdict="accepted", sampled=2, wrong=1), "verdict", "1 of 2 sampled answers passes, and more than 98% must"),
    (review(verdict="accepted", wrong=0, reviewer=" ADA"), "reviewer", "ADA is an annotator of the batch"),
    (review(verdict="accepted", wrong=0, reviewer="rita, Bob"), "reviewer", "Bob is an annotator of the batch"),
    (review(review_id="round-1"), "review_id", "round-1 is what reviews made here are called"),
    (review(reviewed_at="2999-01-01T00:00:00Z"), "reviewed_at", "is in the future"),
]


@pytest.mark.parametrize(("wrong", "field", "why"), REFUSED, ids=[f"{w[1]}: {w[2]}" for w in REFUSED])
def test_a_review_from_elsewhere_that_bears_nothing_out_is_refused(tmp_path: Path, wrong: dict[str, Any], field: str, why: str) -> None:
    lake = annotated(tmp_path / "lake")
    imported(lake, tmp_path, "batch-1", 1, {"instance_id": "0001"}, {"instance_id": "0002", "annotator": "bob"})
    before = lake.snapshot().snapshot_id
    refused = metascenes("annotate", "review", write(tmp_path / "r.json", wrong), "--lake", lake.address)
    assert isinstance(refused.exception, InputError)
    assert (refused.exception.field, why in str(refused.exception)) == (f"reviews[0].{field}", True)
    assert lake.snapshot().snapshot_id == before


def test_a_returned_batch_counts_for_nothing_until_it_is_accepted_anew(tmp_path: Path) -> None:
    lake = annotated(tmp_path / "lake")
    imported(lake, tmp_path, "b", 1, {"instance_id": "0001"}, {"instance_id": "0002"})
    assert annotation_digests(lake) != {}
    reviewed(lake, tmp_path, "b", "r1", 3, "returned")
    imported(lake, tmp_path, "b", 4, {"instance_id": "0001", "choice": None}, {"instance_id": "0002"})
    assert annotation_digests(lake) == {}, "trusted, but returned before"
    reviewed(lake, tmp_path, "b", "r2", 5, "accepted")
    assert annotation_digests(lake) != {}


def test_a_stage_reads_the_answers_that_its_fingerprint_names(tmp_path: Path) -> None:
    lake = annotated(tmp_path / "lake")
    imported(lake, tmp_path, "old", 1, {"instance_id": "0001"})
    planned = lake.snapshot().snapshot_id
    told = (f"annotations={annotation_digests(lake)[SCENE]}",)
    job = Job(lake.address, SCENE, "optimization", None, "{}", 0, fingerprint(9), told, (), 1, snapshot_id=planned)
    imported(lake, tmp_path, "new", 2, {"instance_id": "0001"})
    assert [row.batch_id for row in history_rows(lake, "annotations", job)] == ["old"]
    reviewed(lake, tmp_path, "new", "r1", 3, "returned")
    assert [row.batch_id for row in history_rows(lake, "annotations", job)] == ["old"]
    reviewed(lake, tmp_path, "old", "r1", 4, "returned")
    with pytest.raises(RowsGone, match="changed while this stage was under way"):
        history_rows(lake, "annotations", dataclasses.replace(job, snapshot_id=None))
    later = dataclasses.replace(job, reasons=("annotations=",))
    assert history_rows(lake, "annotations", later) == []


def test_answers_older_than_the_column_seconds_read_as_not_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = TABLES["annotations"]
    older = dataclasses.replace(table, columns=tuple(c for c in table.columns if c.name != "seconds"))
    real = record_module.table_of
    lake = Lake.open(tmp_path / "lake")
    old, new = (sample(Annotation, batch_id=name, choice=ASSET, seconds=seconds) for name, seconds in (("old", None), ("new", 30.0)))
    with monkeypatch.context() as patch:
        patch.setitem(TABLES, "annotations", older)
        patch.setattr(record_module, "table_of", lambda kind: older if kind is Annotation else real(kind))
        lake.stage_rows(stage_run("old", "annotation", fingerprint(1)), {"annotations": [old]})
        lake.commit()
    assert lake.snapshot().rows(Annotation) == [old]
    lake.stage_rows(stage_run("new", "annotation", fingerprint(2)), {"annotations": [new]})
    lake.commit()
    assert lake.snapshot().rows(Annotation) == [new, old]
    asked = lake.snapshot().connect().execute("SELECT batch_id, seconds FROM annotations ORDER BY batch_id").fetchall()
    assert asked == [("new", 30.0), ("old", None)]


def test_answers_of_before_keep_the_hash_that_their_layouts_were_made_from() -> None:
    row = {column.name: getattr(sample(Annotation), column.name) for column in TABLES["annotations"].columns}
    older = {name: value for name, value in row.items() if name not in ("revision", "is_withdrawn", "is_simulated", "tool")}
    assert annotations_digest([row]) == annotations_digest([older])
    for changed in ({"revision": 2}, {"is_simulated": True}, {"tool": "page"}, {"choice": ASSET}):
        assert annotations_digest([row | changed]) != annotations_digest([older])
