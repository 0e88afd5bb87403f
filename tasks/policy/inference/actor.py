"""Agents that act by a trained policy, many at once: each picture is encoded once, and the last steps are kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.errors import InputError
from tasks.policy.actions import START
from tasks.policy.inference.network import Indices, PlainPolicy
from tasks.policy.model.config import OwnEyes, PolicyModel
from tasks.policy.model.shapes import Vocabulary, check_fit
from tasks.policy.senses import channels_of, meant
from tasks.synthesis.inference.layers import Values, one_thread
from tasks.weights import from_safetensors


class Network(Protocol):
    """A policy's network, with torch or without."""

    @property
    def config(self) -> PolicyModel:
        """What it is made of."""
        ...

    def goal_tokens(self, goals: Indices) -> Values:
        """Tokens (n, g, w) of goals (n,)."""
        ...

    def seen(self, pictures: NDArray[np.uint8], goal_tokens: Values) -> Values:
        """Vectors (n, w) of pictures (n, h, w, c)."""
        ...

    def decided(self, seen: Values, last: Indices, times: Indices, goal_tokens: Values) -> Values:
        """Logits (n, t, a) of steps."""
        ...


@dataclasses.dataclass
class _Memory:
    """What n agents remember. goal_tokens: Of what each is sent to. seen, last, times: Of their last steps, oldest first; `sizes` of them
    count. done: How many steps each has made. before: What each did last. goals: Category that each is sent to.
    """

    goal_tokens: Values
    seen: Values
    last: Indices
    times: Indices
    sizes: Indices
    done: Indices
    before: Indices
    goals: NDArray[np.object_]


class Actor:
    """Agents that act by a policy.

    >>> actor = load(weights, config)  # doctest: +SKIP
    >>> actor.reset(2, ["chair", "lamp"])  # doctest: +SKIP
    >>> actor.act(pictures)  # doctest: +SKIP
    array([0, 2])
    """

    def __init__(self, network: Network, vocabulary: Vocabulary) -> None:
        self.network, self.vocabulary = network, vocabulary
        self._memory = self._begun([])

    @property
    def config(self) -> PolicyModel:
        """What the policy is made of, its camera among it."""
        return self.network.config

    def reset(self, n: int, goals: Sequence[str]) -> None:
        """So many agents begin, each with a category to go to. One that the policy does not know counts as unknown."""
        if len(goals) != n:
            raise ValueError(f"goals: {n} agents cannot have {len(goals)}")
        self._memory = self._begun(goals)

    def renew(self, agents: ArrayLike, goals: Sequence[str]) -> None:
        """Some agents begin anew, by their places, shape (m,), each with a category; the others go on."""
        places = np.asarray(agents, dtype=np.int64).reshape(-1)
        if len(goals) != len(places):
            raise ValueError(f"goals: {len(places)} agents cannot have {len(goals)}")
        fresh = self._begun(goals)
        for field in dataclasses.fields(_Memory):
            getattr(self._memory, field.name)[places] = getattr(fresh, field.name)

    def keep(self, agents: ArrayLike) -> None:
        """Go on with some agents alone, by their places, shape (m,): theirs are 0 to m - 1 from now on."""
        places = np.asarray(agents, dtype=np.int64).reshape(-1)
        for field in dataclasses.fields(_Memory):
            setattr(self._memory, field.name, getattr(self._memory, field.name)[places])

    def act(self, pictures: NDArray[np.uint8]) -> NDArray[np.int64]:
        """The likeliest action of every agent, of what it sees now: places in `schemas.evaluation.ACTIONS`, shape (n,).

        pictures: Shape (n, h, w, c), of the policy's camera, three colors and what else it senses: as rendered
            (`tasks.policy.senses`), or with `config.channels` values, the last of which is white where the goal of each agent is.
        """
        actions = self.logits(pictures).argmax(axis=-1)
        self.did(actions)
        return actions

    def logits(self, pictures: NDArray[np.uint8]) -> Values:
        """How likely actions are, shape (n, a), of what every agent sees now. The step is taken when `did` says what was done."""
        memory, window = self._memory, self.config.window
        shape = (len(memory.done), self.config.camera.height, self.config.camera.width)
        fits = pictures.shape[:-1] == shape and pictures.shape[-1] in (channels_of(self.config), self.config.channels)
        if not fits or pictures.dtype != np.uint8:
            raise ValueError(f"pictures: {pictures.dtype} {pictures.shape} are not those of {len(memory.done)} agents with this camera")
        if not len(pictures):
            return np.zeros((0, 4), dtype=np.float32)
        with one_thread():
            seen = self.network.seen(self._meant(pictures), memory.goal_tokens)
            full = memory.sizes == window
            for held in (memory.seen, memory.last, memory.times):
                held[full, :-1] = held[full, 1:]
            memory.sizes[:] = np.minimum(memory.sizes + 1, window)
            every, now = np.arange(len(seen)), memory.sizes - 1
            memory.seen[every, now], memory.last[every, now], memory.times[every, now] = seen, memory.before, memory.done
            made: Any = self.network.decided(memory.seen, memory.last, memory.times, memory.goal_tokens)[every, now]
            return np.asarray(made, dtype=np.float32)

    def _meant(self, pictures: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Pictures as each agent's goal has them."""
        if pictures.shape[-1] == self.config.channels:
            return pictures
        return np.concatenate([meant(pictures[at : at + 1], goal, self.config) for at, goal in enumerate(self._memory.goals.tolist())])

    def did(self, actions: ArrayLike) -> None:
        """What the agents did in this step, shape (n,), whatever the policy said; `act` does this itself."""
        self._memory.before = np.array(actions, dtype=np.int64)
        self._memory.done = self._memory.done + 1

    def _begun(self, goals: Sequence[str]) -> _Memory:
        count, window, width = len(goals), self.config.window, self.config.width
        places = np.array([self.vocabulary.place(goal) for goal in goals], dtype=np.int64)
        with one_thread():
            goal_tokens = self.network.goal_tokens(places)
        return _Memory(
            goal_tokens=goal_tokens,
            seen=np.zeros((count, window, width), dtype=np.float32),
            last=np.full((count, window), START),
            times=np.zeros((count, window), dtype=np.int64),
            sizes=np.zeros(count, dtype=np.int64),
            done=np.zeros(count, dtype=np.int64),
            before=np.full(count, START),
            goals=np.array([*goals, None], dtype=object)[:-1],
        )


def load(weights: bytes, config: PolicyModel, name: str = "weights") -> Actor:
    """What acts by these weights, without torch where the policy has eyes of its own.

    Raises:
        InputError: they are no weights of such a policy; or its eyes are frozen ones, and what these need is not there.
    """
    arrays = from_safetensors(weights, name)
    vocabulary = check_fit(arrays, config, name)
    if not config.blind and not isinstance(config.eyes, OwnEyes):
        from tasks.policy.model.acting import torch_network

        return Actor(torch_network(arrays, config, len(vocabulary)), vocabulary)
    own = {key: np.ascontiguousarray(array, dtype=np.float32) for key, array in arrays.items()}
    return Actor(PlainPolicy(config, own), vocabulary)


def load_model(model: Any) -> Actor:
    """What acts by a `tasks.models.Model` of the learned system `navigation`.

    Raises:
        InputError: as `load`, or its config is not that of a policy.
    """
    from tasks.policy.model.config import config_from

    if model.kind != "navigation":
        raise InputError(model.model_id[:12], "kind", f"is {model.kind!r}", "name a model of the learned system navigation")
    return load(model.weights, config_from(model.config), model.model_id[:12])
