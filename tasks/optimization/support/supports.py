"""What carries what: from the geometry of the placed assets, the floor, the walls and the ceiling."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Shell
from tasks.geometry.meshes import Surface
from tasks.mounting import mounting
from tasks.optimization.support.enclosures import encloses
from tasks.optimization.support.fastening import built_in, is_fixed, is_worktop
from tasks.optimization.support.heights import face_blocks, plan_view, underside
from tasks.optimization.support.leaning import Lean, is_leaning
from tasks.optimization.support.standing import MOST_CELLS, kept_cells, standing_map
from tasks.optimization.support.walls import WallFace, stands_against, wall_contact, wall_faces
from tasks.settings import Config, NonNegative, Positive, Share

Array = NDArray[np.float64]
Cells = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class SupportConfig(Config):
    """When an object counts as carried."""

    reach_m: NonNegative = 0.10  # scans bleed and boxes are a few centimetres off; a gap beyond this is a gap
    drop_m: NonNegative = 0.5  # legs are often too thin for a scan: what nothing carries and is this low was standing on what lies below
    stand_drop_m: NonNegative = 1.0  # as drop_m, for what never hangs; colliders of what nothing carries reach down so far, too
    most_drop_m: NonNegative = 0.3  # bounds both drops: an object farther up keeps its place, and gets a base, a bracket or a remark
    sunk_m: NonNegative = 0.2  # what nothing carries within reach may have sunk this deep: the object and its carrier are both off
    base_m: Positive = 0.02  # feet and rims within this of the lowest point are what an object stands on
    share: Share = 0.3  # of the base over a surface: less, and the center of mass may be past the edge
    carried_share: Share = 0.75  # of the base stays on the carrier when an object is moved: a quarter over the edge tips nothing
    covering_m: NonNegative = 0.05  # as flat as this, a rug or mat, which others may stand on in part
    covering_area_m2: NonNegative = 0.25  # as large as this, something flat of no known kind is a covering: a mat, no keyboard
    wall_m: NonNegative = 0.12  # a picture frame's depth plus the error of a wall's place
    against_m: NonNegative = 0.05  # baseboards and cables keep furniture this far off the wall that it stands against
    ceiling_m: NonNegative = 0.15  # the ceiling's height is known less well than a wall's place
    cable_m: NonNegative = 1.2  # a hanging lamp's cable is too thin for a scan
    rail_m: NonNegative = 1.5  # curtains that reach this high and have no wall hang on a rail across the room
    hung_gap_m: NonNegative = 0.02  # what is usually hung and ends this near a surface stands on it all the same
    desk_frame_m: NonNegative = 0.3  # frames smaller than this stand on furniture as often as they hang
    hung_depth_m: NonNegative = 0.5  # objects of no known kind that stick out farther from a wall are not hung on it
    enclosed_share: Share = 0.85  # of the horizon that a container's sides close; a sofa with arms closes two thirds
    same_bottom_m: NonNegative = 0.03  # bottoms this near say nothing about who carries whom; the larger one does
    rest_quantile: Share = 0.9  # bumps under a tenth of the base are noise of scanned geometry
    cell_m: Positive = 0.01  # grid of the plan views: a mug's foot covers forty cells


@dataclasses.dataclass(frozen=True)
class PlacedAsset:
    """An asset in the world frame as proposed. `low`, `high`: its axis-aligned box [m], shape (3,). `closed`: its faces
    bound a solid and look outward, so that only those that look up carry. `is_scanned`: the scan has points of it; `lean`: how these
    lean, if they do."""

    instance_id: str
    category: str
    surface: Surface
    low: Array
    high: Array
    closed: bool
    is_scanned: bool = False
    lean: Lean | None = None

    @staticmethod
    def of(instance_id: str, category: str, surface: Surface, watertight: bool) -> PlacedAsset:
        """A placed surface with its box. `watertight`: every edge has two faces."""
        used = np.zeros(len(surface.vertices), dtype=np.bool_)
        used[surface.faces] = True
        points = surface.vertices[used]
        low, high = points.min(axis=0), points.max(axis=0)
        closed = watertight
        if watertight:
            a, b, c = (surface.vertices[surface.faces[:, k]] - low for k in range(3))
            closed = float(np.einsum("ni,ni->", a, np.cross(b, c))) > 0
        return PlacedAsset(instance_id, category, surface, low, high, closed)

    @property
    def plan_area(self) -> float:
        """Area of the box in plan [m2]."""
        return float(np.prod((self.high - self.low)[:2]))

    @property
    def height(self) -> float:
        """Height of the box [m]."""
        return float(self.high[2] - self.low[2])

    @cached_property
    def plan_points(self) -> Array:
        """What it covers in plan: its used vertices [m], shape (n, 2)."""
        used = np.zeros(len(self.surface.vertices), dtype=np.bool_)
        used[self.surface.faces] = True
        return np.ascontiguousarray(self.surface.vertices[used, :2])

    def footprint(self, cell: float) -> tuple[Cells, Array]:
        """Cells that it covers in plan, shape (n, 2), and its lowest height in each [m], shape (n,); computed once per cell size."""
        if cell not in self._footprints:
            self._footprints[cell] = underside(self.surface, cell)
        return self._footprints[cell]

    @cached_property
    def blocks(self) -> Array:
        """Boxes around its faces, for plan views [m], shape (n, 6)."""
        return face_blocks(self.surface)

    @cached_property
    def _footprints(self) -> dict[float, tuple[Cells, Array]]:
        return {}


@dataclasses.dataclass(frozen=True)
class Carrier:
    """What carries an object. `gap` [m]: height of its bottom above that, both as proposed. `lift` [m]: how far it is
    moved up to rest, its carrier's own lift included. `against`: part of the room's shell that it hangs on or stands
    against. `is_fixed`: fastened to the room. `is_inferred`: a board, plate or base that was not seen is below it. `reach` [m]: of a base
    of its collider below it, from whose end on the gap counts."""

    relation: str
    parent_id: str | None
    gap: float
    lift: float
    against: str | None = None
    is_fixed: bool = False
    is_inferred: bool = False
    reach: float = 0.0


@dataclasses.dataclass(frozen=True)
class _Rest:
    """A surface that an object can rest on. parent: whose, None for the floor. gap: of the object's bottom above it [m]. lift: how
    far the object is raised by all that is below it [m], where that is known."""

    parent: str | None
    gap: float
    lift: float = 0.0


def find_carriers(placed: Sequence[PlacedAsset], room: Shell | None, config: SupportConfig) -> dict[str, Carrier]:
    """What carries every placed asset, by instance id. No object carries itself, not even through others.

    Surfaces within reach of the bottom count, the highest at every point of the base; whose are most carries it: a mug
    stands on the laptop on the desk, and a book on the board of its compartment, not on the shelf's top. Where the
    lowest part has nothing below it, the next broad part may: a chair lies upside down on a table, its back past the
    edge. What hangs keeps its height, its gap and lift are zero; what nothing carries is set down onto what is below it
    from `drop_m` at most (`stand_drop_m` what never hangs, `most_drop_m` all), and else keeps its height above the floor as its gap.
    """
    span = max((float((p.high - p.low)[:2].max()) for p in placed), default=0.0)
    # what is larger than a hall has the wrong unit: its grid must still fit into memory
    config = dataclasses.replace(config, cell_m=max(config.cell_m, span / MOST_CELLS))
    order = sorted(placed, key=lambda p: (p.low[2], p.high[2], p.instance_id))
    faces = wall_faces(room) if room is not None else []
    rests: dict[str, _Rest] = {}
    by_instance: dict[str, Carrier] = {}
    for obj in order:
        carrier = _carrier(obj, order, rests, faces, room, config)
        by_instance[obj.instance_id] = carrier
        below = rests.get(carrier.parent_id or "")
        rests[obj.instance_id] = _Rest(carrier.parent_id, carrier.gap, carrier.lift + (below.lift if below is not None else 0.0))
    by_id = {obj.instance_id: obj for obj in placed}
    carriers: dict[str, Carrier] = {}

    def settle(name: str) -> Carrier:
        """Carriers first, so that their lift is known."""
        if name not in carriers:
            known, against = by_instance[name], by_instance[name].against
            if known.parent_id is not None:
                inside = encloses(by_id[known.parent_id], by_id[name], known.gap, config)
                lift = known.lift + settle(known.parent_id).lift
                known = dataclasses.replace(known, relation="inside" if inside else "on", lift=lift)
            if faces and against is None and not is_covering(by_id[name], config):
                fitted = mounting(by_id[name].category).is_fitted or is_worktop(by_id[name], known)
                against = stands_against(by_id[name], faces, config.wall_m if fitted else config.against_m)
            fastened = is_fixed(known, by_id[name].category, against) or (is_worktop(by_id[name], known) and against is not None)
            carriers[name] = dataclasses.replace(known, against=against, is_fixed=fastened)
        return carriers[name]

    for name in sorted(by_instance):
        settle(name)
    return built_in(carriers, by_id)


def descendants(parents: Mapping[str, str | None]) -> dict[str, set[str]]:
    """Everything that each object carries, directly or through others, by instance id; `parents` maps child to carrier."""
    below: dict[str, set[str]] = {name: set() for name in parents}
    for name in parents:
        above = parents[name]
        while above is not None:
            below[above].add(name)
            above = parents.get(above)
    return below


def is_covering(obj: PlacedAsset, config: SupportConfig) -> bool:
    """Whether an object is a flat cloth or mat to be stood upon: on the floor or, as a tablecloth, on furniture."""
    kind = mounting(obj.category).kind
    if kind == "covering":
        return obj.height**2 < obj.plan_area  # a carpet that is rolled up and stood in a corner covers nothing
    return kind == "any" and obj.height <= config.covering_m and obj.plan_area >= config.covering_area_m2


def is_floor_covering(obj: PlacedAsset, config: SupportConfig) -> bool:
    """Whether an object lies flat on the floor, to be stood upon: a rug, a mat."""
    return bool(is_covering(obj, config) and abs(obj.low[2]) <= config.reach_m)


def allowed_shifts(obj: PlacedAsset, carrier: PlacedAsset, gap: float, step: float, reach: int, config: SupportConfig) -> NDArray[np.bool_]:
    """Where a carried object may stand, in steps [m] along x and y from its place on its carrier: shape (2 reach + 1,
    2 reach + 1). The same as `support_map`, in steps longer than a cell."""
    per_step = max(1, round(step / config.cell_m))
    return standing_map(obj, carrier, gap, step / per_step, per_step, reach, config)


def support_map(obj: PlacedAsset, carrier: PlacedAsset, gap: float, cell: float, reach: int, config: SupportConfig) -> NDArray[np.bool_]:
    """Where a carried object may stand, in cells [m] along x and y from its place on its carrier: shape (2 reach + 1,
    2 reach + 1).

    It may where as much of its base, or at least `carried_share` of it, is carried at the same height, and where no
    more of the carrier (the side of a compartment) is in its way than at its place. `gap`: as in its `Carrier`.
    """
    return standing_map(obj, carrier, gap, cell, 1, reach, config)


def _carrier(
    obj: PlacedAsset, order: Sequence[PlacedAsset], rests: Mapping[str, _Rest], faces: Sequence[WallFace], room: Shell | None,
    config: SupportConfig,
) -> Carrier:  # fmt: skip
    """What carries one object: 'on' for every object that does, the lift its own only."""
    kind = mounting(obj.category).kind
    contact = wall_contact(obj, faces, config.wall_m) if kind not in ("stands", "covering") else None
    wall = Carrier("wall", None, 0.0, 0.0, contact.face.name) if contact is not None else None
    ceiling = Carrier("ceiling", None, 0.0, 0.0, "ceiling")
    below_ceiling = room.height_m - float(obj.high[2]) if room is not None else math.inf
    is_high = room is not None and float(obj.low[2] + obj.high[2]) > room.height_m
    if kind in ("let_in", "wall"):
        if wall is not None:
            return wall
        if kind == "wall" and float(obj.high[2]) > config.rail_m:
            return ceiling
    rest = _rest_within(obj, order, rests, config)
    if contact is not None and kind not in ("let_in", "wall", "ceiling") and is_leaning(obj, contact.face):
        foot = rest or _rest_off(obj, order, rests, config.most_drop_m, config)
        if foot is not None:
            return Carrier("floor" if foot.parent is None else "on", foot.parent, foot.gap, -foot.gap, contact.face.name)
    if kind == "frame" and wall is not None:
        small = float((obj.high - obj.low).max()) <= config.desk_frame_m
        if rest is None or abs(rest.gap) > (config.reach_m if small else config.hung_gap_m):
            return wall
    if kind == "ceiling" and is_high and below_ceiling <= config.cable_m and (rest is None or abs(rest.gap) > config.hung_gap_m):
        return ceiling
    if rest is None and kind not in ("stands", "covering") and abs(below_ceiling) <= config.ceiling_m:
        return ceiling
    if rest is None and kind == "either" and wall is not None:
        return wall
    deep = _rest_off(obj, order, rests, 2 * config.reach_m, config) if rest is None else None
    if rest is None and deep is None and contact is not None and contact.depth <= config.hung_depth_m:
        return wall or ceiling
    if rest is None and deep is None and mounting(obj.category).is_fitted and (against := stands_against(obj, faces, config.wall_m)):
        return Carrier("wall", None, 0.0, 0.0, against)
    rest = rest or deep or _rest_off(obj, order, rests, config.stand_drop_m if kind == "stands" else config.drop_m, config)
    if rest is None and kind == "ceiling":  # a lamp hangs low over a dining table, on a cord that no scan has
        return ceiling
    if rest is None:
        return Carrier("none", None, float(obj.low[2]), 0.0)
    return Carrier("floor" if rest.parent is None else "on", rest.parent, rest.gap, -rest.gap)


def _rest_within(obj: PlacedAsset, candidates: Sequence[PlacedAsset], rests: Mapping[str, _Rest], config: SupportConfig) -> _Rest | None:
    """What carries most of an object's base within reach; what carries its next broad part where nothing carries the base."""
    cells, heights = obj.footprint(config.cell_m)
    rise = heights - obj.low[2]
    on_base = rise <= config.base_m
    near = [other for other in candidates if _may_carry(other, obj, config) and not _rests_on(other.instance_id, obj.instance_id, rests)]
    has_floor = bool(abs(obj.low[2]) <= config.reach_m)
    rest = _most_carried(obj, cells[on_base], rise[on_base], near, rests, has_floor, config)
    if rest is not None or on_base.all():
        return rest
    levels = np.floor(rise / config.base_m).astype(np.int64)
    counts = np.bincount(levels)
    for level in np.flatnonzero(counts >= config.share * len(cells)):
        at = (rise >= level * config.base_m) & (rise < (level + 1) * config.base_m)
        over = np.abs(cells[at].mean(axis=0) - cells.mean(axis=0)) * config.cell_m
        if level == 0 or (over > 0.25 * (obj.high - obj.low)[:2]).any():  # what lies so far off its middle would tip
            continue
        rest = _most_carried(obj, cells[at], rise[at], near, rests, False, config)
        if rest is not None and rest.gap > -config.reach_m:
            return rest
    return None


def _most_carried(
    obj: PlacedAsset, base: Cells, rise: Array, near: Sequence[PlacedAsset], rests: Mapping[str, _Rest], has_floor: bool,
    config: SupportConfig,
) -> _Rest | None:  # fmt: skip
    """Whose surface is the highest within reach under most of a base; `rise` of its cells over the object's bottom [m].

    What sank into the floor comes out of it again: then its surfaces are higher than the floor where they are not as proposed.
    """
    if not len(base):  # nothing of it near its lowest point is wide enough to stand on
        return None
    low, kept = float(obj.low[2]), kept_cells(base, 2000)
    base, rise = base[kept], rise[kept]
    first, last = base.min(axis=0) * config.cell_m, (base.max(axis=0) + 0.5) * config.cell_m
    # how high the bottom would be with each part of the base touching what is below it
    touching = [-rise] if has_floor else []
    names: list[str | None] = [None] if has_floor else []
    top = low + float(rise.max()) + config.reach_m
    for other in near:
        view = plan_view(other.surface, first, last, top, config.cell_m, other.closed, other.blocks)
        if np.isfinite(view.heights).any():
            touching.append(view.at(base) - rise)
            names.append(other.instance_id)
    if not names:
        return None
    heights = np.array(touching)
    within = np.abs(heights - low) <= config.reach_m
    heights[~within] = -np.inf
    carried = within.any(axis=0)
    if carried.mean() < config.share:
        return None
    raised = np.array([rests[name].lift if has_floor and name is not None and name in rests else 0.0 for name in names])
    over = heights + np.maximum(raised, 0.0)[:, None]
    shares = np.bincount(over.argmax(axis=0)[carried], minlength=len(names))
    best = int(shares.argmax())  # the floor where it carries as much
    if names[best] is None:  # the floor has no bumps: the lowest part stands on it, however small
        return _Rest(None, low)
    return _Rest(names[best], low - float(np.quantile(heights[best, within[best]], config.rest_quantile)))


def _rest_off(
    obj: PlacedAsset, candidates: Sequence[PlacedAsset], rests: Mapping[str, _Rest], drop: float, config: SupportConfig
) -> _Rest | None:
    """The nearest surface at most `drop` [m] below an object that nothing carries within reach, or that it sank into."""
    cells, heights = obj.footprint(config.cell_m)
    low = float(obj.low[2])
    on_base = heights <= low + config.base_m
    kept = kept_cells(cells[on_base], 2000)
    base, rise = cells[on_base][kept], heights[on_base][kept] - low
    options = [_Rest(None, low)] if low <= drop else []
    for other in candidates if len(base) else ():
        if not _may_carry(other, obj, config) or _rests_on(other.instance_id, obj.instance_id, rests):
            continue
        for top in (low + config.reach_m, low + config.sunk_m):
            view = plan_view(other.surface, obj.low[:2], obj.high[:2], top, config.cell_m, other.closed, other.blocks)
            gaps = low - (view.at(base) - rise)
            within = (gaps <= drop) & (gaps >= -config.sunk_m)
            if within.mean() >= config.share:
                options.append(_Rest(other.instance_id, float(np.quantile(gaps[within], 1 - config.rest_quantile))))
                break
    nearest = min(options, key=lambda r: (abs(r.gap), r.parent is not None, r.parent or ""), default=None)
    return nearest if nearest is not None and nearest.gap <= config.most_drop_m else None


def _may_carry(carrier: PlacedAsset, obj: PlacedAsset, config: SupportConfig) -> bool:
    """Whether boxes and heights leave it possible that one object stands on or in another."""
    if carrier.instance_id == obj.instance_id or (carrier.high[:2] < obj.low[:2]).any() or (carrier.low[:2] > obj.high[:2]).any():
        return False
    if is_floor_covering(obj, config) and not is_floor_covering(carrier, config):
        return False  # a rug lies under what stands on it
    difference = float(carrier.low[2] - obj.low[2])
    if difference < -config.same_bottom_m:
        return True
    if is_floor_covering(carrier, config) and not is_floor_covering(obj, config):
        return abs(difference) <= config.reach_m
    if difference > config.same_bottom_m:  # scanned too high, or the other too low: something large may still hold it
        holds = (carrier.low[:2] <= obj.low[:2]).all() and (carrier.high[:2] >= obj.high[:2]).all()
        return bool(holds and difference <= config.reach_m and carrier.high[2] > obj.high[2])
    return (carrier.plan_area, carrier.instance_id) > (obj.plan_area, obj.instance_id)


def _rests_on(name: str, other: str, rests: Mapping[str, _Rest]) -> bool:
    """Whether `name` rests on `other`, directly or through others, as far as is known."""
    while name != other:
        rest = rests.get(name)
        if rest is None or rest.parent is None:
            return False
        name = rest.parent
    return True
