"""One object put to rest and apart by the default method, while all the others are held where they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from schemas.optimization import APPLIED
from tasks.optimization.default import Default, resolve
from tasks.optimization.interior import Interior
from tasks.optimization.search.trace import moved_poses
from tasks.optimization.support.supports import SupportConfig, descendants
from tasks.stage import in_turn

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Rested:
    """Where one object came to. pose: to the world frame [m], shape (4, 4). outcomes: of the steps that led there, in order. problem:
    what could not be put right, empty where all was."""

    pose: Array
    outcomes: tuple[str, ...]
    problem: str


def rest_alone(interior: Interior, name: str, method: Default, supports: SupportConfig, rng: Callable[..., np.random.Generator]) -> Rested:
    """An object brought onto what carries it, out of walls and of other objects, none of which moves. What it carries is left out: that
    is put to rest on it later.

    Raises:
        KeyError: the interior has no such object.
    """
    if name not in interior.names:
        raise KeyError(name)
    held = hold_others(interior, name)
    resolution = resolve(held, method, supports, rng, in_turn)
    held = resolution.interior or held
    parents = {row: carrier.parent_id for row, carrier in zip(held.names, held.carriers, strict=True)}
    steps = [step for step in resolution.steps if step.name == name and step.outcome in APPLIED]
    moved = moved_poses(dict(zip(held.names, held.poses, strict=True)), parents, [(step.name, step.move) for step in steps])
    problems = [*([resolution.problems[name]] if name in resolution.problems else []), *resolution.notes]
    if held.carriers[held.names.index(name)].relation == "none":
        problems.append("nothing within reach carries it")
    return Rested(moved[name], tuple(step.outcome for step in steps), "; ".join(problems))


def hold_others(interior: Interior, name: str) -> Interior:
    """The interior in which all but one object are fastened where they are; without those that it carries."""
    carried = descendants({row: carrier.parent_id for row, carrier in zip(interior.names, interior.carriers, strict=True)}).get(name, set())
    kept = [i for i, row in enumerate(interior.names) if row not in carried]
    place = {row: i for i, row in enumerate(kept)}
    lift = {row: carrier.lift for row, carrier in zip(interior.names, interior.carriers, strict=True)}
    carriers, parents, fixed = [], [], []
    for i in kept:
        carrier, is_held = interior.carriers[i], interior.names[i] != name
        if is_held:
            carrier = dataclasses.replace(carrier, relation="none", parent_id=None, lift=0.0)
        elif carrier.parent_id is not None:  # its carrier is not lifted any more
            carrier = dataclasses.replace(carrier, lift=carrier.lift - lift[carrier.parent_id])
        parent = -1 if is_held else int(interior.parent[i])
        carriers.append(carrier)
        parents.append(place[parent] if parent >= 0 else -1)
        fixed.append(is_held or bool(interior.fixed[i]))
    return dataclasses.replace(
        interior,
        objects=tuple(interior.objects[i] for i in kept),
        proposals=tuple(interior.proposals[i] for i in kept),
        solids=tuple(interior.solids[i] for i in kept),
        poses=interior.poses[kept],
        carriers=tuple(carriers),
        parent=np.array(parents, dtype=np.int64),
        covering=interior.covering[kept],
        fixed=np.array(fixed, dtype=np.bool_),
    )
