"""Instances of a scan that has frames and no labels: regions of frames, as far as views agree, on the scan's surface.

Fused voxels are not clustered: what stands close together has grown into one there. In a room that is walked through, whose furniture no
frame shows whole, regions of its surface come first, and of these what frames see apart.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import vertex_areas
from tasks.capture.instances.naming import PROVIDER, ShapeNamingConfig, name_by_shape, shape_of
from tasks.capture.instances.segmentation import GeometryInstances
from tasks.capture.instances.views import chosen_frames
from tasks.capture.reading import FrameSource, groups_of
from tasks.capture.segmentation.frame import FrameConfig, segmented_frame
from tasks.capture.segmentation.refinement import RefinementConfig, refined
from tasks.capture.small_objects.consensus import ConsensusConfig, associate
from tasks.capture.small_objects.lifting import DepthView, FrameMasks, LiftedFrame, LiftingConfig, depth_noise, depth_view, lift
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import vertex_normals
from tasks.settings import Config, Count, NonNegative, Positive, Share

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]

ROOM = frozenset({"floor", "wall", "ceiling"})
"""Categories of what is part of a room."""

GROUND_M = 0.02
"""Regions of frames that rise no higher above the floor [m] are floor, as in meshes: rugs, and the floor itself where poses drift."""

TABLE = "table"
"""Category of what carries everything in a scan without a room."""

SUPPORT = "support"
"""Name of what carries things, among regions that have none."""

_FINEST_M, _COARSEST_M = 0.005, 0.02
"""Least and largest side of the voxels in which views agree."""

_SHOWN_SIGMAS = 3.0
"""Of a view's depth, within which it shows a vertex."""


@dataclasses.dataclass(frozen=True)
class RegionLifting(LiftingConfig):
    """Which pixels of a region are lifted."""

    farthest_m: Positive = 6.0  # as frames are segmented
    erosion_px: NonNegative = 0.0  # regions end where depth does
    reach_m: Positive = 0.1  # between parts of one thing that another one divides: things are larger than small objects
    same_mask: Share = 1.0  # regions of a frame are apart


@dataclasses.dataclass(frozen=True)
class RegionConsensus(ConsensusConfig):
    """When regions of several frames are one instance."""

    side_by_side: Share = 0.35  # of the frames of two clusters: a joint divides one thing in some of them
    least_masks: Count = 1  # a frame that alone sees a thing cannot be confirmed, and others that do not see it there say so
    reach_m: Positive = 0.1  # as regions are lifted


@dataclasses.dataclass(frozen=True)
class VoteConfig(Config):
    """How frames without labels are segmented, and what they agree on."""

    most_frames: Count = 40  # a walk through a room repeats itself; each costs a second
    room_share: Share = 0.5  # of a region's surface that is floor, wall or ceiling: it is that, too
    table_eye_m: Positive = 0.9  # over the lowest level, without walls: who looks at things on a table sits or bends over it
    near_spacings: Positive = 2.0  # of the surface's vertices from an instance's points, to be its own
    least_vertices: Count = 20  # a surface with fewer is noise
    frame: FrameConfig = dataclasses.field(default_factory=FrameConfig)  # see there
    lifting: RegionLifting = dataclasses.field(default_factory=RegionLifting)  # see there
    consensus: RegionConsensus = dataclasses.field(default_factory=RegionConsensus)  # see there
    overview_share: Share = 0.4  # of the surface in one view, mostly: frames show things whole; dwellings have 0.04, one room of 12 m2 0.3
    refinement: RefinementConfig = dataclasses.field(default_factory=RefinementConfig)  # see there


def has_depth(frames: Sequence[FrameSource]) -> bool:
    """Whether any frame has both depth and a pose."""
    return any(frame.depth is not None and frame.depth_size is not None and frame.pose is not None for frame in frames)


def voted_groups(
    world: Surface,
    by_surface: GeometryInstances,
    frames: Sequence[FrameSource],
    alignment: Array,
    naming: ShapeNamingConfig,
    config: VoteConfig,
) -> GeometryInstances:  # fmt: skip
    """Instances of an aligned scan: the room as its surface has it, and what frames see of the rest.

    by_surface: What the geometry of the surface alone shows; all of it is kept where no frame has depth and a pose, nothing where the scan
    is of a table, and only floor, walls and ceiling where frames show most things whole.
    alignment: Scan frame to world frame, 4x4 [m]. naming: How categories are guessed.

    Raises:
        InputError: images of a frame cannot be read.
    """
    if not has_depth(frames):
        return by_surface
    owner = np.full(len(world.vertices), -1, dtype=np.int64)
    named: list[tuple[str, Indices]] = []
    probabilities: dict[str, float] = {}
    room = [(group.raw_label.partition(":")[2], group) for group in by_surface.groups if group.raw_label.partition(":")[2] in ROOM]
    is_table = is_tabletop([category for category, _ in room], frames, alignment, config)
    for category, group in room:
        if not is_table:
            owner[group.vertices] = len(named)
            named.append((category, group.vertices))
    posed = [depth_view(frames[index], alignment) for index in chosen_frames(frames, config.most_frames)]
    views = [view for view in posed if view is not None]
    normals, areas = vertex_normals(world.vertices, world.faces), vertex_areas(world)
    instances = voted_instances(world, owner >= 0, views, config)
    if room and not is_table and not views:
        return by_surface
    if room and not is_table and shown_share(world, areas, views, config.near_spacings * spacing_of(world)) < config.overview_share:
        regions = [group.vertices for group in by_surface.groups if group.raw_label.partition(":")[2] not in ROOM]
        parts, numbers = refined(regions, [members for members, _ in instances], areas, config.refinement)
        instances = [(members, number >= 0 and instances[number][1]) for members, number in zip(parts, numbers, strict=True)]
    standing = _without_ground(world, owner, named, instances)
    for members, is_support in standing:
        owner[members] = len(named)
        points, facing, sizes = world.vertices[members], normals[members], areas[members]
        if is_support and is_table:
            named.append((TABLE, members))
            continue
        if is_support:  # of what stands on the floor, as far as it was seen from above, legs are missing
            points = np.concatenate([points, points * [1.0, 1.0, 0.0]])
            facing, sizes = np.concatenate([facing, 0.0 * facing]), np.concatenate([sizes, 0.0 * sizes])
        name = name_by_shape(shape_of(points, facing, sizes), naming)
        probabilities[str(len(named))] = name.probability
        named.append((name.category, members))
    objects = sum(category not in ROOM for category, _ in named)
    rows = [(str(index), f"{PROVIDER}:{category}", np.sort(members)) for index, (category, members) in enumerate(named)]
    notes = [f"instances found in the depth of {len(views)} frames: {objects} objects, categories guessed from their sizes"]
    if (count := len(instances) - len(standing)) > 0:
        notes.append(f"{count} regions of frames rise less than {100 * GROUND_M:.0f} cm above the floor and are part of it, as rugs are")
    if is_table:
        notes.append("cameras look at a table from close by, no floor seen: the table's top is at height 0")
    return GeometryInstances(groups_of(rows, owner, world), probabilities, tuple(notes))


def _without_ground(
    world: Surface, owner: Indices, named: list[tuple[str, Indices]], instances: Sequence[tuple[Indices, bool]]
) -> list[tuple[Indices, bool]]:
    """Instances, vertices and whether they carry others, without those that rise no higher than `GROUND_M`: these go to the floor of
    `named` and of `owner`, shape (n,), if there is one."""
    floor = next((number for number, (category, _) in enumerate(named) if category == "floor"), None)
    if floor is None:
        return list(instances)
    is_ground = [float(np.percentile(world.vertices[members, 2], 95)) < GROUND_M for members, _ in instances]
    for (members, _), ground in zip(instances, is_ground, strict=True):
        if ground:
            owner[members] = floor
            named[floor] = ("floor", np.concatenate([named[floor][1], members]))
    return [instance for instance, ground in zip(instances, is_ground, strict=True) if not ground]


def is_tabletop(room: Sequence[str], frames: Sequence[FrameSource], alignment: Array, config: VoteConfig) -> bool:
    """Whether the lowest level of a scan is a table: no walls rise from it, and eyes are nearer to it than to a floor.

    room: Categories of what is part of a room. alignment: Scan frame to world frame, 4x4 [m].
    """
    eyes = [float((alignment @ frame.pose)[2, 3]) for frame in frames if frame.pose is not None]
    return "wall" not in room and bool(eyes) and float(np.median(eyes)) < config.table_eye_m


def voted_instances(world: Surface, is_room: Bools, views: Sequence[DepthView], config: VoteConfig) -> list[tuple[Indices, bool]]:
    """Vertices of each instance that frames see, most first, and whether it carries what they see.

    is_room: Vertices of floor, walls and ceiling, shape (n,).
    """
    from scipy.spatial import cKDTree

    spacing = spacing_of(world)
    voxel = float(np.clip(spacing, _FINEST_M, _COARSEST_M))
    lifting = dataclasses.replace(config.lifting, voxel_m=voxel)
    seen_room = room_pixels(world, is_room, views, config.near_spacings * max(spacing, voxel))
    lifted = [region_masks(view, config.frame, lifting, room) for view, room in zip(views, seen_room, strict=True)]
    consensus = associate(lifted, dataclasses.replace(config.consensus, voxel_m=voxel))
    if not consensus.instances:
        return []
    clouds = [instance.points for instance in consensus.instances]
    whose = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    distance, nearest = cKDTree(np.concatenate(clouds)).query(
        world.vertices, distance_upper_bound=config.near_spacings * max(spacing, voxel)
    )
    owner = np.where(np.isfinite(distance), whose[np.minimum(nearest, len(whose) - 1)], -1)
    sizes = np.bincount(owner[owner >= 0], minlength=len(clouds))
    of_room = np.bincount(owner[(owner >= 0) & is_room], minlength=len(clouds))
    free = np.where(is_room, -1, owner)
    kept = [i for i in range(len(clouds)) if of_room[i] < config.room_share * max(int(sizes[i]), 1)]
    instances = [(np.flatnonzero(free == index), consensus.instances[index].label == SUPPORT) for index in kept]
    return sorted((each for each in instances if len(each[0]) >= config.least_vertices), key=lambda each: (-len(each[0]), int(each[0][0])))


def shown_share(world: Surface, areas: Array, views: Sequence[DepthView], reach: float) -> float:
    """The share of a surface that one view shows, the median over views; 0 without any, and of a surface without area.

    areas: Of its vertices [m2], shape (n,). reach: How far off a view's depth a vertex may be that it shows [m], beside its noise.
    """
    shares, whole = [], max(float(areas.sum()), 1e-12)
    for view in views:
        row, column, depth, inside = view.pixels(world.vertices)
        row, column, depth = row[inside], column[inside], depth[inside]
        seen = view.depth[row, column]
        is_shown = (seen > 0) & (np.abs(seen - depth) < reach + _SHOWN_SIGMAS * depth_noise(depth))
        shares.append(float(areas[inside][is_shown].sum() / whole))
    return float(np.median(shares)) if shares else 0.0


def room_pixels(world: Surface, is_room: Bools, views: Sequence[DepthView], reach: float) -> list[Bools | None]:
    """Pixels of views whose nearest vertex, within a reach [m], is part of the room, shapes (h, w): a frame alone sees strips of walls, and
    the surface all of them. None where there is no room. is_room: Of vertices, shape (n,)."""
    from scipy.spatial import cKDTree

    if not is_room.any():
        return [None] * len(views)
    tree = cKDTree(world.vertices)
    seen: list[Bools | None] = []
    for view in views:
        pixels = view.depth > 0
        distance, nearest = tree.query(view.points()[pixels], distance_upper_bound=reach)
        pixels[pixels] = np.isfinite(distance) & np.append(is_room, False)[nearest]
        seen.append(pixels)
    return seen


def region_masks(view: DepthView, config: FrameConfig, lifting: LiftingConfig, room: Bools | None = None) -> LiftedFrame:
    """Regions of a frame in the world, and what carries them: a table is a thing, too. room: Pixels of floor and walls, shape (h, w)."""
    segments = segmented_frame(view, config, view.pose[2, :3], room)
    masks = [segments.region == number for number in range(int(segments.region.max(initial=-1)) + 1)]
    labels = [""] * len(masks)
    on_support = segments.on_support if room is None else segments.on_support & ~room
    if on_support.any():
        masks.append(on_support)
        labels.append(SUPPORT)
    stack = np.array(masks, dtype=bool).reshape(len(masks), *view.depth.shape)
    return lift(view, FrameMasks(stack, tuple(labels), np.ones(len(masks))), lifting)


def spacing_of(world: Surface) -> float:
    """Median length of the edges of a surface [m]."""
    edges = world.vertices[world.faces[:, 0]] - world.vertices[world.faces[:, 1]]
    return float(np.median(np.linalg.norm(edges, axis=1))) if len(edges) else _COARSEST_M
