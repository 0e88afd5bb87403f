"""What carries what: from the geometry of the placed assets, the floor, the walls and the ceiling."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Room
from tasks.boxes import aabb
from tasks.meshes import Surface
from tasks.optimization.heights import occupancy, plan_view, underside

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class SupportConfig:
    """When a thing counts as carried."""

    reach_m: float = 0.10  # scans bleed and boxes are a few centimetres off; a gap beyond this is a gap
    drop_m: float = 0.5  # legs are often too thin for a scan: what nothing carries and is this low was standing on the floor
    base_m: float = 0.02  # feet and rims within this of the lowest point are what a thing stands on
    share: float = 0.3  # of the base over a surface: less, and the center of mass may be past the edge
    carried_share: float = 0.75  # of the base stays on the carrier when a thing is moved: a quarter over the edge tips nothing
    covering_m: float = 0.05  # as low as this and on the floor: a rug or mat, which others may stand on in part
    covering_share: float = 0.5  # what stands on a rug with less than half of its feet stands on the floor
    wall_m: float = 0.12  # a picture frame's depth plus the error of a wall's place
    ceiling_m: float = 0.15  # the ceiling's height is known less well than a wall's place
    hung_gap_m: float = 0.02  # what is usually hung and ends this near a surface stands on it all the same
    same_bottom_m: float = 0.03  # bottoms this near say nothing about who carries whom; the larger one does
    rest_quantile: float = 0.9  # bumps under a tenth of the base are noise of scanned geometry
    cell_m: float = 0.01  # grid of the plan views: a mug's foot covers forty cells
    hung_categories: tuple[str, ...] = (
        "picture", "painting", "poster", "mirror", "clock", "curtain", "blinds", "whiteboard", "blackboard", "bulletin board",
        "window", "door", "towel", "coat rack", "light switch", "air conditioner", "range hood", "wall lamp", "shower curtain",
    )  # fmt: skip
    """Things that hang even where something stands right below: a picture over a sofa."""

    def __post_init__(self) -> None:
        for name in ("base_m", "cell_m"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be above 0, is {getattr(self, name):g}")
        for name in ("reach_m", "drop_m", "covering_m", "wall_m", "ceiling_m", "hung_gap_m", "same_bottom_m"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be at least 0, is {getattr(self, name):g}")
        for name in ("share", "carried_share", "covering_share", "rest_quantile"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}: must be 0 to 1, is {getattr(self, name):g}")


@dataclasses.dataclass(frozen=True)
class PlacedAsset:
    """An asset in the world frame as proposed. `low`, `high`: its axis-aligned box [m], shape (3,). `closed`: its faces
    bound a solid and look outward, so that only those that look up carry."""

    instance_id: str
    category: str
    surface: Surface
    low: Array
    high: Array
    closed: bool

    @staticmethod
    def of(instance_id: str, category: str, surface: Surface, watertight: bool) -> PlacedAsset:
        """A placed surface with its box. `watertight`: every edge has two faces."""
        low, high = aabb(surface.vertices[np.unique(surface.faces)])
        corners = surface.vertices[surface.faces] - low
        outward = float(np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) > 0
        return PlacedAsset(instance_id, category, surface, low, high, watertight and outward)

    @property
    def plan_area(self) -> float:
        """Area of the box in plan [m2]."""
        return float(np.prod((self.high - self.low)[:2]))


@dataclasses.dataclass(frozen=True)
class Carrier:
    """What carries a thing. `gap` [m]: height of its bottom above that, both as proposed. `lift` [m]: how far it is
    moved up to rest, its carrier's own lift included."""

    relation: str
    parent_id: str | None
    gap: float
    lift: float


def find_carriers(placed: Sequence[PlacedAsset], room: Room | None, config: SupportConfig) -> dict[str, Carrier]:
    """What carries every placed asset, by instance id. No thing carries itself, not even through others.

    Surfaces within reach of the bottom count, the highest wins: a mug stands on the laptop on the desk, and a book on
    the board of its compartment, not on the shelf's top. What hangs keeps its height, its gap and lift are zero; what
    nothing carries is set down on the floor from `drop_m` at most, and keeps its height above that.
    """
    order = sorted(placed, key=lambda p: (p.low[2], p.high[2], p.instance_id))
    rests: dict[str, tuple[str | None, float] | None] = {}
    for thing in order:
        rests[thing.instance_id] = _best_rest(thing, order, rests, config)
    carriers: dict[str, Carrier] = {}

    def settle(thing: PlacedAsset) -> Carrier:
        """Carriers first, so that their lift is known."""
        known = carriers.get(thing.instance_id)
        if known is None:
            known = _carrier(thing, rests[thing.instance_id], room, config)
            if known.parent_id is not None:
                below = settle(by_id[known.parent_id])
                known = dataclasses.replace(known, lift=known.lift + below.lift)
            carriers[thing.instance_id] = known
        return known

    by_id = {thing.instance_id: thing for thing in placed}
    for thing in order:
        settle(thing)
    return {name: carriers[name] for name in sorted(carriers)}


def descendants(parents: Mapping[str, str | None]) -> dict[str, set[str]]:
    """Everything that each thing carries, directly or through others, by instance id; `parents` maps child to carrier."""
    below: dict[str, set[str]] = {name: set() for name in parents}
    for name in parents:
        above = parents[name]
        while above is not None:
            below[above].add(name)
            above = parents.get(above)
    return below


def is_floor_covering(thing: PlacedAsset, config: SupportConfig) -> bool:
    """Whether a thing lies flat on the floor, to be stood upon: a rug, a mat."""
    return bool(thing.high[2] - thing.low[2] <= config.covering_m and abs(thing.low[2]) <= config.covering_m)


def allowed_shifts(
    thing: PlacedAsset, carrier: PlacedAsset, gap: float, step: float, reach: int, config: SupportConfig
) -> NDArray[np.bool_]:
    """Where a carried thing may stand, in steps [m] along x and y from its place on its carrier: shape (2 reach + 1,
    2 reach + 1).

    It may where as much of its base, or at least `carried_share` of it, is carried at the same height, and where no
    more of the carrier (the side of a compartment) is in its way than at its place.
    """
    per_step = max(1, round(step / config.cell_m))
    cell = step / per_step
    rest = float(thing.low[2]) - gap
    cells, heights = underside(thing.surface, cell)
    base = _thinned(cells[heights <= thing.low[2] + config.base_m])
    body = _thinned(cells)
    margin = reach * step + cell
    level = config.base_m
    low, high = thing.low[:2] - margin, thing.high[:2] + margin
    floor = plan_view(carrier.surface, low, high, rest + level, cell, carrier.closed)
    rise = float(thing.high[2] - thing.low[2])
    solid = occupancy(carrier.surface, low, high, rest + level, rest + max(rise - config.cell_m, level), cell)
    carried = np.empty((2 * reach + 1, 2 * reach + 1))
    blocked = np.empty_like(carried)
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            shift = np.array([i, j]) * per_step
            carried[i + reach, j + reach] = (np.abs(floor.at(base + shift) - rest) <= level).mean()
            blocked[i + reach, j + reach] = np.isfinite(solid.at(body + shift)).mean()
    allowed: NDArray[np.bool_] = (carried >= min(config.carried_share, carried[reach, reach])) & (blocked <= blocked[reach, reach] + 0.02)
    allowed[reach, reach] = True
    return allowed


def _thinned(cells: NDArray[np.int64], most: int = 300) -> NDArray[np.int64]:
    """Every n-th cell: shares are needed to a percent."""
    return cells[:: max(1, len(cells) // most)]


def _best_rest(
    thing: PlacedAsset, others: Sequence[PlacedAsset], rests: Mapping[str, tuple[str | None, float] | None], config: SupportConfig
) -> tuple[str | None, float] | None:
    """The highest surface within reach that a thing can rest on: whose (None: the floor), and the gap to it [m]."""
    cells, heights = underside(thing.surface, config.cell_m)
    on_base = heights <= thing.low[2] + config.base_m
    base, rise = cells[on_base], heights[on_base] - thing.low[2]
    if not len(base):  # nothing of it near its lowest point is wide enough to stand on
        return None
    found: list[tuple[float, str | None]] = []
    if abs(thing.low[2]) <= config.reach_m:
        found.append((0.0, None))
    for other in others:
        if not _may_carry(other, thing, config) or _rests_on(other.instance_id, thing.instance_id, rests):
            continue
        view = plan_view(other.surface, thing.low[:2], thing.high[:2], float(thing.low[2]) + config.reach_m, config.cell_m, other.closed)
        # how high the bottom would be with each part of the base touching what is below it
        touching = view.at(base) - rise
        within = np.abs(touching - thing.low[2]) <= config.reach_m
        if within.mean() >= (config.covering_share if is_floor_covering(other, config) else config.share):
            found.append((float(np.quantile(touching[within], config.rest_quantile)), other.instance_id))
    if not found:
        return None
    height, parent = max(found, key=lambda f: (f[0], f[1] is None, f[1] or ""))
    return parent, float(thing.low[2]) - height


def _may_carry(carrier: PlacedAsset, thing: PlacedAsset, config: SupportConfig) -> bool:
    """Whether boxes and heights leave it possible that one thing stands on or in another."""
    if carrier.instance_id == thing.instance_id or (carrier.high[:2] < thing.low[:2]).any() or (carrier.low[:2] > thing.high[:2]).any():
        return False
    difference = float(carrier.low[2] - thing.low[2])
    if abs(difference) <= config.same_bottom_m:
        return (carrier.plan_area, carrier.instance_id) > (thing.plan_area, thing.instance_id)
    return difference < 0


def _rests_on(name: str, other: str, rests: Mapping[str, tuple[str | None, float] | None]) -> bool:
    """Whether `name` rests on `other`, directly or through others, as far as is known."""
    while name != other:
        rest = rests.get(name)
        if rest is None or rest[0] is None:
            return False
        name = rest[0]
    return True


def _carrier(thing: PlacedAsset, rest: tuple[str | None, float] | None, room: Room | None, config: SupportConfig) -> Carrier:
    """The relation of one thing; the lift is its own only."""
    near_wall = room is not None and _wall_distance(thing, room) <= config.wall_m
    hung = thing.category in config.hung_categories and near_wall and (rest is None or abs(rest[1]) > config.hung_gap_m)
    if rest is not None and not hung:
        parent, gap = rest
        return Carrier("floor" if parent is None else "on", parent, gap, -gap)
    if room is not None and not hung and abs(thing.high[2] - room.height_m) <= config.ceiling_m:
        return Carrier("ceiling", None, 0.0, 0.0)
    if near_wall:
        return Carrier("wall", None, 0.0, 0.0)
    gap = float(thing.low[2])
    return Carrier("floor", None, gap, -gap) if 0 < gap <= config.drop_m else Carrier("none", None, gap, 0.0)


def _wall_distance(thing: PlacedAsset, room: Room) -> float:
    """Distance between a thing's box in plan and the nearest wall [m]; the floor polygon's edges where no wall is known."""
    from shapely.geometry import LineString, MultiLineString, box

    ring = room.floor_polygon
    edges = [(*a, *b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
    lines = [LineString([(w[0], w[1]), (w[2], w[3])]) for w in room.walls or edges]
    if not lines:
        return float("inf")
    plan = box(*thing.low[:2], *thing.high[:2])
    return float(MultiLineString(lines).distance(plan))
