"""How many steps a second of one core gives: random actions in furnished rooms, with pictures, collisions, distances and resets."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.goals import goal
from bench.machine import machine
from bench.policy.rooms import stage_room, with_episodes
from bench.replicas import as_drawn
from bench.rooms import scene_of_count
from tasks.navigation import NavigationConfig
from warehouse.lake import Lake

if TYPE_CHECKING:
    import gymnasium

CHANCES = (0.01, 0.49, 0.25, 0.25)
"""Of stop, forward, left and right: an agent that learns soon walks about, and an episode of it ends after some hundred steps."""
STEPS_PER_SECOND = 8000.0
"""Steps per second of one core that are wanted, with pictures of 64 pixels."""


@dataclasses.dataclass(frozen=True)
class StepsBench:
    """What is measured."""

    agents: int = 32  # as many as one core's worth of a learner's batch
    scenes: int = 3
    objects: int = 25  # what a room of a scan has
    sizes: tuple[int, ...] = (64, 128, 256)  # pixels of a side
    steps: int = 100  # of every agent, in one round
    rounds: int = 3  # the best one counts: others use the machine, too
    seed: int = 0


def measure_steps(config: StepsBench) -> dict[str, Any]:
    """Steps of an agent per CPU second of one process, by size of the picture: `batched` in reused memory and `copied` into new memory,
    and `single`, by as many environments as agents one after another, of the first size."""
    with tempfile.TemporaryDirectory() as folder:
        lake = rooms_to_act_in(Path(folder) / "lake", config)
        batched = {str(size): _rate(_batch(lake, config, size, copy=False), config) for size in config.sizes}
        copied = {str(size): _rate(_batch(lake, config, size, copy=True), config) for size in config.sizes}
        single = _rate(_singles(lake, config, config.sizes[0]), config)
    rates = {"batched": batched, "copied": copied, "single": {str(config.sizes[0]): single}}
    goals = [
        goal(
            f"steps per second of one core, pictures of {config.sizes[0]} px",
            rates["batched"][str(config.sizes[0])],
            ">=",
            STEPS_PER_SECOND,
        )
    ]
    return {"machine": machine(), **dataclasses.asdict(config), **rates, "goals": goals}


def rooms_to_act_in(folder: Path, config: StepsBench) -> Lake:
    """A lake of living rooms of so many objects, where the generator put them, with navmeshes and episodes."""
    lake = Lake.open(folder)
    for number in range(config.scenes):
        scene_id = f"bench/acting_{number:04d}"
        drawn, drawn_blobs = as_drawn(scene_of_count(config.objects, config.seed + 1000 * number))
        named = {
            table: [dataclasses.replace(row, scene_id=scene_id) if hasattr(row, "scene_id") else row for row in values]
            for table, values in drawn.items()
        }
        rows, blobs = with_episodes(named, drawn_blobs, config.seed, NavigationConfig(train_episodes=20, test_episodes=20))
        stage_room(lake, rows, blobs, "steps")
    lake.commit("rooms to act in")
    return lake


def _batch(lake: Lake, config: StepsBench, size: int, copy: bool) -> gymnasium.vector.VectorEnv:
    from flows.simulation.vector import ObjectNavVectorEnv

    return ObjectNavVectorEnv(config.agents, lake.address, split=None, copy=copy, width=size, height=size)


def _singles(lake: Lake, config: StepsBench, size: int) -> gymnasium.vector.VectorEnv:
    import gymnasium

    from flows.simulation.environment import ObjectNavEnv

    def make() -> ObjectNavEnv:
        return ObjectNavEnv(lake.address, split=None, width=size, height=size)

    return gymnasium.vector.SyncVectorEnv([make] * config.agents)


def _rate(env: gymnasium.vector.VectorEnv, config: StepsBench) -> float:
    """Steps per CPU second of an agent, the best of some rounds, after one that warms up."""
    rng = np.random.default_rng(config.seed)
    env.reset(seed=config.seed)
    seconds = []
    for _ in range(config.rounds + 1):
        actions = rng.choice(4, (config.steps, config.agents), p=CHANCES)
        clock = time.process_time()
        for action in actions:
            env.step(action)
        seconds.append(time.process_time() - clock)
    env.close()
    return config.steps * config.agents / min(seconds[1:])
