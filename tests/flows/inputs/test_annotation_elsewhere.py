"""Batches that were made elsewhere, and reviews of them: what counts, and when."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.inputs.annotation import (
    conclude,
    draw_sample,
    import_annotations,
    open_reviews,
    save_answers,
    save_verdicts,
    submit,
)
from flows.run.configuration import configure
from flows.run.plan import annotation_digests
from schemas.annotation import Annotation, QualityReview, Submission, WorkBatch
from schemas.errors import InputError
from tests.annotated import SCENES, annotatable, answer, created, fill, judged, state
from warehouse.lake import Lake
from warehouse.tables.reviews import standing_answers


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return annotatable(tmp_path / "lake")


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
    assert "batch s2c: 1 answer of 1 annotator on 1 scene imported (1 new)" in done.output
    assert "left out [0].aligned_models[1]: box/no such: no candidate of demo/room_a 0001 is that model" in done.stderr
    (row,) = lake.snapshot().rows(Annotation)
    assert (row.instance_id, row.annotator, row.tool) == ("0001", "scan2cad", "Scan2CAD")
    assert np.allclose(np.array(row.pose).reshape(4, 4)[:3, 3], [-2.0, -2.0, 0.0])
    assert np.allclose(row.scale, 1.0)
    assert "nothing to do" in CliRunner().invoke(cli, words).output
    assert state(lake, "s2c") == "submitted"


def test_what_was_returned_is_not_concluded_again(lake: Lake) -> None:
    save_answers(lake, {"batch_id": "b0", "annotations": [answer(SCENES[0], "0001", "ada", 1)]})
    draw_sample(lake, "b0")
    save_verdicts(lake, judged(open_reviews(lake, "b0", "rita"), {(SCENES[0], "0001", "ada"): False}, "b0"))
    assert conclude(lake, "b0")["verdict"] == "returned"
    before = lake.snapshot().snapshot_id
    with pytest.raises(InputError, match="is returned: one cannot judge now; what one can: accept, answer, return"):
        conclude(lake, "b0")
    assert lake.snapshot().snapshot_id == before


def test_the_only_answer_of_others_may_be_withdrawn_and_given_again(lake: Lake) -> None:
    key = (SCENES[0], "0001", "ada")
    save_answers(lake, {"batch_id": "b0", "annotations": [answer(*key, 1)]})
    assert save_answers(lake, {"batch_id": "b0", "annotations": [answer(*key, None, at=1, withdrawn=True)]})["withdrawn"] == 1
    assert standing_answers(lake.snapshot()).num_rows == 0
    assert save_answers(lake, {"batch_id": "b0", "annotations": [answer(*key, 2, at=2)]})["corrected"] == 1
    assert [row.is_withdrawn for row in lake.snapshot().rows(Annotation)] == [False, True, False]
    assert [(row.round, row.revision) for row in lake.snapshot().rows(Submission)] == [(1, 1), (2, 3)], (
        "nothing is left to hand in in between"
    )
