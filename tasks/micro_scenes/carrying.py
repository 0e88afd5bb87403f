"""What carries what, from upright boxes alone: for scenes of which nobody has said it.

Boxes do not tell a seat from the back above it, so what is in another's box, above its bottom, counts as carried by it. Nothing is
carried by what does not begin below it, so no object carries itself, not even through others.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.boxes import box_footprint, convex_overlap_area
from tasks.micro_scenes.boxes import StandingBox
from tasks.settings import Config, NonNegative, Positive, Share

Array = NDArray[np.float64]

ROUNDING_M = 1e-6
"""Heights that differ by less are the same [m]: poses turned and turned back differ by less."""


@dataclasses.dataclass(frozen=True)
class CarryingConfig(Config):
    """When one box counts as carrying another."""

    gap_m: NonNegative = 0.02  # boxes of what touches are that near: feet sink into cloth, and scans are no finer
    float_m: NonNegative = 0.05  # finished datasets leave objects floating by as much; what is over nothing nearer is on that
    thinnest_m: Positive = 0.001  # of what carries: a sheet of paper carries nothing
    beside_m: Positive = 0.01  # what begins less far above another's bottom stands under it, not in it: floors are that uneven
    overlap_share: Share = 0.5  # of the carried one's plan: its middle is over the carrier, and it would not tip
    lean_gap_m: NonNegative = 0.02  # between a leaning object and the side that it leans on
    lean_degrees: Positive = 5.0  # less is how scans put things up, and what a certificate calls stable

    @property
    def lean_radians(self) -> float:
        """Tilt from which on an object leans [rad]."""
        return math.radians(self.lean_degrees)


@dataclasses.dataclass(frozen=True)
class CarriedBy:
    """How an object is carried. parent: Instance of what carries it. relation: on, inside or leans."""

    parent: str
    relation: str


def carriers_of(boxes: Sequence[StandingBox], config: CarryingConfig, solid: Collection[str] = ()) -> dict[str, CarriedBy]:
    """What carries each box, by instance; what nothing carries is not there. solid: Instances that others are never in.

    A box is on another when its bottom is near the other's top, and part of its plan over it; of several the one that begins highest, as
    a laptop does on a desk. It is carried by the smallest one that its bottom is in where that stands on the former, as a basket does,
    or where there is no former: inside where it does not reach above it, else on it. What is neither floats over the nearest below.
    """
    footprints = [box_footprint(box.pose, box.size) for box in boxes]
    low, high = np.zeros((len(boxes), 2)), np.zeros((len(boxes), 2))
    for i, corners in enumerate(footprints):
        low[i], high[i] = corners.min(axis=0), corners.max(axis=0)
    bottoms, tops = np.array([box.bottom for box in boxes]), np.array([box.top for box in boxes])
    reach = max(config.gap_m, config.float_m) + ROUNDING_M
    carried: dict[str, CarriedBy] = {}
    for i, box in enumerate(boxes):
        begins_below = bottoms < bottoms[i] - config.thinnest_m + ROUNDING_M
        near = (low < high[i]).all(axis=1) & (high > low[i]).all(axis=1) & (tops > bottoms[i] - reach)
        least = config.overlap_share * float(np.prod(box.size[:2])) * (1.0 - ROUNDING_M)
        under = [
            boxes[j] for j in np.flatnonzero(begins_below & near).tolist() if convex_overlap_area(footprints[i], footprints[j]) >= least
        ]
        if under and (carrier := _carrier(box, under, config, solid)) is not None:
            carried[box.name] = carrier
    return carried


def _carrier(box: StandingBox, under: Sequence[StandingBox], config: CarryingConfig, solid: Collection[str]) -> CarriedBy | None:
    """What carries a box, of those that it is over in plan and that begin below it."""
    touched = [other for other in under if abs(box.bottom - other.top) <= config.gap_m + ROUNDING_M]
    around = [
        other
        for other in under
        if other.top - box.bottom > config.gap_m + ROUNDING_M
        and box.bottom - other.bottom > config.beside_m - ROUNDING_M
        and other.name not in solid
    ]
    on = min(touched, key=lambda other: (-round(other.bottom, 6), other.name), default=None)
    inner = min(around, key=lambda other: (round(float(np.prod(other.size)), 9), other.name), default=None)
    if inner is not None and (on is None or inner.bottom > on.top - config.gap_m - ROUNDING_M):
        return CarriedBy(inner.name, "inside" if box.top <= inner.top + config.gap_m + ROUNDING_M else "on")
    if on is None:
        below = [other for other in under if other.top < box.bottom]
        on = min(below, key=lambda other: (round(box.bottom - other.top, 6), other.name), default=None)
    return CarriedBy(on.name, "on") if on is not None else None


def leans_on(box: StandingBox, larges: Sequence[StandingBox], config: CarryingConfig) -> str | None:
    """Instance of the box, among `larges`, on whose side another leans: near it, no higher above the floor than its top, and tilted
    towards it; the nearest of several, None for none."""
    if box.tilt <= config.lean_radians:
        return None
    near = []
    for large in larges:
        if large.name == box.name or box.bottom >= large.top or box.top <= large.bottom:
            continue
        gap = _gap(box, large)
        if gap <= config.lean_gap_m + ROUNDING_M and _towards(box, large) > config.lean_radians:
            near.append((round(gap, 6), large.name))
    return min(near)[1] if near else None


def without_circles(carried: Mapping[str, CarriedBy]) -> bool:
    """Whether no object carries itself, not even through others."""
    for name in carried:
        seen, at = {name}, carried[name].parent
        while at in carried and at not in seen:
            seen.add(at)
            at = carried[at].parent
        if at in seen:
            return False
    return True


def _gap(box: StandingBox, other: StandingBox) -> float:
    """Distance of two boxes in plan [m]."""
    import shapely

    first, second = (shapely.Polygon(box_footprint(part.pose, part.size)) for part in (box, other))
    return float(first.distance(second))


def _towards(box: StandingBox, large: StandingBox) -> float:
    """By how much a box is tilted towards the side of another that is nearest to it [rad]."""
    own = large.pose[:2, :2].T @ (box.center - large.pose[:3, 3])[:2]
    half = 0.5 * large.size[:2]
    nearest = np.clip(own, -half, half)
    ahead = nearest - own
    if not ahead.any():  # its middle is within the other's plan, as that of a tilted box can be: away from the nearest side
        axis = int(np.argmin(half - np.abs(own)))
        ahead[axis] = -1.0 if own[axis] > 0 else 1.0
    ahead = large.pose[:2, :2] @ ahead / np.hypot(*ahead)
    return math.atan2(float(box.up[:2] @ ahead), float(box.up[2]))
