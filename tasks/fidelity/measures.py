"""What is measured of a scan and its replica: distances of samples both ways, and what follows from them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.fidelity.agreement import NO_SAMPLES, THRESHOLDS_M, SurfaceSamples, distances, joined, sampled
from tasks.fidelity.configuration import FidelityConfig
from tasks.fidelity.marked_points import OBJECT, SHELL, UNLABELED, MarkedPoints
from tasks.fidelity.replicas import ReplicaRays, ReplicaSurface
from tasks.fidelity.scans import ScannedSurface
from tasks.fidelity.visibility import seen_past, visible
from tasks.geometry.meshes import Surface, surface_of, union_of
from tasks.geometry.rendering import Camera, RayScene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Generator = Callable[..., np.random.Generator]

OWN_M = 0.05
"""Surface this near counts as the object's own, or as explained [m]: the middle threshold."""


@dataclasses.dataclass(frozen=True)
class ObjectAgreement:
    """Samples of an object's scanned surface with their distance to its own asset (infinite without one), and samples of the
    asset's visible surface with their distance to the object's scanned surface, both [m] and infinite where no threshold reaches.

    empty, foreign: which of the asset's samples lie where the scan saw nothing, and in other objects.
    """

    scan: SurfaceSamples
    to_asset: Array
    seen: SurfaceSamples
    to_scan: Array
    empty: Mask
    foreign: Mask
    is_placed: bool


@dataclasses.dataclass(frozen=True)
class SceneAgreement:
    """All objects' samples pooled, and those of the shell.

    object_to_any, seen_to_any: distances of objects' samples to any asset, and of assets' to any object [m]. shell,
    shell_to_replica: scanned floor, walls and ceiling. wall, wall_to_scan: what the cameras could see of the replica's. Distances to
    the scan's surface are infinite where no threshold reaches.
    unlabeled: samples of no instance. marked: samples of the scan with their distance to anything in the replica.
    """

    objects: dict[str, ObjectAgreement]
    object_to_any: Array
    seen_to_any: Array
    shell: SurfaceSamples
    shell_to_replica: Array
    wall: SurfaceSamples
    wall_to_scan: Array
    unlabeled: SurfaceSamples
    marked: MarkedPoints
    areas: Array


@dataclasses.dataclass(frozen=True)
class ScanSamples:
    """Samples of a scan's objects, by instance, of its shell, and of the whole mesh."""

    objects: dict[str, SurfaceSamples]
    shell: SurfaceSamples
    whole: SurfaceSamples

    @property
    def points(self) -> Array:
        """All of them [m], shape (n, 3)."""
        return joined([*self.objects.values(), self.shell, self.whole]).points


def sample_scan(scan: ScannedSurface, config: FidelityConfig, rng: Generator) -> ScanSamples:
    """Samples of a scan, each surface by a generator of its own."""
    per, least, most = config.object_samples_per_m2, config.min_samples, config.max_samples
    objects = {name: sampled(surface, per, least, most, rng("scan", name)) for name, surface in scan.objects.items()}
    room = (config.room_samples_per_m2, config.min_samples, config.max_room_samples)
    return ScanSamples(objects, sampled(scan.shell, *room, rng("shell")), sampled(scan.whole, *room, rng("whole")))


def agreement(
    scan: ScannedSurface, replica: ReplicaSurface, samples: ScanSamples, scan_rays: RayScene, replica_rays: ReplicaRays,
    cameras: Sequence[Camera], config: FidelityConfig, rng: Generator,
) -> SceneAgreement:  # fmt: skip
    """Scan and replica held against each other. Trees over large meshes are built once each: all that is asked of one is asked at once."""
    assets = {name: surface_of(parts) for name, parts in replica.objects.items()}
    per, least, most = config.object_samples_per_m2, config.min_samples, config.max_samples
    placed = {name: sampled(surface, per, least, most, rng("asset", name)) for name, surface in assets.items()}
    wall = sampled(replica.shell, config.room_samples_per_m2, config.min_samples, config.max_room_samples, rng("replica shell"))
    everything = joined([*placed.values(), wall])
    could = visible(everything.points, replica_rays, scan_rays, cameras, config.hidden_m)
    *visible_parts, could_wall = _split(could, [*(len(s.points) for s in placed.values()), len(wall.points)])
    seen = {name: placed[name][mask] for name, mask in zip(placed, visible_parts, strict=True)}
    wall = wall[could_wall]
    pooled = joined(list(seen.values()))

    scanned = joined(list(samples.objects.values()))
    objects, shell = union_of(list(scan.objects.values())), scan.shell
    asked = [pooled.points, wall.points, samples.whole.points]
    ends = [len(points) for points in asked]
    reach = _reach(config)
    seen_to_any, _, whole_to_objects = _split(distances(np.concatenate(asked), objects, reach), ends)
    seen_to_shell, wall_to_scan, whole_to_shell = _split(distances(np.concatenate(asked), shell, reach), ends)
    unlabeled = samples.whole[np.minimum(whole_to_objects, whole_to_shell) > config.label_reach_m]
    empty = _empty(pooled.points, np.minimum(seen_to_any, seen_to_shell), scan.whole, scan_rays, cameras, config)

    asked = [scanned.points, samples.shell.points, unlabeled.points]
    ends = [len(points) for points in asked]
    to_assets = _split(distances(np.concatenate(asked), union_of(list(assets.values()))), ends)
    to_shell = _split(distances(np.concatenate(asked), replica.shell), ends)
    nearest = np.concatenate([np.minimum(a, b) for a, b in zip(to_assets, to_shell, strict=True)])
    parts = np.repeat(np.array([OBJECT, SHELL, UNLABELED], dtype=np.uint8), ends)
    rows = _by_object(scan, samples, assets, seen, seen_to_any, empty, reach)
    return SceneAgreement(
        objects=rows, object_to_any=to_assets[0], seen_to_any=seen_to_any, shell=samples.shell, shell_to_replica=to_shell[1],
        wall=wall, wall_to_scan=wall_to_scan, unlabeled=unlabeled, marked=MarkedPoints(np.concatenate(asked), nearest, parts),
        areas=np.concatenate([scanned.areas, samples.shell.areas, unlabeled.areas]),
    )  # fmt: skip


def _reach(config: FidelityConfig) -> float:
    """Beyond this distance nothing is asked of the scan's surface, nor of an asset by its own object [m]: more than any threshold."""
    return 2.0 * max(*THRESHOLDS_M, OWN_M, config.label_reach_m, config.empty_margin_m)


def _by_object(
    scan: ScannedSurface, samples: ScanSamples, assets: dict[str, Surface], seen: dict[str, SurfaceSamples], seen_to_any: Array,
    empty: Mask, reach: float,
) -> dict[str, ObjectAgreement]:  # fmt: skip
    """Every object with its own asset. reach: Distances of more [m] may be infinite."""
    ends = [len(s.points) for s in seen.values()]
    any_of = dict(zip(seen, _split(seen_to_any, ends), strict=True))
    empty_of = dict(zip(seen, _split(empty, ends), strict=True))
    rows = {}
    for name, own in samples.objects.items():
        if name not in assets:
            nothing = np.zeros(0, dtype=bool)
            rows[name] = ObjectAgreement(own, np.full(len(own.points), np.inf), NO_SAMPLES, np.zeros(0), nothing, nothing, False)
            continue
        to_scan = distances(seen[name].points, scan.objects[name], reach)
        foreign = (to_scan > OWN_M) & (any_of[name] <= OWN_M)
        to_asset = distances(own.points, assets[name], reach)
        rows[name] = ObjectAgreement(own, to_asset, seen[name], to_scan, empty_of[name], foreign, True)
    return rows


def _empty(points: Array, apart: Array, whole: Surface, scan: RayScene, cameras: Sequence[Camera], config: FidelityConfig) -> Mask:
    """Which points lie where the scan saw nothing, shape (n,). apart: distance to labeled surface [m]. whole: the scan, unlabeled too."""
    empty = apart > config.empty_margin_m
    empty[empty] = seen_past(points[empty], scan, cameras, config.empty_margin_m)
    if empty.any():  # few are left, and samples of unlabeled surface lie too far apart to tell
        empty[empty] = distances(points[empty], whole, _reach(config)) > config.empty_margin_m
    return empty


def _split(values: NDArray[Any], counts: Sequence[int]) -> list[NDArray[Any]]:
    """Values of several surfaces, one after another, for each of them."""
    ends = np.cumsum([0, *counts])
    return [values[start:end] for start, end in itertools.pairwise(ends)]
