"""Small objects of a scan: looked for above what carries things, and joined with the instances that its files name (supplementary A.1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.instances.rows import InstancePoints, box_of, scanned_solid
from tasks.capture.instances.views import Sight, border_contact, chosen_frames, depth_tolerance
from tasks.capture.labels import Label, LabelMap
from tasks.capture.reading import FrameSource, Group
from tasks.capture.small_objects.classical import ClassicalConfig, found_objects
from tasks.capture.small_objects.joining import ExistingInstance, FoundObject, JoiningConfig, NewInstance, found_object, joined
from tasks.capture.small_objects.learned import LearnedConfig, check, networks_of, objects_on
from tasks.capture.small_objects.lifting import DepthView, at_color, depth_view, visible_points
from tasks.capture.small_objects.naming import UNKNOWN, NamingConfig, name_by_size
from tasks.capture.small_objects.support_views import CarryingInstance
from tasks.capture.small_objects.supports import SupportSlab, support_kind, support_slabs
from tasks.geometry.meshes import Surface
from tasks.mounting import mounting
from tasks.settings import Config, Count, Positive, union_of
from tasks.stage import Context

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

OBJECT = "object"
"""What an object without a name is called, as everywhere in capture."""

_STEP_PX = 8
"""Every so many pixels of a frame are tried for whether they show a support: a board a metre away covers hundreds of these."""

_LEAST_SHOWN = 4
"""Of these; a frame with fewer shows no board."""

_ABOVE_M = 0.01
"""Vertices lower than this above a board are the board's [m]: a scan mesh's noise."""

_BELOW_NEXT_M = 0.01
"""And those so near to the next board are that one's [m]."""

_LEAST_LEFT = 3
"""Vertices that a support keeps at least: it is there, whatever stands on it."""


@dataclasses.dataclass(frozen=True)
class Unsought(Config):
    """Nobody looks for small objects: there are those that the scan names."""

    kind: ClassVar[str] = "none"


SmallObjectsProvider = union_of((Unsought, ClassicalConfig, LearnedConfig))
"""Whoever can find small objects."""


@dataclasses.dataclass(frozen=True)
class SmallObjectsConfig(Config):
    """Who looks for small objects that a scan's files do not name, in posed frames with depth; what they name stays as it is."""

    provider: SmallObjectsProvider = dataclasses.field(default_factory=ClassicalConfig)  # type: ignore[valid-type]  # asks no model
    views: Count = 12  # of a support, those that show most of it: objects behind others show up in one of them
    reach_m: Positive = 0.02  # around an object, within which the scan mesh is its own: edges have no depth, and poses drift
    joining: JoiningConfig = dataclasses.field(default_factory=JoiningConfig)  # see there
    naming: NamingConfig = dataclasses.field(default_factory=NamingConfig)  # of what nobody names


@dataclasses.dataclass(frozen=True)
class Finder:
    """Who found an instance. name: As rows have it. probability: Of its category, 0 to 1; None where a file says it."""

    name: str
    probability: float | None


@dataclasses.dataclass(frozen=True)
class Instances:
    """Instances of a scan with what was found besides. groups, meanings, solids: Of all, those of the scan first, in their order.
    finders: Of those that were found, by number. sights: Of these. notes: What was found, and what was odd about it, a line each."""

    groups: tuple[Group, ...]
    meanings: list[Label]
    solids: list[InstancePoints]
    finders: Mapping[int, Finder]
    sights: tuple[Sight, ...]
    notes: tuple[str, ...]


def with_small_objects(
    groups: Sequence[Group], meanings: Sequence[Label], solids: Sequence[InstancePoints], world: Surface,
    frames: Sequence[FrameSource], alignment: Array, labels: LabelMap, context: Context, config: SmallObjectsConfig, *,
    most_frames: int, most_views: int,
) -> Instances:  # fmt: skip
    """The instances of a scan, and the small objects that frames show on what carries things and that none of them is.

    A vertex of the scan mesh within an object's outline is its own where it had been the support's or nobody's. alignment: Scan frame
    to world frame, 4x4 [m]. most_frames: Frames that are read, evenly over all. most_views: Sights of an object that are kept, the best.

    Raises:
        InputError: the settings name networks or endpoints that cannot be used.
        EndpointAway: an endpoint does not answer, and that is left to the next run.
    """
    plain = Instances(tuple(groups), list(meanings), list(solids), {}, (), ())
    if isinstance(config.provider, Unsought):
        return plain
    if isinstance(config.provider, LearnedConfig):
        check(config.provider)
    supports = [
        CarryingInstance(f"{number:04d}", label.category, slabs, solid.points)
        for number, (label, solid) in enumerate(zip(meanings, solids, strict=True))
        if not label.is_structure
        and support_kind(label.category) is not None  # most carry nothing, and a box costs milliseconds
        and (slabs := support_slabs(label.category, *box_of(solid, world, label.category), solid.points))
    ]
    if not supports:
        return plain
    with_depth = [place for place, frame in enumerate(frames) if frame.depth is not None]
    chosen = [with_depth[index] for index in chosen_frames([frames[place] for place in with_depth], most_frames)]
    posed, views, problems = _seen(frames, chosen, alignment)
    if not views:
        why = "no frame has a pose and depth" if not chosen else "no frame can be read"
        return dataclasses.replace(plain, notes=(*problems, f"small objects were not looked for: {why}"))
    objects: list[FoundObject] = []
    tried = {name: _tried(view) for name, view in views.items()}
    if isinstance(config.provider, LearnedConfig):
        for done, support in enumerate(supports):
            best = _best_views(support, tried, config.views)
            shown = [frames[posed[name]] for name in best]
            seen = objects_on(support, shown, alignment, networks_of(config.provider), context, config.provider)
            objects += seen.objects
            problems += [f"{support.instance_id} {support.category}: {problem}" for problem in seen.problems]
            context.report(done + 1, len(supports), support.instance_id)
    else:
        work = [
            _Looking(support, [views[name] for name in _best_views(support, tried, config.views)], config.provider, config.naming)
            for support in supports
        ]
        objects += [each for part in context.spread(_classical_objects, work) for each in part]
        context.report(len(supports), len(supports), supports[-1].instance_id)
    existing = [
        ExistingInstance(f"{number:04d}", solid.points, label.is_structure)
        for number, (label, solid) in enumerate(zip(meanings, solids, strict=True))
    ]
    result = joined(existing, objects, config.joining)
    boards = {support.instance_id: support.slabs for support in supports}
    made = Making(list(groups), list(meanings), list(solids), world, [obj.points for obj in result.added], config.reach_m)
    finders: dict[int, Finder] = {}
    sights: list[Sight] = []
    for place, obj in enumerate(result.added):
        number = made.add(place, obj, boards[obj.support_id], labels)
        finders[number] = Finder(obj.found_by, obj.probability)
        own = [_sight(number, obj, views[name], posed[name], frames[posed[name]], mask) for name, mask in sorted(obj.masks.items())]
        sights += sorted((sight for sight in own if sight is not None), key=lambda sight: (-sight.score, sight.frame))[:most_views]
    for name in sorted({finder.name for finder in finders.values()}):
        count = sum(finder.name == name for finder in finders.values())
        noun = "small object that the scan does not name was" if count == 1 else "small objects that the scan does not name were"
        problems.append(f"{count} {noun} found by {name}")
    return Instances(tuple(made.groups), made.meanings, made.solids, finders, tuple(sights), (*problems, *result.notes))


def _seen(frames: Sequence[FrameSource], chosen: Sequence[int], alignment: Array) -> tuple[dict[str, int], dict[str, DepthView], list[str]]:
    """Places of frames by id, the frames as views, and why some are left out: an image that cannot be read costs no scan, as long as
    nobody needs it."""
    posed, views, problems = {}, {}, []
    for place in chosen:
        frame = frames[place]
        try:
            view = depth_view(frame, alignment)
        except InputError as error:
            problems.append(f"small objects are looked for without frame {frame.frame_id}: {error}")
            continue
        if view is not None:
            posed[frame.frame_id], views[frame.frame_id] = place, view
    return posed, views, problems


def _best_views(support: CarryingInstance, tried: Mapping[str, Array], most: int) -> list[str]:
    """Ids of the frames that show most of a support's boards and what is above them, in their order. tried: See `_tried`."""
    shown = {name: _shown(points, support.slabs) for name, points in tried.items()}
    best = sorted((name for name in shown if shown[name] >= _LEAST_SHOWN), key=lambda name: (-shown[name], name))
    return sorted(best[:most])


@dataclasses.dataclass(frozen=True)
class _Looking:
    """A support and the frames that show most of it, for the classical member."""

    support: CarryingInstance
    views: Sequence[DepthView]
    config: ClassicalConfig
    naming: NamingConfig


def _classical_objects(work: _Looking) -> list[FoundObject]:
    """What frames have on a support as the classical member sees it, named by size."""
    support, config = work.support, work.config
    seen = found_objects(work.views, support.slabs, config)
    names = [name_by_size(each.points, board_of(each.points, support.slabs).height, work.naming) for each in seen.instances]
    return [
        found_object(instance, seen.frames, name.category, name.probability, config.kind, support.instance_id)
        for instance, name in zip(seen.instances, names, strict=True)
    ]


def _tried(view: DepthView) -> Array:
    """Points of some pixels of a frame, world frame [m], shape (n, 3)."""
    depth = view.depth[::_STEP_PX, ::_STEP_PX]
    fx, fy, cx, cy = (value / _STEP_PX for value in view.intrinsics)
    return dataclasses.replace(view, depth=depth, intrinsics=(fx, fy, cx, cy)).points()[depth > 0]


def _shown(points: Array, slabs: Sequence[SupportSlab]) -> int:
    """How many points of a frame lie on boards or above them."""
    return int(np.any([slab.holds(points) for slab in slabs], axis=0).sum())


def board_of(points: Array, slabs: Sequence[SupportSlab]) -> SupportSlab:
    """The board that carries points, world frame [m], shape (n, 3): the one with most of them above it."""
    return max(slabs, key=lambda slab: int(slab.holds(points).sum()))


class Making:
    """Instances, to which others are added. clouds: Points of these, world frame [m], shapes (n, 3)."""

    def __init__(
        self, groups: list[Group], meanings: list[Label], solids: list[InstancePoints], world: Surface, clouds: Sequence[Array],
        reach: float,
    ) -> None:  # fmt: skip
        from scipy.spatial import cKDTree

        self.groups, self.meanings, self.solids = groups, meanings, solids
        self._world, self._reach = world, reach
        self._points = cKDTree(np.concatenate([np.zeros((0, 3)), *clouds]))
        self._whose = np.repeat(np.arange(len(clouds)), [len(points) for points in clouds])
        self._owner = np.full(len(world.vertices), -1, dtype=np.int64)
        for number, group in enumerate(groups):
            self._owner[group.vertices] = number

    def add(self, place: int, obj: NewInstance, slabs: Sequence[SupportSlab], labels: LabelMap) -> int:
        """Take the object at a place in; its number."""
        number, support = len(self.groups), int(obj.support_id)
        vertices = self._vertices(place, obj, board_of(obj.points, slabs), support)
        faces = self._world.faces
        self._owner[vertices] = number
        own = np.flatnonzero((self._owner[faces] == number).all(axis=1)) if len(vertices) else np.zeros(0, dtype=np.int64)
        label = labels[obj.category] if obj.category not in ("", UNKNOWN) else labels[OBJECT]
        if label.is_structure or mounting(label.category).kind == "let_in":  # no wall, and no window in one, stands on a table
            label = labels[OBJECT]
        origin = f"{obj.found_by} on {self.groups[support].source_id}"
        self.groups.append(Group(f"found.{number:04d}", f"{obj.found_by}:{label.category}", vertices, own, origin))
        self.meanings.append(label)
        self.solids.append(InstancePoints(obj.points, obj.colors, own, is_exact=False))
        carrier = self.groups[support]
        if not self.solids[support].is_exact and len(vertices):
            rest = carrier.vertices[self._owner[carrier.vertices] == support]
            is_left = (self._owner[faces[carrier.faces]] == support).all(axis=1)
            self.groups[support] = dataclasses.replace(carrier, vertices=rest, faces=carrier.faces[is_left])
            self.solids[support] = scanned_solid(self._world, self.groups[support])
        return number

    def _vertices(self, place: int, obj: NewInstance, board: SupportSlab, support: int) -> Indices:
        """Vertices of the scan mesh that are an object's, sorted: the support's or nobody's, above its board, within its outline in plan,
        and nearer to its points than to those of other objects, so that its sides which no frame shows are its own, too."""
        import shapely

        points, reach = self._world.vertices, self._reach
        free = (self._owner == -1) | (self._owner == support)
        near = np.flatnonzero(free & ((points >= obj.points.min(axis=0) - reach) & (points <= obj.points.max(axis=0) + reach)).all(axis=1))
        height = board.local(points[near])[:, 2]
        near = near[(height > _ABOVE_M) & (height < board.high[2] - _BELOW_NEXT_M)]
        outline = shapely.MultiPoint(obj.points[:, :2]).convex_hull.buffer(reach)
        near = near[shapely.contains_xy(outline, points[near, :2])]
        near = near[self._whose[self._points.query(points[near])[1]] == place]
        left = int((self._owner == support).sum() - (self._owner[near] == support).sum())
        return near if left >= _LEAST_LEFT else near[self._owner[near] == -1]


def _sight(number: int, obj: NewInstance, view: DepthView, place: int, frame: FrameSource, mask: NDArray[np.bool_]) -> Sight | None:
    """An object as a frame with a mask of it sees it; None where its color image does not show it."""
    whole = at_color(mask, frame)
    if not whole.any():
        return None
    rows, columns = np.flatnonzero(whole.any(axis=1)), np.flatnonzero(whole.any(axis=0))
    box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    *_, depth, inside = view.pixels(obj.points)
    seen = visible_points(view, obj.points, depth_tolerance(depth))[0]
    fraction = float(seen.sum() / max(int(inside.sum()), 1))
    score = fraction * np.sqrt(float(whole.sum())) * (1 - border_contact(whole))
    return Sight(number, place, box, whole[box[1] : box[3], box[0] : box[2]], fraction, float(score))
