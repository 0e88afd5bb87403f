"""Frozen eyes and goals by SigLIP, of a tiny one with random weights: as transformers has them, and each picture encoded once."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.policy.augmentation import PictureAugmentation
from tasks.policy.corrections import CorrectionsConfig
from tasks.policy.inference.actor import load
from tasks.policy.model.config import SiglipEyes, SiglipGoal
from tasks.policy.model.frozen import INSTRUCTION, states_of, tokens_of
from tasks.policy.model.objective import PolicyBatchConfig
from tasks.policy.model.shapes import vocabulary_of
from tasks.stage import Blobs
from tasks.training.systems.navigation import NavigationTraining, PolicyFitting, train, trained_on
from tests.tasks.policy.policies import TINY, drawn_pictures
from tests.tasks.policy.rooms import Compass, context, dataset, walks

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tests.tasks.selection.model.test_foreign import saved_pair

    made = tmp_path_factory.mktemp("siglip")
    saved_pair(made, "siglip")
    return made


def model_of(folder: Path):
    goal = SiglipGoal(str(folder), 16, 17)
    return dataclasses.replace(TINY, eyes=SiglipEyes(str(folder), 16, (3, 2)), goal=goal)


def test_tokens_are_pooled_patches_and_each_picture_is_encoded_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    eyes, memory = SiglipEyes(str(folder), 16, (3, 2)), {}
    pictures = np.random.default_rng(0).integers(0, 256, (3, 32, 32, 3), dtype=np.uint8)
    made = tokens_of(pictures, eyes, memory)
    assert (made.shape, made.dtype, len(memory)) == ((3, 6, 16), np.float16, 3)
    vision = transformers.SiglipVisionModel.from_pretrained(folder).eval()
    with torch.no_grad():
        states = vision(pixel_values=torch.from_numpy(pictures).permute(0, 3, 1, 2).float() / 127.5 - 1).last_hidden_state
    plane = states.transpose(1, 2).reshape(3, 16, 4, 4)
    assert np.allclose(made[..., 0], torch.nn.functional.adaptive_avg_pool2d(plane, (3, 2)).flatten(2).transpose(1, 2)[..., 0], atol=2e-3)
    monkeypatch.setattr("tasks.policy.model.frozen.VisionTokens.tokens", lambda *_: pytest.fail("encoded again"))
    assert np.array_equal(tokens_of(pictures[::-1], eyes, memory), made[::-1])


def test_goals_are_states_of_instructions_and_the_pooled_one(folder: Path) -> None:
    goals = vocabulary_of(["mug", "lamp"])
    states = states_of(goals, SiglipGoal(str(folder), 16, 17))
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    text = transformers.SiglipTextModel.from_pretrained(folder).eval()
    read = tokenizer([INSTRUCTION.format("mug")], padding="max_length", truncation=True, max_length=16, return_tensors="pt")
    with torch.no_grad():
        goal_tokens = text(input_ids=read["input_ids"])
    assert np.allclose(states[2, :16], goal_tokens.last_hidden_state[0], atol=1e-6)
    assert np.allclose(states[2, 16], goal_tokens.pooler_output[0], atol=1e-6)
    assert not states[0].any()
    with pytest.raises(InputError, match="states have the shape"):
        states_of(goals, SiglipGoal(str(folder), 16, 9))


def test_a_policy_with_frozen_eyes_trains_acts_and_is_corrected(folder: Path) -> None:
    model = model_of(folder)
    fitting = PolicyFitting(steps=3, warmup_steps=1, validate_steps=2, checkpoint_steps=2, device="cpu")
    config = NavigationTraining(
        model, batch=PolicyBatchConfig(windows=4), augmentation=PictureAugmentation(versions=2), fitting=fitting, validation_share=0.3,
        corrections=CorrectionsConfig(rounds=1, steps=2, episodes=1, max_steps=3),
    )  # fmt: skip
    made = trained_on(walks(3), Compass(), None, context(Blobs()), config)
    again = trained_on(walks(3), Compass(), None, context(Blobs()), config)
    assert made.weights == again.weights
    assert not made.is_fallback
    actor = load(made.weights, model)
    actor.reset(2, ["chair", "mug"])
    assert actor.act(drawn_pictures(model, 2)).shape == (2,)
    rows, blobs = dataset(2)
    odd = dataclasses.replace(config, augmentation=PictureAugmentation())
    with pytest.raises(InputError, match="frozen eyes would encode every picture anew"):
        train(dataset=rows, start=None, context=context(blobs), config=odd)
    wide = dataclasses.replace(model, eyes=SiglipEyes(str(folder), 12, (3, 2)))
    with pytest.raises(InputError, match="tokens have 16 numbers, the config says 12"):
        trained_on(walks(3), Compass(), None, context(Blobs()), dataclasses.replace(config, model=wide))
