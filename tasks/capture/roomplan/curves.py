"""Walls unrolled into a plane: flat ones as they are, arcs of a circle along their length."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import json_floats

Array = NDArray[np.float64]

MAX_SAGITTA_M = 0.01
"""Distance between an arc and its chords: less than RoomPlan's own error on flat walls."""

MAX_CHORDS = 320
"""Chords of a wall: enough for a full circle of the largest radius within the sagitta."""

MIN_RADIUS_M, MAX_RADIUS_M = 0.05, 200.0
"""Radii of walls: a pipe casing, and a wall that no scan tells from a flat one."""

MIN_SWEEP = np.radians(1.0)
"""Sweep of an arc [rad]: less is flat."""

MAX_END_GAP, MIN_END_GAP_M = 0.05, 0.05
"""Distance of an arc's ends from those of its wall, as a share of its width or in meters, at which both are one statement."""

_DEGREES = {"°": 1.0, "deg": 1.0, "rad": float(np.degrees(1.0)), "grad": 0.9, "rev": 360.0}
"""Degrees per unit of an angle, by Foundation's symbols."""

_AXES = (((0, 1), 1.0), ((0, 1), -1.0), ((1, 0), 1.0), ((1, 0), -1.0))
"""Readings of an angle: from x towards z, the documented axes, then the other three; signs are of the second axis."""

_AGAIN = "export the room again"


@dataclasses.dataclass(frozen=True)
class Curve:
    """A curve as the file states it, in the x-z plane of its wall's own frame.

    center: [m], shape (2,). sweeps: pairs of start and end angle [rad], the stated unit first.
    """

    center: Array
    radius: float
    sweeps: tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class Neighbors:
    """Ends of the other walls in the x-z plane of a wall [m].

    middle: mean of the ends, shape (2,). gaps: function from points (n, 2) to their distances from the nearest end, shape (n,).
    """

    middle: Array
    gaps: Callable[[Array], Array]


class WallSheet(Protocol):
    """A wall's surface as a part of a plane: x along the wall, y up, z away from it."""

    @property
    def seams(self) -> Array:
        """Places along the wall where flat pieces meet, its ends included [m], shape (k,)."""

    def unroll(self, points: Array) -> Array:
        """Points of the wall's own frame in the plane [m], shape (n, 3)."""

    def roll(self, points: Array) -> Array:
        """Points of the plane in the wall's own frame [m], shape (n, 3)."""


@dataclasses.dataclass(frozen=True)
class Flat:
    """A wall that lies in a plane. width: [m]."""

    width: float

    @property
    def seams(self) -> Array:
        """Both ends."""
        return np.array([-0.5, 0.5]) * self.width

    def unroll(self, points: Array) -> Array:
        """The same points."""
        return points

    def roll(self, points: Array) -> Array:
        """The same points."""
        return points


@dataclasses.dataclass(frozen=True)
class Arc:
    """A wall along an arc of a circle, in the x-z plane of its own frame.

    start, sweep: angles [rad], from x towards z, of the end that comes first along x; sweep may be negative.
    """

    center: Array
    radius: float
    start: float
    sweep: float

    @property
    def length(self) -> float:
        """Length along the arc [m]."""
        return self.radius * abs(self.sweep)

    @property
    def chords(self) -> int:
        """Number of flat pieces that stand for the arc."""
        step = 2.0 * np.arccos(1.0 - min(MAX_SAGITTA_M / self.radius, 1.0))
        return int(np.clip(np.ceil(abs(self.sweep) / step - 1e-9), 2, MAX_CHORDS))

    @property
    def sagitta(self) -> float:
        """Distance between the arc and its chords [m]."""
        return self.radius * float(1.0 - np.cos(0.5 * self.sweep / self.chords))

    @property
    def seams(self) -> Array:
        """Ends of the chords."""
        return np.linspace(-0.5, 0.5, self.chords + 1) * self.length

    @property
    def ends(self) -> Array:
        """Both ends in the x-z plane [m], shape (2, 2)."""
        return self._points(np.array([self.start, self.start + self.sweep]))

    def unroll(self, points: Array) -> Array:
        """Points by their direction from the center, and their distance from the circle."""
        offset = points[:, [0, 2]] - self.center
        angle = np.arctan2(offset[:, 1], offset[:, 0]) - self.start - 0.5 * self.sweep
        angle = (angle + np.pi) % (2.0 * np.pi) - np.pi
        along = np.sign(self.sweep) * self.radius * angle
        return np.column_stack([along, points[:, 1], np.linalg.norm(offset, axis=1) - self.radius])

    def roll(self, points: Array) -> Array:
        """Points on the chords."""
        seams = self.seams
        ends = self._points(self.start + self.sweep * (seams / self.length + 0.5))
        x, z = (np.interp(points[:, 0], seams, ends[:, axis]) for axis in (0, 1))
        return np.column_stack([x, points[:, 1], z])

    def _points(self, angles: Array) -> Array:
        return self.center + self.radius * np.column_stack([np.cos(angles), np.sin(angles)])


def curve_of(value: Any, name: str, field: str) -> Curve | None:
    """The curve of a wall, None for a flat one.

    Raises:
        InputError: it is not an arc of a circle.
    """
    if value is None:
        return None
    if not isinstance(value, dict):
        raise InputError(name, field, "must be an object", _AGAIN)
    center = json_floats(value.get("center"), name, f"{field}.center", 2)
    radius = float(json_floats([value.get("radius")], name, f"{field}.radius", 1)[0])
    if not MIN_RADIUS_M <= radius <= MAX_RADIUS_M:
        raise InputError(name, f"{field}.radius", f"must be {MIN_RADIUS_M:g} to {MAX_RADIUS_M:g} m, is {radius:g}", _AGAIN)
    starts = _angles(value.get("startAngle"), name, f"{field}.startAngle")
    ends = _angles(value.get("endAngle"), name, f"{field}.endAngle")
    sweeps = tuple((start, end) for start, end in zip(starts, ends, strict=False) if MIN_SWEEP <= abs(end - start) <= 2.0 * np.pi)
    if not sweeps:
        raise InputError(name, f"{field}.endAngle", "must be 1 to 360 degrees from the start", _AGAIN)
    return Curve(center, radius, sweeps)


def _angles(value: Any, name: str, field: str) -> tuple[float, ...]:
    """An angle [rad]: a measurement with its unit, or a plain number, which may be in radians or in degrees."""
    if not isinstance(value, dict):
        number = float(json_floats([value], name, field, 1)[0])
        return number, float(np.radians(number))
    number = float(json_floats([value.get("value")], name, f"{field}.value", 1)[0])
    unit = value.get("unit")
    symbol = unit.get("symbol") if isinstance(unit, dict) else unit
    if not isinstance(symbol, str) or symbol not in _DEGREES:
        raise InputError(name, f"{field}.unit", f"must be one of {', '.join(_DEGREES)}", _AGAIN)
    return (float(np.radians(number * _DEGREES[symbol])),)


def arc_of(curve: Curve, width: float, neighbors: Neighbors | None) -> tuple[Arc, str]:
    """The arc of a wall, and a remark on contradictions, '' without any.

    The file does not state from which axis angles count. The arc that ends where the wall's rectangle
    does is the stated one. If none does, the arc goes between the ends of the rectangle.

    width: of the rectangle [m]. neighbors: the other walls, None without any.
    """
    rectangle = np.array([[-0.5, 0.0], [0.5, 0.0]]) * width
    stated = [arc for sweep in curve.sweeps for arc in _readings(curve, *sweep)]
    gaps = [float(np.linalg.norm(arc.ends - rectangle, axis=1).max()) for arc in stated]
    limit = max(MAX_END_GAP * width, MIN_END_GAP_M)
    fitting = [arc for arc, gap in zip(stated, gaps, strict=True) if gap <= limit]
    if fitting:
        return fitting[0], ""
    bent = _bent(curve, width, neighbors)
    # Neighbors decide: a wall begins where another one ends.
    if neighbors is not None:
        arcs = (bent, *stated)
        misfits = neighbors.gaps(np.concatenate([arc.ends for arc in arcs])).reshape(-1, 2).max(axis=1)
        best = int(np.argmin(misfits))
        if best and misfits[best] <= limit < misfits[0]:
            return arcs[best], f"dimensions state a width of {width:.2f} m, which ends elsewhere: the curve is used"
    return bent, f"its ends lie {min(gaps):.2f} m from those of its wall: bent between the ends of the wall"


def _readings(curve: Curve, start: float, end: float) -> list[Arc]:
    """Arcs from a start to an end angle, one for each reading of angles, the end that comes first along x first."""
    sweep = end - start
    if sweep < -np.pi:
        sweep += 2.0 * np.pi  # past the full circle
    arcs = []
    for axes, sign in _AXES:
        first, turn = (start * sign, sweep * sign) if axes == (0, 1) else (0.5 * np.pi - start * sign, -sweep * sign)
        arc = Arc(curve.center, curve.radius, first, turn)
        ends = arc.ends
        arcs.append(arc if ends[0, 0] <= ends[1, 0] else Arc(curve.center, curve.radius, first + turn, -turn))
    return arcs


def _bent(curve: Curve, width: float, neighbors: Neighbors | None) -> Arc:
    """An arc of the stated sweep between the ends of the wall, away from the stated center, or from the other walls."""
    start, end = curve.sweeps[0]
    sweep = abs(end - start) if end > start else min(abs(end - start), 2.0 * np.pi - abs(end - start))
    sweep = float(np.clip(sweep, MIN_SWEEP, 2.0 * np.pi - MIN_SWEEP))
    radius = 0.5 * width / np.sin(0.5 * sweep)
    away = float(curve.center[1])
    if abs(away) < MIN_END_GAP_M and neighbors is not None:
        away = float(neighbors.middle[1])
    side = -1.0 if away > 0 else 1.0
    center = np.array([0.0, -side * radius * np.cos(0.5 * sweep)])
    return Arc(center, float(radius), side * 0.5 * (np.pi + sweep), -side * sweep)


def unrolled_corners(sheet: WallSheet, corners: Array, width: float) -> Array:
    """Corners of a wall's outline along its sheet [m], shape (n, 2): those in the plane of the ends are stretched."""
    if isinstance(sheet, Flat):
        return corners[:, :2]
    if np.abs(corners[:, 2]).max() > MAX_SAGITTA_M:
        return sheet.unroll(corners)[:, :2]
    stretch = float(np.ptp(sheet.seams)) / max(width, 1e-9)
    return np.column_stack([corners[:, 0] * stretch, corners[:, 1]])
