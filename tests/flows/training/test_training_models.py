"""Which model a stage gets, and what is learned from: newest, named, withdrawn, shipped; rows as streams, and the content's name."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from bench.samples import fingerprint, sample, stage_batch, stage_run, stage_whole_scene
from flows.training import datasets
from flows.training import models as models_of_lake
from flows.training.datasets import chosen_dataset
from flows.training.models import found_model, listed_models, loaded_model, shipped_rows, wanted_model
from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.training import LearnedModel
from tasks.models import folders_in, identity_json, model_id_of
from tasks.stage import WantedModel
from tasks.training.fitting import FittingConfig
from tasks.weights import to_safetensors
from warehouse.lake import Lake

WEIGHTS = to_safetensors({})
CONFIG = "{}"
KIND = "selection"


def kept(lake: Lake, seed: int, at: float, **values: Any) -> LearnedModel:
    """A model in the lake, trained `at` seconds after the first."""
    config = json.dumps({"seed": seed})
    given = {
        "model_id": model_id_of(WEIGHTS, config), "training_id": f"training-{seed}", "kind": KIND, "origin": "trained", "config": config,
        "weights_blob": lake.blobs.put(WEIGHTS, "weights"), "parent_id": None, "is_withdrawn": False,
    }  # fmt: skip
    row = sample(LearnedModel, **(given | values))
    lake.stage_rows(stage_run(row.training_id, "training", fingerprint(seed, at), at=at), {"models": [row]})
    lake.commit()
    made: LearnedModel = row
    return made


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake")


@dataclasses.dataclass(frozen=True)
class Shipping:
    """A learned system that ships models."""

    place: Path
    name: str = KIND

    def shipped(self) -> Any:
        return folders_in(self.place)


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Id of a model that ships inside the package, under the name `small`."""
    folder = tmp_path / "shipped" / "small"
    folder.mkdir(parents=True)
    document = {
        "format": 1, "model_id": model_id_of(WEIGHTS, CONFIG), "kind": KIND, "architecture": "small", "parameter_count": 0, "config": {},
        "dataset": "snapshot 3", "dataset_fingerprint": "a" * 64, "examples": {"train": 5}, "seed": 0, "code_fingerprint": "b" * 64,
        "device": "cpu", "license": "CC0-1.0", "parent_id": None, "is_fallback": False, "notes": [], "measures": [],
    }  # fmt: skip
    (folder / "model.json").write_text(json.dumps(document))
    (folder / "weights.safetensors").write_bytes(WEIGHTS)
    monkeypatch.setattr(models_of_lake, "SYSTEMS", (Shipping(tmp_path / "shipped"),))
    return str(document["model_id"])


def ids(models: Iterable[tuple[LearnedModel, str]]) -> list[str]:
    return [row.model_id for row, _ in models]


def test_the_newest_that_counts_is_wanted_then_the_shipped_one(lake: Lake, shipped: str) -> None:
    wanted = WantedModel(KIND)
    assert wanted_model(None, wanted).model_id == shipped
    first, second = kept(lake, 1, at=1), kept(lake, 2, at=2)
    reader = lake.snapshot()
    assert ids(listed_models(reader)) == [second.model_id, first.model_id, shipped]
    assert wanted_model(reader, wanted) == second
    assert loaded_model(lake, second).weights == WEIGHTS
    kept(lake, 2, at=3, is_withdrawn=True)
    assert wanted_model(lake.snapshot(), wanted).model_id == first.model_id
    with pytest.raises(InputError, match="was withdrawn; name another"):
        wanted_model(lake.snapshot(), WantedModel(KIND, second.model_id))
    kept(lake, 1, at=4, is_withdrawn=True)
    last = wanted_model(lake.snapshot(), wanted)
    assert (last.model_id, last.origin) == (shipped, "shipped")
    assert loaded_model(lake, last).weights == WEIGHTS
    assert wanted_model(reader, wanted) == second, "of the snapshot as it was"


def test_a_model_is_meant_by_its_id_its_beginning_or_its_name(lake: Lake, shipped: str) -> None:
    row = kept(lake, 1, at=1)
    reader = lake.snapshot()
    assert found_model(reader, row.model_id)[0] == found_model(reader, row.model_id[:12])[0] == row
    assert found_model(reader, "small")[0].model_id == shipped
    for asked, problem in (("", "there is no model ''"), ("zz", "there is no model 'zz'")):
        with pytest.raises(InputError, match=problem):
            found_model(reader, asked)
    with pytest.raises(InputError, match="is a model of selection"):
        found_model(reader, row.model_id, "another system")
    others = [kept(lake, seed, at=seed) for seed in range(2, 40)]
    start = next(digit for digit in "0123456789abcdef" if sum(each.model_id.startswith(digit) for each in others) > 1)
    with pytest.raises(InputError, match=f"models begin with '{start}'; give more digits"):
        found_model(lake.snapshot(), start)


def test_no_row_of_a_lake_replaces_a_bundled_model(lake: Lake, shipped: str) -> None:
    """Rows with its id, rows that claim to be bundled, and ids that begin like its name."""
    (bundled,) = shipped_rows().values()
    for seed, origin in ((5, "trained"), (6, "imported")):
        kept(lake, seed, at=seed, model_id=shipped, origin=origin, license="of somebody else")
        reader = lake.snapshot()
        assert listed_models(reader) == [(bundled, "small")]
        for text in ("small", shipped, shipped[:12]):
            assert found_model(reader, text) == (bundled, "small")
        assert wanted_model(reader, WantedModel(KIND)) == wanted_model(reader, WantedModel(KIND, "small")) == bundled
        assert loaded_model(lake, reader.rows_by_key(LearnedModel, [shipped])[0]).weights == WEIGHTS
    kept(lake, 7, at=7, origin="shipped")
    assert listed_models(lake.snapshot()) == [(bundled, "small")]


def test_a_bundled_name_comes_before_ids_that_begin_like_it(lake: Lake, shipped: str, tmp_path: Path) -> None:
    row = kept(lake, 1, at=1)
    name = row.model_id[:4]
    (tmp_path / "shipped" / "small").rename(tmp_path / "shipped" / name)
    assert found_model(lake.snapshot(), name)[0].model_id == shipped
    assert found_model(lake.snapshot(), row.model_id[:5])[0] == row


def test_weights_that_are_gone_or_of_another_model_are_refused(lake: Lake, shipped: str) -> None:
    row = kept(lake, 1, at=1)
    with pytest.raises(InputError, match="is not the model of its weights and config"):
        loaded_model(lake, dataclasses.replace(row, config='{"seed":2}'))
    with pytest.raises(InputError, match="is not in the lake"):
        loaded_model(lake, dataclasses.replace(row, weights_blob=f"{hashlib.sha256(b'gone').hexdigest()}.weights"))


def test_what_changes_no_weight_is_no_part_of_a_model() -> None:
    plain = identity_json(FittingConfig())
    assert identity_json(FittingConfig(workers=3, checkpoint_steps=7)) == plain
    assert identity_json(FittingConfig(threads=2)) != plain


def test_rows_are_streamed_in_the_order_of_the_key(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    for index in range(7):
        stage_whole_scene(lake, f"scannet/scene{index:04d}_00", 0, index)
    lake.commit()
    monkeypatch.setattr(datasets, "SCENES_AT_ONCE", 3)
    monkeypatch.setattr(datasets, "ROWS_AT_ONCE", 2)
    dataset = chosen_dataset(lake)
    for record in (Instance, Asset):
        assert list(dataset.rows(record)) == lake.snapshot().rows(record)


def test_the_content_has_one_name_while_its_rows_are_the_same(lake: Lake) -> None:
    with pytest.raises(InputError, match="the lake has none yet"):
        chosen_dataset(lake)
    stage_whole_scene(lake, "scannet/scene0000_00", 0, 0)
    lake.commit()
    with pytest.raises(InputError, match="there is nothing to learn from"):
        chosen_dataset(lake).fingerprint(["annotations"])
    before = chosen_dataset(lake).fingerprint(["instances"])
    stage_batch(lake, "batch-1", ["scannet/scene0000_00"], 1)
    lake.commit()
    dataset = chosen_dataset(lake)
    assert dataset.name == "snapshot 2"
    assert dataset.fingerprint(["instances"]) == before == chosen_dataset(lake, 1).fingerprint(["instances"])
    both = dataset.fingerprint(["instances", "annotations"])
    assert both != before
    stage_whole_scene(lake, "scannet/scene0000_00", "again", 2)
    lake.commit()
    assert chosen_dataset(lake).fingerprint(["instances"]) != before
    assert chosen_dataset(lake, 2).fingerprint(["instances"]) == before


def test_answers_are_those_that_count_and_those_of_simulated_annotators(lake: Lake) -> None:
    def answer(batch: str, simulated: bool) -> Annotation:
        made: Annotation = sample(
            Annotation, batch_id=batch, scene_id="scannet/scene0000_00", instance_id="0001", annotator="anna", is_simulated=simulated,
            is_withdrawn=False,
        )  # fmt: skip
        return made

    for batch, simulated in (("people", False), ("programs", True)):
        lake.stage_rows(stage_run(batch, "annotation", fingerprint(batch)), {"annotations": [answer(batch, simulated)]})
    lake.commit()
    assert [(row.batch_id, row.is_simulated) for row in chosen_dataset(lake).rows(Annotation)] == [("programs", True)]
