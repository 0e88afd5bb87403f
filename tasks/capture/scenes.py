"""The capture stage: reads a scan in its format, aligns it, and makes its rows."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from schemas.capture import Frame, Instance, Mask, Room, RoomSurface, Scene, Shell
from schemas.errors import InputError
from tasks.capture.cloud import Cloud, cloud_of
from tasks.capture.files.images import encode_jpeg
from tasks.capture.formats import room_of
from tasks.capture.fusion import FusionConfig, fused_surface
from tasks.capture.instances.hidden import with_hidden_parts
from tasks.capture.instances.merged import own_size, set_apart
from tasks.capture.instances.naming import PROVIDER, UNKNOWN
from tasks.capture.instances.rows import InstancePoints, instance_row, modelled_solid, scanned_solid
from tasks.capture.instances.segmentation import SegmentationConfig, geometry_instances
from tasks.capture.instances.split import rejoined
from tasks.capture.instances.views import Sight, best_sights, run_lengths, view_of
from tasks.capture.labels import DOOR, WALL, WINDOW, Label, LabelMap, label_map
from tasks.capture.leveling import aligned, height_notes, read_with_meanings
from tasks.capture.poses.provider import PosesConfig, with_poses
from tasks.capture.reading import FrameSource, Group, Reading, StatedRoom
from tasks.capture.rooms.alignment import Alignment
from tasks.capture.rooms.heights import with_plausible_height
from tasks.capture.rooms.leaves import whole_leaves
from tasks.capture.rooms.lintels import lintels
from tasks.capture.rooms.openings import open_sides, wall_openings
from tasks.capture.rooms.passages import passages
from tasks.capture.rooms.plausibility import size_notes
from tasks.capture.rooms.room import estimate_room, floor_points, wall_points
from tasks.capture.rooms.rows import parted
from tasks.capture.rooms.separation import Seen
from tasks.capture.rooms.textures import LOOSE, OBJECT, STRUCTURE, TextureConfig, baked_surfaces
from tasks.capture.scan import Scan
from tasks.capture.scan_mesh import scan_mesh
from tasks.capture.segmentation.votes import VoteConfig, voted_groups
from tasks.capture.small_objects.additions import OBJECT as NAMELESS
from tasks.capture.small_objects.additions import Finder, Instances, SmallObjectsConfig, Unsought, with_small_objects
from tasks.capture.storeys.levels import StoreyConfig, advice, stated_or_found
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import flat
from tasks.mounting import mounting
from tasks.settings import Config, Count
from tasks.stage import Blobs, Context, Outcome, in_turn

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True)
class CaptureConfig(Config):
    """How scans are captured.

    `label_map_sha256` is filled in from the label map in use, the project's own or the user's, so that its content decides
    whether a scene is captured again.
    """

    label_map: str | None = None  # The project's own map; ScanNet's is research-only, so users bring it themselves.
    label_map_sha256: str = dataclasses.field(init=False)  # From the file.
    max_view_frames: Count = 60  # A walk through a room repeats itself: more frames find no better views, but cost 20 ms each.
    views_per_instance: Count = 3  # Enough for a caption model to see two sides and one occlusion.
    view_size_px: Count = 256  # What caption and selection models take in; larger crops only fill the lake.
    max_points: Count = 20_000  # A sofa at 2 cm has fewer; walls are thinned.
    max_faces: Count = 400_000  # The finest ScanNet meshes in use have about that; a viewer still turns it smoothly.
    poses: PosesConfig = dataclasses.field(default_factory=PosesConfig)  # see there
    fusion: FusionConfig = dataclasses.field(default_factory=FusionConfig)  # Used when a scan has frames but no mesh.
    segmentation: SegmentationConfig = dataclasses.field(default_factory=SegmentationConfig)  # Used when nothing names instances.
    storeys: StoreyConfig = dataclasses.field(default_factory=StoreyConfig)  # A scene is of one; a scan of several says so.
    votes: VoteConfig = dataclasses.field(default_factory=VoteConfig)  # Used when a scan has frames with depth but names no instances.
    textures: TextureConfig = dataclasses.field(default_factory=TextureConfig)
    small_objects: SmallObjectsConfig = dataclasses.field(default_factory=SmallObjectsConfig)  # a scan names few of them

    @model_validator(mode="after")
    def _with_label_map(self) -> Self:
        object.__setattr__(self, "label_map_sha256", label_map(self.label_map).sha256)
        return self


def run(*, scan: Scan, context: Context, config: CaptureConfig) -> Outcome:
    """Rows of `scenes`, `shells`, `rooms`, `surfaces`, `frames`, `instances` and `masks` of one scan.

    Raises:
        InputError: a file of the scan cannot be used; names the file and the field.
    """
    labels = label_map(config.label_map)
    if labels.sha256 != config.label_map_sha256:
        raise InputError(config.label_map or "labels.csv", "content", "has changed since the run was planned", "start the run again")
    reading, meanings, is_modelled = read_with_meanings(scan, labels)
    reading, pose_notes = with_poses(reading, config.poses, scan.path.name)
    notes = [*reading.degradations, *pose_notes]
    surface = reading.surface
    if surface is None:
        surface, fusion_notes = fused_surface(reading.frames, config.fusion, scan.path.name)
        notes += fusion_notes
    alignment = aligned(reading, surface, meanings, config.votes, is_authored=is_modelled)
    world = surface.transformed(alignment.pose)
    notes += [*alignment.notes, *height_notes(reading.frames, alignment.pose), *size_notes(world.vertices, scan.path.name)]
    notes += advice(stated_or_found(reading.levels, alignment.pose, world, config.storeys), scan.path)
    groups, probabilities = reading.groups, {}
    if groups is None:
        by_surface = geometry_instances(world, config.segmentation, reading.materials)
        by_frames = voted_groups(world, by_surface, reading.frames, alignment.pose, config.segmentation.naming, config.votes)
        groups, probabilities = by_frames.groups, by_frames.probabilities
        notes += by_frames.notes
        meanings = [labels[NAMELESS if (name := group.raw_label.partition(":")[2]) == UNKNOWN else name] for group in groups]
    blobs = Blobs()
    solids = _solids(reading, world, groups, context, config)
    if not is_modelled:
        groups, meanings, solids, more = _mended(reading, world, groups, meanings, solids, labels, context, config)
        notes += more
    sought = SmallObjectsConfig(provider=Unsought()) if is_modelled else config.small_objects  # who models names everything
    instances = with_small_objects(
        groups, meanings, solids, world, reading.frames, alignment.pose, labels, context, sought,
        most_frames=config.max_view_frames, most_views=config.views_per_instance,
    )  # fmt: skip
    groups, meanings, solids = instances.groups, instances.meanings, instances.solids
    notes += [*_unknown_labels(groups, meanings, scan.path.name), *instances.notes]
    finders = [instances.finders.get(index) or _finder(group, reading, probabilities) for index, group in enumerate(groups)]
    geometry, rngs = _geometry(reading), [context.rng("points", index) for index in range(len(groups))]
    work = (  # what takes longest first, so that nobody waits for it at the end
        partial(
            _interior, context.scene_id, geometry, world, alignment.pose, groups, meanings, solids, finders, rngs, context.rng("room"),
            is_modelled, config,
        ),
        partial(_sights, _shown(instances, context), world, reading.frames, alignment.pose, config),
        partial(scan_mesh, geometry, world, alignment, config.max_faces),
    )  # fmt: skip
    is_large = reading.parts or len(world.faces) > _MOST_SENT
    spread = in_turn if is_large else context.spread
    interior, sights, (mesh, mesh_notes) = spread(_value, work)
    notes += interior.notes
    blobs.update(interior.blobs)
    rows, masks = _with_views(
        interior.rows, [*sights, *instances.sights], reading.frames, context.scene_id, blobs, config, instances.finders
    )
    scene = Scene(
        scene_id=context.scene_id,
        room_id=room_of(scan),
        dataset=scan.scene_id.partition("/")[0],
        scan=scan.scene_id.partition("/")[2],
        scan_format=scan.format,
        scan_path=str(scan.path),
        alignment=flat(alignment.pose),
        alignment_source=alignment.source,
        to_original=flat(reading.to_original @ np.linalg.inv(alignment.pose)),
        floor_tilt_radians=alignment.floor_tilt,
        mesh_blob=blobs.add(mesh, "glb"),
        vertex_count=len(world.vertices),
        face_count=len(world.faces),
        frame_count=len(reading.frames),
        instance_count=len(rows),
        segmentation="geometry" if reading.groups is None else "file",
        license=reading.license,
    )
    frames = [_frame_row(frame, context.scene_id, alignment) for frame in reading.frames]
    return Outcome(
        scenes=[scene], shells=[interior.shell], rooms=interior.rooms, surfaces=interior.surfaces, frames=frames, instances=rows,
        masks=masks, syntheses=[], synthesis_objects=[], blobs=blobs, degradations=[*notes, *mesh_notes],
    )  # fmt: skip


def _mended(
    reading: Reading, world: Surface, groups: tuple[Group, ...], meanings: Sequence[Label], solids: list[InstancePoints], labels: LabelMap,
    context: Context, config: CaptureConfig,
) -> tuple[tuple[Group, ...], list[Label], list[InstancePoints], list[str]]:  # fmt: skip
    """Instances of a scan with what people get wrong put right: slips of the hand, several things as one, one as several; and a line for
    each of the latter two."""
    own_words = [(label.is_known and not label.is_respelled) or reading.groups is None for label in meanings]
    meanings = [
        label if is_known else labels.of_size(group.raw_label, partial(own_size, solid.points))
        for group, label, solid, is_known in zip(groups, meanings, solids, own_words, strict=True)
    ]
    groups, meanings, apart = set_apart(groups, meanings, world) if reading.groups is not None else (groups, meanings, [])
    solids = _solids(reading, world, groups, context, config) if apart else solids
    groups, meanings, joined = rejoined(groups, meanings, solids)
    solids = _solids(reading, world, groups, context, config) if joined else solids
    return groups, list(meanings), solids, [*apart, *joined]


def _unknown_labels(groups: Sequence[Group], meanings: Sequence[Label], scan: str) -> list[str]:
    """One line per label that the map does not have, or has in another spelling, with the place where it is met first."""
    lines: dict[tuple[str, str], str] = {}
    for group, label in zip(groups, meanings, strict=True):
        if label.is_known and not label.is_respelled:
            continue
        meaning = f"is read as {label.category!r}" if label.is_known else "is not in the label map, nyu40 class 0"
        lines.setdefault((group.raw_label, label.category), f"{group.origin or f'{scan}: geometry'}: {group.raw_label!r} {meaning}")
    return list(lines.values())


def _finder(group: Group, reading: Reading, probabilities: Mapping[str, float]) -> Finder:
    """Who found an instance that the scan has: its files, or its geometry. probabilities: Of guessed categories, by source id."""
    if reading.groups is None or group.raw_label.startswith(f"{PROVIDER}:"):
        return Finder(PROVIDER, probabilities.get(group.source_id))
    return Finder("file", None)


def _solids(reading: Reading, world: Surface, groups: Sequence[Group], context: Context, config: CaptureConfig) -> list[InstancePoints]:
    if reading.is_dense:
        return [scanned_solid(world, group) for group in groups]
    starts = np.concatenate([[0], np.cumsum([len(part.faces) for part in reading.parts])]).astype(np.int64)
    return [
        modelled_solid(world, group, reading.parts, starts, context.rng("surface", index), config.max_points)
        for index, group in enumerate(groups)
    ]


FURNITURE_WITH_DOORS = frozenset(
    {"cabinet", "wardrobe", "closet", "cupboard", "fridge", "refrigerator", "oven", "folding", "shower", "microwave"}
)  # fmt: skip
"""What a door is of, by the first word of its name, that need not be in a wall, nor as high as one of a house."""

_PROBES = 400
"""Points of an instance that are tested for visibility: their share is then known to 2 or 3 percent."""

_MOST_SENT = 2_000_000
"""Faces of a scan up to which it is sent to other processes, 70 MB for each; textures of a model take longer to send than to use."""


def _value(function: Callable[[], Any]) -> Any:
    """What a function of nothing gives: for work of several kinds that is done side by side."""
    return function()


def _geometry(reading: Reading) -> Reading:
    """What a scan's mesh in the lake is made of besides its surface in the world frame."""
    return dataclasses.replace(reading, surface=None, frames=(), groups=None, materials=None, stated=reading.stated.seen_by(reading.frames))


@dataclasses.dataclass(frozen=True)
class _Interior:
    """Rows of instances without their views, and of the room around them, with the blobs that they name, and what was odd about it."""

    rows: list[Instance]
    shell: Shell
    rooms: list[Room]
    surfaces: list[RoomSurface]
    blobs: Blobs
    notes: list[str]


def _interior(
    scene_id: str, geometry: Reading, world: Surface, pose: NDArray[np.float64], groups: Sequence[Group], meanings: Sequence[Label],
    solids: Sequence[InstancePoints], finders: Sequence[Finder], rngs: Sequence[np.random.Generator], rng: np.random.Generator,
    is_modelled: bool, config: CaptureConfig,
) -> _Interior:  # fmt: skip
    """What stands in the room, and the room. geometry: See `_geometry`. pose: Scan frame to world frame, 4x4 [m]. rngs: One for each
    instance. rng: For the room."""
    blobs, notes = Blobs(), list[str]()
    rows = [
        instance_row(
            scene_id, f"{index:04d}", group, label, solid, world, blobs, own, config.max_points, finder.name, finder.probability
        )
        for index, (group, label, solid, finder, own) in enumerate(zip(groups, meanings, solids, finders, rngs, strict=True))
    ]  # fmt: skip
    cloud = cloud_of(world, groups, geometry.is_dense, rng)
    classes = np.array([0, *(label.nyu40_id for label in meanings)], dtype=np.int64)[cloud.instance + 1]
    shell, is_seen, leaves = _shell(scene_id, cloud, classes, meanings, solids, notes, is_modelled, geometry.stated.moved(pose))
    if not is_modelled:
        rows = with_hidden_parts(rows, [solid.points for solid in solids], floor_points(cloud, classes)[:, :2], shell, leaves)
    shell, rooms, rows = parted(shell, rows, geometry.room_type, is_seen)
    surfaces, pictures = _surfaces(shell, geometry.parts, world, pose, groups, meanings, config)
    blobs.update(pictures)
    return _Interior(rows, shell, rooms, surfaces, blobs, notes)


def _shown(instances: Instances, context: Context) -> tuple[list[NDArray[np.int64]], list[NDArray[np.float64]]]:
    """Faces of each instance, and points of everything that is not part of the room itself by which views of it are found."""
    probes = []
    for index, (label, solid) in enumerate(zip(instances.meanings, instances.solids, strict=True)):
        count = 0 if label.is_structure or index in instances.finders else min(_PROBES, len(solid.points))
        probes.append(solid.points[context.rng("probes", index).choice(len(solid.points), count, replace=False)])
    return [group.faces for group in instances.groups], probes


def _sights(
    shown: tuple[list[NDArray[np.int64]], list[NDArray[np.float64]]], world: Surface, frames: Sequence[FrameSource],
    pose: NDArray[np.float64], config: CaptureConfig,
) -> list[Sight]:  # fmt: skip
    """Best views of everything that is not part of the room itself. pose: Scan frame to world frame, 4x4 [m]."""
    face_instance = np.full(len(world.faces), -1, dtype=np.int64)
    for index, faces in enumerate(shown[0]):
        face_instance[faces] = index
    return best_sights(
        world, face_instance, shown[1], frames, pose, most_frames=config.max_view_frames, per_instance=config.views_per_instance
    )


def _with_views(
    rows: Sequence[Instance], sights: Sequence[Sight], frames: Sequence[FrameSource], scene_id: str, blobs: Blobs, config: CaptureConfig,
    finders: Mapping[int, Finder],
) -> tuple[list[Instance], list[Mask]]:  # fmt: skip
    """Instances with the crop of their best view, and the masks of all views that were kept."""
    masks = [
        Mask(
            scene_id=scene_id,
            frame_id=frames[sight.frame].frame_id,
            instance_id=rows[sight.instance].instance_id,
            found_by=finders[sight.instance].name if sight.instance in finders else "surface",
            pixel_box=sight.pixel_box,
            pixel_count=int(sight.mask.sum()),
            visible_share=sight.visible_share,
            score=sight.score,
            run_lengths=run_lengths(sight.mask),
        )
        for sight in sights
    ]
    of_instance: dict[int, list[Sight]] = {}
    for sight in sights:
        of_instance.setdefault(sight.instance, []).append(sight)
    crops: dict[int, str] = {}
    best_by_frame: dict[int, list[Sight]] = {}
    for own in of_instance.values():
        best_by_frame.setdefault(own[0].frame, []).append(own[0])
    for frame, best in sorted(best_by_frame.items()):
        image = frames[frame].color()
        for sight in best:
            crops[sight.instance] = blobs.add(encode_jpeg(view_of(image, sight.pixel_box), config.view_size_px), "jpg")
    best_frames = {index: tuple(frames[s.frame].frame_id for s in own) for index, own in of_instance.items()}
    seen = [dataclasses.replace(row, view_blob=crops.get(index), best_frames=best_frames.get(index, ())) for index, row in enumerate(rows)]
    return seen, masks


def _shell(
    scene_id: str, cloud: Cloud, classes: NDArray[np.int64], meanings: Sequence[Label],
    solids: Sequence[InstancePoints], notes: list[str], is_modelled: bool, stated: StatedRoom,
) -> tuple[Shell, Seen | None, dict[int, NDArray[np.float64]]]:  # fmt: skip
    """The row of the shell, where floor and walls were seen, and of doors and windows that were seen in part, by number, corners of
    the whole [m], shape (8, 3)."""
    shape = estimate_room(cloud, classes, stated.outline, stated.eyes)
    shape, remarks = with_plausible_height(shape, is_modelled or stated.has_height)
    notes += [*shape.notes, *remarks]
    parts = [(solid.colors, label) for solid, label in zip(solids, meanings, strict=True)]
    if not shape.is_room:  # a scan of things
        return shape.row(scene_id, parts, open_sides(shape.polygon, shape.height), ()), None, {}
    fillings = {i: solids[i].points for i, label in enumerate(meanings) if label.nyu40_id in (DOOR, WINDOW) or _is_let_in(label)}
    lines, names = (shape.polygon, shape.interior_walls, shape.height), [meanings[i].category.split() for i in fillings]
    is_door, of_house = [not name[-1].startswith("window") for name in names], [name[0] not in FURNITURE_WITH_DOORS for name in names]
    whole = whole_leaves(*lines, list(fillings.values()), is_door, cloud.points[classes == WALL], of_house)
    leaves = {i: corners for i, corners in zip(fillings, whole, strict=True) if corners is not None and not is_modelled}
    free = passages(cloud, wall_points(cloud, classes), shape.polygon, shape.height)
    openings = wall_openings(*lines, list((fillings | leaves).values()), [*stated.openings, *free])
    doors = [points for points, door in zip((fillings | leaves).values(), is_door, strict=True) if door]
    over = lintels(cloud, classes == WALL, shape.polygon, shape.interior_walls, doors)
    return shape.row(scene_id, parts, openings, over), shape.is_seen, leaves


def _is_let_in(label: Label) -> bool:
    """Whether something is a door or window by its name alone: few of those that people give to doors are in a label map."""
    return mounting(label.category).kind == "let_in" and label.category.split()[0] not in FURNITURE_WITH_DOORS


def _surfaces(
    room: Shell, models: Sequence[trimesh.Trimesh], world: Surface, pose: NDArray[np.float64], groups: Sequence[Group],
    meanings: Sequence[Label], config: CaptureConfig,
) -> tuple[list[RoomSurface], Blobs]:  # fmt: skip
    """How floor, walls and ceiling look, and their images. Faces with a corner of an object may have its colors, whatever they are named.
    models: Parts of a scan that is one, scan frame. pose: Scan frame to world frame, 4x4 [m]."""
    blobs = Blobs()
    is_object, kinds = np.zeros(len(world.vertices), dtype=bool), np.full(len(world.faces), LOOSE, dtype=np.int8)
    for group, label in zip(groups, meanings, strict=True):
        if label.is_structure:
            kinds[group.faces] = STRUCTURE
        else:
            is_object[group.vertices] = True
    kinds[is_object[world.faces].any(axis=1)] = OBJECT
    if not models:
        return baked_surfaces(room, [world.to_trimesh()], [kinds], config.textures, blobs), blobs
    faces = np.cumsum([0, *(len(part.faces) for part in models)])
    parts = []
    for part in models:
        moved = part.copy()
        moved.vertices = np.asarray(part.vertices) @ pose[:3, :3].T + pose[:3, 3]
        parts.append(moved)
    own = [kinds[start:end] for start, end in itertools.pairwise(faces)]
    return baked_surfaces(room, parts, own, config.textures, blobs), blobs


def _frame_row(frame: FrameSource, scene_id: str, alignment: Alignment) -> Frame:
    return Frame(
        scene_id=scene_id,
        frame_id=frame.frame_id,
        color_file=frame.color_file,
        depth_file=frame.depth_file,
        width=frame.width,
        height=frame.height,
        intrinsics=frame.intrinsics,
        depth_scale=float(frame.depth_scale),
        pose=None if frame.pose is None else flat(alignment.pose @ frame.pose),
        pose_source=None if frame.pose is None else frame.pose_source,
    )
