"""The learned system `synthesis` on rows: layouts out of a dataset, and a model out of layouts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from schemas.capture import Scene
from schemas.errors import InputError
from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.navigation import Split
from tasks.models import identity_json
from tasks.stage import Blobs, Context
from tasks.synthesis.model.config import Atiss, ClipText, DiffuScene, LearnedText, Noise, PhyScene, SynthesisModel, Transformer, config_from
from tasks.synthesis.model.encoding import encoding_in
from tasks.synthesis.model.presets import PRESETS
from tasks.training.dataset import RowsInMemory
from tasks.training.systems.synthesis import SYNTHESIS, SynthesisFitting, SynthesisTraining, collected, held_out, opened, preset, train
from tasks.weights import from_safetensors, to_safetensors
from tests.tasks.synthesis.drawn_layouts import layouts

torch = pytest.importorskip("torch")

TEXT = LearnedText(width=8)
MODELS: dict[str, SynthesisModel] = {
    "atiss": Atiss(slots=5, text=TEXT, embedding=4, layers=1, heads=2, feedforward=16, mixtures=2),
    "diffuscene": DiffuScene(slots=5, text=TEXT, architecture=Transformer(16, 1, 2, 16), noise=Noise(steps=20)),
    "physcene": PhyScene(slots=5, text=TEXT, architecture=Transformer(16, 1, 2, 16), noise=Noise(steps=20), classes="all"),
}
FITTING = SynthesisFitting(steps=6, warmup_steps=1, validate_steps=3, checkpoint_steps=2, record_steps=2, averaging=0.5, device="cpu")


def training(name: str, **changes) -> SynthesisTraining:
    return dataclasses.replace(SynthesisTraining(MODELS[name], 8, FITTING, validation_share=0.3), **changes)


def scene(scene_id: str, license_: str) -> Scene:
    return Scene(
        scene_id=scene_id, room_id=scene_id, dataset="test", scan="x", scan_format="scannet", scan_path="x",
        alignment=tuple(np.eye(4).ravel()), alignment_source="identity", to_original=tuple(np.eye(4).ravel()),
        floor_tilt_radians=None, mesh_blob="0" * 64 + ".glb",
        vertex_count=3, face_count=1, frame_count=0, instance_count=4, segmentation="file", license=license_,
    )  # fmt: skip


def rows_of(count: int = 24) -> list[object]:
    """A micro-scene in each of so many rooms; every fourth room is a test room."""
    rows: list[object] = []
    for number, layout in enumerate(layouts(count, most=7)):
        name = f"test/room{number}"
        rows += [scene(name, "CC-BY-4.0" if number % 2 else "MIT"), Split(room_id=name, split="test" if number % 4 == 0 else "train")]
        rows.append(
            MicroScene(
                scene_id=name, instance_id="0000", room_id=name, room_index=0, room_type=layout.large.room_type,
                category=layout.large.category, word=layout.large.category, asset_id="0" * 64, frame_pose=tuple(np.eye(4).ravel()),
                box_size=layout.large.size, object_count=len(layout),
            )
        )  # fmt: skip
        for place, category in enumerate(layout.categories):
            rows.append(
                MicroSceneObject(
                    scene_id=name, large_id="0000", instance_id=f"{place + 1:04d}", category=category, word=category, asset_id="0" * 64,
                    parent_id="0000", relation="on", depth=1, box_center=tuple(layout.centers[place]), box_size=tuple(layout.sizes[place]),
                    yaw_radians=float(layout.yaws[place]), tilt_radians=0.0,
                )
            )  # fmt: skip
    return rows


DATASET = RowsInMemory("snapshot 1", *rows_of())


class Interrupted(Exception):
    pass


def context(caches=None, stop: int = 0, seed: int = 0) -> Context:
    def report(done: int, of: int, text: str) -> None:
        if done == stop:
            raise Interrupted

    made = Context("training", "training", seed, Blobs(), report=report)
    return made if caches is None else dataclasses.replace(made, caches={"tasks.training.fitting": caches})


def trained(name: str, start: bytes | None = None, **changes):
    return train(dataset=DATASET, start=start, context=context(), config=training(name, **changes))


def test_layouts_are_split_by_room_and_carry_the_licenses_of_their_scans() -> None:
    data = collected(DATASET, 0.2)
    assert (len(data.train), len(data.test), data.license) == (18, 6, "CC-BY-4.0, MIT")
    assert {room for room, _ in data.test} == {f"test/room{number}" for number in range(0, 24, 4)}
    assert sorted(len(layout) for _, layout in data.train + data.test) == sorted(len(layout) for layout in layouts(24, most=7))
    without = RowsInMemory("x", *(row for row in rows_of() if not isinstance(row, Split)))
    learning, held = held_out(data.train, 0.3)
    assert held
    assert len(learning) + len(held) == 18
    twice = [(room, layout) for room, layout in data.train for _ in range(2)]
    assert [len(part) for part in held_out(twice, 0.3)] == [2 * len(learning), 2 * len(held)]
    assert not held_out(data.train, 0.0)[1]
    assert len(held_out(data.train, 1.0)[0]) == 1
    assert not held_out(data.train[:1], 0.5)[1]
    # what is held out by names is no part of what is held out for tests by names
    assert len(held_out(collected(without, 0.5).train, 0.3)[1]) == round(0.3 * len(collected(without, 0.5).train))
    assert len(collected(without, 0.0).train) == 24
    with pytest.raises(InputError, match="has none in a training room"):
        collected(without, 1.0)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_a_model_is_the_same_twice_and_after_an_interruption_and_opens_itself(name: str) -> None:
    config = training(name)
    made = trained(name)
    kept: dict[str, bytes] = {}
    with pytest.raises(Interrupted):
        train(dataset=DATASET, start=None, context=context(kept, stop=5), config=config)
    assert kept
    again = train(dataset=DATASET, start=None, context=context(kept), config=config)
    assert again.weights == made.weights
    assert trained(name, fitting=dataclasses.replace(FITTING, averaging=0.0)).weights != made.weights
    arrays = from_safetensors(made.weights)
    encoding = encoding_in(arrays)
    assert {*encoding.small} == {"mug", "monitor", "book"}
    assert (len(encoding.classes) == 60) == (name == "physcene")
    assert all(values.dtype == np.float16 for key, values in arrays.items() if not key.startswith("encoding."))
    assert config_from(identity_json(config)) == config.model
    module, _ = opened(made.weights, config.model)
    assert sum(values.numel() for values in module.parameters()) == made.parameter_count
    assert made.examples == {"train": 18 - made.examples["validation"], "validation": made.examples["validation"], "test": 6}
    figures = {(figure.split, figure.metric): figure.value for figure in made.measures}
    assert {split for split, _ in figures} == {"validation", "test"}
    assert all(np.isfinite(value) for value in figures.values())
    # figures are of the weights as they are kept: half precision, and the mean
    assert figures["validation", "loss"] == pytest.approx(-max(p.validation for p in made.steps if p.validation is not None), rel=1e-2)
    assert made.is_fallback
    assert any("stand in for CLIP's" in note for note in made.notes)
    assert any("have more than 4 small objects" in note for note in made.notes)
    assert any(note.startswith("not as published: ") for note in made.notes)


def test_what_goes_on_keeps_its_vocabulary_and_leaves_out_what_that_lacks() -> None:
    made = trained("atiss")
    more = [
        dataclasses.replace(row, category="kettle") if isinstance(row, MicroSceneObject) and row.scene_id.endswith("m1") else row
        for row in rows_of()
    ]
    on = train(dataset=RowsInMemory("x", *more), start=made.weights, context=context(), config=training("atiss"))
    assert encoding_in(from_safetensors(on.weights)).arrays()["encoding.vocabulary"].tobytes() == (
        encoding_in(from_safetensors(made.weights)).arrays()["encoding.vocabulary"].tobytes()
    )
    assert sum(on.examples.values()) == 23
    assert any("1 micro-scenes" in note and "left out" in note for note in on.notes)
    assert on.weights != made.weights


def test_settings_that_cannot_be_trained_are_refused_before_the_first_step() -> None:
    made = trained("atiss")
    config = training("atiss")
    other = dataclasses.replace(config, model=dataclasses.replace(config.model, heights="middles"))
    with pytest.raises(InputError, match=r"system\.model\.heights: is 'middles', but the weights to begin with tell bottoms"):
        train(dataset=RowsInMemory("x", *rows_of()), start=made.weights, context=context(), config=other)
    config = training("physcene")
    odd = dataclasses.replace(config.model, architecture=dataclasses.replace(config.model.architecture, waves=3))
    with pytest.raises(InputError, match="2 sines and cosines do not share 3 channels"):
        train(dataset=RowsInMemory("x", *rows_of()), start=None, context=context(), config=dataclasses.replace(config, model=odd))


def test_weights_and_config_of_two_models_do_not_go_together() -> None:
    made = trained("atiss")
    SYNTHESIS.fits(made.weights, training("atiss"), "file")
    with pytest.raises(InputError, match="take weights and config of one model"):
        SYNTHESIS.fits(made.weights, training("diffuscene"), "file")
    with pytest.raises(InputError, match="is missing"):
        SYNTHESIS.fits(to_safetensors({"query": np.zeros(3)}), training("atiss"), "file")
    with pytest.raises(InputError, match="is not that of a synthesis model"):
        config_from("{}")


def test_presets_have_what_was_published_or_say_so() -> None:
    for name in PRESETS:
        config = preset(name)
        assert config.model == PRESETS[name]
        assert identity_json(config)
        assert config.fitting.averaging == (0.0 if name.endswith("-paper") else 0.998)
    assert (preset("atiss-paper").scenes, preset("atiss-paper").fitting.learning_rate) == (128, 1e-4)
    assert preset("physcene-paper").model.noise.target == "eps"
    assert preset("atiss", FITTING).fitting == FITTING
    with pytest.raises(KeyError):
        preset("none")
    assert SYNTHESIS.paths(training("atiss", foreign="/x/y")) == {"foreign": "/x/y"}


def test_clips_vectors_are_kept_with_the_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    from tasks.selection.methods import encoders

    class Fake:
        def texts(self, texts):
            said.extend(texts)
            return np.stack([np.random.default_rng(len(text)).normal(size=6) for text in texts]).astype(np.float32)

    said: list[str] = []
    monkeypatch.setattr(encoders, "clip_in", lambda folder: Fake() if folder == "/clip" else None)
    model = dataclasses.replace(MODELS["atiss"], text=ClipText("/clip", 6))
    made = trained("atiss", model=model)
    assert not made.is_fallback
    assert not any("CLIP" in note for note in made.notes)
    assert said == [f"A {large} in the {room}" for large in ("desk", "table") for room in ("room", "kitchen", "office")]
    table = from_safetensors(made.weights)["text.table"]
    expected = np.random.default_rng(len("A table in the office")).normal(size=6) * np.sqrt(6)
    np.testing.assert_allclose(table[1, 2], expected, rtol=1e-2)
    opened(made.weights, model)
    assert SYNTHESIS.paths(training("atiss", model=model)) == {"model.text.weights": "/clip"}
    with pytest.raises(InputError, match="is 8 wide, but its CLIP 6"):
        trained("atiss", model=dataclasses.replace(model, text=ClipText("/clip", 8)))
