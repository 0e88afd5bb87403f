"""Storeys of a leveled mesh: floors that people walk on, above one another, and the heights at which the mesh is cut between them.

A storey is told from what else is level and high (mezzanines, platforms, wardrobes, ceilings, roofs) by what it does: one stands up on
it, walls rise from it, and it closes off what is below.
"""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import face_areas, face_normals, spread
from tasks.settings import Config, Positive, Share

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class StoreyConfig(Config):
    """What it takes for a level to be a storey of its own, and not a mezzanine, a platform or a roof."""

    min_rise_m: Positive = 2.2  # From floor to floor: 2 m to stand in and a slab; half-storeys and platforms rise less.
    clear_m: Positive = 1.8  # What one stands up in: codes allow less only where nobody stays.
    min_floor_m2: Positive = 4.0  # Of floor that was seen: the tops of a row of wardrobes have less.
    min_share: Share = 0.12  # Of the floor below that its own has at least: a single room below the roof of a house.
    min_cover: Share = 0.6  # Of what is walked on below that lies under its floor or a ceiling: codes let mezzanines cover up to half.
    min_parted_cover: Share = 0.3  # The same where walls end below the slab: what is open has walls that go on, what was badly scanned not.
    min_walls: Share = 0.3  # Of the outline of its floor from which walls rise: from a flat roof that was seen from above none do.


@dataclasses.dataclass(frozen=True)
class Levels:
    """Floors of a scan's storeys, and the heights at which it is cut between them, the lowest first [m], shapes (n,) and (n - 1,)."""

    floors: tuple[float, ...]
    cuts: tuple[float, ...]

    def storey_of(self, height: Array) -> NDArray[np.int64]:
        """The storey that a height [m] is in, shape (k,)."""
        return np.searchsorted(np.array(self.cuts), height, side="right").astype(np.int64)

    def raised(self, by: float) -> Levels:
        """The same storeys in a frame whose heights are larger by some meters."""
        return Levels(tuple(height + by for height in self.floors), tuple(height + by for height in self.cuts))


ONE = Levels((0.0,), ())
"""What is not high enough for two."""

_CELL_M = 0.15
"""Of the plan: a few vertices of a scan at 2 to 5 cm."""

_POINTS_PER_M2, _MOST_POINTS = 250.0, 2_000_000
"""Some points for each cell; a hall of a hectare gets fewer."""

_BIN_M, _BAND_BINS, _BAND_M = 0.02, 11, 0.12
"""Of the heights of floors, and how far a floor is off its height: drift, a warped mesh, a threshold."""

_FURNITURE_M = 1.2
"""Above a floor: what looks up there stands on it."""

_MOST_HOLE_CELLS = 90
"""2 m2 that furniture hides, or that nobody scanned; an open well of stairs or of a gallery is larger, and stays open."""

_UP, _UPRIGHT = 0.85, 0.3
"""Vertical part of the normals of floors that were scanned with noise, and of walls."""

_LARGE = 0.3
"""Of the largest level of a storey: landings and tops of furniture have less."""

_THROUGH = 0.15
"""Share of the walls below that go on through a slab where rooms were scanned from inside: those of stairs."""

_SLAB_M = 0.1
"""Below a floor where nothing else says how thick its slab is: thinner ones carry nobody."""


@dataclasses.dataclass(frozen=True)
class _Seen:
    """Points spread over what looks up, what looks down and what is upright: height [m] and cell of the plan, shape (n,) each, and the
    area that each stands for [m2]."""

    height: Array
    cell: NDArray[np.int64]
    area: float

    def between(self, low: float, high: float) -> Mask:
        """Points with heights in a range [m]."""
        return (self.height >= low) & (self.height < high)


@dataclasses.dataclass(frozen=True)
class _Plan:
    """Cells of a mesh seen from above. shape: of the grid. up, down, upright: what was seen of it."""

    shape: tuple[int, int]
    up: _Seen
    down: _Seen
    upright: _Seen

    def cells(self, seen: _Seen, where: Mask) -> Mask:
        """Cells with one of the points, shape of the grid."""
        filled = np.zeros(self.shape, dtype=bool)
        filled.ravel()[seen.cell[where]] = True
        return filled

    def area(self, cells: Mask) -> float:
        """Area of cells [m2]."""
        return float(cells.sum()) * _CELL_M**2


def stated_or_found(stated: Levels | None, pose: Array, world: Surface, config: StoreyConfig) -> Levels:
    """The storeys of a scan in its leveled frame. stated: by the scan, in its own frame. pose: scan to leveled frame, 4x4 [m]."""
    return levels(world, config) if stated is None else stated.raised(float(pose[2, 3]))


def levels(surface: Surface, config: StoreyConfig) -> Levels:
    """The storeys of a mesh in a frame whose z axis is up; one, where nothing says that there are more."""
    if not len(surface.faces) or np.ptp(surface.vertices[:, 2]) < config.min_rise_m + config.clear_m:
        return ONE
    plan = _plan(surface)
    heights = _level_heights(plan.up, config)
    if not heights:
        return ONE
    floors, cuts = [_main(plan.up, heights, heights[0], config.min_rise_m)], []
    base = heights[0]
    for height in heights[1:]:
        if height < floors[-1] + config.min_rise_m:
            continue
        floor = _main(plan.up, heights, height, _FURNITURE_M)
        cut = _cut(plan, floors[-1], floor, config)
        if _is_storey(plan, [low for low in heights if base <= low < height - 0.5], floor, cut, config):
            cuts.append(cut)
            floors.append(floor)
            base = height
    return Levels(tuple(floors), tuple(cuts))


def _plan(surface: Surface) -> _Plan:
    vertices, faces = surface.vertices, surface.faces
    areas, vertical = face_areas(vertices, faces), face_normals(vertices, faces)[:, 2]
    if _is_inside_out(vertices[faces, 2].mean(axis=1), areas, vertical):
        vertical = -vertical
    low = vertices[:, :2].min(axis=0)
    shape = tuple(int(n) for n in np.ceil((vertices[:, :2].max(axis=0) - low) / _CELL_M).astype(int) + 1)
    density = min(_POINTS_PER_M2, _MOST_POINTS / max(float(areas.sum()), 1e-9))

    def seen(chosen: Mask) -> _Seen:
        own = faces[chosen & (areas > 0)]
        total = float(areas[chosen].sum())
        count = int(np.ceil(density * total)) if len(own) else 0
        if not count:
            return _Seen(np.zeros(0), np.zeros(0, dtype=np.int64), 0.0)
        face, weights = spread(vertices, own, count, np.random.default_rng(0))
        points = np.einsum("nk,nkd->nd", weights, vertices[own[face]])
        column = np.minimum(((points[:, :2] - low) / _CELL_M).astype(np.int64), np.array(shape) - 1)
        return _Seen(points[:, 2], column[:, 0] * shape[1] + column[:, 1], total / count)

    return _Plan((shape[0], shape[1]), seen(vertical > _UP), seen(vertical < -_UP), seen(np.abs(vertical) < _UPRIGHT))


def _is_inside_out(height: Array, areas: Array, vertical: Array) -> bool:
    """Whether the faces of a mesh are turned the wrong way round: its lowest large level, a floor, looks down."""
    level = np.abs(vertical) > _UP
    if not level.any():
        return False
    bins = ((height[level] - height[level].min()) / (_BIN_M * _BAND_BINS)).astype(np.int64)
    total = np.bincount(bins, weights=areas[level])
    lowest = bins == np.argmax(total >= 0.25 * total.max())
    return float((areas[level] * vertical[level])[lowest].sum()) < -0.5 * float(areas[level][lowest].sum())


def _level_heights(up: _Seen, config: StoreyConfig) -> list[float]:
    """Heights of levels with floor enough [m], the lowest first; of two that are nearer than half a metre the larger."""
    if not len(up.height):
        return []
    start = float(up.height.min())
    area = np.convolve(np.bincount(((up.height - start) / _BIN_M).astype(np.int64)) * up.area, np.ones(_BAND_BINS), mode="same")
    least = max(config.min_floor_m2, 0.1 * config.min_share * float(area.max()))
    peaks = []
    while (best := float(area.max())) >= least:
        first = int(np.argmax(area))
        equal = int(np.argmin(np.append(area[first : first + _BAND_BINS] == best, False)))  # all bins around a thin floor are as full
        peak = start + (first + 0.5 * equal) * _BIN_M
        peaks.append(float(np.median(up.height[up.between(peak - _BAND_M, peak + _BAND_M)])))
        area[np.abs(start + (np.arange(len(area)) + 0.5) * _BIN_M - peak) < 0.5] = 0.0
    return sorted(peaks)


def _main(up: _Seen, heights: list[float], lowest: float, reach: float) -> float:
    """The largest of the levels from `lowest` on that are not higher than `reach` above it [m]."""
    near = [height for height in heights if lowest <= height < lowest + reach]
    return max(near, key=lambda height: (int(up.between(height - _BAND_M, height + _BAND_M).sum()), -height))


def _is_storey(plan: _Plan, below: list[float], floor: float, cut: float, config: StoreyConfig) -> bool:
    """Whether a floor is a storey's. below: Levels of the storey below it, its floor among them [m]. cut: Height within its slab [m]."""
    from scipy import ndimage

    on_floor = plan.cells(plan.up, plan.up.between(floor - _BAND_M, floor + _BAND_M))
    area = plan.area(on_floor)
    walked = {low: plan.cells(plan.up, plan.up.between(low - _BAND_M, low + _BAND_M)) for low in below}
    most = max(int(cells.sum()) for cells in walked.values())
    if area < max(config.min_floor_m2, config.min_share * most * _CELL_M**2):
        return False
    overhead = plan.cells(plan.down, plan.down.between(floor + 1.0, floor + config.clear_m))
    if (on_floor & overhead).sum() > 0.5 * on_floor.sum():
        return False
    footprint = _closed(plan.cells(plan.up, plan.up.between(floor - _BAND_M, floor + _FURNITURE_M)))
    rising = plan.upright.between(floor + 0.5, floor + 1.5)
    near = ndimage.binary_dilation(footprint, iterations=3)
    walls = float(near.ravel()[plan.upright.cell[rising]].sum()) * plan.upright.area
    if walls < config.min_walls * 4.0 * np.sqrt(area):
        return False
    cover = config.min_parted_cover if _is_parted(plan, cut) else config.min_cover
    for low, cells in walked.items():
        roofed = plan.cells(plan.down, plan.down.between(low + config.clear_m, floor + 0.05))
        covered = ndimage.binary_dilation(footprint | roofed) & cells
        if cells.sum() > _LARGE * most and covered.sum() < cover * cells.sum():
            return False  # also where half a storey higher is floor, whose rooms reach past this one
    return True


def _is_parted(plan: _Plan, cut: float) -> bool:
    """Whether walls end below a cut, and begin above it: rooms that were scanned from inside, with a slab between."""
    through, below = (int(plan.upright.between(cut - low, cut - high).sum()) for low, high in ((0.05, -0.05), (1.2, 0.7)))
    return through <= _THROUGH * below / 5


def _closed(cells: Mask) -> Mask:
    """Cells without the gaps and small holes between them."""
    from scipy import ndimage

    padded = np.pad(cells, 3)
    closed = ndimage.binary_closing(padded, np.ones((5, 5), dtype=bool))[3:-3, 3:-3]
    holes, count = ndimage.label(~closed)
    sizes = np.bincount(holes.ravel(), minlength=count + 1)
    small = sizes <= _MOST_HOLE_CELLS
    small[0] = False
    return np.asarray(closed | small[holes])


def _cut(plan: _Plan, lower: float, floor: float, config: StoreyConfig) -> float:
    """Height between the highest ceiling of the storey below and a floor [m], or a little below the floor where no ceiling was seen."""
    own = plan.up.height[plan.up.between(floor - _BAND_M, floor + _BAND_M)]
    under = float(np.percentile(own, 2))
    ceiling = plan.down.height[plan.down.between(max(lower + config.clear_m, floor - 1.0), under - 0.02)]
    if len(ceiling) * plan.down.area < 1.0:
        return under - _SLAB_M
    return max(0.5 * (float(np.percentile(ceiling, 98)) + under), under - 0.5)


def floors_text(levels: Levels) -> str:
    """How many storeys there are, and how far their floors are above the lowest."""
    rises = [f"{high - levels.floors[0]:.2f}" for high in levels.floors]
    return f"{len(rises)} storeys, floors at {', '.join(rises[:-1])} and {rises[-1]} m"


def advice(levels: Levels, scan: Path) -> list[str]:
    """What a scene of a scan with several storeys says of itself: the command that makes a scan of each. scan: Where it lies."""
    if not levels.cuts:
        return []
    command = f"metascenes storeys --scans {shlex.quote(str(scan))} --out storeys"
    return [f"{floors_text(levels)}, but a scene is of one, here of the lowest: {command} makes a scan of each"]
