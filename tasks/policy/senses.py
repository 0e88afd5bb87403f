"""What an agent senses at each pixel beside colors: how far away it is, and whether it is of what the agent was sent to.

Pictures as they are rendered hang on no goal: a pixel has red, green and blue, where the policy asks for it the depth, and three bytes that
stand for the category of what it shows. For an agent, these three become one: white where the category is that of its goal.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.policy.model.config import PolicyModel

if TYPE_CHECKING:
    from tasks.simulation.rasterizer import Pictures

CODE = 3
"""Bytes of a category's code: of 120 categories no two have the same one, but with two bytes two do."""

FAR_M = 8.0
"""What is farther looks as if it were so far [m]; a byte holds steps of 3 cm then."""


def channels_of(model: PolicyModel) -> int:
    """Bytes of a rendered pixel."""
    return 3 + model.senses_depth + CODE * model.senses_goal


def codes_of(categories: Iterable[str]) -> NDArray[np.uint8]:
    """The bytes of each category, zeros for none, and of nothing last, shape (n + 1, 3): by their names, the same in every scene."""
    return np.array([*map(_code, categories), [0] * CODE], dtype=np.uint8)


@cache
def _code(category: str) -> tuple[int, ...]:
    if not category:
        return (0,) * CODE
    code = hashlib.sha256(f"category {category}".encode()).digest()[:CODE]
    return (*code[:-1], max(code[-1], 1))  # zeros are nothing


def sensed(drawn: Pictures, codes: NDArray[np.uint8], model: PolicyModel) -> NDArray[np.uint8]:
    """Pictures of a policy's camera with all that it senses, shape (n, h, w, c).

    drawn: As they were rendered. codes: Of the parts of the scene, from `codes_of`.
    """
    if channels_of(model) == 3:
        return drawn.rgb
    made = np.empty((*drawn.part.shape, channels_of(model)), dtype=np.uint8)
    made[..., :3] = drawn.rgb
    if model.senses_depth:  # nothing is infinitely far
        metres = np.where(drawn.part >= 0, np.minimum(drawn.depth, FAR_M), FAR_M)
        made[..., 3] = np.rint(metres * (255.0 / FAR_M))
    if model.senses_goal:
        made[..., -CODE:] = codes[drawn.part]
    return made


def meant(pictures: NDArray[np.uint8], category: str, model: PolicyModel) -> NDArray[np.uint8]:
    """Rendered pictures (n, h, w, c) for an agent that was sent to a category: what its network takes."""
    if not model.senses_goal:
        return pictures
    made = np.array(pictures[..., : 1 - CODE], order="C")
    made[..., -1] = np.where((pictures[..., -CODE:] == np.array(_code(category), dtype=np.uint8)).all(axis=-1), 255, 0)
    return made
