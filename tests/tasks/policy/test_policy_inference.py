"""Acting without torch, held against torch with random weights."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from schemas.evaluation import ACTIONS
from tasks.models import Model, identity_json
from tasks.policy.inference.actor import Actor, load, load_model
from tasks.policy.model.config import SiglipEyes
from tasks.policy.senses import meant
from tasks.training.systems.navigation import NavigationTraining
from tests.conftest import REPOSITORY
from tests.tasks.policy.policies import GOALS, MODELS, TINY, drawn_network, drawn_pictures, drawn_weights

torch = pytest.importorskip("torch")

WANTED = ["chair", "mug", "piano", "lamp", "chair"]


def acted(actor: Actor, pictures: np.ndarray, goals: list[str]) -> np.ndarray:
    """Logits of agents over steps, shape (steps, n, a), of pictures (steps, n, h, w, 3)."""
    actor.reset(len(goals), goals)
    made = []
    for now in pictures:
        made.append(actor.logits(now))
        actor.did(made[-1].argmax(axis=-1))
    return np.array(made)


def pictures_of(model, steps: int, agents: int, seed: int = 0) -> np.ndarray:
    return drawn_pictures(model, steps * agents, seed).reshape(steps, agents, model.camera.height, model.camera.width, -1)


@pytest.mark.parametrize("name", MODELS)
def test_agents_act_as_in_torch(name: str) -> None:
    from tasks.policy.model.acting import TorchPolicy

    model = MODELS[name]
    pictures = pictures_of(model, model.window + 3, len(WANTED))
    made = acted(load(drawn_weights(model), model), pictures, WANTED)
    expected = acted(Actor(TorchPolicy(drawn_network(model)), GOALS), pictures, WANTED)
    assert made.shape == (model.window + 3, len(WANTED), len(ACTIONS))
    assert np.abs(made - expected).max() < 1e-5
    assert np.abs(made[1:] - made[:-1]).max() > 1e-3


@pytest.mark.parametrize("name", ["tiny", "small", "sensing"])
def test_acting_is_what_training_tells_of_a_walk(name: str) -> None:
    """An agent that is led along a walk decides as the network does that is given the whole walk."""
    from tasks.policy.demonstrations import AgentWalk
    from tasks.policy.model.objective import logits_of

    model, steps = MODELS[name], MODELS[name].window + 5
    pictures = pictures_of(model, steps, 1)
    done = np.random.default_rng(0).integers(0, 3, steps)
    walk = AgentWalk("a/b", "a/b", "0000", "lamp", np.zeros((steps, 3)), done, done)
    expected = logits_of(drawn_network(model), walk, meant(pictures[:, 0], "lamp", model), GOALS)
    actor = load(drawn_weights(model), model)
    actor.reset(1, ["lamp"])
    for step in range(steps):
        assert np.abs(actor.logits(pictures[step])[0] - expected[step]).max() < 1e-5
        actor.did(done[step : step + 1])


@settings(max_examples=12, deadline=None)
@given(
    agents=st.lists(st.integers(0, 19), min_size=1, max_size=19, unique=True), name=st.sampled_from(["tiny", "states", "small", "sensing"])
)
def test_what_an_agent_does_hangs_on_no_other(agents: list[int], name: str) -> None:
    model = MODELS[name]
    actor, goals = load(drawn_weights(model), model), [WANTED[i % 5] for i in range(20)]
    pictures = pictures_of(model, 3, 20)
    every = acted(actor, pictures, goals)
    some = acted(actor, np.ascontiguousarray(pictures[:, agents]), [goals[i] for i in agents])
    assert np.array_equal(every[:, agents], some)


@pytest.mark.parametrize("name", ["tiny", "sensing"])
def test_who_begins_anew_remembers_nothing_and_the_others_go_on(name: str) -> None:
    model = MODELS[name]
    actor = load(drawn_weights(model), model)
    pictures = pictures_of(model, 6, 3)
    whole = acted(actor, pictures, WANTED[:3])
    fresh = acted(actor, pictures[3:, 1:2], ["lamp"])
    actor.reset(3, WANTED[:3])
    for step in range(6):
        if step == 3:
            actor.renew([1], ["lamp"])
        logits = actor.logits(pictures[step])
        assert np.array_equal(logits[[0, 2]], whole[step][[0, 2]])
        assert np.array_equal(logits[1], whole[step, 1] if step < 3 else fresh[step - 3, 0])
        actor.did(logits.argmax(axis=-1))


def test_who_marks_the_goal_itself_is_understood() -> None:
    model = MODELS["sensing"]
    pictures = pictures_of(model, 4, 3)
    marked = np.stack([np.stack([meant(one[None], goal, model)[0] for one, goal in zip(now, WANTED, strict=False)]) for now in pictures])
    actor = load(drawn_weights(model), model)
    every = acted(actor, marked, WANTED[:3])
    assert np.array_equal(every, acted(actor, pictures, WANTED[:3]))
    actor.reset(3, WANTED[:3])
    for now, logits in zip(pictures[:2], every[:2], strict=True):  # and when one has left
        actor.logits(now)
        actor.did(logits.argmax(axis=-1))
    actor.keep([0, 2])
    assert np.array_equal(actor.logits(pictures[2][[0, 2]]), every[2][[0, 2]])


def test_actions_are_the_likeliest_ones_and_pictures_must_fit() -> None:
    actor = load(drawn_weights(TINY), TINY)
    pictures = pictures_of(TINY, 1, 2)[0]
    actor.reset(2, ["chair", "mug"])
    logits = actor.logits(pictures)
    actor.reset(2, ["chair", "mug"])
    actions = actor.act(pictures)
    assert actions.tolist() == logits.argmax(axis=-1).tolist()
    for wrong in (pictures[:1], pictures[:, :8], pictures.astype(np.float32)):
        with pytest.raises(ValueError, match="pictures: "):
            actor.act(wrong)
    with pytest.raises(ValueError, match="3 agents cannot have 1"):
        actor.reset(3, ["chair"])
    actor.reset(0, [])
    assert actor.act(pictures[:0]).shape == (0,)


def test_models_of_other_systems_and_frozen_eyes_without_a_folder_are_refused() -> None:
    config = identity_json(NavigationTraining(TINY))
    model = Model("0" * 64, "navigation", "small", config, drawn_weights(TINY))
    assert isinstance(load_model(model), Actor)
    with pytest.raises(InputError, match="name a model of the learned system navigation"):
        load_model(dataclasses.replace(model, kind="selection"))
    with pytest.raises(InputError, match="take weights and config of one model"):
        load_model(dataclasses.replace(model, config=identity_json(NavigationTraining())))
    frozen = dataclasses.replace(TINY, eyes=SiglipEyes(width=12))
    with pytest.raises(InputError, match="names no folder"):
        load(drawn_weights(frozen), frozen)


def test_acting_needs_no_torch() -> None:
    code = (
        "import sys, pathlib; sys.modules['torch'] = None\n"
        "import numpy as np\n"
        "from tasks.policy.inference.actor import load\nfrom tests.tasks.policy.policies import TINY\n"
        "actor = load(sys.stdin.buffer.read(), TINY); actor.reset(2, ['mug', 'lamp'])\n"
        "print(actor.act(np.zeros((2, 16, 16, 3), np.uint8)).shape)"
    )
    done = subprocess.run([sys.executable, "-c", code], input=drawn_weights(TINY), capture_output=True, cwd=REPOSITORY, check=False)
    assert done.stdout.decode().strip() == "(2,)", done.stderr.decode()
