"""The policy inside the package: whole, small, free, acting without torch, and better than chance in a room that it never saw."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from schemas.lineage.licenses import OF_THE_SCAN, is_unknown
from tasks.evaluation import EvaluationConfig
from tasks.evaluation.measures import path_finder
from tasks.evaluation.policies.random import RANDOM
from tasks.models import CARD, model_id_of
from tasks.navigation.follower import Motion, replay
from tasks.policy.demonstrations import views_of
from tasks.policy.inference.actor import load_model
from tasks.policy.rollout import rolled_out
from tasks.simulation.world import world_of
from tasks.training.systems.navigation import NAVIGATION
from tests.tasks.policy.rooms import navigated

SHIPPED = NAVIGATION.shipped()

ACTS = """
import sys
import numpy as np
from tasks.policy.inference.actor import load_model
from tasks.policy.senses import channels_of
from tasks.training.systems.navigation import NAVIGATION
for folder in NAVIGATION.shipped().values():
    actor = load_model(folder.model)
    camera = actor.config.camera
    actor.reset(1, ["chair"])
    actor.act(np.zeros((1, camera.height, camera.width, channels_of(actor.config)), dtype=np.uint8))
print("torch" in sys.modules)
"""


def test_something_ships_and_acts_without_torch() -> None:
    assert list(SHIPPED) == ["objectnav"]
    done = subprocess.run([sys.executable, "-c", ACTS], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize("name", SHIPPED)
def test_its_name_is_that_of_its_bytes_and_they_may_be_passed_on(name: str) -> None:
    folder = SHIPPED[name]
    assert folder.model.model_id == model_id_of(folder.model.weights, folder.model.config)
    assert len(folder.model.weights) <= 5_000_000
    assert not any(each == OF_THE_SCAN or is_unknown(each) for each in folder.document["license"].split(", "))
    card = (folder.folder / CARD).read_text()
    for part in (folder.model.model_id, folder.document["license"], "## Data", "## In rooms that nobody learned from", "## Limits"):
        assert part in card


@pytest.mark.parametrize("name", SHIPPED)
def test_it_finds_more_than_chance_does_in_a_room_that_it_never_saw(name: str) -> None:
    rows, blobs = navigated(24)
    episodes, mesh = rows["episodes"], rows["navmeshes"][0]
    config = EvaluationConfig(success_m=1.0, max_steps=150)
    world = world_of(
        mesh.scene_id, rows["shells"][0], (), rows["placements"], rows["assets"], rows["instances"], mesh, episodes, blobs, config.reach_m
    )  # fmt: skip
    finder = path_finder(blobs[mesh.navmesh_blob], "a.navmesh")
    attempts = {
        "learned": rolled_out(world, load_model(SHIPPED[name].model), episodes, config),
        "chance": tuple(RANDOM.act(episodes, config, lambda *words: np.random.default_rng([*" ".join(map(str, words)).encode()]))),
    }
    shares = {}
    for who, every in attempts.items():
        near = 0
        for episode, attempt in zip(episodes, every, strict=True):
            end = replay(attempt.actions, episode.start_position[:2], episode.start_yaw_radians, finder, Motion()).poses[-1, :2]
            near += attempt.actions[-1] == "stop" and float(finder.field(views_of(episode, finder)[:, :2]).distances(end[None])[0]) < 1.0
        shares[who] = near / len(episodes)
    assert shares["learned"] >= max(0.5, 2 * shares["chance"])
