"""Libraries with vectors of a CLIP or SigLIP: indexed with them, asked with the same model's, refused with another's."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from flows.library.adding import add_library, planned_library
from flows.run.configuration import configure
from flows.run.libraries import library_for_worker
from flows.run.plan import make_plan
from flows.run.scene import job_of
from flows.worker import execute
from schemas.candidates import Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.runs import StageRun
from tasks.candidates.request import CandidateRequest
from tasks.candidates.retrieval import Retrieval
from tasks.capture.scan import Scan
from tasks.library.embeddings import encoder_in
from tasks.library.indexing import IndexConfig
from tasks.library.search import SearchWeights
from tasks.selection.methods.encoders import weights_digest
from tasks.stage import Context
from tests.flows.library.libraries import added, write_models
from tests.flows.library.test_library_runs import SETTINGS, STAGES, cache, scan
from tests.tasks.library.test_library_embeddings import siglip_folder
from tests.tasks.selection.test_foreign_methods import clip_folder
from warehouse.lake import Lake

pytest.importorskip("torch")
pytest.importorskip("transformers")

pytestmark = pytest.mark.whole

__all__ = ["cache", "clip_folder", "scan", "siglip_folder"]


@pytest.fixture(params=["clip_folder", "siglip_folder"])
def weights(request: pytest.FixtureRequest) -> str:
    return str(request.getfixturevalue(request.param))


def computed(lake: Lake, scan: Scan, encoder: str) -> StageRun:
    """The run of candidates, with what comes before it."""
    configuration = configure(settings=(*SETTINGS, f"candidates.encoder={json.dumps(encoder)}"), library=Path("chairs"))
    (scene,) = make_plan(lake, [scan], (), configuration).scenes
    runs = [execute(job_of(lake, scene, step, configuration)) for step in scene.todo if step.stage in STAGES]
    lake.commit()
    return runs[-1]


def test_scores_are_of_vectors_of_caption_and_view(tmp_path: Path, cache: Path, scan: Scan, weights: str) -> None:
    lake = Lake.open(tmp_path / "lake")
    contents = added(lake, write_models(tmp_path / "models"), config=IndexConfig(views=2, weights=weights))
    assert {contents.library.weights, *(row.weights for row in contents.models)} == {weights_digest(weights)}
    run = computed(lake, scan, weights)
    assert (run.error, run.degradations) == (None, ())
    reader = lake.snapshot()
    rows = [row for row in reader.rows(Candidate, scan.scene_id) if row.library == "chairs"]
    instance = next(row for row in reader.rows(Instance, scan.scene_id) if row.instance_id == rows[0].instance_id)
    mask = next(
        row for row in reader.rows(Mask, scan.scene_id)
        if (row.instance_id, row.frame_id) == (instance.instance_id, instance.best_frames[0])
    )  # fmt: skip
    frame = next(row for row in reader.rows(Frame, scan.scene_id) if row.frame_id == mask.frame_id)
    caption = next(row for row in reader.rows(Caption, scan.scene_id) if row.instance_id == instance.instance_id)
    library = library_for_worker(lake.address, "chairs", contents.library.content, None)
    assert library is not None
    context = Context(scan.scene_id, "candidates", 0, lake.blobs)
    plain = CandidateRequest(instance, caption, context, Retrieval(library, SearchWeights()), (instance,), frame, mask).ranking
    fit = {match.file: match.fit for match in plain}
    encoder, views = encoder_in(weights), dict(zip(library.search.files, library.search.arrays["views"], strict=True))
    request = CandidateRequest(instance, caption, context, Retrieval(library, SearchWeights(), weights), (instance,), frame, mask)
    view = request.view
    assert view is not None
    from tasks.views.crops import filling, squared

    assert view.silhouette is not None
    images = encoder.images(np.stack([squared(view.image, encoder.side), filling(view.image, view.silhouette, encoder.side)]))
    text = encoder.texts([caption.sentence])[0]
    for row in rows:
        own = views[str(row.library_file)]
        mean = own.mean(axis=0) / np.linalg.norm(own.mean(axis=0))
        total = 0.45 + 0.25 + 0.1 + 0.1 + 0.3 + 0.2
        score = (total * fit[str(row.library_file)] + 0.5 * float(mean @ text) + 0.5 * float((own @ images.T).max())) / (total + 1.0)
        assert row.library_score == pytest.approx(score, abs=1e-5)


def test_another_model_is_refused_and_none_is_told(tmp_path: Path, cache: Path, scan: Scan, clip_folder: Path, siglip_folder: Path) -> None:
    lake, folder = Lake.open(tmp_path / "lake"), write_models(tmp_path / "models")
    added(lake, folder, config=IndexConfig(views=2, weights=str(clip_folder)))
    run = computed(lake, scan, str(siglip_folder))
    assert (run.outcome, run.error_kind) == ("failed", "input")
    assert "candidates: encoder: is the model" in str(run.error)
    run = computed(lake, scan, "")
    assert run.error is None
    assert any("has vectors, which are compared where candidates.encoder names" in line for line in run.degradations)
    planned = planned_library(lake, folder, "chairs", (), IndexConfig(), 1)
    assert planned.why == "config changed"
    assert add_library(lake, planned).library.weights is None
