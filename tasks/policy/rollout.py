"""Policies let go: what agents do in the episodes of a scene, each picture drawn from where the last actions led."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from schemas.evaluation import ACTIONS
from schemas.navigation import Episode
from tasks.evaluation.batch import Attempt
from tasks.evaluation.configuration import EvaluationConfig
from tasks.policy.actions import STOP
from tasks.policy.inference.actor import Actor
from tasks.policy.reflex import Reflex
from tasks.policy.senses import channels_of, codes_of, sensed
from tasks.simulation import protocol
from tasks.simulation.agents import Agents
from tasks.simulation.cameras import camera_poses
from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.world import World

_NUMBERS = np.array([protocol.ACTIONS.index(action) for action in ACTIONS], dtype=np.int64)
"""Actions of a policy as the simulator numbers them."""


def rolled_out(world: World, actor: Actor, episodes: Sequence[Episode], config: EvaluationConfig) -> tuple[Attempt, ...]:
    """What a policy does in episodes of one scene until it stops, `max_steps` at most; each as if it were alone.

    Poses are left out: they follow from the navmesh, on which the agents walk.

    Raises:
        InputError: an episode starts off the navmesh, or without a path to a view point.
    """
    agents = Agents(len(episodes), SimulationConfig(1, 1, forward_m=config.forward_m, turn_degrees=config.turn_degrees))
    for index, episode in enumerate(episodes):
        agents.place(index, world, world.start(episode), episode.start_yaw_radians)
    actor.reset(len(episodes), [episode.category for episode in episodes])
    camera, codes = actor.config.camera, codes_of(world.categories)
    reflex = Reflex(len(episodes)) if config.turns_aside and not actor.config.blind else None
    actions: list[list[str]] = [[] for _ in episodes]
    going = np.arange(len(episodes))
    for _ in range(config.max_steps):
        if not len(going):
            break
        pictures = np.zeros((len(going), camera.height, camera.width, channels_of(actor.config)), dtype=np.uint8)
        if not actor.config.blind:
            ways = np.column_stack([agents.position[going], agents.yaw[going]])
            poses = camera_poses(ways, camera.height_m, math.radians(camera.pitch_degrees))
            pictures = sensed(world.camera.render(poses, camera.width, camera.height, camera.hfov_radians), codes, actor.config)
        logits = actor.logits(pictures)
        chosen = logits.argmax(axis=-1) if reflex is None else reflex.chosen(logits, pictures)
        actor.did(chosen)
        for index, action in zip(going.tolist(), chosen.tolist(), strict=True):
            actions[index].append(ACTIONS[action])
        numbers = np.zeros(len(episodes), dtype=np.int64)
        numbers[going] = _NUMBERS[chosen]
        agents.step(numbers, going)
        still = np.flatnonzero(chosen != STOP)
        if len(still) < len(going):
            going = going[still]
            actor.keep(still)
            if reflex is not None:
                reflex.keep(still)
    return tuple(
        Attempt(episode.scene_id, episode.episode_id, tuple(done), None, None, f"episode {episode.scene_id} {episode.episode_id}")
        for episode, done in zip(episodes, actions, strict=True)
    )
