"""Layouts drawn from a trained model, without torch."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.synthesis.inference.atiss import CHANCES, Next
from tasks.synthesis.inference.denoiser import PlainDenoiser, denoiser_of
from tasks.synthesis.inference.guidance import Guidance, guided, settled, sound
from tasks.synthesis.inference.layers import Layers, Values, one_thread
from tasks.synthesis.layout import Array, Large, Layout
from tasks.synthesis.model.config import Atiss, Diffusion, PhyScene, Transformer
from tasks.synthesis.model.encoding import BOUNDS, BOX, VOCABULARY, Encoding
from tasks.synthesis.model.shapes import check_fit
from tasks.weights import from_safetensors

PLACES = 16
"""Layouts that are drawn side by side. Products of matrices round each row by its place among the others, but not by what these hold:
layout n of a seed has place n modulo this, and its numbers are the same to the last bit whatever is drawn with it."""


@dataclasses.dataclass(frozen=True)
class Drawer:
    """A trained model that draws layouts."""

    config: Diffusion | Atiss
    encoding: Encoding
    network: PlainDenoiser | Next

    def check(self, large: Large) -> None:
        """Hold a large object that somebody asks for against what the model knows.

        Raises:
            InputError: it does not know its category, or its kind of room.
        """
        self.encoding.condition(large)
        if large.room_type not in self.encoding.rooms:
            problem = f"{large.room_type!r} is no kind of room that the model knows"
            raise InputError("synthesis", "room", problem, f"it knows {', '.join(self.encoding.rooms)}")

    def draw(
        self, larges: Sequence[Large], seed: int, numbers: Sequence[int] | None = None, *,
        steps: int | None = None, guidance: Guidance | None = None,
    ) -> list[Layout]:  # fmt: skip
        """A layout on each large object: a function of seed, number and large object alone. A kind of room that the model does not know
        counts as unknown.

        Args:
            larges: Large objects.
            seed: Not negative.
            numbers: Of the layouts, not negative; counted from 0 where there are none.
            steps: Of a diffusion, so many by DDIM; all of them by DDPM where there is none.
            guidance: By physics; PhyScene is guided where there is none, too. Of ATISS, whose objects come one after another, only the
                finished layout settles.

        Raises:
            InputError: the model does not know the category of a large object.
        """
        numbers = range(len(larges)) if numbers is None else numbers
        if len(numbers) != len(larges):
            raise ValueError(f"{len(larges)} layouts cannot have {len(numbers)} numbers")
        conditions = np.array([self.encoding.condition(large) for large in larges], dtype=np.int64).reshape(-1, 2)
        firsts = np.array([self.encoding.large_vector(large) for large in larges]).reshape(-1, self.encoding.width)
        guide = Guidance() if guidance is None and isinstance(self.config, PhyScene) else guidance
        made: dict[int, Layout] = {}
        left = list(range(len(larges)))
        for attempt in range(1 if guide is None else max(1, guide.tries)):
            drawn: dict[int, tuple[Layout, Array]] = {}
            with one_thread():
                for places in _groups([numbers[at] for at in left]):
                    own = [left[index] for index in places.values()]
                    rngs = [np.random.default_rng([seed, numbers[at], *[attempt] * (attempt > 0)]) for at in own]
                    group = _Group(dict(zip(places, own, strict=True)), [larges[at] for at in own], firsts[own], conditions[own], rngs)
                    vectors, free = self._vectors(group, steps, guide)
                    for place, at in group.places.items():
                        is_there = self.encoding.categories(vectors[place, 1:]) != self.encoding.empty
                        drawn[at] = self.encoding.layout(vectors[place], larges[at]), free[place, is_there]
            layouts = [drawn[at][0] for at in left]
            if guide is not None:
                layouts = settled(layouts, guide, [drawn[at][1] for at in left])
            made |= dict(zip(left, layouts, strict=True))
            if guide is None:
                break
            left = [at for at, is_sound in zip(left, sound(layouts), strict=True) if not is_sound]
            if not left:
                break
        return [made[at] for at in range(len(larges))]

    def _vectors(self, group: _Group, steps: int | None, guide: Guidance | None) -> tuple[Values, Array]:
        """Vectors of a group (b, slots, d), and what slots but the first keep free [m], shape (b, slots - 1)."""
        shape, network = (PLACES, self.config.slots - 1), self.network
        free = np.zeros(shape) if guide is None else group.placed(np.array([guide.free(rng, shape[1:]) for rng in group.rngs]))
        if isinstance(network, Next):
            return _one_after_another(network, self.encoding, group), free
        return _all_at_once(network, self.encoding, group, steps, guide, free), free


def load(weights: bytes, config: Diffusion | Atiss, name: str = "weights") -> Drawer:
    """What draws by these weights.

    Raises:
        InputError: they are no weights of such a model.
    """
    arrays = from_safetensors(weights, name)
    encoding = check_fit(arrays, config, name)
    check_sizes(config, name)
    own = {key: np.asarray(array, dtype=np.float32) for key, array in arrays.items() if key not in (VOCABULARY, BOUNDS)}
    network = Next(config, Layers(own)) if isinstance(config, Atiss) else denoiser_of(config, own)
    return Drawer(config, encoding, network)


def check_sizes(config: Diffusion | Atiss, name: str = "weights") -> None:
    """Hold the sizes of a config against each other.

    Raises:
        InputError: heads or groups do not share the channels, or sines and cosines do not.
    """
    shape = config if isinstance(config, Atiss) else config.architecture
    shared = [("heads", shape.heads, shape.width)] if isinstance(shape, Atiss | Transformer) else [("groups", shape.groups, shape.width)]
    shared.append(("sines and cosines", 2, shape.embedding if isinstance(shape, Atiss) else shape.width))
    if isinstance(shape, Transformer):
        shared.append(("sines and cosines", 2, shape.waves))
    for field, count, channels in shared:
        if channels % count:
            raise InputError(name, "config.model", f"{count} {field} do not share {channels} channels", "train the model with other sizes")


@dataclasses.dataclass(frozen=True)
class _Group:
    """Layouts that are drawn side by side, n of them at some of the places.

    places: To index among all. larges: Of the layouts. firsts: Vectors of these, shape (n, d). conditions: Places of their categories and
    rooms in the vocabulary, shape (n, 2). rngs: Of the layouts.
    """

    places: dict[int, int]
    larges: Sequence[Large]
    firsts: Values
    conditions: NDArray[np.int64]
    rngs: Sequence[np.random.Generator]

    def placed(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of the layouts (n, ...) at their places, shape (`PLACES`, ...); zeros at the others."""
        made = np.zeros((PLACES, *values.shape[1:]), dtype=values.dtype)
        made[list(self.places)] = values
        return made

    def normal(self, *shape: int) -> Values:
        """Normal numbers, shape (`PLACES`, *shape)."""
        return self.placed(np.array([rng.standard_normal(shape, dtype=np.float32) for rng in self.rngs]))

    def even(self, count: int) -> Values:
        """Even numbers in 0..1, shape (`PLACES`, count)."""
        return self.placed(np.array([rng.random(count, dtype=np.float32) for rng in self.rngs]))


def _groups(numbers: Sequence[int]) -> Iterator[dict[int, int]]:
    """Which layouts are drawn side by side: place to index, each at the place of its number."""
    queues: dict[int, list[int]] = {}
    for at, number in enumerate(numbers):
        queues.setdefault(number % PLACES, []).append(at)
    for turn in range(max(map(len, queues.values()), default=0)):
        yield {place: queue[turn] for place, queue in sorted(queues.items()) if turn < len(queue)}


def _all_at_once(
    network: PlainDenoiser, encoding: Encoding, group: _Group, count: int | None, guidance: Guidance | None, free: Array
) -> Values:
    """Vectors (b, slots, d) out of noise. free: What slots but the first keep free around them [m], shape (b, slots - 1)."""
    config, schedule = network.config, network.schedule
    weight, shape = np.float32(config.guidance), (config.slots, encoding.width)
    first, conditions = group.placed(group.firsts), group.placed(group.conditions)
    with_text = network.conditions(first, conditions)
    without = None if weight == 1 else network.conditions(first, conditions, is_null=True)
    steps = range(schedule.steps - 1, -1, -1) if count is None else schedule.some(count)
    sample = group.normal(*shape)
    for at, step in enumerate(steps):
        sample[:, 0] = first
        predicted = network.prediction(sample, step, with_text)
        if without is not None:
            null = network.prediction(sample, step, without)
            predicted = null + weight * (predicted - null)
        clean = schedule.denoised(predicted, step, sample)
        if guidance is not None and step < guidance.share * schedule.steps:
            clean = guided(clean, dict(zip(group.places, group.larges, strict=True)), encoding, guidance, free)
        if count is None:
            sample = schedule.ddpm(clean, step, sample, group.normal(*shape) if step else None)
        else:
            sample = schedule.ddim(clean, schedule.noise_in(predicted, step, sample), steps[at + 1] if step else None)
    return sample


def _one_after_another(network: Next, encoding: Encoding, group: _Group) -> Values:
    """Vectors (b, slots, d), objects until the end symbol or until no slot is left."""
    slots, end = network.config.slots, len(encoding.classes) + 1
    can_be = np.append(encoding.is_small[:-1], [False, True])
    first = group.placed(group.firsts)
    boxes = np.concatenate([first[:, :6], np.zeros_like(first[:, :1])], axis=-1)
    large = network.token(first[:, BOX:].argmax(axis=-1), boxes, is_large=True)
    tokens = np.concatenate([network.start(group.placed(group.conditions)), large], axis=1)
    made = np.full((PLACES, slots, encoding.width), -1.0, dtype=np.float32)
    made[:, 0], made[:, 1:, -1] = first, 1.0
    is_open = group.placed(np.ones(len(group.larges), dtype=bool))
    for slot in range(1, slots):
        category, boxes = network.drawn(network.next(tokens), can_be, group.even(CHANCES))
        is_open &= category != end
        if not is_open.any():
            break
        yaws = np.pi * boxes[:, 6].astype(np.float64)
        made[is_open, slot, :BOX] = np.column_stack([boxes[:, :6], np.cos(yaws), np.sin(yaws)])[is_open]
        made[is_open, slot, -1] = -1.0
        made[is_open, slot, BOX + category[is_open]] = 1.0
        tokens = np.concatenate([tokens, network.token(np.where(is_open, category, 0), boxes)], axis=1)
    return made
