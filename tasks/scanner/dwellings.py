"""Scans of dwellings: few places to stand, surfaces unseen, a coarse mesh, careless annotation, and the truth about all of it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.furniture.dwellings import Dwelling
from tasks.geometry.meshes import Surface
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import inverse, transform_points
from tasks.scanner import ScannerConfig, aggregate, observed_shares, owners, write_scan
from tasks.scanner.bleeding import BleedingSettings, bleed, blurred, cut_segments
from tasks.scanner.defects import Annotated, Blindness, DefectSettings, annotate, decimated, draw_blindness
from tasks.scanner.fusion import fuse
from tasks.scanner.route import Targets, directions, looks, standpoints, targets_of, walk
from tasks.scanner.scenery import STRUCTURE, Paint, Scenery, scenery_of
from tasks.scanner.segments import segment
from tasks.scanner.sensor import Shot, drift, scan_frame, shoot
from tasks.scanner.truth import DwellingTruth, truth_of

Array = NDArray[np.float64]

LEAST_FRAMES = 12
"""No scan has fewer."""

HARD = ScannerConfig(
    depth_noise_m=0.002,  # of a Structure sensor out of its calibration
    depth_noise_per_m=0.0012,
    edge_dropout=0.5,
    speckle_dropout=0.004,
    grazing_cosine=0.12,
    drift_m=0.012,
    drift_radians=0.005,
    max_range_m=4.0,
    standpoint_spacing_m=0.9,
    pitches_degrees=(-34.0, -2.0),
    yaws=8,
    least_looks=0.3,  # most is seen from one stop alone
    target_spacing_m=0.14,
    voxel_m=0.022,
    segment_owner_weight=0.3,
    segment_least=8,  # cups have few vertices left
    least_vertices=10,
    least_share=0.03,
    speck_faces=60,
)
"""How a dwelling is walked and fused: see `ScannerConfig` for what each of these means in a careful scan."""


@dataclasses.dataclass(frozen=True)
class HardScanSettings:
    """How a dwelling is scanned. frames: as in `ScannerConfig`. walked: see `hurried_views`; unseen: see `fused_in_part`, a share
    is drawn from this range; the coarse mesh adds some hundredths. bleeding, blur_rounds: see `tasks.scanner.bleeding`."""

    scanner: ScannerConfig = HARD
    defects: DefectSettings = dataclasses.field(default_factory=DefectSettings)
    frames: Literal["exported", "none"] = "none"
    walked: float = 0.2  # share of what could be seen that a walk in a hurry passes by; noise, holes and a coarse mesh take more
    unseen: tuple[float, float] = (0.26, 0.35)  # and frames are lost until a third is missing
    bleeding: BleedingSettings | None = None  # labels end at seams without it
    blur_rounds: int = 0  # colors are averaged over neighboring vertices so often


WILD_DEFECTS = DefectSettings(merged=0.25)
"""A quarter of the objects is annotated together with what it touches, as in a real scan with a lamp, its table and a blanket in one."""

WILD = HardScanSettings(
    defects=WILD_DEFECTS,
    walked=0.24,
    unseen=(0.32, 0.35),  # 38 % with what the coarse mesh adds, as in a real labeled room
    bleeding=BleedingSettings(),
    blur_rounds=4,  # 3 to 4 cm: frames that are off by a centimetre, and voxels of 2 cm
)
"""How a wild room is scanned."""


def scan_dwelling(home: Dwelling, out: Path, scan: str, settings: HardScanSettings, rng: np.random.Generator) -> DwellingTruth:
    """Scan a dwelling into the folder `<out>/<scan>` as ScanNet lays it out; what is true goes to `<out>/<scan>.truth.json`.

    The same dwelling, settings and generator state write the same bytes.

    Raises:
        InputError: the folder is there already.
    """
    if (out / scan).exists():
        raise InputError(out / scan, "folder", "is there already", "remove it or choose another name")
    config = dataclasses.replace(settings.scanner, frames=settings.frames, scene_type="Apartment")
    scenery = scenery_of(home.furnished)
    scene = RayScene(scenery.parts)
    targets = targets_of(scenery, config.target_spacing_m, config.target_least, rng)
    blind = draw_blindness(scenery, settings.defects, rng)
    visible = visible_targets(scene, scenery, targets, rng)
    weight = surface_weights(scenery, targets) * visible
    views = hurried_views(scene, scenery, targets, weight, settings.walked, config, rng)
    to_scan = scan_frame(config, rng, np.array([*targets.points.mean(axis=0)[:2], 0.0]))
    alignment, paint = inverse(to_scan), Paint(scene)
    offs = drift(len(views), config, rng)
    shots = [shoot(scene, paint, view, to_scan @ view @ off, config, rng, blind) for view, off in zip(views, offs, strict=True)]
    fused, shots = fused_in_part(shots, targets, weight, alignment, float(rng.uniform(*settings.unseen)), config, rng)
    surface = decimated(fused, settings.defects.vertices)
    if settings.blur_rounds:
        surface = blurred(surface, settings.blur_rounds)
    world = transform_points(surface.vertices, alignment)
    owner = owners(scenery, world, config.owner_reach_m)
    segments = segment(
        surface, config.segment_threshold, config.segment_least, config.segment_color_weight, owner, config.segment_owner_weight
    )
    observed = observed_shares(targets.points, targets.obj, len(scenery.objects), world)
    unseen = unseen_share(targets, weight, world)
    labels, bleeds = (owner, []) if settings.bleeding is None else bleed(scenery, owner, world, settings.bleeding, rng)
    if bleeds:
        segments = cut_segments(segments, owner, labels)
    groups, numbers = aggregate(scenery.objects, segments, labels, observed, config)
    known = [(index, groups[number][1]) for index, number in sorted(numbers.items(), key=lambda item: item[1])]
    annotated = annotate(scenery, known, segments, owner, world, settings.defects, rng)
    listed = [(instance.label, list(instance.segments)) for instance in annotated]
    write_scan(out / scan, scan, config, shots, [shot.pose for shot in shots], surface, segments, listed, alignment)
    truth = truth_of(scan, home, scenery, alignment, observed, unseen, annotated, blind, len(shots), bleeds)
    (out / f"{scan}.truth.json").write_text(truth.to_json())
    return truth


def visible_targets(scene: RayScene, scenery: Scenery, targets: Targets, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which points a careful walk could see at all, from a step's distance to the next: not the insides and backs of things."""
    careful = ScannerConfig(standpoint_spacing_m=0.8, min_range_m=0.2)
    seen = np.zeros(len(targets.points), dtype=np.bool_)
    for eye in standpoints(scene, scenery, careful, rng):
        seen[looks(scene, targets, eye, careful)[0]] = True
    return seen


def surface_weights(scenery: Scenery, targets: Targets) -> Array:
    """Area that each point stands for [m2], shape (n,); the house's own surfaces count nothing."""
    areas = np.zeros(len(scenery.objects))
    np.add.at(areas, scenery.object_of, [float(part.area) for part in scenery.parts])
    own = np.array([obj.category not in STRUCTURE for obj in scenery.objects])
    share = areas / np.maximum(np.bincount(targets.obj, minlength=len(areas)), 1)
    return np.asarray(share[targets.obj] * own[targets.obj], dtype=np.float64)


def hurried_views(
    scene: RayScene, scenery: Scenery, targets: Targets, weight: Array, unseen: float, config: ScannerConfig, rng: np.random.Generator
) -> list[Array]:
    """Views of somebody in a hurry, camera to world, 4x4: few stops, from each a look all the way round, until so much of the weight
    of points is left unseen. What lies behind things from there stays unseen: nobody walks round them."""
    eyes = standpoints(scene, scenery, config, rng)
    seen = [looks(scene, targets, eye, config)[0] for eye in eyes]
    have = np.zeros(len(weight), dtype=np.bool_)
    left = unseen * weight.sum()
    stops: dict[int, list[Array]] = {}
    while len(stops) < len(eyes) and weight[~have].sum() > left:
        # a little by chance: nobody plans a walk that well
        gains = np.array([float(weight[index[~have[index]]].sum()) * float(rng.uniform(0.6, 1.0)) for index in seen])
        gains[list(stops)] = 0.0  # what no look from there showed, none will
        best = int(np.argmax(gains))
        if gains[best] <= 0:
            break
        stops[best] = []
        for view in directions(eyes[best], config, rng):
            if weight[~have].sum() > left:
                camera = Camera.with_fov(view, config.depth_width, config.depth_height, config.fov_radians)
                pixel, depth = camera.project(targets.points[seen[best]])
                inside = (depth > 0) & (pixel >= 0).all(axis=1) & (pixel[:, 0] < camera.width) & (pixel[:, 1] < camera.height)
                have[seen[best][inside]] = True
                stops[best].append(view)
    order = walk(eyes[list(stops)], list(stops))
    return [view for k in order for view in stops[k]]


def fused_in_part(
    shots: list[Shot], targets: Targets, weight: Array, alignment: Array, unseen: float, config: ScannerConfig, rng: np.random.Generator
) -> tuple[Surface, list[Shot]]:
    """The mesh of as many frames as leave such a share of the weight of points unseen, and those frames: others were blurred."""
    kept = list(shots)
    while True:
        surface = fuse(kept, config)
        lacking = unseen - unseen_share(targets, weight, transform_points(surface.vertices, alignment))
        lost = max(1, round(0.7 * lacking * len(kept)))
        if lacking <= 0 or len(kept) - lost < LEAST_FRAMES:
            return surface, kept
        gone = {int(k) for k in rng.permutation(len(kept))[:lost]}
        kept = [shot for k, shot in enumerate(kept) if k not in gone]


def unseen_share(targets: Targets, weight: Array, vertices: Array) -> float:
    """Share of the weight of points that have no vertex of the mesh within 5 cm."""
    from scipy.spatial import cKDTree

    near = np.isfinite(cKDTree(vertices).query(targets.points, distance_upper_bound=0.05)[0])
    return float(weight[~near].sum() / max(weight.sum(), 1e-9))


__all__ = ["HARD", "WILD", "Annotated", "Blindness", "HardScanSettings", "scan_dwelling", "unseen_share", "visible_targets"]
