"""Variant of Algorithm 1 whose loss is the overlap volume of boxes, in random order, with supports respected."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from schemas.errors import InputError
from tasks.optimization.interior import Interior
from tasks.optimization.search.collisions import OUTCOMES, Crowd, descend, plan_ring, room_triangles, stacked
from tasks.optimization.search.trace import Resolution, SearchStep
from tasks.optimization.support.supports import SupportConfig, allowed_shifts
from tasks.settings import Config, Natural, Positive
from tasks.shell import interior_footprints


@dataclasses.dataclass(frozen=True)
class Released(Config):
    """Algorithm 1 with an overlap volume as its loss: the method named `paper` in releases before 1.0.

    The loss is the volume in which the axis-aligned boxes of two assets overlap, summed over the pairs that count.
    A random object moves by 5 cm along x or y. A move out of the room is undone, and so is a move that does not
    bring the loss below the smallest so far. The search ends at a loss of zero or after a number of moves.
    `paper` follows the supplementary more closely; this method keeps replicas whole:

    - Walls, floor and ceiling take no part. What hangs on them counts in the loss but is not moved: off its wall it
      would hang in the air.
    - What stands on or in another object does not collide with that object: the box of a shelf holds its books. Nor does
      anything collide with a rug, which stays where it is.
    - What an object carries moves along with it. A carried object may move on its carrier, not off it.
    - An object that reaches out of the room from the start (rooms are estimated) may move unless more of it gets outside.
    - The loop also ends once every possible move was tried since the last kept one. It changes nothing but the time.
    """

    kind: ClassVar[str] = "released"
    step_m: Positive = 0.05  # the step of Algorithm 1
    max_steps: Natural = 10_000  # the loop ends itself long before, when no move helps; 40 objects need about 5000
    shift_reach: Natural = 12  # steps that a carried object may stray on its carrier: 60 cm, most of a desk's depth


def resolve(interior: Interior, method: Released, supports: SupportConfig, rng: Callable[..., np.random.Generator]) -> Resolution:
    """Objects put to rest on what carries them, then Algorithm 1. Only moves along x and y follow."""
    steps = []
    for i, carrier in enumerate(interior.carriers):
        parent = int(interior.parent[i])
        lift = carrier.lift - (interior.carriers[parent].lift if parent >= 0 else 0.0)
        if lift != 0.0:
            steps.append((i, lift))
    crowd, problem = crowd_of(interior, method, supports)
    trace = descend(crowd, method.step_m, method.max_steps, rng("moves"))
    names = interior.names
    rows = [SearchStep(names[i], (0.0, 0.0, lift, 0.0, 0.0, 0.0), trace.start, trace.start, "rested") for i, lift in steps]
    columns = (trace.objects.tolist(), (trace.moves * method.step_m).tolist(), trace.loss.tolist(), trace.smallest.tolist())
    for number, (obj, (dx, dy), loss, smallest, code) in enumerate(zip(*columns, trace.outcome.tolist(), strict=True), start=1):
        rows.append(SearchStep(names[obj], (dx, dy, 0.0, 0.0, 0.0, 0.0), loss, smallest, OUTCOMES[code], number))
    notes = [problem] if problem else []
    if trace.final > 0:
        why = "no single move lowers it" if trace.exhausted else f"{len(trace.loss)} steps were not enough"
        notes.append(f"collision loss {trace.final:.3g} m3 of {trace.start:.3g} m3 is left: {why}")
    if trace.start == 0.0:
        ended = "nothing_to_do"
    else:
        ended = "zero_loss" if trace.final == 0.0 else "no_move_helps" if trace.exhausted else "out_of_moves"
    return Resolution(tuple(rows), trace.start, trace.final, len(trace.loss), 1, ended, tuple(notes), {})


def crowd_of(interior: Interior, method: Released, supports: SupportConfig) -> tuple[Crowd, str | None]:
    """The boxes at rest, which pairs of them count, and what limits their moves; and what is wrong with the room."""
    n, reach, objects = len(interior.objects), method.shift_reach, interior.objects
    carries = np.zeros((n, n), dtype=np.bool_)
    for i, group in enumerate(interior.groups()):
        carries[i, group] = True
    counted = ~(carries | carries.T | interior.covering[:, None] | interior.covering[None])
    shifts = np.zeros((n, 2 * reach + 1, 2 * reach + 1), dtype=np.bool_)
    for i, carrier in enumerate(interior.carriers):
        if interior.parent[i] >= 0:
            shifts[i] = allowed_shifts(objects[i], objects[interior.parent[i]], carrier.gap, method.step_m, reach, supports)
    lifts = np.array([[0.0, 0.0, carrier.lift] for carrier in interior.carriers]).reshape(-1, 3)
    outlines, corners = stacked([plan_ring(obj.surface.vertices[np.unique(obj.surface.faces), :2]) for obj in objects])
    floor, problem = np.zeros((0, 3, 2)), None
    if interior.room is not None and interior.ring is not None:
        try:
            floor = room_triangles(interior.ring, interior_footprints(interior.room))
        except InputError as error:
            problem = f"nothing keeps the assets inside the room: {error}"
    crowd = Crowd(
        low=np.array([obj.low for obj in objects]).reshape(-1, 3) + lifts,
        high=np.array([obj.high for obj in objects]).reshape(-1, 3) + lifts,
        counted=counted,
        movable=np.array([carrier.relation not in ("wall", "ceiling") for carrier in interior.carriers], dtype=np.bool_)
        & ~interior.covering,
        carries=carries,
        outlines=outlines,
        corners=corners,
        room=floor,
        carrier=interior.parent.copy(),
        shifts=shifts,
    )
    return crowd, problem
