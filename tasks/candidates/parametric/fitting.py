"""Analysis by synthesis: of all templates of a category, turned four ways, the one whose surface is nearest to an instance's points, and
whose surface has points where it should."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tasks.candidates.parametric.distances import FitTarget, misfits
from tasks.candidates.parametric.drawing import Block, FurnitureTemplate

Array = NDArray[np.float64]

SURFACE_WEIGHT = 0.5
"""What a model's surface without points counts beside points without a model: the scan saw the half of it."""

REFINED = 4
"""Forms with their turns that are refined: those that begin best; what begins worse by half stays behind."""

HOPELESS = 1.6
"""A form that begins so many times as bad as the best one is not refined."""

STEP_M = (0.12, 0.05, 0.02, 0.008, 0.004)
"""Steps of the search along each parameter, one after another [m]: the last is finer than a scan."""

MOST_ROUNDS = 6
"""Rounds at one step: a parameter that is still running then is far from where it began, and no form for these points."""

MOST_STARTS = 36
"""Starts of one form in one turn."""

WORTH_M = 0.0005
"""What each parameter must gain of the misfit to be worth having [m]: of forms that fit alike, the plainest."""


@dataclasses.dataclass(frozen=True)
class ParametricFit:
    """A form that fits. turn: quarter turns of its front from the box's +x. values: of its parameters [m]. outside: mean distance of the
    points from it, truncated [m]. covered: share of the points on its surface. bare: share of its surface without points."""

    template: FurnitureTemplate
    turn: int
    values: tuple[float, ...]
    outside: float
    covered: float
    bare: float
    cost: float

    @property
    def blocks(self) -> list[Block]:
        """Its blocks in its own frame, front +X."""
        return self.template.blocks(self.values)


def fitted_template(target: FitTarget, forms: Sequence[tuple[FurnitureTemplate, int]]) -> ParametricFit | None:
    """The best of some forms, each in a turn; None without any. Of equal ones the first."""
    begun: list[tuple[float, int, tuple[float, ...]]] = []
    for number, (template, turn) in enumerate(forms):
        starts = list(product(*(parameter.starts for parameter in template.parameters)))
        starts = starts[:: max(1, -(-len(starts) // MOST_STARTS))]
        costs = _costs(target, template, turn, starts)
        best = int(costs.argmin())
        begun.append((float(costs[best]), number, starts[best]))
    begun.sort(key=lambda start: (round(start[0], 9), start[1]))
    chosen = [start for start in begun[:REFINED] if start[0] <= HOPELESS * begun[0][0]]
    fits = [_refined(target, *forms[number], values) for _, number, values in chosen]
    return min(fits, key=lambda fit: round(fit.cost, 9), default=None)


def _refined(target: FitTarget, template: FurnitureTemplate, turn: int, start: tuple[float, ...]) -> ParametricFit:
    """A form from a start, its parameters moved one at a time, all by ever smaller steps."""
    values, cost = start, float(_costs(target, template, turn, [start])[0])
    for step in STEP_M:
        for _ in range(MOST_ROUNDS):
            tried = []
            for k, parameter in enumerate(template.parameters):
                for change in (-step, step):
                    moved = min(max(values[k] + change, parameter.low), parameter.high)
                    if moved != values[k]:
                        tried.append((*values[:k], moved, *values[k + 1 :]))
            if not tried:
                break
            costs = _costs(target, template, turn, tried)
            best = int(costs.argmin())
            if costs[best] >= cost - 1e-7:
                break
            better = [values, *(t for t, c in zip(tried, costs, strict=True) if c < cost)]
            values, cost = tried[best], float(costs[best])
            # all changes that help, taken together, are often better still
            joint = tuple(v + sum(b[k] - better[0][k] for b in better[1:]) for k, v in enumerate(better[0]))
            joint = tuple(min(max(v, p.low), p.high) for v, p in zip(joint, template.parameters, strict=True))
            together = float(_costs(target, template, turn, [joint])[0])
            if together < cost:
                values, cost = joint, together
    out, _, covered, bare = _measured(target, template, turn, [values])[0].tolist()
    return ParametricFit(template, turn, values, out, covered, bare, cost)


def _costs(target: FitTarget, template: FurnitureTemplate, turn: int, values: Sequence[tuple[float, ...]]) -> Array:
    measured = _measured(target, template, turn, values)
    return np.asarray(measured[:, 0] + SURFACE_WEIGHT * measured[:, 1] + WORTH_M * len(template.parameters))


def _measured(target: FitTarget, template: FurnitureTemplate, turn: int, values: Sequence[tuple[float, ...]]) -> Array:
    """Misfits of a form with several values of its parameters, shape (len(values), 4)."""
    drawn = [[block.spans for block in template.blocks(v)] for v in values]
    counts = np.array([len(blocks) for blocks in drawn], dtype=np.int64)
    stack = np.zeros((len(drawn), max(int(counts.max()), 1), 6))
    for k, blocks in enumerate(drawn):
        if blocks:
            stack[k, : len(blocks)] = blocks
    return misfits(target, turned(stack, turn), counts)


def turned(blocks: Array, turn: int) -> Array:
    """Blocks, shape (..., 6), turned by quarters about +Z, counter-clockwise."""
    for _ in range(turn % 4):
        x0, x1, y0, y1, z0, z1 = np.moveaxis(blocks, -1, 0)
        blocks = np.stack([-y1, -y0, x0, x1, z0, z1], axis=-1)
    return blocks
