"""Poses of models in their own size: no scale is fitted, and the height of what does not stand on the floor is free.

A model of a library has the size of what it depicts. Where it is the scanned object, that size explains the points better than any that the
scanned box asks for: boxes lack thin rods, and hold what bled from neighbors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.alignment.distances import nearest_indices
from tasks.alignment.measures import coarse_costs
from tasks.alignment.samples import Fit, Sample

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig
    from tasks.alignment.targets import ScannedInstance

Array = NDArray[np.float64]

HEIGHT_ROUNDS = 3
"""Rounds of plan and height in turn: the height settles in two."""

MAX_HEIGHT_SHIFT_M = 0.1
"""A model moves up or down by at most this: scanned boxes end so far from the object where rims are lost or floors bleed."""

SAME_HEIGHT_M = 0.03
"""Heights that differ by less are the same: a model that is as tall as the box stands on its bottom."""

Refine = Callable[["ScannedInstance", Sample, Fit, "AlignmentConfig"], Fit]
"""Refines a pose in plan."""


def own_size_starts(target: ScannedInstance, sample: Sample, yaws: Array, config: AlignmentConfig) -> list[Fit]:
    """The best few poses of a model in its own size, on the bottom of the box and, off the floor, below its top.

    Args:
        target: scanned instance.
        sample: samples of the model.
        yaws: turns about +Z that are tried, shape (k,) [rad].
        config: settings of the alignment; `starts` poses are returned.
    """
    spare = float(target.size[2] - sample.extents[2])
    heights = (0.0,) if target.is_grounded or abs(spare) <= SAME_HEIGHT_M else (0.0, spare)
    fits = [Fit(float(yaw), np.array([0.0, 0.0, height]), np.ones(3)) for height in heights for yaw in yaws]
    costs = coarse_costs(target, sample, fits, config)
    order = np.argsort(np.round(costs / target.diagonal, 6), kind="stable")
    return [fits[i] for i in order[: config.starts].tolist()]


def refine_height(target: ScannedInstance, sample: Sample, fit: Fit, config: AlignmentConfig, refine: Refine) -> Fit:
    """A pose with yaw, shift and height by nearest points, plan and height in turn.

    Args:
        target: scanned instance.
        sample: samples of the model.
        fit: pose that is refined in plan already; the height stays within `MAX_HEIGHT_SHIFT_M` of its own.
        config: settings of the alignment.
        refine: refines a pose in plan.
    """
    start, keep = float(fit.offset[2]), max(int(config.refine_share * len(target.points)), 3)
    for _ in range(HEIGHT_ROUNDS):
        placed = sample.placed(fit)[0]
        index, distance = nearest_indices(target.points, placed)
        used = np.argsort(distance, kind="stable")[:keep]
        # Points on upright faces say nothing of the height: their nearest samples lie above as often as below.
        shift = float((target.points[used, 2] - placed[index[used], 2]).mean())
        height = float(np.clip(fit.offset[2] + shift, start - MAX_HEIGHT_SHIFT_M, start + MAX_HEIGHT_SHIFT_M))
        fit = refine(target, sample, dataclasses.replace(fit, offset=np.array([*fit.offset[:2], height])), config)
    return fit
