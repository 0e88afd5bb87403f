"""Layouts drawn by a network in torch, as it is trained: the reference of `tasks.synthesis.inference`, which needs no torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.model.config import Atiss, Diffusion
from tasks.synthesis.model.encoding import BOX, Encoding
from tasks.synthesis.model.objective import schedule

if TYPE_CHECKING:
    import torch
    from torch import Tensor


def drawn(module: Any, encoding: Encoding, larges: Sequence[Large], seed: int, steps: int | None = None) -> list[Layout]:
    """A layout for each large object. steps: Of a diffusion, so many by DDIM; all of them by DDPM where None.

    Raises:
        InputError: the model does not know a large object's category.
    """
    import torch

    generator = torch.Generator().manual_seed(seed)
    was_training = module.training
    module.eval()
    with torch.no_grad():
        slots = torch.from_numpy(np.array([encoding.large_vector(large) for large in larges]).reshape(-1, encoding.width))
        places = torch.tensor([encoding.condition(large) for large in larges], dtype=torch.long).reshape(-1, 2)
        if isinstance(module.config, Atiss):
            vectors = one_after_another(module, encoding, slots, places, generator)
        else:
            vectors = all_at_once(module, slots, places, generator, steps)
    module.train(was_training)
    return [encoding.layout(rows, large) for rows, large in zip(vectors.double().numpy(), larges, strict=True)]


def all_at_once(module: Any, first: Tensor, places: Tensor, generator: torch.Generator, steps: int | None) -> Tensor:
    """Vectors (b, slots, d) out of noise. first: Of the large objects (b, d). places: Their category and room in the vocabulary (b, 2)."""
    import torch
    from diffusers import DDIMScheduler

    config: Diffusion = module.config
    scheduler = schedule(config.noise)
    more: dict[str, Any] = {"generator": generator}
    if steps is not None:
        scheduler, more = DDIMScheduler.from_config(scheduler.config), {}
    scheduler.set_timesteps(steps or config.noise.steps)
    sample = torch.randn((len(first), config.slots, first.shape[-1]), generator=generator)
    for step in scheduler.timesteps.tolist():
        sample[:, 0] = first
        sample = scheduler.step(predicted(module, sample, step, places), step, sample, **more).prev_sample
    sample[:, 0] = first
    return sample


def predicted(module: Any, sample: Tensor, step: int, places: Tensor) -> Tensor:
    """What the denoiser tells of a sample in a step, led away from what it tells without text by the weight of its config."""
    import torch

    steps, weight = torch.full((len(sample),), step), module.config.guidance
    with_text = module(sample, steps, places[:, 0], places[:, 1])
    if weight == 1.0:
        return with_text
    without = module(sample, steps, places[:, 0], places[:, 1], torch.ones(len(sample), dtype=torch.bool))
    return without + weight * (with_text - without)


def one_after_another(module: Any, encoding: Encoding, first: Tensor, places: Tensor, generator: torch.Generator) -> Tensor:
    """Vectors (b, slots, d), objects until the end symbol or until no slot is left. Others: As `all_at_once`."""
    import torch

    from tasks.synthesis.model.networks.atiss import angle_of, drawn_number

    slots, count = module.config.slots, len(first)
    classes = torch.full((count, slots), encoding.empty)
    boxes = torch.zeros(count, slots, 7)
    classes[:, 0], boxes[:, 0, :6], boxes[:, 0, 6] = first[:, BOX:].argmax(dim=-1), first[:, :6], angle_of(first[:, 6], first[:, 7])
    can_be = torch.from_numpy(np.append(encoding.is_small[:-1], [False, True]))  # no start; the end
    is_open = torch.ones(count, dtype=torch.bool)
    is_there = torch.zeros(count, slots, dtype=torch.bool)
    is_there[:, 0] = True
    for slot in range(1, slots):
        hidden = module.hidden(classes[:, :slot], boxes[:, :slot], is_there[:, :slot], places[:, 0], places[:, 1])
        chances = module.class_out(hidden).masked_fill(~can_be, -torch.inf).softmax(dim=-1)
        category = torch.multinomial(chances, 1, generator=generator)[:, 0]
        is_open &= category != module.end
        middle = drawn_number(module.numbers(hidden, category, boxes[:, slot, :0], "translation"), generator)
        angle = drawn_number(module.numbers(hidden, category, middle, "angle"), generator)
        size = drawn_number(module.numbers(hidden, category, torch.cat([middle, angle], dim=-1), "size"), generator)
        boxes[:, slot] = torch.cat([middle, size, angle], dim=-1)
        classes[:, slot] = torch.where(is_open, category, encoding.empty)
        is_there[:, slot] = is_open
        if not is_open.any():
            break
    made = torch.full((count, slots, encoding.width), -1.0)
    made[..., :6], made[..., 6], made[..., 7] = boxes[..., :6], (torch.pi * boxes[..., 6]).cos(), (torch.pi * boxes[..., 6]).sin()
    made[..., BOX:].scatter_(-1, classes[..., None], 1.0)
    made[:, 0] = first
    return made
