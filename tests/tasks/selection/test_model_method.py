"""The scores of a learned model in use: of the same sight that it is trained on."""

from __future__ import annotations

import dataclasses
import json
import pickle
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from schemas.annotation import Annotation
from schemas.captions import Caption
from schemas.capture import Scene
from schemas.errors import InputError
from tasks.geometry.transforms import yaw_pose
from tasks.selection import STAGE, ScoreConfig, SelectionConfig
from tasks.selection.evidence import gather
from tasks.selection.methods.geometric import Geometric
from tasks.selection.methods.model import ModelScores, contenders_of, scanned_of, score
from tasks.selection.model.collection import collected
from tasks.selection.model.inference import load
from tasks.selection.model.sight import remember_clouds, surface_cloud
from tasks.settings import plain
from tasks.stage import Context, WantedModel
from tasks.training.dataset import RowsInMemory
from tests.samples import sample
from tests.tasks.selection.drawn import CONFIG, drawn_model
from tests.tasks.selection.rooms import RED, SCENE, Room, cabinet, chair, photographed, scan, shelf, table


@pytest.fixture(scope="module")
def room() -> Room:
    made, pose = Room(), yaw_pose(0.4)
    points, colors = scan(chair(RED), pose, (1, 1, 1), np.random.default_rng(0), view=0.4)
    instance = made.instance(points, colors, 0.4, category="chair")
    offered = ((table(), "library"), (chair(RED), "library"), (cabinet(), "scan_crop_closed"), (shelf(), "library"))
    for slot, (parts, provider) in enumerate(offered, start=1):
        made.candidate(instance, slot, made.asset(parts, "chair" if slot == 2 else f"model {slot}", provider), provider)
    photographed(made, instance, chair(RED), pose, (2.4, 1.3, 1.6))
    made.captions.append(sample(Caption, scene_id=SCENE, instance_id="0000", sentence="A red chair of wood."))
    return made


def by_model() -> SelectionConfig:
    return SelectionConfig(provider=ModelScores(within=1.0))


def test_rows_say_which_model_scored_and_scores_are_its_chances(room: Room) -> None:
    model = drawn_model()
    rows, degradations = room.select(by_model(), model=model)
    assert degradations == ()
    assert {(row.provider, row.provider_version) for row in rows} == {("model", f"2:{model.model_id[:12]}")}
    assert sum(row.score for row in rows) == pytest.approx(1.0)
    query, candidates = _gathered(room)
    logits = load(model.weights, CONFIG).score(scanned_of(query, CONFIG), contenders_of(query, candidates, CONFIG))
    powers = np.exp(logits - logits.max())
    expected = dict(zip((each.candidate.slot for each in candidates), powers / powers.sum(), strict=True))
    assert {row.slot: row.score for row in rows} == pytest.approx(expected, abs=1e-9)
    assert len({round(row.score, 6) for row in rows}) == 4


def test_what_fits_badly_does_not_compete_with_what_fits(room: Room) -> None:
    """At every limit: those that near to the best geometric score share out what lies between by their chances among each other, and the
    rest keep their scores: none is farther from its own than the limit."""
    model = drawn_model()
    fits = {row.slot: row.score for row in room.select()[0]}
    chances = {row.slot: row.score for row in room.select(by_model(), model=model)[0]}
    best = max(fits.values())
    assert len(set(fits.values())) == len(fits)
    for limit in (0.0, *sorted(best - fit + 1e-9 for fit in fits.values()), 0.999):
        rows, _ = room.select(SelectionConfig(provider=ModelScores(within=limit)), model=model)
        competes = {slot for slot, fit in fits.items() if fit >= best - limit}
        total = sum(chances[slot] for slot in competes)
        least = max(best - limit, 0.0)
        wanted = {slot: least + (best - least) * chances[slot] / total if slot in competes else fit for slot, fit in fits.items()}
        assert {row.slot: row.score for row in rows} == pytest.approx(wanted)
        if limit:
            assert rows[0].slot == max(competes, key=lambda slot: chances[slot])
        assert all(abs(row.score - fits[row.slot]) <= limit + 1e-9 for row in rows)
        assert {row.provider_version for row in rows} == {f"2:{model.model_id[:12]}:{limit!r}"}


@pytest.mark.parametrize("within", [0.05, 0.5, 0.999])
def test_scores_of_what_hardly_fits_are_none_below_zero(within: float) -> None:
    """A cabinet's scan, of which the candidates are a chair and a table of its size: rows are sound, and so is a score of nothing."""
    made = Room()
    points, colors = scan(cabinet(), yaw_pose(0.4), (1, 1, 1), np.random.default_rng(0))
    instance = made.instance(points, colors, 0.4, category="cabinet")
    for slot, parts in enumerate((chair(RED), table(), shelf()), start=1):
        made.candidate(instance, slot, made.asset(parts, f"model {slot}"))
    model = drawn_model()
    rows, _ = made.select(SelectionConfig(provider=ModelScores(within=within), score=ScoreConfig(falloff=0.001)), model=model)
    assert all(0.0 <= row.score <= 1.0 for row in rows)
    fits = [row.score for row in made.select(SelectionConfig(provider=Geometric(), score=ScoreConfig(falloff=0.001)))[0]]
    assert max(fits) < 0.999
    query, candidates = _gathered(made)
    poor = [dataclasses.replace(each, geometric=0.02) for each in candidates]
    assert (score(query, poor, ModelScores(within=within), model) >= 0.0).all()


def test_another_model_scores_otherwise_and_geometry_stays_as_it_was(room: Room) -> None:
    first, second = (room.select(by_model(), model=drawn_model(seed))[0] for seed in (0, 1))
    assert {row.slot: row.score for row in first} != {row.slot: row.score for row in second}
    assert room.select(SelectionConfig(provider=Geometric()), model=drawn_model())[0] == room.select()[0]


def test_what_is_seen_in_use_is_what_was_seen_in_training(room: Room) -> None:
    """From the rows that selection left and an answer, training collects the same arrays, to the last bit but for poses."""
    rows, _ = room.select()
    answer = Annotation(
        batch_id="b1", scene_id=SCENE, instance_id="0000", annotator="a", revision=1, answered_at=datetime(2026, 1, 1, tzinfo=UTC),
        choice=rows[0].asset_id, pose=None, scale=None, ranking=(), box_pose=room.instances[0].box_pose,
        box_size=room.instances[0].box_size, source_file="a.json", seconds=None, is_withdrawn=False, tool=None, is_simulated=True,
    )  # fmt: skip
    scene = sample(Scene, scene_id=SCENE, room_id="test/somewhere")
    context = Context(SCENE, "selection", 0, room.blobs)
    dataset = RowsInMemory("rows", scene, *room.instances, *room.candidates, *room.assets.values(), *room.captions, *rows, answer)
    (example,) = collected(dataset, context, CONFIG, 0.0).train
    query, candidates = _gathered(room)
    scanned, contenders = scanned_of(query, CONFIG), contenders_of(query, candidates, CONFIG)
    for name in ("points", "colors"):
        assert (getattr(example.scanned.cloud, name) == getattr(scanned.cloud, name)).all()
    assert (example.scanned.extents == scanned.extents).all()
    assert (example.scanned.category, example.scanned.caption) == (scanned.category, scanned.caption) == ("chair", "A red chair of wood.")
    assert example.scanned.image is not None
    assert scanned.image is not None
    assert (example.scanned.image == scanned.image).all()
    clouds = collected(dataset, context, CONFIG, 0.0).clouds
    for learned, used in zip(example.contenders(clouds), contenders, strict=True):
        assert (learned.cloud.points == used.cloud.points).all()
        assert (learned.evidence == used.evidence).all()
        assert (learned.extents == used.extents).all()
        assert (learned.scale == used.scale).all()
        assert np.allclose(learned.pose, used.pose, atol=1e-9)
    model = drawn_model()
    scorer = load(model.weights, CONFIG)
    assert scorer.score(example.scanned, example.contenders(clouds)) == pytest.approx(scorer.score(scanned, contenders), abs=1e-4)


def test_a_crop_that_cannot_be_read_is_no_reason_to_ask_somebody_else(room: Room) -> None:
    broken = dataclasses.replace(room.instances[0], view_blob=room.blobs.add(b"no picture", "jpg"))
    gone = dataclasses.replace(room.instances[0], view_blob=None)
    scores = []
    for instance in (broken, gone):
        made = Room()
        made.__dict__.update(room.__dict__ | {"instances": [instance]})
        rows, degradations = made.select(by_model(), model=drawn_model())
        assert {row.provider for row in rows} == {"model"}
        assert degradations == ()
        scores.append([row.score for row in rows])
    assert scores[0] == scores[1]


def test_weights_that_do_not_fit_their_config_are_refused(room: Room) -> None:
    model = drawn_model()
    other = dataclasses.replace(model, model_id="0" * 64, config=json.dumps({"model": plain(dataclasses.replace(CONFIG, quality=False))}))
    with pytest.raises(InputError, match="model 000000000000"):
        room.select(by_model(), model=other)


def test_the_stage_says_which_model_it_wants() -> None:
    assert STAGE.outside == ("model",)
    assert STAGE.model_wanted is not None
    assert STAGE.model_wanted(SelectionConfig()) is None
    assert STAGE.model_wanted(SelectionConfig(provider=ModelScores("small"))) == WantedModel("selection", "small")
    assert STAGE.model_wanted(by_model()) == WantedModel("selection", "")
    assert STAGE.model_wanted(SelectionConfig(provider=ModelScores(model_id="ab12"))) == WantedModel("selection", "ab12")


def test_clouds_that_are_made_at_once_are_those_that_are_made_when_asked_for(room: Room) -> None:
    blobs = dict(room.blobs) | {"broken.glb": b"glTF"}
    names = [asset.mesh_blob for asset in room.assets.values()]
    parted: list[int] = []

    def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        parted.append(len(items))
        return [function(pickle.loads(pickle.dumps(item))) for item in items]

    memory: dict[str, bytes] = {}
    remember_clouds([*names, "broken.glb", "gone.glb"], Context(SCENE, "selection", 0, blobs, spread=spread), CONFIG, memory)
    assert memory == {key: value for name in names for key, value in _clouds_of(name, blobs).items()}
    remember_clouds(names, Context(SCENE, "selection", 0, blobs, spread=spread), CONFIG, memory)
    assert parted[1] == 0, "what is known is not made again"


def _clouds_of(name: str, blobs: Mapping[str, bytes]) -> dict[str, bytes]:
    alone: dict[str, bytes] = {}
    surface_cloud(name, blobs, CONFIG, alone)
    return alone


def _gathered(room: Room):
    context = Context(SCENE, "selection", 0, room.blobs)
    gathered = gather(
        room.instances, room.candidates, list(room.assets.values()), context, SelectionConfig(), [], captions=room.captions,
        frames=room.frames, masks=room.masks,
    )  # fmt: skip
    return next(iter(gathered))
