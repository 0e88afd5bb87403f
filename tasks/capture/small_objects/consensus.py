"""Masks of many views as instances: those that other views agree to be one object.

After MaskClustering (Yan et al., CVPR 2024), written anew on sparse matrices, with what small objects need besides: masks of one frame
never become one instance, and masks of different names only where they cover the same points. Source: specs/models.md A.5.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.views import depth_tolerance
from tasks.capture.small_objects.lifting import LiftedFrame, density_clusters, depths, visible_points, voxel_keys
from tasks.settings import Config, Count, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]

_PERCENTILES = tuple(range(95, -1, -5))
"""Of the numbers of observers: pairs that many views know are joined first, since their consensus is the surest."""


@dataclasses.dataclass(frozen=True)
class ConsensusConfig(Config):
    """When masks are one instance, and what of it is kept."""

    voxel_m: Positive = 0.005  # a mug has a thousand points
    seen_share: Share = 0.3  # of a mask's points that a frame has to see, in some mask, before it has a say
    contained: Share = 0.8  # of these in one mask: the frame agrees; in several: it divides the mask
    split_share: Share = 0.3  # a mask that more of its views divide holds several objects
    agreement: Share = 0.9  # of the views that know both masks: they are one
    side_by_side: Share = 0.0  # of the frames of two clusters that may show both: masks of one frame are two objects
    two_sides: Share = 0.2  # of the smaller one's points in another one: two that merely touch share less, by the drift of poses
    other_name: Share = 0.5  # overlap from which on masks of different names are one object
    least_masks: Count = 2  # one view alone may be a reflection, or a part of something
    kept_share: Share = 0.5  # of the views of a point that have it in the instance
    reach_m: Positive = 0.05  # parts that lie farther apart are two objects
    reach_points: Count = 4  # within the reach, fewer are stray points
    least_points: Count = 30  # of 5 mm: what a mouse shows to one view
    doubled: Share = 0.8  # of its points in a larger instance: it is a part of that


@dataclasses.dataclass(frozen=True)
class ConsensusInstance:
    """An object that several views agree on.

    points: World frame [m], shape (n, 3). colors: Shape (n, 3). label: The name that weighs most over its masks, '' for none.
    label_share: Its share of their weight. score: How sure its masks were on average. masks: Frame and mask of that frame, the numbers
    of `LiftedFrame`s and of their masks; one a frame.
    """

    points: Array
    colors: NDArray[np.uint8]
    label: str
    label_share: float
    score: float
    masks: Mapping[int, tuple[int, ...]]


@dataclasses.dataclass(frozen=True)
class Consensus:
    """Instances, the most points first, and masks (frame, number) that hold several objects as other views see it."""

    instances: tuple[ConsensusInstance, ...]
    under_segmented: tuple[tuple[int, int], ...]


@dataclasses.dataclass(frozen=True)
class _Sightings:
    """What frames see of points. points: (p, 3). colors: (p, 3). own: Masks by points, 1 where a mask was lifted to a point. holds: The
    same, 1 where a point is seen in a mask. visible: Points by frames. frame: Of each mask, (k,). first: Number of each frame's first
    mask."""

    points: Array
    colors: NDArray[np.uint8]
    own: Any
    holds: Any
    visible: NDArray[np.float32]
    frame: Indices
    first: Indices


@dataclasses.dataclass(frozen=True)
class _Views:
    """What frames say of masks. observes: Masks by frames, 1 where a frame has the mask's points in one mask. supports: Masks by masks,
    1 where a mask has the points of another one."""

    observes: Any
    supports: Any
    is_under_segmented: Bools


def associate(frames: Sequence[LiftedFrame], config: ConsensusConfig) -> Consensus:
    """Instances that the masks of frames are of."""
    seen = _sightings(frames, config)
    if not len(seen.frame) or not len(seen.points):
        return Consensus((), ())
    views = _agreement(seen, config)
    names = [label for frame in frames for label in frame.labels]
    cluster = _clusters(seen, views, names, config)
    dropped = np.flatnonzero(views.is_under_segmented)
    under = tuple((int(seen.frame[i]), int(i - seen.first[seen.frame[i]])) for i in dropped)
    return Consensus(_instances(frames, seen, views, cluster, config), under)


def _sightings(frames: Sequence[LiftedFrame], config: ConsensusConfig) -> _Sightings:
    """Scene points, and which masks and frames see them."""
    from scipy.sparse import csr_array

    counts = np.array([len(frame.masks) for frame in frames], dtype=np.int64)
    first = np.cumsum(counts) - counts
    own = [points for frame in frames for points in frame.points]
    everything = np.concatenate(own) if own else np.zeros((0, 3))
    tints = [colors for frame in frames for colors in frame.colors]
    keys = voxel_keys(everything, config.voxel_m)
    _, thin, voxel = np.unique(keys, return_index=True, return_inverse=True)
    points = everything[thin]
    lifted = np.repeat(np.arange(int(counts.sum())), [len(part) for part in own])
    visible = np.zeros((len(points), len(frames)), dtype=np.float32)
    rows, columns = [], []
    for index, frame in enumerate(frames):
        is_seen, row, column = visible_points(frame.view, points, depth_tolerance(depths(frame.view, points)))
        visible[:, index] = is_seen
        owner = np.where(is_seen, frame.owner[row, column], -1)
        inside = np.flatnonzero(owner >= 0)
        rows.append(first[index] + owner[inside])
        columns.append(inside)
    mask = np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
    holds = csr_array(
        (np.ones(len(mask), dtype=np.float32), (mask, np.concatenate(columns) if columns else mask)), shape=(int(counts.sum()), len(points))
    )
    colors = np.concatenate(tints)[thin] if tints else np.zeros((0, 3), dtype=np.uint8)
    of_mask = _binary(csr_array((np.ones(len(lifted), dtype=np.float32), (lifted, voxel)), shape=holds.shape))
    return _Sightings(points, colors, of_mask, holds, visible, np.repeat(np.arange(len(frames)), counts), first)


def _ones(rows: Indices, columns: Indices, shape: tuple[int, int]) -> Any:
    """A sparse matrix of ones."""
    from scipy.sparse import csr_array

    return csr_array((np.ones(len(rows), dtype=np.float32), (rows, columns)), shape=shape)


def _binary(matrix: Any) -> Any:
    """A sparse matrix with ones wherever it has anything."""
    matrix = matrix.tocsr()
    matrix.data = np.ones_like(matrix.data)
    return matrix


def _agreement(seen: _Sightings, config: ConsensusConfig) -> _Views:
    """Observers and supporters of masks, without those that hold several objects."""
    masks, frames = len(seen.frame), seen.visible.shape[1]
    of_frame = _ones(np.arange(masks), seen.frame, (masks, frames))
    shared = (seen.own @ seen.holds.T).tocoo()
    sizes = np.asarray(seen.own.sum(axis=1)).ravel()
    in_masks = np.asarray((shared.tocsr() @ of_frame).todense())
    in_view = seen.own @ seen.visible
    has_say = (in_view >= config.seen_share * sizes[:, None]) & (in_masks >= config.seen_share * in_view) & (in_masks > 0)
    # of each mask and frame, the mask of the frame that has most of its points
    order = np.lexsort((shared.col, -shared.data, seen.frame[shared.col], shared.row))
    row, column, count = shared.row[order], shared.col[order], shared.data[order]
    key = row.astype(np.int64) * frames + seen.frame[column]
    best = np.flatnonzero(np.r_[True, key[1:] != key[:-1]]) if len(key) else np.zeros(0, dtype=np.int64)
    row, column, count = row[best], column[best], count[best]
    frame = seen.frame[column]
    say = has_say[row, frame]
    whole = say & (count > config.contained * in_masks[row, frame])
    splits, votes = np.bincount(row[say & ~whole], minlength=masks), np.bincount(row[say], minlength=masks)
    under = splits > config.split_share * np.maximum(votes, 1)
    whole &= ~under[row] & ~under[column]
    row, column, frame = row[whole], column[whole], frame[whole]
    return _Views(_ones(row, frame, (masks, frames)), _ones(row, column, (masks, masks)), np.asarray(under))


def _clusters(seen: _Sightings, views: _Views, names: Sequence[str], config: ConsensusConfig) -> Indices:
    """Cluster of each mask, -1 for masks that hold several objects."""
    cluster = np.where(views.is_under_segmented, -1, np.cumsum(~views.is_under_segmented) - 1)
    counts = (views.observes @ views.observes.T).tocoo()
    pairs = counts.data[counts.row < counts.col]
    if not len(pairs):
        return np.asarray(cluster, dtype=np.int64)
    median = float(np.median(pairs))
    for percentile in _PERCENTILES:
        least = float(np.percentile(pairs, percentile))
        if least <= 1:
            if least < median or percentile < 50:
                break
            least = 1.0
        while True:
            merged = _joined(seen, views, names, cluster, least, config)
            if merged is None:
                break
            cluster = merged
    return _completed(seen, np.asarray(cluster, dtype=np.int64), names, config)


def _completed(seen: _Sightings, cluster: Indices, names: Sequence[str], config: ConsensusConfig) -> Indices:
    """Clusters after those have become one that no frame shows side by side and that share points: an object from its two sides."""
    while True:
        used = np.flatnonzero(cluster >= 0)
        count = int(cluster.max(initial=-1)) + 1
        if count < 2:
            return cluster
        member = _ones(cluster[used], used, (count, len(cluster)))
        own, holds = _binary(member @ seen.own), _binary(member @ seen.holds)
        shared = (own @ holds.T).tocoo()
        sizes = np.asarray(own.sum(axis=1)).ravel()
        other = shared.row != shared.col
        a, b = np.minimum(shared.row, shared.col)[other], np.maximum(shared.row, shared.col)[other]
        overlap = shared.data[other] / sizes[shared.row[other]]
        fit = overlap > config.two_sides
        merged = _united(seen, member, names, cluster, a[fit], b[fit], overlap[fit], config)
        if merged is None:
            return cluster
        cluster = merged


def _joined(
    seen: _Sightings, views: _Views, names: Sequence[str], cluster: Indices, least: float, config: ConsensusConfig
) -> Indices | None:
    """Clusters of masks after all pairs that enough frames observe and agree on have become one; None where there is no such pair."""
    used = np.flatnonzero(cluster >= 0)
    count = int(cluster.max()) + 1
    member = _ones(cluster[used], used, (count, len(cluster)))
    observes, supports = _binary(member @ views.observes), _binary(member @ views.supports)
    supporters = (supports @ supports.T).tocoo()
    upper = supporters.row < supporters.col
    a, b, agree = supporters.row[upper], supporters.col[upper], supporters.data[upper]
    known = np.asarray(observes.todense()) > 0
    observers = (known[a] & known[b]).sum(axis=1)
    fit = (observers >= least) & (agree >= config.agreement * np.maximum(observers, 1))
    surest = agree[fit] / np.maximum(observers[fit], 1) + 1e-6 * observers[fit]
    return _united(seen, member, names, cluster, a[fit], b[fit], surest, config)


def _united(
    seen: _Sightings, member: Any, names: Sequence[str], cluster: Indices, a: Indices, b: Indices, surest: Array, config: ConsensusConfig
) -> Indices | None:
    """Clusters of masks after pairs a, b have become one, the surest first, but for pairs that one frame shows side by side, and for pairs
    of different names that do not cover the same points; None where no pair is left."""
    frames = np.asarray((member @ _ones(np.arange(len(cluster)), seen.frame, (len(cluster), seen.visible.shape[1]))).todense()) > 0
    fit = _may_join(frames[a], frames[b], config)
    a, b, surest = a[fit], b[fit], surest[fit]
    used = np.flatnonzero(cluster >= 0)
    named: list[set[str]] = [set() for _ in frames]
    for mask in used.tolist():
        named[cluster[mask]] |= {names[mask]} - {""}
    same = np.array([not named[i] or not named[j] or bool(named[i] & named[j]) for i, j in zip(a, b, strict=True)], dtype=bool)
    if not same.all():
        same[~same] = _overlaps(seen, member, frames, a[~same], b[~same]) > config.other_name
        a, b, surest = a[same], b[same], surest[same]
    if not len(a):
        return None
    root = np.arange(len(frames))
    for i in np.lexsort((b, a, -surest)):
        low, high = sorted((_root(root, int(a[i])), _root(root, int(b[i]))))
        if low != high and _may_join(frames[low], frames[high], config):
            root[high] = low
            frames[low] |= frames[high]
    whole = np.array([_root(root, i) for i in range(len(root))])
    merged = cluster.copy()
    merged[used] = np.unique(whole, return_inverse=True)[1][cluster[used]]
    return merged


def _may_join(first: Bools, second: Bools, config: ConsensusConfig) -> Bools:
    """Whether clusters in these frames, shape (..., f), may be one: too few frames show them side by side."""
    both, fewer = (first & second).sum(axis=-1), np.minimum(first.sum(axis=-1), second.sum(axis=-1))
    return np.asarray(both <= config.side_by_side * fewer)


def _root(root: Indices, index: int) -> int:
    """Of a forest of unions."""
    while root[index] != index:
        root[index] = root[root[index]]
        index = int(root[index])
    return index


def _overlaps(seen: _Sightings, member: Any, frames: Bools, a: Indices, b: Indices) -> Array:
    """Intersection over union of pairs of clusters, among the points that both had in view."""
    has = _binary(member @ seen.holds)
    overlap = np.zeros(len(a))
    for i, (first, second) in enumerate(zip(a, b, strict=True)):
        mine, theirs = has[[first]].indices, has[[second]].indices
        shared = len(np.intersect1d(mine, theirs))
        of_mine = int((seen.visible[mine][:, frames[second]].any(axis=1)).sum())
        of_theirs = int((seen.visible[theirs][:, frames[first]].any(axis=1)).sum())
        overlap[i] = shared / max(of_mine + of_theirs - shared, 1)
    return overlap


def _instances(
    frames: Sequence[LiftedFrame], seen: _Sightings, views: _Views, cluster: Indices, config: ConsensusConfig
) -> tuple[ConsensusInstance, ...]:
    """Clusters as instances: their lasting points, each part that lies apart for itself, none that is a part of another."""
    parts: list[tuple[Indices, Array, Indices]] = []  # points, how many of their views have them, masks
    for number in range(int(cluster.max(initial=-1)) + 1):
        masks = np.flatnonzero(cluster == number)
        if len(masks) < config.least_masks:
            continue
        has = np.asarray(seen.holds[masks].sum(axis=0)).ravel()
        known = np.asarray(views.observes[masks].sum(axis=0)).ravel() > 0
        known[seen.frame[masks]] = True
        points = np.flatnonzero(has)
        share = has[points] / np.maximum(seen.visible[points][:, known].sum(axis=1), 1)
        lasting = share > config.kept_share
        parts += _pieces(seen, points[lasting], share[lasting], masks, config)
    order = sorted(range(len(parts)), key=lambda i: (-len(parts[i][0]), int(parts[i][2][0])))
    return tuple(
        _instance(frames, seen, points, masks) for points, masks in _exclusive([parts[i] for i in order], len(seen.points), config)
    )


def _pieces(
    seen: _Sightings, points: Indices, share: Array, masks: Indices, config: ConsensusConfig
) -> list[tuple[Indices, Array, Indices]]:
    """A cluster's parts that lie apart, each with the masks that have more of it than of the other parts."""
    label = density_clusters(seen.points[points], config.reach_m, config.reach_points)
    count = int(label.max(initial=-1)) + 1
    if not count:
        return []
    held = np.stack([np.asarray(seen.holds[masks][:, points[label == part]].sum(axis=1)).ravel() for part in range(count)], axis=1)
    best = np.where(held.max(axis=1) > 0, held.argmax(axis=1), -1)
    pieces = [(points[label == part], share[label == part], masks[best == part]) for part in range(count)]
    return [piece for piece in pieces if len(piece[2]) >= config.least_masks and len(piece[0]) >= config.least_points]


def _exclusive(parts: Sequence[tuple[Indices, Array, Indices]], count: int, config: ConsensusConfig) -> list[tuple[Indices, Indices]]:
    """Parts, the largest first, without those that lie in a larger one; a point that two have is the one's whose views have it more."""
    kept: list[tuple[Indices, Array, Indices]] = []
    for points, share, masks in parts:
        if all(len(np.intersect1d(points, larger, assume_unique=True)) <= config.doubled * len(points) for larger, _, _ in kept):
            kept.append((points, share, masks))
    owner, most = np.full(count, -1, dtype=np.int64), np.zeros(count)
    for number, (points, share, _) in enumerate(kept):
        more = share > most[points]
        owner[points[more]], most[points[more]] = number, share[more]
    own = [(np.flatnonzero(owner == number), masks) for number, (_, _, masks) in enumerate(kept)]
    return [(points, masks) for points, masks in own if len(points) >= config.least_points]


def _instance(frames: Sequence[LiftedFrame], seen: _Sightings, points: Indices, masks: Indices) -> ConsensusInstance:
    held: dict[int, tuple[int, ...]] = {}
    for mask in sorted(int(mask) for mask in masks):
        frame = int(seen.frame[mask])
        held[frame] = (*held.get(frame, ()), mask - int(seen.first[frame]))
    return instance_of(frames, seen.points[points], seen.colors[points], held)


def instance_of(
    frames: Sequence[LiftedFrame], points: Array, colors: NDArray[np.uint8], masks: Mapping[int, tuple[int, ...]]
) -> ConsensusInstance:
    """An instance of points, named by its masks: see `ConsensusInstance`."""
    weights: dict[str, float] = {}
    scores = []
    for frame, mask in ((frame, mask) for frame, numbers in masks.items() for mask in numbers):
        score, label = float(frames[frame].scores[mask]), frames[frame].labels[mask]
        scores.append(score)
        if label:
            weights[label] = weights.get(label, 0.0) + score
    label = min(weights, key=lambda name: (-weights[name], name), default="")
    share = weights[label] / max(sum(weights.values()), 1e-12) if label else 0.0
    return ConsensusInstance(points, colors, label, share, float(np.mean(scores)), dict(masks))
