"""Walls inside a room, between its parts: straight slabs with openings where there is no wall.

A wall is told by its faces: upright planes of points of wall instances. Two faces that look away from one another, at most
`MAX_THICKNESS_M` apart, are the two sides of one slab; a face whose other side nobody has seen gets the thickness of a
light partition, where there is floor behind it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tasks.capture.cloud import Cloud
from tasks.capture.rooms.directions import oblique_direction
from tasks.capture.rooms.low_walls import low_walls
from tasks.capture.rooms.slabs import MAX_THICKNESS_M, NARROW_M, Slab, joined

if TYPE_CHECKING:
    from shapely import Polygon

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CELL_M = 0.1
"""Step along a wall: an eighth of a narrow doorway, and still a vertex or two of a coarse mesh."""

_LOW_M, _BAND_M, _BANDS, _ALL_BANDS = 0.2, 0.2, 9, 16
"""Wall is looked for from 0.2 m, above thresholds and skirting, to 2.0 m, below lintels, in bands of 0.2 m; more lie above."""

_TALL_BANDS = 5
"""Bands that make a wall: with the lowest 0.2 m it is then 1.2 m tall, too tall to be the side of a counter."""

_STUB_M = 0.25
"""In line with another, a wall may be as short: beside a doorway."""

_FAINT_BANDS = 3
"""Bands that make a wall in line with another."""

_IN_LINE_M = 2.0
"""So far from a wall's end it may go on: beyond a passage."""

_SILL_BANDS, _OVER_FURNITURE = 3, 4
"""Wall seen in all bands to 0.8 m and above a lintel has a window in it; wall seen from 1 m on stands behind furniture."""

_HEIGHT_M = 1.2
_LENGTH_M = 0.4

_EDGE_M = 0.2
"""Faces nearer than this to an edge of the floor polygon along which they run are that edge."""

_MIN_THICKNESS_M = 0.04
"""A sheet of glass in its frame."""

_PARTITION_M = 0.1
"""Thickness of a wall that was seen from one side only: studs and board."""

_FACE_M2 = 0.3
"""Less than this on one plane is no face of a wall: it is 0.4 m long and 1.2 m tall at least, with gaps."""

_FLAT_M = 0.05
"""Points of a face lie this near to its plane: noise, drift, and a skirting board."""

_FLOOR_BEHIND = 0.3
"""Share of the strip behind a face, 0.15 to 0.8 m, that is seen floor when the face is a wall between two floors."""

_OBLIQUE_LENGTH_M = 0.6
"""Walls in a direction other than the room's own are longer: they could be noise otherwise."""

_STRIP_M = 0.08
"""Floor is looked for this far to both sides of a wall's center line at least: farther than vertices are apart."""

_THRESHOLD_M, _LEVEL = 0.04, 0.9
"""What is level and so low is floor, whatever it was called: thresholds of doorways are often annotated with their wall."""

_SLOPE = 0.1
"""A stretch askew by more is a piece of a wall that runs in another direction."""

_MOST_OBLIQUE, _UNEXPLAINED_M2 = 4, 1.0


def interior_walls(
    cloud: Cloud, is_wall: Mask, floor: Polygon, height: float, is_floor: Callable[[Array], Mask]
) -> tuple[list[Slab], list[str]]:
    """Walls that stand inside the floor polygon, sorted by their ends, and what of them had to be left out.

    Args:
        cloud: The scan.
        is_wall: Which of its points are wall, shape (n,).
        floor: The floor polygon [m].
        height: Height of the room [m].
        is_floor: Where floor was seen, of places shape (m, 2).
    """
    import shapely

    inside = is_wall & (np.abs(cloud.normals[:, 2]) < 0.4) & (cloud.points[:, 2] < height + 0.1)
    inside[inside] = shapely.contains_xy(floor.buffer(_FLAT_M), cloud.points[inside, :2])
    left = inside & ~_behind_edges(cloud, inside, floor)
    is_threshold = (np.abs(cloud.points[:, 2]) < _THRESHOLD_M) & (cloud.normals[:, 2] > _LEVEL)
    objects = (~is_wall | is_threshold) & (cloud.points[:, 2] < _LOW_M + _BANDS * _BAND_M)
    site = _Site(cloud, cloud.points[objects, :2], floor, height, is_floor)
    slabs: list[Slab] = []
    for angle in (0.0, np.pi / 2):
        slabs += _slabs(site, left, angle, _LENGTH_M)
    tried: list[float] = []
    while len(tried) < _MOST_OBLIQUE:
        free = left & ~_explained(cloud, left, slabs)
        oblique = oblique_direction(cloud, free, tried)
        if oblique is None:
            break
        tried.append(oblique)
        slabs += _slabs(site, free, oblique, _OBLIQUE_LENGTH_M)
    slabs = joined(slabs, floor)
    slabs += joined(low_walls(cloud, is_wall, floor, slabs, is_floor), floor, beside=slabs)
    return sorted(slabs, key=lambda slab: slab.row), _notes(cloud, left, slabs, floor)


@dataclasses.dataclass(frozen=True)
class _Site:
    """What a wall is judged by: all points, places of what is no wall, shape (m, 2), floor polygon, height [m], seen floor."""

    cloud: Cloud
    objects: Array
    floor: Polygon
    height: float
    is_floor: Callable[[Array], Mask]


@dataclasses.dataclass(frozen=True)
class _Face:
    """One plane of wall. `sign`: side that it looks to along its normal. `seen`: bands by cell, shape (cells, _ALL_BANDS)."""

    sign: int
    position: float
    members: NDArray[np.int64]
    seen: Mask


_Stretch = tuple[float, float, int, int, list[_Face]]
"""Low and high position [m], cells from and to (exclusive), and the faces."""

_Gaps = Callable[[float, float], Mask]


def _behind_edges(cloud: Cloud, mask: Mask, floor: Polygon) -> Mask:
    """Which points of `mask` belong to the walls around the floor polygon."""
    points, normals = cloud.points[mask, :2], cloud.normals[mask, :2]
    behind = np.zeros(len(points), dtype=bool)
    ring = np.asarray(floor.exterior.coords)
    for a, b in itertools.pairwise(ring):
        length = float(np.linalg.norm(b - a))
        along = (b - a) / max(length, 1e-9)
        beside, away = (points - a) @ along, (points - a) @ np.array([-along[1], along[0]])
        parallel = np.abs(normals @ along) < 0.5
        behind |= parallel & (np.abs(away) < _EDGE_M) & (beside > -_EDGE_M) & (beside < length + _EDGE_M)
    whole = np.zeros(len(mask), dtype=bool)
    whole[mask] = behind
    return whole


def _explained(cloud: Cloud, mask: Mask, slabs: Iterable[Slab]) -> Mask:
    """Which points of `mask` belong to slabs."""
    import shapely

    explained = np.zeros(len(mask), dtype=bool)
    for slab in slabs:
        explained[mask] |= shapely.contains_xy(slab.polygon(0.1), cloud.points[mask, :2])
    return explained


def _slabs(site: _Site, free: Mask, angle: float, shortest: float) -> list[Slab]:
    """Slabs whose faces look along `angle` [rad], both ways, out of the points in `free`."""
    across, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    members = np.flatnonzero(free & (np.abs(site.cloud.normals[:, :2] @ across) > 0.9))
    if not len(members):
        return []
    u, v = site.cloud.points[members, :2] @ across, site.cloud.points[members, :2] @ along
    first = np.floor(v.min() / _CELL_M)
    cell = np.floor(v / _CELL_M - first).astype(np.int64)
    count = int(cell.max()) + 1
    band = np.floor((site.cloud.points[members, 2] - _LOW_M) / _BAND_M).astype(np.int64)
    facing = np.sign(site.cloud.normals[members, :2] @ across)
    objects = site.objects @ np.column_stack([across, along])
    places = np.floor(objects[:, 1] / _CELL_M - first).astype(np.int64)
    known = (places >= 0) & (places < count)
    objects_u, places = objects[known, 0], places[known]

    def is_empty(low: float, high: float) -> Mask:
        """Cells with nothing but wall seen between two planes, shape (count,): no floor, and no door."""
        between = np.abs(objects_u - (low + high) / 2) < max((high - low) / 2 - 0.03, _STRIP_M)
        return np.bincount(places[between], minlength=count) < 2

    faces = []
    for sign in (-1, 1):
        for position in _planes(u[facing == sign], site.cloud.areas[members[facing == sign]]):
            mine = (facing == sign) & (np.abs(u - position) < _FLAT_M)
            seen = np.zeros((count, _ALL_BANDS), dtype=bool)
            inner = mine & (band >= 0) & (band < _ALL_BANDS)
            seen[cell[inner], band[inner]] = True
            faces.append(_Face(sign, position, np.flatnonzero(mine), seen))
    taken: list[tuple[float, float, int, int]] = []
    slabs: list[Slab] = []
    for stretches in (_pairs, _singles):
        for low, high, start, stop, owners in stretches(_without(faces, taken), shortest, is_empty):
            if any(low - 0.06 < b and high + 0.06 > a and start < d and stop > c for a, b, c, d in taken):
                continue
            own = np.unique(np.concatenate([face.members for face in owners]))
            own = own[(cell[own] >= start) & (cell[own] < stop)]
            slab = _measured(site, members[own], u[own], v[own], (low, high), len(owners) == 2, across, along)
            if slab is not None and slab.length > shortest - 0.5 * _CELL_M and _stands(site, slab, owners, across):
                slabs.append(slab)
                taken.append((low, high, start, stop))
    for low, high, start, stop, owners in _continued(_without(faces, taken), taken, _STUB_M):
        own = np.unique(np.concatenate([face.members for face in owners]))
        own = own[(cell[own] >= start) & (cell[own] < stop)]
        slab = _measured(site, members[own], u[own], v[own], (low, high), False, across, along)
        if slab is not None and _has_room(site, slab, across):
            slabs.append(slab)
    return slabs


def _continued(faces: list[_Face], taken: list[tuple[float, float, int, int]], shortest: float) -> list[_Stretch]:
    """Stretches in line with walls that were found: there a wall goes on, however little was seen of it, and of the floor behind it."""
    made: list[_Stretch] = []
    for low, high in sorted({entry[:2] for entry in taken}):
        own = [face for face in faces if abs(face.position - (low if face.sign < 0 else high)) < _FLAT_M]
        if not own:
            continue
        seen = np.any([face.seen for face in own], axis=0)
        runs = _stretches(seen, np.zeros(len(seen), dtype=bool), shortest, _FAINT_BANDS)
        spans = [entry[2:] for entry in taken if abs(entry[0] - low) < _FLAT_M and abs(entry[1] - high) < _FLAT_M]
        for start, stop in runs:
            near = min(max(start - b, a - stop) for a, b in spans) * _CELL_M
            if near <= _IN_LINE_M and not any(
                low - 0.06 < b and high + 0.06 > a and start < d and stop > c for a, b, c, d in [*taken, *(e[:4] for e in made)]
            ):
                made.append((low, high, start, stop, own))
    return made


def _without(faces: list[_Face], taken: list[tuple[float, float, int, int]]) -> list[_Face]:
    """Faces without the cells that belong to a slab already: low, high, start, stop."""
    rest = []
    for face in faces:
        seen = face.seen.copy()
        for low, high, start, stop in taken:
            if low - 0.06 < face.position < high + 0.06:
                seen[start:stop] = False
        rest.append(dataclasses.replace(face, seen=seen))
    return rest


def _planes(offsets: Array, areas: Array) -> list[float]:
    """Positions [m] of planes, that is of peaks in the offsets along their normal."""
    if not len(offsets):
        return []
    start = offsets.min() - 0.1
    bins = np.floor((offsets - start) / 0.01).astype(np.int64)
    smooth = np.convolve(np.bincount(bins, weights=areas, minlength=int(bins.max()) + 10), np.ones(7), mode="same")
    planes: list[float] = []
    for peak in np.argsort(-smooth, kind="stable"):
        if smooth[peak] < _FACE_M2:
            break
        position = float(start + (peak + 0.5) * 0.01)
        if all(abs(position - other) > 0.08 for other in planes):
            near = np.abs(offsets - position) < 0.04
            planes.append(float(np.average(offsets[near], weights=areas[near])))
    return sorted(planes)


def _pairs(faces: list[_Face], shortest: float, is_empty: _Gaps) -> list[_Stretch]:
    """Two faces that look away from one another, by stretch of cells, best seen first: low, high, start, stop, faces."""
    pairs = []
    for a in (face for face in faces if face.sign < 0):
        for b in (face for face in faces if face.sign > 0 and -0.03 < face.position - a.position < MAX_THICKNESS_M):
            low, high = sorted((a.position, b.position))
            for start, stop in _stretches(a.seen | b.seen, is_empty(low, high), shortest):
                counts = [int((face.seen[start:stop].sum(axis=1) >= 2).sum()) for face in (a, b)]
                if min(counts) >= 2:
                    rank = (-sum(counts), b.position - a.position, a.position, start)
                    pairs.append((rank, (low, high, start, stop, [a, b])))
    return [entry for _, entry in sorted(pairs, key=lambda item: item[0])]


def _singles(faces: list[_Face], shortest: float, is_empty: _Gaps) -> list[_Stretch]:
    """Faces by stretch of cells, most of it first: low, high, start, stop, face. What is behind them is not seen."""
    singles = []
    for face in faces:
        low, high = sorted((face.position, face.position - face.sign * _PARTITION_M))
        for start, stop in _stretches(face.seen, is_empty(low, high), shortest):
            singles.append(((start - stop, low, face.sign), (low, high, start, stop, [face])))
    return [entry for _, entry in sorted(singles, key=lambda item: item[0])]


def _stretches(seen: Mask, empty: Mask, shortest: float, bands: int = _TALL_BANDS) -> list[tuple[int, int]]:
    """Cells from, to (exclusive) in which there is wall without an opening.

    Args:
        seen: Bands with wall by cell, shape (cells, _ALL_BANDS).
        empty: Cells with neither floor nor door in them: wall above and nothing below is wall that furniture hides.
        shortest: Of wall that is seen over its height [m].
        bands: That make up that height.
    """
    tall = (seen[:, :_BANDS].sum(axis=1) >= bands) & seen[:, _OVER_FURNITURE:].any(axis=1)
    above = seen[:, _BANDS:].any(axis=1)
    behind = (seen[:, _OVER_FURNITURE:_BANDS].sum(axis=1) >= 2) | (above & empty) | (above & seen[:, :_SILL_BANDS].all(axis=1))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (tall | behind).astype(np.int8), [0]])))
    runs: list[tuple[int, int]] = []
    for start, stop in edges.reshape(-1, 2).tolist():
        if runs and (start - runs[-1][1]) * _CELL_M <= NARROW_M + 1e-9:
            runs[-1] = (runs[-1][0], stop)
        else:
            runs.append((start, stop))
    return [(start, stop) for start, stop in runs if tall[start:stop].sum() * _CELL_M >= shortest - 1e-9]


def _measured(
    site: _Site, points: NDArray[np.int64], u: Array, v: Array, span: tuple[float, float], is_double: bool, across: Array, along: Array
) -> Slab | None:
    """The slab that the points of a stretch of wall make, None where it is too low or runs in another direction."""
    z = site.cloud.points[points, 2]
    top = float(np.percentile(z, 99))
    if top < _HEIGHT_M - 0.03:
        return None
    side = np.sign(site.cloud.normals[points, :2] @ across)
    for mine in (side == sign for sign in (-1, 1) if (side == sign).sum() > 2):
        if abs(np.cov(u[mine], v[mine])[0, 1]) > _SLOPE * np.var(v[mine]):
            return None
    start, end = -_end(-v, z), _end(v, z)
    low, high = span
    if is_double:
        near = [np.abs(u - position) < _FLAT_M for position in span]
        low, high = (
            float(np.median(u[mine & (side == sign)])) if (mine & (side == sign)).any() else position
            for mine, sign, position in zip(near, (-1, 1), span, strict=True)
        )
    middle, thickness = (low + high) / 2, max(abs(high - low), _MIN_THICKNESS_M)
    # What ends a hand below the ceiling was hidden there, or lies above what the scanner was pointed at.
    height = site.height if top > min(site.height - 0.4, 2.0) else top
    return Slab(middle * across + start * along, middle * across + end * along, thickness, height)


def _end(v: Array, z: Array) -> float:
    """How far a stretch of wall reaches [m]; a lintel that goes on over a doorway does not count."""
    last = v > v.max() - 2 * _CELL_M
    low = last & (z > _LOW_M) & (z < _LOW_M + _BANDS * _BAND_M)
    reach = float(np.percentile(v[low], 99)) if low.any() else -np.inf
    # wall that only shows above what hides it reaches cells further; a lintel's first cell is often the wall's last
    return reach if reach > v.max() - 1.5 * _CELL_M else float(np.percentile(v[last], 99))


def _stands(site: _Site, slab: Slab, owners: list[_Face], across: Array) -> bool:
    """Whether there is room on both sides of a slab, and floor seen behind it if only one side of it was."""
    import shapely

    if not _has_room(site, slab, across):
        return False
    if len(owners) == 2:
        return True
    steps = np.linspace(0.1, 0.9, 9)[:, None]
    line = slab.start + steps * (slab.end - slab.start)
    face = line + owners[0].sign * across * slab.thickness / 2
    reach = np.arange(0.15, 0.81, 0.05)
    behind = (face[:, None] - owners[0].sign * across * reach[:, None]).reshape(-1, 2)
    return bool((site.is_floor(behind) & shapely.contains_xy(site.floor, behind)).mean() > _FLOOR_BEHIND)


def _has_room(site: _Site, slab: Slab, across: Array) -> bool:
    """Whether there is room on both sides of a slab."""
    import shapely

    steps = np.linspace(0.1, 0.9, 9)[:, None]
    line = slab.start + steps * (slab.end - slab.start)
    for sign in (-1.0, 1.0):
        beside = line + sign * across * (slab.thickness / 2 + 0.15)
        if shapely.contains_xy(site.floor, beside).mean() < 0.5:
            return False
    return True


def _notes(cloud: Cloud, left: Mask, slabs: list[Slab], floor: Polygon) -> list[str]:
    """Says what was taken for walls inside the room, and how much wall fits none."""
    import shapely

    rest = left & (cloud.points[:, 2] > _LOW_M) & (cloud.points[:, 2] < _LOW_M + _BANDS * _BAND_M)
    rest[rest] = shapely.contains_xy(floor.buffer(-MAX_THICKNESS_M), cloud.points[rest, :2])
    area = float(cloud.areas[rest & ~_explained(cloud, rest, slabs)].sum())
    if area < _UNEXPLAINED_M2:
        return []
    return [f"{area:.1f} m2 of wall inside the room are too low, short or bent for a straight wall: left out of interior_walls"]
