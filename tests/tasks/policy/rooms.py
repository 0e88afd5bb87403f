"""Rooms with episodes for tests of policies, and pictures of them that need no renderer."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np

from schemas.navigation import Episode, Split
from tasks.navigation import NavigationConfig, run
from tasks.policy.collection import CollectedWalks, collected
from tasks.policy.demonstrations import WalkConfig
from tasks.stage import Blobs, Context
from tasks.training.dataset import RowsInMemory
from tests.tasks.navigation.test_navigation import living_room

EPISODES = 6


@cache
def navigated(episodes: int = EPISODES) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Rows of a room and of its episodes, by table, and blobs."""
    tables, context = living_room()
    outcome = run(**tables, context=context, config=NavigationConfig(train_episodes=episodes, test_episodes=episodes))
    return {**tables, **outcome.rows}, {**context.blobs, **outcome.blobs}


def dataset(rooms: int = 4, episodes: int = EPISODES, tests: int = 1) -> tuple[RowsInMemory, Blobs]:
    """The room so many times, under names of its own each; the last ones are test rooms."""
    rows, data = navigated(episodes)
    blobs = Blobs()
    for name, value in data.items():
        blobs.add(value, name.rpartition(".")[2])
    made: list[Any] = []
    for number in range(rooms):
        name = f"demo/room_{number:02d}"
        for table in ("scenes", "shells", "placements", "instances", "navmeshes", "episodes"):
            for row in rows[table]:
                changes: dict[str, Any] = {"scene_id": name}
                if table == "scenes":
                    changes |= {"room_id": name, "license": "MIT"}
                if isinstance(row, Episode):
                    changes |= {"split": "test" if number >= rooms - tests else "train"}
                made.append(dataclasses.replace(row, **changes))
        made.append(Split(room_id=name, split="test" if number >= rooms - tests else "train"))
    order = sorted((row for row in made if isinstance(row, Episode)), key=lambda row: (row.scene_id, row.episode_id))
    rest = [row for row in made if not isinstance(row, Episode)]
    return RowsInMemory("snapshot 1", *rest, *rows["assets"], *order), blobs


def context(blobs: Any, caches: dict[str, dict[str, bytes]] | None = None, **changes: Any) -> Context:
    made = Context("navigation-test", "training", 0, blobs, **changes)
    return made if caches is None else dataclasses.replace(made, caches=caches)


def walks(rooms: int = 4, episodes: int = EPISODES, config: WalkConfig | None = None) -> CollectedWalks:
    rows, blobs = dataset(rooms, episodes)
    return collected(rows, context(blobs), config or WalkConfig(), 0.2)


class Compass:
    """A stand-in for the camera: patches of a picture are as bright as waves of where it was taken say. calls: Poses so far."""

    def __init__(self, side: int = 16, patch: int = 4) -> None:
        self.side, self.patch, self.calls = side, patch, 0

    def __call__(self, scene_id: str, poses: np.ndarray) -> np.ndarray:
        self.calls += len(poses)
        x, y, yaw = np.asarray(poses, dtype=np.float64).reshape(-1, 3).T
        waves = [f(k * v) for v in (x, y) for k in (0.7, 1.9) for f in (np.sin, np.cos)]
        waves += [f(k * yaw) for k in (1, 2, 3) for f in (np.sin, np.cos)]
        cells = (self.side // self.patch) ** 2 * 3
        values = np.stack([waves[i % len(waves)] for i in range(cells)], axis=1)
        tiles = (127.5 + 127.0 * values).astype(np.uint8).reshape(len(x), self.side // self.patch, self.side // self.patch, 3)
        return tiles.repeat(self.patch, axis=1).repeat(self.patch, axis=2)
