"""New small objects beside the instances that a scan's files have: none is there twice."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tasks.capture.small_objects.consensus import ConsensusInstance
from tasks.capture.small_objects.lifting import LiftedFrame
from tasks.settings import Config, Count, Positive, Share

_SPACING_POINTS = 500
"""Of an instance, by which its spacing is measured."""

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class JoiningConfig(Config):
    """When a new object is one that is there already."""

    reach_m: Positive = 0.02  # a scan mesh's vertices lie as far from each other, and poses drift by a centimeter
    reach_spacings: Positive = 0.8  # of those of a coarser one: the middle of a square of vertices is 0.7 of its side from them
    same_share: Share = 0.5  # of a new object's points at those of an instance, or the other way round: it is that one
    structure_share: Share = 0.8  # of its points at those of a wall: it is wall; what hangs there or leans on it stands off by a part
    whole_share: Share = 0.4  # of an instance's points at those of one new object: they are of a size, and it is that one
    least_held: Count = 2  # new objects in one instance: it holds several


@dataclasses.dataclass(frozen=True)
class ExistingInstance:
    """An instance that a scan has. instance_id: Zero-padded. points: World frame [m], shape (n, 3). is_structure: Floor, wall or
    ceiling."""

    instance_id: str
    points: Array
    is_structure: bool = False

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest coordinates of its points [m], shapes (3,)."""
        return self.points.min(axis=0), self.points.max(axis=0)

    @cached_property
    def spacing(self) -> float:
        """Median distance of its points from the nearest other place that has one [m]; 0 where there is but one."""
        from scipy.spatial import cKDTree

        places = np.unique(np.round(self.points, 3), axis=0)  # corners of several faces are one
        if len(places) < 2:
            return 0.0
        some = places[:: max(1, len(places) // _SPACING_POINTS)]
        return float(np.median(cKDTree(places).query(some, k=2)[0][:, 1]))


@dataclasses.dataclass(frozen=True)
class NewInstance:
    """An object to be added: what a row of `instances`, and its rows of `masks`, are made of.

    instance_id: Goes on after those there are. category: '' where nobody named it. probability: Of the category, 0 to 1. found_by: Who
    found it. support_id: Instance that carries it, '' for none. points: World frame [m], shape (n, 3). colors: Shape (n, 3). masks: By
    frame id, at the resolution of its depth, shape (h, w).
    """

    instance_id: str
    category: str
    probability: float
    found_by: str
    support_id: str
    points: Array
    colors: NDArray[np.uint8]
    masks: Mapping[str, Bools]


@dataclasses.dataclass(frozen=True)
class FoundObject:
    """An object as somebody found it: see `NewInstance`."""

    points: Array
    colors: NDArray[np.uint8]
    category: str
    probability: float
    found_by: str
    support_id: str
    masks: Mapping[str, Bools]


@dataclasses.dataclass(frozen=True)
class Joined:
    """What comes of both. added: New instances. known: Place of a found object among those given, and the id of the instance that it is.
    under_segmented: Instances that hold several found objects, with their places. notes: A line for each of these."""

    added: tuple[NewInstance, ...]
    known: Mapping[int, str]
    under_segmented: Mapping[str, tuple[int, ...]]
    notes: tuple[str, ...]


def found_object(
    instance: ConsensusInstance, frames: Sequence[LiftedFrame], category: str, probability: float, found_by: str, support_id: str
) -> FoundObject:
    """An instance that views agree on as a found object."""
    masks = {
        frames[frame].view.frame_id: np.asarray(frames[frame].masks[list(numbers)].any(axis=0)) for frame, numbers in instance.masks.items()
    }
    return FoundObject(instance.points, instance.colors, category, probability, found_by, support_id, masks)


def joined(existing: Sequence[ExistingInstance], objects: Sequence[FoundObject], config: JoiningConfig) -> Joined:
    """Found objects that no instance has, those that one is, and instances that hold several.

    What carries an object is none that it can be: what stands on a table may be annotated as a part of it.
    An instance stays as it is, whatever is found: one that holds several objects is told, and they are not added, since their points
    would be there twice. Of two found objects with the same points the one with more is kept.
    """
    rivals = [other for other in existing if len(other.points)]
    known: dict[int, str] = {}
    held: dict[str, list[int]] = {}
    for place, obj in enumerate(objects):
        inside = [_sameness(obj, other, config) for other in rivals]
        wanted = [config.structure_share if other.is_structure else config.same_share for other in rivals]
        best = max(range(len(rivals)), key=lambda i: (inside[i] - wanted[i], -i), default=None)
        if best is None or inside[best] < wanted[best]:
            continue
        other = rivals[best]
        known[place] = other.instance_id
        if not other.is_structure:
            held.setdefault(other.instance_id, []).append(place)
    several = {name: tuple(places) for name, places in sorted(held.items()) if len(places) >= config.least_held}
    by_id = {other.instance_id: other for other in rivals}
    # two parts of one object are no proof that it is several, when one of them is nearly all of it
    several = {
        name: places
        for name, places in several.items()
        if sum(_share(by_id[name].points, objects[i].points, config.reach_m) < 1 - config.whole_share for i in places) == len(places)
    }
    fresh = [place for place in range(len(objects)) if place not in known]
    kept: list[int] = []
    for place in sorted(fresh, key=lambda i: (-len(objects[i].points), i)):
        if all(_share(objects[place].points, objects[i].points, config.reach_m) < config.same_share for i in kept):
            kept.append(place)
    start = 1 + max((int(other.instance_id) for other in existing), default=-1)
    added = [
        NewInstance(f"{start + number:04d}", obj.category, obj.probability, obj.found_by, obj.support_id, obj.points, obj.colors, obj.masks)
        for number, obj in enumerate(objects[place] for place in sorted(kept))
    ]
    notes = tuple(
        f"instance {name} holds {len(places)} objects, as {objects[places[0]].found_by} sees it; it stays as it is"
        for name, places in several.items()
    )
    return Joined(tuple(added), known, several, notes)


def _sameness(obj: FoundObject, other: ExistingInstance, config: JoiningConfig) -> float:
    """Share of an object's points within reach [m] of an instance's, or of these of the object's where it is more: a scan mesh has a
    vertex every two centimeters, and of a bowl a hundred. What carries the object is another."""
    if other.instance_id == obj.support_id or not _meet(obj.points, other, config.reach_m):
        return 0.0
    reach = max(config.reach_m, config.reach_spacings * other.spacing)
    own = _share(obj.points, other.points, reach)
    return own if other.is_structure else max(own, _share(other.points, obj.points, reach))


def _meet(points: Array, other: ExistingInstance, reach: float) -> bool:
    """Whether the boxes of points and of an instance come within reach [m] of each other."""
    low, high = other.bounds
    return bool((points.min(axis=0) - reach <= high).all() and (points.max(axis=0) + reach >= low).all())


def _share(points: Array, nearby: Array, reach: float) -> float:
    """Share of points, shape (n, 3), with one of the others, shape (m, 3), within reach [m]; 0 to 1."""
    from scipy.spatial import cKDTree

    near = np.flatnonzero(((nearby >= points.min(axis=0) - reach) & (nearby <= points.max(axis=0) + reach)).all(axis=1))
    if not len(near):
        return 0.0
    distance = cKDTree(nearby[near]).query(points, distance_upper_bound=reach)[0]
    return float(np.isfinite(distance).mean())
