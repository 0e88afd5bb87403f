"""Models of others: what is taken in, what is refused in a line, and what the lake knows of its own."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.samples import fingerprint, stage_run, stage_whole_scene
from flows.training import models as models_of_lake
from flows.training import training
from flows.training.contents import content_of
from flows.training.folders import document_of, export_model, import_model, withdraw_model
from flows.training.models import listed_models, shipped_models, shipped_rows
from flows.training.training import planned_training, system_configuration
from schemas.errors import InputError
from schemas.training import LearnedModel, ModelEvaluation
from tasks.models import ModelFolder, identity_json, model_id_of
from tasks.selection.model.config import OwnImage, OwnText, PointNet2, SelectionModel, Small
from tasks.selection.model.shapes import shapes_of
from tasks.training.systems.selection import SelectionTraining
from tasks.weights import to_safetensors
from warehouse.lake import Lake
from warehouse.upkeep.erasure import erase

SMALL = Small(points=48, groups=8, group_size=6, dim=24, depth=1, heads=2, first_widths=(8, 16), second_widths=(16, 24), position_width=8,
              embedding=16, head_width=16)  # fmt: skip
SETTINGS = SelectionTraining(
    SelectionModel(SMALL, image=OwnImage(widths=(4, 6, 8)), text=OwnText(buckets=64, width=8), residual_points=32, residual_widths=(8, 12))
)
WEIGHTS = to_safetensors({name: np.ones(shape, dtype="<f2") for name, shape in shapes_of(SETTINGS.model).items()})
CONFIG: dict[str, Any] = json.loads(identity_json(SETTINGS))


def model_row(weights: bytes = WEIGHTS, config: dict[str, Any] | None = None, **values: Any) -> LearnedModel:
    text = json.dumps(config or CONFIG, sort_keys=True, separators=(",", ":"))
    row = LearnedModel(
        model_id=model_id_of(weights, text), training_id="selection-1", kind="selection", origin="trained", architecture="small",
        parameter_count=3, config=text, weights_blob=f"{hashlib.sha256(weights).hexdigest()}.weights", weights_bytes=len(weights),
        dataset="snapshot 1", snapshot_id=1, release=None, dataset_fingerprint="a" * 64, examples=("train=5",), seed=0,
        code_fingerprint="b" * 64, device="cpu", seconds=2.5, license="CC0-1.0", parent_id=None, is_fallback=False, is_withdrawn=False,
        notes=("made up",),
    )  # fmt: skip
    return dataclasses.replace(row, **values)


def kept(lake: Lake, row: LearnedModel, weights: bytes = WEIGHTS) -> LearnedModel:
    lake.blobs.put(weights, "weights")
    lake.stage_rows(stage_run(row.training_id, "training", fingerprint(row.training_id), at=1), {"models": [row]})
    lake.commit()
    return row


def folder(place: Path, weights: bytes = WEIGHTS, config: dict[str, Any] | None = None, **fields: Any) -> Path:
    """A folder of a model whose name is that of its weights and config; `fields` change its document."""
    place.mkdir()
    (place / "weights.safetensors").write_bytes(weights)
    (place / "model.json").write_text(json.dumps(document_of(model_row(weights, config), []) | fields))
    return place


def changed(path: str, value: Any) -> dict[str, Any]:
    """The config with another value at a path."""
    made: dict[str, Any] = json.loads(json.dumps(CONFIG))
    *way, last = path.split(".")
    table = made
    for name in way:
        table = table[name]
    table[last] = value
    return made


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake")


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("model.architecture.points", 2_000_000_000, "config.model.architecture.points: must be at most 65536, is 2000000000"),
        ("model.architecture.group_size", 4097, "must be at most 4096"),
        ("model.architecture.depth", 10**9, "must be at most 128"),
        ("model.architecture.dim", 10**9, "must be at most 8192"),
        ("model.architecture.first_widths", [8, 10**9], "item 2: must be at most 8192"),
        ("model.architecture.heads", 5, "5 heads do not share 24 channels"),
        ("model.residual_points", 10**9, "must be at most 65536"),
        ("model.text.tokens", 10**9, "must be at most 65536"),
        ("model.text.buckets", 10**9, "must be at most 524288"),
        ("model.image", {"kind": "clip", "weights": "/etc"}, "config.model.image: is a frozen encoder (clip) in a folder"),
        ("model.text", {"kind": "siglip", "weights": "/etc"}, "config.model.text: is a frozen encoder (siglip) in a folder"),
        ("model.architecture.head_width", 17, "quality.0.bias: has the shape (16,); the model's config wants (17,)"),
        ("model.extents", False, "the model's config wants"),
    ],
)
def test_settings_that_allocate_open_or_do_not_fit_are_refused(lake: Lake, tmp_path: Path, path: str, value: Any, said: str) -> None:
    with pytest.raises(InputError) as refused:
        import_model(lake, folder(tmp_path / "m", config=changed(path, value)))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    assert not lake.exists, "nothing was taken in"


@pytest.mark.whole
def test_networks_of_torch_are_held_against_weights_without_being_made(lake: Lake, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from tasks.selection.model.scoring import torch_shapes

    points = PointNet2(
        points=48, centers=(8, 4), samples=(4, 4), first_widths=(8, 8), second_widths=(8, 8), third_widths=(8, 16), last_widths=(16, 8),
        embedding=16, head_width=16,
    )  # fmt: skip
    settings = dataclasses.replace(SETTINGS, model=dataclasses.replace(SETTINGS.model, architecture=points))
    config = json.loads(identity_json(settings))
    weights = to_safetensors({name: np.ones(shape, dtype="<f2") for name, shape in torch_shapes(settings.model).items()})
    with pytest.raises(InputError, match=r"^of another: pc_projection: has the shape \(48, 16\); the model's config wants \(8, 16\)"):
        import_model(lake, folder(tmp_path / "of another", WEIGHTS, config))
    uni3d = {"kind": "uni3d", "dim": 8192, "depth": 128, "mlp_width": 32_768}  # 400 GB, if it were made
    with pytest.raises(InputError, match="the model's config wants"):
        import_model(lake, folder(tmp_path / "huge", weights, changed("model.architecture", uni3d)))
    assert import_model(lake, folder(tmp_path / "right", weights, config))[1]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"seconds": "x"}, "seconds: must be a number of at least 0, is 'x'"),
        ({"seconds": -1}, "seconds: must be a number"),
        ({"examples": {"a": "zz"}}, "examples.a: must be a whole number of at least 0, is 'zz'"),
        ({"examples": {"a": -1}}, "examples.a: must be a whole number"),
        ({"examples": {"a": True}}, "examples.a: must be a whole number"),
        ({"examples": {"a=b": 1}}, "examples: 'a=b' is no name of a split"),
        ({"notes": [3]}, "notes: line 1 must be a text, is 3"),
        ({"seed": 10**30}, "seed: is too large"),
        ({"parameter_count": 10**30}, "parameter_count: is too large"),
        ({"parameter_count": -1}, "parameter_count"),
        ({"measures": [3]}, "measures: item 1 must be a table"),
        ({"measures": [{"method": "selection", "dataset": "d", "split": "s", "metric": "m", "value": 10**400, "low": None, "high": None,
                        "examples": 3}]}, "measures: item 1 has a number that is too large"),
        ({"measures": [{"method": "selection", "dataset": "d", "split": "s", "metric": "m", "value": "x", "low": None, "high": None,
                        "examples": 3}]}, "value"),
        ({"dataset_fingerprint": "x"}, "dataset_fingerprint"),
    ],
)  # fmt: skip
def test_values_that_are_none_are_refused_by_field(lake: Lake, tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as refused:
        import_model(lake, folder(tmp_path / "m", **fields))
    assert said in str(refused.value)
    assert not lake.exists


def test_what_fits_is_taken_in_and_is_the_newest(lake: Lake, tmp_path: Path) -> None:
    row, is_new = import_model(lake, folder(tmp_path / "m"))
    assert (is_new, row.origin, row.snapshot_id) == (True, "imported", None)
    assert listed_models(lake.snapshot())[0][0] == row
    assert import_model(lake, tmp_path / "m") == (row, False)


FIGURE = {"method": "selection", "dataset": "d", "split": "test", "metric": "m", "value": 0.5, "low": None, "high": None, "examples": 3}
OTHER_FACTS: list[tuple[dict[str, Any], str]] = [
    ({"license": "MIT"}, "license: is 'MIT', and 'CC0-1.0' in"),
    ({"dataset": "snapshot 9"}, "dataset: is 'snapshot 9', and 'snapshot 1' in"),
    ({"dataset_fingerprint": "c" * 64}, "dataset_fingerprint: is 'ccc"),
    ({"examples": {"train": 6}}, "examples: is {'train': 6}, and {'train': 5} in"),
    ({"notes": ["better"]}, "notes: is ['better'], and ['made up'] in"),
    ({"architecture": "large"}, "architecture: is 'large', and 'small' in"),
    ({"parent_id": "d" * 64}, "parent_id: is 'ddd"),
    ({"is_fallback": True}, "is_fallback: is True, and False in"),
    ({"seed": 1}, "seed: is 1, and 0 in"),
    ({"measures": [FIGURE | {"value": 0.9}]}, "measures of selection, d, test, m: is [0.9, None, None, 3], and [0.5, None, None, 3] in"),
    ({"measures": [FIGURE | {"metric": "n"}, FIGURE | {"low": 0.4}]}, "measures of selection, d, test, m: is [0.5, 0.4, None, 3], and"),
]


@pytest.mark.parametrize(("fields", "said"), OTHER_FACTS)
@pytest.mark.parametrize("origin", ["imported", "withdrawn", "bundled"])
def test_the_same_weights_with_other_facts_are_refused(
    lake: Lake, tmp_path: Path, fields: dict[str, Any], said: str, origin: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = folder(tmp_path / "first", measures=[FIGURE])
    if origin == "bundled":
        monkeypatch.setattr(models_of_lake, "shipped_models", lambda kind=None: iter([("small", ModelFolder(first))]))
    else:
        import_model(lake, first)
    if origin == "withdrawn":
        withdraw_model(lake, model_row().model_id, "wrong license")
    before = lake.snapshot().rows(LearnedModel) if lake.exists else []
    with pytest.raises(InputError) as refused:
        import_model(lake, folder(tmp_path / "second", **({"measures": [FIGURE]} | fields)))
    assert said in str(refused.value)
    assert "with the same weights; ask its author for the unchanged folder" in str(refused.value)
    assert "\n" not in str(refused.value)
    assert (lake.snapshot().rows(LearnedModel) if lake.exists else []) == before


@pytest.mark.parametrize("origin", ["imported", "withdrawn", "bundled"])
def test_a_newer_export_with_other_figures_is_the_known_model(
    lake: Lake, tmp_path: Path, origin: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Figures that one side alone has are no difference, and those of the folder are not taken in."""
    first = folder(tmp_path / "first", measures=[FIGURE, FIGURE | {"metric": "a, b", "split": "c"}])
    if origin == "bundled":
        monkeypatch.setattr(models_of_lake, "shipped_models", lambda kind=None: iter([("small", ModelFolder(first))]))
    else:
        import_model(lake, first)
    if origin == "withdrawn":
        withdraw_model(lake, model_row().model_id, "by mistake")
    before = lake.snapshot().rows(ModelEvaluation) if lake.exists else []
    newer = [FIGURE | {"metric": "b", "split": "c, a", "value": 0.7}, FIGURE, FIGURE | {"metric": "n"}]
    row, is_new = import_model(lake, folder(tmp_path / "second", measures=newer))
    assert (row.model_id, is_new) == (model_row().model_id, origin == "withdrawn")
    assert (lake.snapshot().rows(ModelEvaluation) if lake.exists else []) == before


@pytest.mark.parametrize("is_known", [True, False])
def test_a_repeated_figure_is_refused(lake: Lake, tmp_path: Path, is_known: bool) -> None:
    if is_known:
        import_model(lake, folder(tmp_path / "first", measures=[FIGURE]))
    with pytest.raises(InputError, match=r"measures: item 2 repeats the figure selection, d, test, m; export the model again$"):
        import_model(lake, folder(tmp_path / "second", measures=[FIGURE | {"value": 0.9}, FIGURE]))


def test_a_bundled_model_is_the_same_after_export_and_import(lake: Lake, tmp_path: Path) -> None:
    for name, bundled in shipped_rows().items():
        export_model(None, name, tmp_path / name)
        assert import_model(lake, tmp_path / name) == (bundled, False)
    assert not lake.exists
    kinds = [folder_name for folder_name, _ in shipped_models()]
    assert len(kinds) == len(set(kinds)), "a bundled name stands for one model"


def test_an_id_that_begins_like_another_does_not_replace_it(lake: Lake, tmp_path: Path) -> None:
    config = changed("validation_share", 0.01)
    other = folder(tmp_path / "other", config=config)
    kept(lake, model_row(training_id=f"import-{model_row(config=config).model_id[:16]}", origin="imported"))
    with pytest.raises(InputError, match="begins like the id of another model"):
        import_model(lake, other)


@pytest.mark.parametrize("text", ["a\nb", "a\x1b[31m", "a\x00b", "a\u202eb", "a\tb", "a\u2066b"])
@pytest.mark.parametrize("field", ["license", "dataset", "architecture", "device", "notes", "measures"])
def test_texts_with_control_characters_are_refused(lake: Lake, tmp_path: Path, field: str, text: str) -> None:
    value: Any = {"notes": [text], "measures": [FIGURE | {"dataset": text}]}.get(field, text)
    with pytest.raises(InputError, match=f"{field}: .*control character") as refused:
        import_model(lake, folder(tmp_path / "m", **{field: value}))
    assert "\n" not in str(refused.value)
    assert text not in str(refused.value)


def test_a_model_that_is_withdrawn_and_imported_again_is_what_it_was(lake: Lake, tmp_path: Path) -> None:
    for path, value in (("seed", None), ("model.image", {"kind": "clip", "weights": "/of/this/machine"})):
        own = kept(lake, model_row(config=changed(path, value) if value else None, training_id=f"selection-{path[:5]}"))
        export_model(lake, own.model_id, tmp_path / path)
        withdraw_model(lake, own.model_id, "by mistake")
        row, is_new = import_model(lake, tmp_path / path)
        assert is_new
        assert row == dataclasses.replace(own, notes=("made up", "withdrawn: by mistake"))
        assert [each for each in lake.snapshot().rows(LearnedModel) if each.model_id == own.model_id] == [row]


def test_an_erasure_names_what_descends_from_what_it_names(lake: Lake) -> None:
    before = kept(lake, model_row(training_id="before"))
    stage_whole_scene(lake, "scannet/scene0000_00", 0, 0)
    lake.commit()
    now = lake.snapshot().snapshots[-1].snapshot_id
    assert before.snapshot_id is not None
    assert before.snapshot_id < now
    named: list[LearnedModel] = []
    cases: list[dict[str, Any]] = [{"snapshot_id": now, "is_withdrawn": True}, {"snapshot_id": None}, {"snapshot_id": 1}, {}]
    for number, values in enumerate(cases):
        config = changed("validation_share", 0.01 * (number + 1))
        parent = named[-1].model_id if named and values else before.model_id if not values else None
        origin = "imported" if number == 1 else "trained"
        named.append(kept(lake, model_row(config=config, training_id=f"t{number}", parent_id=parent, origin=origin, **values)))
    assert set(erase(lake, "scannet/scene0000_00", dry_run=True).models) == {named[1].model_id, named[2].model_id}


def test_other_bytes_at_the_same_path_are_another_training(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stage_whole_scene(lake, "scannet/scene0000_00", 0, 0)
    lake.commit()
    monkeypatch.setattr(training, "reads_of", lambda _: ("instances",))
    file, clip = tmp_path / "ulip.safetensors", tmp_path / "clip"
    clip.mkdir()
    file.write_bytes(b"one")
    (clip / "model.safetensors").write_bytes(b"one")

    def named(*settings: str) -> str:
        return planned_training(lake, system_configuration("selection", settings=settings)).training_id

    of_file = f"training.system.foreign={file}"
    of_folder = f'training.system.model.image={{kind="clip",weights="{clip}"}}'
    plain, first, second = named(), named(of_file), named(of_folder)
    assert (named(), named(of_file), named(of_folder)) == (plain, first, second)
    assert len({plain, first, second}) == 3
    file.write_bytes(b"two")
    (clip / "config.json").write_text("{}")
    assert named() == plain
    assert len({named(of_file), named(of_folder), first, second}) == 4
    file.unlink()
    with pytest.raises(InputError, match=r"training.system: foreign: .*ulip.safetensors cannot be read \(No such file"):
        named(of_file)


def test_the_content_of_a_file_is_its_hash_and_of_a_folder_that_of_names_and_files(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x").write_bytes(b"1")
    assert content_of(tmp_path / "a" / "x", "f") == hashlib.sha256(b"1").hexdigest()
    before = content_of(tmp_path / "a", "f")
    (tmp_path / "a" / "x").rename(tmp_path / "a" / "y")
    assert content_of(tmp_path / "a", "f") != before
    (tmp_path / "a" / "y").rename(tmp_path / "a" / "x")
    assert content_of(tmp_path / "a", "f") == before
