"""How well small objects are lifted: precision and recall of instances against the truth of generated desks and shelves."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bench.models.standins import found_by_standins
from bench.models.tabletops import SupportWord, Tabletop, tabletop
from tasks.capture.small_objects.classical import ClassicalConfig, Found, found_objects
from tasks.capture.small_objects.consensus import ConsensusConfig, associate
from tasks.capture.small_objects.lifting import FrameMasks, LiftingConfig, lifted, sound_pixels, voxel_first
from tasks.capture.small_objects.supports import support_slabs

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

Method = Literal["classical", "true masks", "corrupted masks", "stand-ins", "trained"]
"""`stand-ins`: the chain of networks, with some in their place that know the truth and blur it, see `bench.models.standins`. `trained`: see
`bench.models.trained`."""

LEAST_IOU = 0.5
"""Overlap in points from which on an instance is an object."""

REACH_M = 0.02
"""A true point is an instance's when the nearest point of the frames is: within so much [m], twice the drift of poses."""

NEAR_M = 0.008
"""A pixel's point that is so near to an instance is its own [m]; others speak against it."""

CORRUPTED_SHARE = 0.1
"""Share of the true masks that are split or merged by chance."""


@dataclasses.dataclass(frozen=True)
class LiftingFigures:
    """Of some scenes. objects: That frames show. instances: That were found. matched: Pairs of the two whose points overlap enough."""

    word: SupportWord
    touching: bool
    method: Method
    scenes: int
    objects: int
    instances: int
    matched: int
    seconds: float

    @property
    def precision(self) -> float:
        """Share of the instances that are an object."""
        return self.matched / max(self.instances, 1)

    @property
    def recall(self) -> float:
        """Share of the objects that are an instance."""
        return self.matched / max(self.objects, 1)


def measured(
    words: Sequence[SupportWord] = ("desk", "bookshelf"),
    methods: Sequence[Method] = ("classical", "true masks", "corrupted masks", "stand-ins"),
    scenes: int = 20,
    first_seed: int = 0,
    classical: ClassicalConfig | None = None,
) -> list[LiftingFigures]:
    """Figures by support, by how objects stand, and by method, each over `scenes` seeds from `first_seed` on."""
    figures = []
    for word in words:
        for touching in (False, True):
            made = [tabletop(word, touching, first_seed + seed) for seed in range(scenes)]
            for method in methods:
                rngs = [np.random.default_rng([first_seed + seed, 7]) for seed in range(scenes)]
                finders = [partial(instances_of, method=method, rng=rng, classical=classical) for rng in rngs]
                figures.append(lifting_figures(word, touching, method, made, finders))
    return figures


def lifting_figures(
    word: SupportWord, touching: bool, method: Method, made: Sequence[Tabletop], finders: Sequence[Callable[[Tabletop], Found]]
) -> LiftingFigures:
    """Figures of scenes, each with who finds what is in it."""
    objects = instances = matched = 0
    seconds = 0.0
    for scene, finder in zip(made, finders, strict=True):
        started = time.perf_counter()
        clouds = finder(scene)
        seconds += time.perf_counter() - started
        overlap = overlaps(scene, [instance.points for instance in clouds.instances])
        pairs, counted = matched_pairs(overlap), set(scene.counted)
        # what frames hardly show need not be found, and is no error either
        spare = {
            i for i in range(len(clouds.instances)) if len(overlap) and int(overlap[:, i].argmax()) not in counted and overlap[:, i].any()
        }
        objects, instances = objects + len(counted), instances + len(clouds.instances) - len(spare)
        matched += sum(obj in counted for obj, _ in pairs)
    return LiftingFigures(word, touching, method, len(made), objects, instances, matched, seconds)


def instances_of(scene: Tabletop, method: Method, rng: np.random.Generator, classical: ClassicalConfig | None = None) -> Found:
    """What a method finds in the frames of a scene."""
    if method == "classical":
        config = classical or ClassicalConfig()
        slabs = support_slabs(scene.word, scene.box_pose, scene.box_size, scene.support_points)
        return found_objects(scene.views, slabs, config)
    if method == "stand-ins":
        return found_by_standins(scene, rng).lifted
    share = CORRUPTED_SHARE if method == "corrupted masks" else 0.0
    masks = [corrupted(scene.masks(frame)[0], scene.views[frame].points(), share, rng) for frame in range(len(scene.views))]
    seen = [FrameMasks(own, ("",) * len(own), np.ones(len(own))) for own in masks]
    frames = lifted(scene.views, seen, LiftingConfig())
    return Found(tuple(frames), associate(frames, ConsensusConfig()).instances)


def corrupted(masks: Bools, points: Array, share: float, rng: np.random.Generator) -> Bools:
    """Masks of a frame, shape (n, h, w), a share of which is split in two halves, or merged with the nearest other one.

    points: Of the pixels [m], shape (h, w, 3)."""
    kept = {index: mask for index, mask in enumerate(masks) if mask.any()}
    middles = {index: points[mask].mean(axis=0) for index, mask in kept.items()}
    for index in list(kept):
        if index not in kept or rng.random() >= share:
            continue
        mask = kept[index]
        neighbors = [other for other in kept if other != index and other in middles]
        if rng.random() < 0.5 or not neighbors:
            rows, columns = np.nonzero(mask)
            along = columns if rng.random() < 0.5 else rows
            half = np.zeros_like(mask)
            half[rows, columns] = along <= np.median(along)
            kept[index], kept[len(masks) + index] = mask & half, mask & ~half
        else:
            other = min(neighbors, key=lambda i: float(np.linalg.norm(middles[i] - middles[index])))
            kept[index] = mask | kept.pop(other)
    return np.array([mask for mask in kept.values() if mask.any()]).reshape(-1, *masks.shape[1:])


def overlaps(scene: Tabletop, clouds: Sequence[Array]) -> Array:
    """Intersection over union of the points of objects and instances, shape (objects, instances).

    Every true point, of objects and support alike, is of the instance whose point is nearest to it, or of none where a point of the frames
    that no instance has is nearer.
    """
    from scipy.spatial import cKDTree

    shape = (len(scene.words), len(clouds))
    if not clouds:
        return np.zeros(shape)
    own, whose = np.concatenate(clouds), np.repeat(np.arange(len(clouds)), [len(points) for points in clouds])
    pixels = np.concatenate([view.points()[sound_pixels(view.depth, LiftingConfig())] for view in scene.views])
    pixels = pixels[voxel_first(pixels, 0.005)]
    rest = pixels[~np.isfinite(cKDTree(own).query(pixels, distance_upper_bound=NEAR_M)[0])]
    tree, label = cKDTree(np.concatenate([own, rest])), np.concatenate([whose, np.full(len(rest), len(clouds))])
    true, obj = np.concatenate(scene.points), np.repeat(np.arange(len(scene.points)), [len(points) for points in scene.points])
    distance, index = tree.query(true, distance_upper_bound=REACH_M)
    answer = np.where(np.isfinite(distance), label[np.minimum(index, len(label) - 1)], len(clouds))
    table = np.zeros((len(scene.points), len(clouds) + 1))
    np.add.at(table, (obj, answer), 1)
    union = table.sum(axis=1)[:-1, None] + table.sum(axis=0)[None, :-1] - table[:-1, :-1]
    return np.asarray(table[:-1, :-1] / np.maximum(union, 1))


def matched_pairs(overlap: Array) -> list[tuple[int, int]]:
    """Pairs of objects and instances that overlap enough, each one in one pair at most."""
    from scipy.optimize import linear_sum_assignment

    enough = np.where(overlap >= LEAST_IOU, overlap, 0.0)
    rows, columns = linear_sum_assignment(enough, maximize=True)
    return [(int(row), int(column)) for row, column in zip(rows, columns, strict=True) if enough[row, column] > 0]
