"""Small policies with random weights for tests."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tasks.policy.model.config import AgentCamera, OwnEyes, PolicyModel, SiglipGoal, SmallPolicy
from tasks.policy.model.shapes import Vocabulary, vocabulary_of
from tasks.policy.senses import CODE, channels_of, codes_of

TINY = SmallPolicy(
    camera=AgentCamera(16, 16), eyes=OwnEyes(patch=4, part=2, width=8), width=16, heads=2, feedforward=24, fusion_layers=1,
    decoder_layers=2, window=4,
)  # fmt: skip
MODELS: dict[str, PolicyModel] = {
    "tiny": TINY,
    "blind": dataclasses.replace(TINY, blind=True),
    "goalless": dataclasses.replace(TINY, goalless=True),
    "states": dataclasses.replace(TINY, goal=SiglipGoal(width=12, tokens=5)),
    "sensing": dataclasses.replace(TINY, eyes=OwnEyes(patch=4, part=2, width=8, depth=True, goal=True)),
    "wide": dataclasses.replace(TINY, camera=AgentCamera(24, 16), eyes=OwnEyes(patch=8, part=4), window=1),
    "small": SmallPolicy(),
}
GOALS = vocabulary_of(["chair", "lamp", "mug"])


def drawn_network(model: PolicyModel, goals: Vocabulary = GOALS, seed: int = 0) -> Any:
    """A network in evaluation with random weights, also where training begins with zeros and ones."""
    import torch

    from tasks.training.systems.navigation import network

    module = network(model, len(goals), seed).eval()
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for tensor in module.state_dict().values():
            tensor.add_(0.1 * torch.randn(tensor.shape, generator=generator))
    return module


def drawn_weights(model: PolicyModel, goals: Vocabulary = GOALS, seed: int = 0) -> bytes:
    """Its weights as they are kept."""
    from tasks.training.systems.navigation import kept

    return kept(drawn_network(model, goals, seed).state_dict(), goals, half=False)


def drawn_pictures(model: PolicyModel, count: int, seed: int = 0) -> np.ndarray:
    """Rendered pictures without sense; where categories are told, pixels are of things that one is sent to, or of nothing."""
    rng = np.random.default_rng(seed)
    shape = (count, model.camera.height, model.camera.width)
    pictures = rng.integers(0, 256, (*shape, channels_of(model)), dtype=np.uint8)
    if model.senses_goal:
        pictures[..., -CODE:] = codes_of(["chair", "lamp", "mug", "piano"])[rng.integers(0, 5, shape)]
    return pictures
