"""What an agent saw on walks: rendered when it is asked for, a scene at a time, and kept within bounds.

The pictures of a hundred episodes in each of sixty rooms take 1.8 GB at 64 x 64, and their tokens by SigLIP ten times as much again. So
training goes by parts: a part is some of the scenes, as many as the bound holds, and for some hundreds of steps all walks are of these;
the next part is rendered when its first step comes. Which scenes are in the part of a step follows from the seed and the step alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, MutableMapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.policy.augmentation import PictureAugmentation, drawn, looked
from tasks.policy.demonstrations import AgentWalk, Array
from tasks.policy.model.config import PolicyModel, SiglipEyes
from tasks.policy.model.frozen import is_frozen, tokens_of
from tasks.policy.senses import channels_of

Render = Callable[[str, Array], NDArray[np.uint8]]
"""Pictures of a scene from poses x, y, yaw (n, 3), shape (n, h, w, c)."""

AT_ONCE = 2048
"""Poses that are rendered in one go."""


def pictures_of(walks: Sequence[AgentWalk], render: Render, model: PolicyModel) -> list[NDArray[np.uint8]]:
    """Pictures of walks of one scene, shape (n, h, w, c) each; of blind policies with no pixels."""
    if not walks:
        return []
    poses = np.concatenate([walk.poses for walk in walks])
    if model.blind:
        every: NDArray[np.uint8] = np.zeros((len(poses), 0, 0, channels_of(model)), dtype=np.uint8)
    else:
        parts = [render(walks[0].scene_id, poses[first : first + AT_ONCE]) for first in range(0, len(poses), AT_ONCE)]
        every = np.concatenate(parts)
    return np.split(every, np.cumsum([len(walk) for walk in walks])[:-1])


def observed(pictures: NDArray[np.uint8], model: PolicyModel, memory: MutableMapping[str, bytes]) -> NDArray[Any]:
    """What a policy's network takes for pictures: these, or their tokens by frozen eyes (n, p, e) in half precision.

    Raises:
        InputError: frozen eyes are not where the config says.
    """
    if not is_frozen(model):
        return pictures
    assert isinstance(model.eyes, SiglipEyes)
    return tokens_of(pictures, model.eyes, memory)


@dataclasses.dataclass
class Store:
    """Observations of walks. walks: All of them. megabytes: That are kept. part_steps: Steps of training that a part of the scenes has.

    memory: Of frozen eyes. Of these a walk has `augmentation.versions` versions, else one, which nobody changed.
    """

    walks: Sequence[AgentWalk]
    render: Render
    model: PolicyModel
    augmentation: PictureAugmentation
    memory: MutableMapping[str, bytes]
    megabytes: int
    part_steps: int
    seed: int

    def __post_init__(self) -> None:
        self._by_scene: dict[str, list[int]] = {}
        for number, walk in enumerate(self.walks):
            self._by_scene.setdefault(walk.scene_id, []).append(number)
        each = self._step_bytes()
        self._sizes = {name: each * sum(len(self.walks[number]) for number in numbers) for name, numbers in self._by_scene.items()}
        self._kept: dict[str, dict[int, list[NDArray[Any]]]] = {}
        self._every: list[list[str]] = []  # parts of all laps so far, one after another
        self._laps = 0

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": {}}

    @property
    def versions(self) -> int:
        """Of each walk."""
        return max(self.augmentation.versions, 1) if is_frozen(self.model) else 1

    def part(self, step: int) -> list[int]:
        """Walks of the part that a step belongs to."""
        names = sorted(self._by_scene)
        turn = step // self.part_steps
        while len(self._every) <= turn:  # a lap has a part at least
            order = np.random.default_rng([self.seed, 31, self._laps]).permutation(len(names))
            self._every += self._parts([names[i] for i in order])
            self._laps += 1
        return [number for name in self._every[turn] for number in self._by_scene[name]]

    def of(self, number: int, version: int = 0) -> NDArray[Any]:
        """Observations of a walk (n, ...)."""
        name = self.walks[number].scene_id
        if name not in self._kept:
            while self._kept and sum(self._sizes[kept] for kept in (*self._kept, name)) > self.megabytes << 20:
                del self._kept[next(iter(self._kept))]
            self._kept[name] = self._made(name)
        return self._kept[name][number][version]

    def _made(self, name: str) -> dict[int, list[NDArray[Any]]]:
        numbers = self._by_scene[name]
        made = {}
        for number, pictures in zip(numbers, pictures_of([self.walks[i] for i in numbers], self.render, self.model), strict=True):
            versions = [pictures]
            if is_frozen(self.model) and self.augmentation.versions:
                looks = [drawn(self.augmentation, np.random.default_rng([self.seed, 32, number, v])) for v in range(self.versions)]
                versions = [looked(pictures, look) for look in looks]
            made[number] = [observed(version, self.model, self.memory) for version in versions]
        return made

    def _parts(self, order: Sequence[str]) -> list[list[str]]:
        """Scenes in order as parts within the bound; one that alone is beyond it is a part."""
        parts: list[list[str]] = [[]]
        held = 0
        for name in order:
            held += self._sizes[name]
            if parts[-1] and held > self.megabytes << 20:
                parts.append([])
                held = self._sizes[name]
            parts[-1].append(name)
        return parts

    def _step_bytes(self) -> int:
        """What observations of one step take."""
        model = self.model
        if model.blind:
            return 0
        if is_frozen(model):
            assert isinstance(model.eyes, SiglipEyes)
            return 2 * model.tokens * model.eyes.width * self.versions
        return channels_of(model) * model.camera.width * model.camera.height
