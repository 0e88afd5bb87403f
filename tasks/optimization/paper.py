"""Algorithm 1 of the MetaScenes supplementary: sweeps over all objects, with a sum of IoU as the loss."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.optimization.interior import Interior
from tasks.optimization.search.collisions import plan_ring
from tasks.optimization.search.descent import TOUCH_M
from tasks.optimization.search.trace import Resolution, SearchStep
from tasks.settings import Config, Natural, Positive
from tasks.shell import interior_footprints

if TYPE_CHECKING:
    from shapely import Geometry

Array = NDArray[np.float64]

MIN_DECREASE = 1e-12
"""Smallest decrease of the loss that counts: the rounding of a sum of some hundred IoU."""

MIN_OUTSIDE_M2 = 1e-9
"""Smallest area by which more of an outline must lie outside for it to have left the room: the rounding of clipped areas."""


@dataclasses.dataclass(frozen=True)
class Paper(Config):
    """Algorithm 1 of the supplementary: sweeps over all objects; a move is kept if the loss falls.

    The loss is the sum of IoU of axis-aligned boxes over all pairs of objects (equation A1). A sweep visits the
    objects i = 1..m in the order of their ids and draws one of four movements for each. A movement that leaves
    the room is skipped. It is kept if the loss of the whole scene falls below the smallest so far, and reverted
    otherwise. The search ends at a loss of zero or after `max_sweeps` sweeps.

    The text does not print the movements and optimizes "horizontal and vertical placement". Our reading:

    - The four movements are one step forward or backward along a horizontal axis (x or y, drawn), up, or down.
    - The room bounds heights, too: an object does not go below the floor or above the ceiling.
    - An object that reaches out of the room at the start may move unless more of it gets outside.
    - Objects are put on their carriers first, and what an object carries moves along with it.
    - The search also ends once every movement was tried since the last kept one. This saves time only.
    """

    kind: ClassVar[str] = "paper"
    step_m: Positive = 0.05  # the step of Algorithm 1
    max_sweeps: Natural = 1_000  # the search ends by itself long before, when no movement helps


MOVEMENTS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
"""All movements in steps: the horizontal ones along x and along y, then up and down."""


def resolve(interior: Interior, method: Paper, rng: Callable[..., np.random.Generator]) -> Resolution:
    """Put objects on what carries them, then search.

    Args:
        interior: the proposed objects in their room.
        method: step and number of sweeps.
        rng: seeded generators by name.
    """
    names, carriers = interior.names, interior.carriers
    lifts = np.array([carrier.lift for carrier in carriers], dtype=np.float64)
    boxes = np.array([[obj.low, obj.high] for obj in interior.objects], dtype=np.float64).reshape(-1, 2, 3)
    boxes[:, :, 2] += lifts[:, None]
    room, problem = _room_of(interior)
    search = _Search(interior, boxes, room)
    start = search.loss
    # Carriers come first: an object's own move is the rest of its lift.
    steps = []
    for i, parent in enumerate(interior.parent):
        rest = lifts[i] - (lifts[parent] if parent >= 0 else 0.0)
        if rest != 0.0:
            steps.append(SearchStep(names[i], (0.0, 0.0, float(rest), 0.0, 0.0, 0.0), start, start, "rested"))
    steps += search.run(method, rng("moves"))
    tried = sum(step.number > 0 for step in steps)
    notes = [problem] if problem else []
    if search.loss > 0:
        why = "no single move lowers it" if search.is_exhausted else f"{method.max_sweeps} sweeps were not enough"
        notes.append(f"collision loss {search.loss:.3g} of {start:.3g} is left: {why}")
    if start == 0.0:
        ended = "nothing_to_do"
    elif search.loss == 0.0:
        ended = "zero_loss"
    else:
        ended = "no_move_helps" if search.is_exhausted else "out_of_moves"
    return Resolution(tuple(steps), start, search.loss, tried, 1, ended, tuple(notes), {})


def _ious(boxes: Array, i: int) -> Array:
    """IoU of box i with every other box, shape (n,). Boxes that only touch have none. boxes: low and high corners [m], shape (n, 2, 3)."""
    sides = np.minimum(boxes[:, 1], boxes[i, 1]) - np.maximum(boxes[:, 0], boxes[i, 0])
    shared = np.where((sides > TOUCH_M).all(axis=1), sides.prod(axis=1), 0.0)
    shared[i] = 0.0
    volumes = (boxes[:, 1] - boxes[:, 0]).prod(axis=1)
    return np.divide(shared, volumes + volumes[i] - shared, out=np.zeros(len(boxes)), where=shared > 0)


@dataclasses.dataclass(frozen=True)
class _Room:
    """Bounds of objects. free: floor polygon without inner walls. height_m: height of the ceiling [m]."""

    free: Geometry
    height_m: float

    def outside(self, outline: Array, box: Array) -> Array:
        """Area of an outline outside of the floor [m2], and how far its box is below the floor and above the ceiling [m]."""
        import shapely

        shape = shapely.Polygon(outline)
        area = 0.0 if self.free.covers(shape) else shape.difference(self.free).area
        return np.array([area, max(-box[0, 2], 0.0), max(box[1, 2] - self.height_m, 0.0)])


def _room_of(interior: Interior) -> tuple[_Room | None, str | None]:
    """Bounds of the room, and the reason if there are none."""
    import shapely

    if interior.room is None or interior.ring is None:
        return None, None
    try:
        walls = interior_footprints(interior.room)
        free = shapely.Polygon(interior.ring).buffer(0)
        if walls:
            free = free.difference(shapely.union_all([shapely.Polygon(corners) for corners in walls]))
    except (InputError, shapely.errors.GEOSException) as error:
        return None, f"nothing keeps the assets inside the room: {error}"
    shapely.prepare(free)
    return _Room(free, interior.room.height_m), None


class _Search:
    """State of the search. loss: sum of IoU over all pairs of objects (equation A1). is_exhausted: no single movement lowers it."""

    def __init__(self, interior: Interior, boxes: Array, room: _Room | None) -> None:
        self._names, self._groups, self._room = interior.names, interior.groups(), room
        self._boxes, self._first, self._moved = boxes, boxes, np.zeros((len(boxes), 3), dtype=np.int64)
        self._outlines = [plan_ring(obj.surface.vertices[np.unique(obj.surface.faces), :2]) for obj in interior.objects]
        self._outside = [self._outside_of(i, boxes) for i in range(len(boxes))]
        self._ious = np.array([_ious(boxes, i) for i in range(len(boxes))]).reshape(len(boxes), len(boxes))
        self.loss, self.is_exhausted = float(self._ious.sum() / 2), False

    def run(self, method: Paper, rng: np.random.Generator) -> list[SearchStep]:
        """Sweep until the loss is zero, no movement helps, or all sweeps are done. One step for each movement that was drawn."""
        order = sorted(range(len(self._names)), key=lambda i: self._names[i])
        steps: list[SearchStep] = []
        tried: set[tuple[int, int]] = set()
        for _ in range(method.max_sweeps):
            for i in order:
                if self.loss == 0.0 or self.is_exhausted:
                    return steps
                movement = int(rng.integers(4))
                # Two of four movements are horizontal; their axis is drawn.
                choice = movement + 2 * int(rng.integers(2)) if movement < 2 else movement + 2
                loss, outcome = self._try(i, MOVEMENTS[choice], method.step_m)
                tried = set() if outcome == "kept" else tried | {(i, choice)}
                self.is_exhausted = len(tried) == len(MOVEMENTS) * len(order)
                move = (*(MOVEMENTS[choice] * method.step_m).tolist(), 0.0, 0.0, 0.0)
                steps.append(SearchStep(self._names[i], move, loss, self.loss, outcome, len(steps) + 1))
        return steps

    def _try(self, i: int, movement: NDArray[np.int64], step: float) -> tuple[float, str]:
        """Move an object with all it carries, and keep the move if the loss falls. Returns the loss and the outcome."""
        group = self._groups[i]
        boxes = self._boxes.copy()
        # Boxes follow from their first place, so that rounding does not add up.
        boxes[group] = self._first[group] + ((self._moved[group] + movement) * step)[:, None]
        outside = [self._outside_of(k, boxes) for k in group]
        if any((outside[n] > self._outside[k] + MIN_OUTSIDE_M2).any() for n, k in enumerate(group)):
            return self.loss, "left_room"
        ious = self._ious.copy()
        for k in group:
            ious[k] = ious[:, k] = _ious(boxes, k)
        loss = float(ious.sum() / 2)
        if loss >= self.loss - MIN_DECREASE:
            return loss, "reverted"
        self.loss, self._boxes, self._ious = loss, boxes, ious
        self._moved[group] += movement
        for n, k in enumerate(group):
            self._outside[k] = outside[n]
        return loss, "kept"

    def _outside_of(self, i: int, boxes: Array) -> Array:
        """Part of an object outside of the room: area [m2], depth below the floor and above the ceiling [m]."""
        if self._room is None:
            return np.zeros(3)
        return self._room.outside(self._outlines[i] + boxes[i, 0, :2] - self._first[i, 0, :2], boxes[i])
