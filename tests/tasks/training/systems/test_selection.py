"""The learned system `selection` on rows: examples out of a dataset, and a model out of examples."""

from __future__ import annotations

import dataclasses
import io
from datetime import UTC, datetime

import numpy as np
import pytest

from schemas.annotation import Annotation
from schemas.candidates import Asset
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.navigation import Split
from tasks.models import identity_json
from tasks.selection.model.batches import BatchConfig, predicted
from tasks.selection.model.collection import answers_of, collected
from tasks.selection.model.config import OwnImage, OwnText, SelectionModel, Small
from tasks.selection.model.inference import load
from tasks.selection.model.sight import config_from
from tasks.stage import Blobs, Context
from tasks.training.dataset import RowsInMemory
from tasks.training.systems.selection import SELECTION, SelectionFitting, SelectionTraining, network, train
from tests.tasks.selection.generated import generated_room

SMALL = Small(
    points=48,
    groups=8,
    group_size=6,
    dim=24,
    depth=1,
    heads=2,
    first_widths=(8, 16),
    second_widths=(16, 24),
    position_width=8,
    embedding=16,
    head_width=16,
)
MODEL = SelectionModel(
    SMALL, image=OwnImage(widths=(4, 6, 8)), text=OwnText(buckets=64, width=8), residual_points=32, residual_widths=(8, 12)
)
QUICK = SelectionTraining(
    MODEL, BatchConfig(objects=4), SelectionFitting(steps=4, validate_steps=2, warmup_steps=1, device="cpu"), validation_share=0.3
)


def jpeg(seed: int) -> bytes:
    import PIL.Image

    file = io.BytesIO()
    PIL.Image.fromarray(np.random.default_rng(seed).integers(0, 255, (20, 30, 3), dtype=np.uint8)).save(file, format="JPEG")
    return file.getvalue()


def answer(instance: Instance, choice: str | None, ranking: tuple[str, ...] = (), **more) -> Annotation:
    values = {"batch_id": "b", "annotator": "ann", "revision": 1, "is_simulated": False, "is_withdrawn": False} | more
    return Annotation(
        scene_id=instance.scene_id,
        instance_id=instance.instance_id,
        answered_at=datetime(2026, 1, 1, tzinfo=UTC),
        choice=choice,
        pose=None,
        scale=None,
        ranking=ranking,
        box_pose=instance.box_pose,
        box_size=instance.box_size,
        source_file="x.json",
        seconds=None,
        tool=None,
        **values,
    )


@pytest.fixture(scope="module")
def world():
    """Four scenes of one generated room, as if each were of a room of its own, with answers for every object: rows and blobs."""
    room = generated_room(count=4)
    blobs = Blobs()
    blobs.update(room.blobs)
    view = blobs.add(jpeg(0), "jpg")
    ranked = room.selections()
    rows: list[object] = list(room.assets)
    for number in range(4):
        scene = f"test/room{number}"
        rows.append(dataclasses.replace(_scene(), scene_id=scene, room_id=scene))
        rows.append(Split(room_id=scene, split="test" if number == 3 else "train"))
        for instance in room.instances:
            own = dataclasses.replace(instance, scene_id=scene, view_blob=view if instance.instance_id != "0001" else None)
            rows.append(own)
            best = [row.asset_id for row in ranked if row.instance_id == instance.instance_id][:3]
            rows.append(answer(own, best[0], tuple(best)))
        for table in (room.candidates, room.captions, ranked):
            rows += [dataclasses.replace(row, scene_id=scene) for row in table]
    return rows, blobs


def _scene() -> Scene:
    return Scene(
        scene_id="test/x",
        room_id="test/x",
        dataset="test",
        scan="x",
        scan_format="scannet",
        scan_path="x",
        alignment=tuple(np.eye(4).ravel()),
        alignment_source="identity",
        to_original=tuple(np.eye(4).ravel()),
        floor_tilt_radians=None,
        mesh_blob="0" * 64 + ".glb",
        vertex_count=3,
        face_count=1,
        frame_count=0,
        instance_count=4,
        segmentation="file",
        license="CC-BY-4.0",
    )


def context(blobs: Blobs, seed: int = 0) -> Context:
    return Context("t1", "training", seed, blobs)


def test_examples_are_split_by_room_and_hold_what_the_rows_say(world) -> None:
    rows, blobs = world
    data = collected(RowsInMemory("made up", *rows), context(blobs), MODEL, 0.2)
    assert {e.room_id for e in data.train} == {f"test/room{i}" for i in range(3)}
    assert {e.room_id for e in data.test} == {"test/room3"}
    assert len(data.train) == 12
    assert data.license.startswith("CC-BY-4.0")
    selections = {(r.scene_id, r.instance_id, r.slot): r for r in rows if type(r).__name__ == "Selection"}
    for example in data.train:
        own = sorted((k[2], r) for k, r in selections.items() if k[:2] == (example.scene_id, example.instance_id))
        assert [c.asset_id for c in example.candidates] == [r.asset_id for _, r in own]
        chosen = next(
            r for r in rows if isinstance(r, Annotation) and (r.scene_id, r.instance_id) == (example.scene_id, example.instance_id)
        )
        assert example.candidates[example.choice].asset_id == chosen.choice
        for (_, row), contender in zip(own, example.contenders(data.clouds), strict=True):
            instance = next(
                r for r in rows if isinstance(r, Instance) and (r.scene_id, r.instance_id) == (example.scene_id, example.instance_id)
            )
            world_points = (
                contender.cloud.points.astype(np.float64) * row.scale @ np.reshape(row.pose, (4, 4))[:3, :3].T
                + np.reshape(row.pose, (4, 4))[:3, 3]
            )
            box = np.reshape(instance.box_pose, (4, 4))
            local = (world_points - box[:3, 3]) @ box[:3, :3] + [0, 0, 0.5 * instance.box_size[2]]
            assert np.abs(local - contender.placed().points).max() < 2e-3 * max(1.0, np.abs(local).max())
    assert (data.train[1].scanned.image is None) == (data.train[1].instance_id == "0001")


def test_what_was_cut_from_a_scan_has_the_license_of_that_scan(world) -> None:
    rows, blobs = world
    crops = [
        dataclasses.replace(row, license="LicenseRef-scan", source="scan test/room1") if isinstance(row, Asset) else row for row in rows
    ]
    assert collected(RowsInMemory("a", *crops), context(blobs), MODEL, 0.2).license == "CC-BY-4.0"
    bare = [dataclasses.replace(row, license=None) if isinstance(row, Scene) and row.scene_id == "test/room1" else row for row in crops]
    assert collected(RowsInMemory("a", *bare), context(blobs), MODEL, 0.2).license == "CC-BY-4.0, unknown"


def test_point_clouds_are_made_once_for_each_content(world) -> None:
    rows, blobs = world
    first = context(blobs)
    one = collected(RowsInMemory("a", *rows), first, MODEL, 0.2)
    again = dataclasses.replace(first, blobs={k: v for k, v in blobs.items() if not k.endswith(".glb")})
    two = collected(RowsInMemory("a", *rows), again, MODEL, 0.2)
    assert one.clouds == two.clouds
    assert len(one.clouds) > 5


def test_of_answers_the_last_revision_counts_and_people_before_programs() -> None:
    room = generated_room(count=4)
    a, b, c = (f"{i:064x}" for i in range(3))
    one, two, three, four = room.instances[:4]
    rows = [
        answer(one, a, revision=2),
        answer(one, b),
        answer(one, c, annotator="bot", is_simulated=True),
        answer(two, a, (b, a, c), is_simulated=True),
        answer(three, None),
        answer(three, c, annotator="bot", is_simulated=True),
        answer(four, a),
        answer(four, a, revision=2, is_withdrawn=True),
    ]
    answers, simulated = answers_of(RowsInMemory("x", *rows))
    assert answers == {(one.scene_id, one.instance_id): [(a,)], (two.scene_id, two.instance_id): [(a, b, c)]}
    assert simulated == {(two.scene_id, two.instance_id)}


def test_without_a_choice_training_says_what_to_do() -> None:
    with pytest.raises(InputError, match="has no choice that counts"):
        train(dataset=RowsInMemory("x"), start=None, context=context(Blobs()), config=QUICK)


@pytest.mark.whole
def test_a_model_is_trained_and_scores_without_torch_what_its_figures_say(world) -> None:
    pytest.importorskip("torch")
    rows, blobs = world
    trained = train(dataset=RowsInMemory("x", *rows), start=None, context=context(blobs), config=QUICK)
    again = train(dataset=RowsInMemory("x", *rows), start=None, context=context(blobs), config=QUICK)
    assert trained.weights == again.weights
    other = train(dataset=RowsInMemory("x", *rows), start=None, context=context(blobs, 1), config=QUICK)
    assert trained.weights != other.weights
    assert trained.examples == {"train": 8, "validation": 4, "test": 4}
    config = config_from(identity_json(QUICK))
    assert config == MODEL
    scorer = load(trained.weights, config)
    data = collected(RowsInMemory("x", *rows), context(blobs), MODEL, 0.2)
    right = [int(scorer.score(e.scanned, e.contenders(data.clouds)).argmax()) == e.choice for e in data.test]
    figure = next(m for m in trained.measures if (m.split, m.metric) == ("test", "top_1"))
    assert (figure.value, figure.examples) == (np.mean(right), 4)
    assert trained.is_fallback
    assert any("stands in" in note for note in trained.notes)
    module = network(MODEL, 0)
    assert trained.parameter_count == sum(p.numel() for p in module.parameters())
    more = train(dataset=RowsInMemory("x", *rows), start=trained.weights, context=context(blobs), config=QUICK)
    assert more.weights != trained.weights
    with pytest.raises(InputError, match="does not fit"):
        train(
            dataset=RowsInMemory("x", *rows),
            start=trained.weights,
            context=context(blobs),
            config=dataclasses.replace(QUICK, model=dataclasses.replace(MODEL, extents=False)),
        )
    assert SELECTION.config is SelectionTraining
    assert len(predicted(module, data.test, data.clouds)) == 4
