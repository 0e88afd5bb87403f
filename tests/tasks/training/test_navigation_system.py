"""The learned system `navigation` on rows: a policy out of episodes, the same after any interruption."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from schemas.errors import InputError
from schemas.evaluation import ACTIONS
from tasks.models import identity_json
from tasks.policy.augmentation import PictureAugmentation
from tasks.policy.corrections import CorrectionsConfig
from tasks.policy.inference.actor import load
from tasks.policy.model.objective import PolicyBatchConfig
from tasks.policy.model.shapes import shapes_of, vocabulary_in
from tasks.training.systems import navigation
from tasks.training.systems.navigation import NAVIGATION, NavigationTraining, PolicyFitting, train
from tasks.weights import from_safetensors
from tests.tasks.policy.policies import TINY
from tests.tasks.policy.rooms import Compass, context, dataset

torch = pytest.importorskip("torch")

FITTING = PolicyFitting(steps=6, warmup_steps=1, validate_steps=3, checkpoint_steps=2, record_steps=2, device="cpu")
CONFIG = NavigationTraining(TINY, batch=PolicyBatchConfig(windows=8, part_steps=2), fitting=FITTING, validation_share=0.3)
CORRECTED = dataclasses.replace(CONFIG, corrections=CorrectionsConfig(rounds=2, steps=4, episodes=2, max_steps=10))
ROWS, BLOBS = dataset(rooms=4)


class Interrupted(Exception):
    pass


@pytest.fixture(autouse=True)
def compass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(navigation, "sight_of", lambda data, context, model: Compass())


def trained(config: NavigationTraining = CONFIG, start: bytes | None = None, kept: dict | None = None, stop: int = 0, rows=ROWS):
    def report(done: int, of: int, text: str) -> None:
        if done == stop:
            raise Interrupted

    caches = {"tasks.training.fitting": {} if kept is None else kept, navigation.EYES_MEMORY: {}}
    return train(dataset=rows, start=start, context=context(BLOBS, caches, report=report), config=config)


@pytest.mark.parametrize("stops", [(5,), (3, 4), (7,), (9, 13)])
def test_a_policy_is_the_same_bytes_after_interruptions_also_between_rounds(stops: tuple[int, ...]) -> None:
    whole = trained(CORRECTED)
    kept: dict[str, bytes] = {}
    for stop in stops:
        with pytest.raises(Interrupted):
            trained(CORRECTED, kept=kept, stop=stop)
        assert kept
    again = trained(CORRECTED, kept=kept)
    assert again.weights == whole.weights
    assert [dataclasses.replace(point, seconds=0) for point in again.steps] == [
        dataclasses.replace(point, seconds=0) for point in whole.steps
    ]
    assert again.notes == whole.notes


def test_corrections_change_weights_and_are_told_of() -> None:
    plain, made = trained(), trained(CORRECTED)
    assert plain.weights != made.weights
    assert plain.weights == trained().weights
    assert [point.step for point in made.steps] == [2, 4, 6, 8, 10, 12, 14]
    assert sum(note.startswith("round ") for note in made.notes) == 2
    assert "not as published: 2 rounds of corrections of its own mistakes" in made.notes


def test_figures_are_of_rooms_that_were_not_learned_from_with_baselines() -> None:
    made = trained()
    assert made.examples == {"train": 12, "validation": 6, "test": 6}
    assert (made.architecture, made.license, made.is_fallback) == ("small", "CC0-1.0, MIT", True)
    figures = {(figure.split, figure.method, figure.metric): figure for figure in made.measures}
    for split in ("validation", "test"):
        whole = figures[split, "", "action_accuracy"]
        parts = [figures[split, "", f"accuracy_{name}"] for name in ACTIONS]
        assert whole.value == pytest.approx(sum(part.value * part.examples for part in parts) / whole.examples)
        assert whole.examples == sum(part.examples for part in parts)
        assert parts[ACTIONS.index("stop")].examples == 6
        most = max(parts, key=lambda part: part.examples)
        assert figures[split, "majority", "action_accuracy"].value == pytest.approx(most.examples / whole.examples)
        assert 0 < figures[split, "repeat", "action_accuracy"].value < 1
        assert {"action_accuracy_untold"} < {metric for part, method, metric in figures if part == split and not method}
    arrays = from_safetensors(made.weights)
    assert {str(array.dtype) for name, array in arrays.items() if name != "goal.vocabulary"} == {"float16"}
    assert set(vocabulary_in(arrays)) > {"", "chair", "table"}
    validations = [point.validation for point in made.steps if point.validation is not None]
    assert figures["validation", "", "action_accuracy"].value == pytest.approx(max(validations), abs=0.03)


def test_what_goes_on_keeps_its_goals_and_learns_further_ones() -> None:
    first = trained()
    named = [
        dataclasses.replace(row, category="armchair") if getattr(row, "category", "") == "chair" and hasattr(row, "actions") else row
        for row in ROWS._rows
    ]
    quick = dataclasses.replace(CONFIG, fitting=dataclasses.replace(FITTING, steps=1, learning_rate=1e-9, final_learning_rate=0.0))
    second = trained(quick, start=first.weights, rows=type(ROWS)("x", *named))
    before, after = from_safetensors(first.weights), from_safetensors(second.weights)
    known = vocabulary_in(before)
    assert tuple(vocabulary_in(after)) == (*known, "armchair")
    assert np.allclose(after["goal.vectors.weight"][: len(known)], before["goal.vectors.weight"], atol=1e-3)
    assert np.allclose(after["head.weight"], before["head.weight"], atol=1e-3)
    other = dataclasses.replace(CONFIG, model=dataclasses.replace(TINY, feedforward=8))
    with pytest.raises(InputError, match="take weights and config of one model"):
        trained(other, start=first.weights)


def test_nothing_goes_on_from_what_senses_something_else_though_its_weights_fit() -> None:
    deep = dataclasses.replace(CONFIG, model=dataclasses.replace(TINY, eyes=dataclasses.replace(TINY.eyes, depth=True)))
    sent = dataclasses.replace(CONFIG, model=dataclasses.replace(TINY, eyes=dataclasses.replace(TINY.eyes, goal=True)))
    assert shapes_of(deep.model, 3) == shapes_of(sent.model, 3)
    NAVIGATION.continues(identity_json(deep), deep, "model 0123")
    with pytest.raises(InputError, match="model 0123: senses_depth: is true of it, and false of what is to be trained"):
        NAVIGATION.continues(identity_json(deep), sent, "model 0123")


@pytest.mark.slow
@pytest.mark.whole
def test_a_few_walks_are_learned_by_heart_and_walked() -> None:
    """On the rooms that it learned from a policy tells every action, and acts as the expert does."""
    rows, blobs = dataset(rooms=1, episodes=4, tests=0)
    plain = PictureAugmentation(0, 0, 0, 0, 1.0, 0, 0, 0)
    fitting = PolicyFitting(steps=800, learning_rate=2e-3, warmup_steps=20, validate_steps=800, checkpoint_steps=800, device="cpu")
    model = dataclasses.replace(TINY, width=32, feedforward=64, dropout=0.0)
    config = NavigationTraining(model, batch=PolicyBatchConfig(windows=32), augmentation=plain, fitting=fitting, validation_share=0.0)
    made = train(dataset=rows, start=None, context=context(blobs), config=config)
    from tasks.policy.collection import collected

    data = collected(rows, context(blobs), config.walks, 0.0)
    actor, wrong = load(made.weights, model), 0
    for walk in data.train:
        actor.reset(1, [walk.category])
        for pose, action in zip(walk.poses, walk.targets, strict=True):
            wrong += int(actor.act(Compass()(walk.scene_id, pose[None]))[0] != action)
    assert wrong == 0
    assert made.examples == {"train": 4, "validation": 0, "test": 0}


def test_loading_processes_change_nothing() -> None:
    made = [
        trained(dataclasses.replace(CONFIG, fitting=dataclasses.replace(FITTING, workers=workers))).weights for workers in (0, 1)
    ]  # fmt: skip
    assert all(a == b for a, b in itertools.pairwise(made))
