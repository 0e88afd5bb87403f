"""What a policy learns: the right action of each step, told from pictures and actions up to it (behavior cloning)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from schemas.evaluation import ACTIONS
from tasks.policy.actions import START, STOP, UNKNOWN, UNTOLD
from tasks.policy.augmentation import drawn, looked
from tasks.policy.demonstrations import AgentWalk
from tasks.policy.model.config import PolicyModel
from tasks.policy.model.frozen import is_frozen
from tasks.policy.model.shapes import Vocabulary
from tasks.policy.model.steps import sliding
from tasks.policy.senses import meant
from tasks.policy.store import Store, observed, pictures_of
from tasks.settings import WHOLE, Config, Count, Natural, Positive, Share

if TYPE_CHECKING:
    from torch import Tensor

Batch = dict[str, NDArray[Any]]

AT_ONCE = 512
"""Pictures that are looked at in one go, where nothing is learned."""


@dataclasses.dataclass(frozen=True)
class PolicyBatchConfig(Config):
    """What a step of training sees."""

    windows: Count = 64  # of a step (specs E.4)
    last_dropout: Share = 0.5  # of last actions that are not told: a policy that is told all of them learns to repeat them (specs E.4)
    stop_weight: Positive = 3.0  # of steps whose right action is to stop: one in an episode, and all hangs on it (specs E.4)
    time_shift: Natural = 1000  # most of the offset that a window's steps are counted from: how many steps were made tells nothing
    unknown_share: Share = 0.02  # of windows whose goal is not told but by its pixels, so that one that nobody knows is something learned
    corrected_share: Share = 0.5  # of windows that are of the policy's own walks, once there are some
    store_mb: Annotated[int, Field(ge=1, le=1_000_000), WHOLE] = 512  # of pictures in memory: forty rooms, seventeen with all senses
    part_steps: Count = 500  # for which the same scenes are in memory: rendering others takes a twentieth of them


class Windows:
    """Windows of walks: so many steps in a row, or what a walk has of these. Each step of a walk is in as many as any other."""

    def __init__(self, walks: Sequence[AgentWalk], size: int) -> None:
        self.walks, self.size = walks, size
        self.ends = np.cumsum([len(walk) + size - 1 for walk in walks])

    def __len__(self) -> int:
        return int(self.ends[-1]) if len(self.ends) else 0

    def at(self, place: int) -> tuple[int, int, int]:
        """Walk, first step, and the one after the last, of a window."""
        number = int(np.searchsorted(self.ends, place, side="right"))
        length = len(self.walks[number])
        first = place - (int(self.ends[number]) - length)  # of the step at the window's beginning, below 0 before the walk
        return number, max(first, 0), min(first + self.size, length)


@dataclasses.dataclass
class PolicyObjective:
    """An `Objective`. shown: What experts did. visited: Where the policy itself got to, with what an expert would have done there.

    held: Walks of rooms that are held out.
    """

    shown: Store
    visited: Store
    held: Sequence[AgentWalk]
    model: PolicyModel
    config: PolicyBatchConfig
    vocabulary: Vocabulary
    seed: int

    def __post_init__(self) -> None:
        self._held: list[NDArray[Any]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_held": None}

    def batch(self, step: int) -> Mapping[str, Tensor]:
        """Windows of a step."""
        rng = np.random.default_rng([self.seed, 30, step])
        count = round(self.config.windows * self.config.corrected_share) if self.visited.walks else 0
        parts = list(self._drawn(self.visited, count, step, rng)) + list(self._drawn(self.shown, self.config.windows - count, step, rng))
        return tensors(together(parts, self.model.window))

    def _drawn(self, store: Store, count: int, step: int, rng: np.random.Generator) -> Iterator[Batch]:
        """Windows of walks, changed as training has them."""
        if not count:
            return
        numbers = store.part(step)
        windows = Windows([store.walks[number] for number in numbers], self.model.window)
        for place in rng.integers(len(windows), size=count):
            which, first, end = windows.at(int(place))
            walk, version = store.walks[numbers[which]], int(rng.integers(store.versions))
            seen = store.of(numbers[which], version)[first:end]
            look = drawn(store.augmentation, rng)
            if not is_frozen(self.model) and not self.model.blind:
                seen = looked(meant(seen, walk.category, self.model), look)
            last = walk.last[first:end].copy()
            last[rng.random(len(last)) < self.config.last_dropout] = UNTOLD
            shift = int(rng.integers(self.config.time_shift + 1))
            goal = 0 if rng.random() < self.config.unknown_share else self.vocabulary.place(walk.category)
            yield {
                "pictures": seen, "last": last, "times": np.arange(first, end) + shift, "goals": np.array(goal),
                "targets": walk.targets[first:end],
            }  # fmt: skip

    def loss(self, module: Any, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """The loss, and the share of steps whose action is the likeliest."""
        logits = module(batch)
        loss = cross_entropy(logits, batch["targets"], self.config.stop_weight)
        counts = batch["targets"] >= 0
        right = (logits.argmax(dim=-1) == batch["targets"])[counts].float().mean()
        return loss, {"accuracy": float(right.detach())}

    def validate(self, module: Any) -> float | None:
        """Share of the steps of held-out walks whose action is the likeliest; None without any."""
        if not self.held:
            return None
        if self._held is None:
            self._held = list(seen_on(self.held, self.shown))
        every = [logits_of(module, walk, seen, self.vocabulary) for walk, seen in zip(self.held, self._held, strict=True)]
        right = np.concatenate([made.argmax(axis=-1) == walk.targets for made, walk in zip(every, self.held, strict=True)])
        counts = np.concatenate([walk.targets != UNKNOWN for walk in self.held])
        return float(right[counts].mean()) if counts.any() else None


def together(parts: Sequence[Batch], window: int) -> Batch:
    """Windows (t, ...) as a batch: filled up at their ends with steps of which nothing is learned."""
    sizes = np.array([len(part["last"]) for part in parts])
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    places = first[:, None] + np.minimum(np.arange(window), sizes[:, None] - 1)

    def filled(name: str, value: int) -> NDArray[np.int64]:
        made = np.full((len(parts), window), value, dtype=np.int64)
        for row, part in enumerate(parts):
            made[row, : sizes[row]] = part[name]
        return made

    return {
        "pictures": np.concatenate([part["pictures"] for part in parts]),
        "owner": np.repeat(np.arange(len(parts)), sizes),
        "places": places,
        "goals": np.array([part["goals"] for part in parts], dtype=np.int64),
        "last": filled("last", START),
        "times": filled("times", 0),
        "targets": filled("targets", UNKNOWN),
    }


def tensors(batch: Mapping[str, NDArray[Any]]) -> dict[str, Tensor]:
    """A batch for torch."""
    import torch

    return {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in batch.items()}


def cross_entropy(logits: Tensor, targets: Tensor, stop_weight: float) -> Tensor:
    """Minus the logarithm of the chance of right actions (b, t), those to stop weighted, the mean over weights."""
    import torch
    from torch.nn import functional

    weights = torch.ones(len(ACTIONS), device=logits.device)
    weights[STOP] = stop_weight
    return functional.cross_entropy(logits.flatten(0, 1), targets.flatten(), weights, ignore_index=UNKNOWN)


def seen_on(walks: Sequence[AgentWalk], store: Store) -> Iterator[NDArray[Any]]:
    """Observations of walks, in their order, as a store would make them, unchanged; walks of a scene lie together."""
    first = 0
    while first < len(walks):
        end = first
        while end < len(walks) and walks[end].scene_id == walks[first].scene_id:
            end += 1
        some = walks[first:end]
        for walk, pictures in zip(some, pictures_of(some, store.render, store.model), strict=True):
            yield observed(meant(pictures, walk.category, store.model), store.model, store.memory)
        first = end


def logits_of(module: Any, walk: AgentWalk, seen: NDArray[Any], vocabulary: Vocabulary, *, tells_last: bool = True) -> NDArray[np.float32]:
    """Logits of the steps of a walk (n, a), each told from the last steps up to it, as in acting; every picture is encoded once.

    tells_last: Whether last actions are told.
    """
    import torch

    window, device = module.config.window, module.fusion.device
    with torch.no_grad():
        goal_tokens = module.goal_tokens(torch.tensor([vocabulary.place(walk.category)], device=device))
        parts = [torch.from_numpy(seen[first : first + AT_ONCE]).to(device) for first in range(0, len(walk), AT_ONCE)]
        vectors = torch.cat([module.seen(part, goal_tokens.expand(len(part), -1, -1)) for part in parts])
        rows, sizes = sliding(len(walk), window)
        last = walk.last if tells_last else np.full(len(walk), UNTOLD)
        steps = torch.from_numpy(rows).to(device)
        logits = module.decided(vectors[steps], torch.from_numpy(last[rows]).to(device), steps, goal_tokens.expand(len(rows), -1, -1))
        return np.asarray(logits[torch.arange(len(rows)), torch.from_numpy(sizes - 1)].cpu().numpy())
