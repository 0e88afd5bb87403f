"""What is true of a frame's pixels, and how regions that a program found are held against it."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NOTHING, UNKNOWN = -1, -2
"""Owners of pixels that are no object's (floor, walls, what is behind), and of those of which nobody says whose they are."""

LEAST_PIXELS = 200
"""An object of which less has a depth is not counted, and a region that is mostly it is no error: 2.4 cm square at 1 m."""

HALF = 0.5
"""Of a region that nobody labeled: it is neither right nor wrong. Of a support's pixels and a region's: the region is that support."""

PART = 0.2
"""An object is in pieces where two regions have so much of it each."""


@dataclasses.dataclass(frozen=True)
class FrameTruth:
    """owner: Object of each pixel from 0, `NOTHING` or `UNKNOWN`, shape (h, w). supports: Objects that carry others."""

    owner: NDArray[np.int64]
    supports: frozenset[int] = frozenset()


@dataclasses.dataclass(frozen=True)
class FrameScore:
    """Of a frame, or of several. objects: That are counted. regions: Found, but for those that are neither right nor wrong. matched,
    matched_well: Pairs with an IoU of 0.5 and 0.75. in_pieces: Objects in two regions or more. shared: Objects whose region has half of
    another one, too."""

    objects: int = 0
    regions: int = 0
    matched: int = 0
    matched_well: int = 0
    in_pieces: int = 0
    shared: int = 0

    def __add__(self, other: FrameScore) -> FrameScore:
        return FrameScore(*(a + b for a, b in zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)))

    @property
    def precision(self) -> float:
        """Share of the regions that are an object."""
        return self.matched / max(self.regions, 1)

    @property
    def recall(self) -> float:
        """Share of the objects that are a region."""
        return self.matched / max(self.objects, 1)

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall."""
        return 2 * self.matched / max(self.objects + self.regions, 1)

    @property
    def f1_well(self) -> float:
        """The same at an IoU of 0.75."""
        return 2 * self.matched_well / max(self.objects + self.regions, 1)


def frame_score(truth: FrameTruth, labels: NDArray[np.int64], has_depth: NDArray[np.bool_]) -> FrameScore:
    """Regions of a frame against its truth. labels: Region of each pixel from 0, -1 for none, shape (h, w)."""
    count = int(truth.owner.max(initial=-1)) + 1
    regions = int(labels.max(initial=-1)) + 1
    owner, region = truth.owner[has_depth], labels[has_depth]
    table = np.zeros((count + 2, regions + 1), dtype=np.int64)
    np.add.at(table, (np.where(owner >= 0, owner, count - 1 - owner), np.where(region >= 0, region, regions)), 1)
    known = np.delete(table, count + 1, axis=0)
    shared = known[:count, :regions].astype(np.float64)
    sizes, spans = known[:count].sum(axis=1), known[:, :regions].sum(axis=0)
    overlap = shared / np.maximum(sizes[:, None] + spans[None, :] - shared, 1)
    counted = np.array([i for i in range(count) if i not in truth.supports and sizes[i] >= LEAST_PIXELS], dtype=np.int64)
    wrong = [j for j in range(regions) if _is_judged(j, table, overlap, counted, truth.supports)]
    own = overlap[np.ix_(counted, np.array(wrong, dtype=np.int64))]
    share = shared[counted] / np.maximum(sizes[counted], 1)[:, None]
    best = share.argmax(axis=1) if share.size else np.zeros(0, dtype=np.int64)
    halves = (share >= HALF)[np.arange(len(counted)), best] if share.size else np.zeros(0, dtype=bool)
    both = sum(bool(halves[i]) and (best[halves] == best[i]).sum() > 1 for i in range(len(halves)))
    return FrameScore(
        len(counted), len(wrong), matches(own, 0.5), matches(own, 0.75), int(((share >= PART).sum(axis=1) > 1).sum()), int(both)
    )


def _is_judged(region: int, table: NDArray[np.int64], overlap: Array, counted: NDArray[np.int64], supports: frozenset[int]) -> bool:
    """Whether a region is right or wrong: it has pixels, most of them labeled, and is neither a support nor mostly a thing too small."""
    column = table[:, region]
    if not column.sum() or column[-1] > HALF * column.sum():
        return False
    most = int(column[:-1].argmax())
    if most in supports:
        return bool(overlap[most, region] < HALF)
    return most == len(column) - 2 or most in counted


def matches(overlap: Array, least: float) -> int:
    """Pairs of objects and regions, shape (objects, regions), that overlap enough, each one in one pair at most."""
    from scipy.optimize import linear_sum_assignment

    enough = np.where(overlap >= least, overlap, 0.0)
    rows, columns = linear_sum_assignment(enough, maximize=True)
    return int((enough[rows, columns] > 0).sum())
