"""Settings of policies: JSON there and back, and what cannot be."""

from __future__ import annotations

import json

import pytest

from schemas.errors import InputError
from tasks.models import identity_json
from tasks.policy.model.config import AgentCamera, OwnEyes, PaperPolicy, SmallPolicy, config_from
from tasks.policy.model.presets import PRESETS
from tasks.policy.model.shapes import vocabulary_in, vocabulary_of
from tasks.settings import adapter
from tasks.training.systems.navigation import NAVIGATION, NavigationTraining, preset
from tests.tasks.policy.policies import MODELS


@pytest.mark.parametrize("name", [*PRESETS, *MODELS])
def test_settings_are_the_same_after_json(name: str) -> None:
    training = preset(name) if name in PRESETS else NavigationTraining(MODELS[name])
    text = identity_json(training)
    assert config_from(text) == training.model
    again = adapter(NavigationTraining).validate_python(json.loads(text))
    assert identity_json(again) == text


def test_the_paper_is_as_printed_and_the_small_one_is_small() -> None:
    paper = preset("paper")
    model = paper.model
    assert (model.fusion_layers, model.decoder_layers, model.window, model.width, model.heads, model.feedforward) == (
        3,
        3,
        10,
        512,
        8,
        2048,
    )
    assert (paper.batch.windows, paper.fitting.learning_rate, paper.fitting.final_learning_rate, paper.fitting.steps) == (
        256, 1e-4, 1e-4, 70_000,
    )  # fmt: skip
    assert (paper.walks.train_episodes, paper.walks.test_episodes, model.tokens) == (100, 50, 84)
    assert (SmallPolicy().tokens, SmallPolicy().width, SmallPolicy().window, preset("small").batch.stop_weight) == (16, 64, 10, 3.0)
    assert preset("small").batch.last_dropout == 0.5
    with pytest.raises(KeyError):
        preset("none")


def test_a_word_names_the_size() -> None:
    assert adapter(NavigationTraining).validate_python({"model": "paper"}).model == PaperPolicy()


def test_sizes_that_do_not_go_together_are_refused() -> None:
    with pytest.raises(ValueError, match="width: 64 channels are not shared by 5 heads"):
        SmallPolicy(heads=5)
    with pytest.raises(ValueError, match="pictures of 60 x 64 pixels do not divide into patches of 16"):
        SmallPolicy(camera=AgentCamera(60, 64))
    with pytest.raises(ValueError, match="or these into parts of 5"):
        SmallPolicy(eyes=OwnEyes(part=5))
    with pytest.raises(InputError, match="is not that of a policy"):
        config_from("{}")


def test_files_that_settings_name_are_known() -> None:
    training = adapter(NavigationTraining).validate_python(
        {"foreign": "/x", "model": {"kind": "paper", "eyes": {"kind": "siglip", "weights": "/y"}}}
    )
    assert NAVIGATION.paths(training) == {"foreign": "/x", "model.eyes.weights": "/y"}
    assert NAVIGATION.paths(NavigationTraining()) == {}


def test_goals_are_known_by_place_and_strangers_are_one() -> None:
    goals = vocabulary_of(["mug", "chair", "mug", ""])
    assert tuple(goals) == ("", "chair", "mug")
    assert [goals.place(name) for name in ("chair", "mug", "piano", "")] == [1, 2, 0, 0]
    assert vocabulary_in({"goal.vocabulary": goals.array()}) == goals
    for text in (b'["a"]', b'["", "a", "a"]', b"{}", b'["", 1]', b"\xff"):
        import numpy as np

        with pytest.raises(InputError, match="is no vocabulary"):
            vocabulary_in({"goal.vocabulary": np.frombuffer(text, dtype=np.uint8)})
    with pytest.raises(InputError, match="is missing"):
        vocabulary_in({})
