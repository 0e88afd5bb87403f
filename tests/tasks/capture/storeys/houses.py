"""Houses of plates with known storeys: rooms above one another, with walls, ceilings, furniture, stairs, and what is no storey."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import yaw_pose
from tests.capture_scans import Mesh, box_plates, plate

STEP = 0.3
"""Distance of a house's vertices [m]."""


@dataclasses.dataclass(frozen=True)
class House:
    """A house in a frame whose z axis is up. storey: Of each vertex, where it was drawn, shape (n,). floors: Heights [m]. slabs: Lowest
    and highest height between each two storeys at which nothing is but walls and stairs [m]. instance: Of each vertex. labels: Of each."""

    surface: Surface
    storey: np.ndarray
    floors: tuple[float, ...]
    slabs: tuple[tuple[float, float], ...]
    instance: np.ndarray
    labels: tuple[str, ...]


@dataclasses.dataclass
class Builder:
    """Pieces of a house, in the order in which they are added."""

    pieces: list[tuple[str, int, Mesh]] = dataclasses.field(default_factory=list)
    step: float = STEP

    def add(self, label: str, storey: int, mesh: Mesh) -> None:
        """One more instance."""
        self.pieces.append((label, storey, mesh))

    def box(self, label: str, storey: int, low: Sequence[float], high: Sequence[float]) -> None:
        """A box between two corners [m]."""
        a, b = np.array(low, dtype=float), np.array(high, dtype=float)
        self.add(label, storey, box_plates(b - a, yaw_pose(0.0, (a + b) / 2), self.step))

    def room(self, storey: int, low: Sequence[float], size: Sequence[float], has_ceiling: bool = True) -> None:
        """Floor, walls and ceiling around a box of air, as seen from inside."""
        corner, (x, y, z) = np.array(low, dtype=float), size
        self.add("floor", storey, plate(corner, [x, 0, 0], [0, y, 0], self.step))
        self.add("wall", storey, plate(corner, [0, 0, z], [x, 0, 0], self.step))
        self.add("wall", storey, plate(corner + np.array([0, y, 0]), [x, 0, 0], [0, 0, z], self.step))
        self.add("wall", storey, plate(corner, [0, y, 0], [0, 0, z], self.step))
        self.add("wall", storey, plate(corner + np.array([x, 0, 0]), [0, 0, z], [0, y, 0], self.step))
        if has_ceiling:
            self.add("ceiling", storey, plate(corner + np.array([0, 0, z]), [0, y, 0], [x, 0, 0], self.step))

    def house(self, floors: Sequence[float], slabs: Sequence[tuple[float, float]] = ()) -> House:
        """All pieces as one mesh."""
        offsets = np.cumsum([0, *(len(points) for _, _, (points, _) in self.pieces)])
        vertices = np.concatenate([points for _, _, (points, _) in self.pieces])
        faces = np.concatenate([triangles + at for (_, _, (_, triangles)), at in zip(self.pieces, offsets, strict=False)])
        counts = [len(points) for _, _, (points, _) in self.pieces]
        instance = np.repeat(np.arange(len(self.pieces)), counts)
        storey = np.repeat([number for _, number, _ in self.pieces], counts)
        colors = np.random.default_rng(0).integers(0, 256, (len(vertices), 3)).astype(np.uint8)
        labels = tuple(label for label, _, _ in self.pieces)
        return House(Surface(vertices, faces, colors), storey, tuple(floors), tuple(slabs), instance, labels)


def furnish(builder: Builder, storey: int, low: Sequence[float], size: Sequence[float]) -> None:
    """A table, a bed, a shelf and a row of wardrobes along the walls."""
    x, y, z = low
    builder.box("table", storey, (x + 1.2, y + 1.0, z + 0.7), (x + 2.6, y + 1.8, z + 0.75))
    builder.box("bed", storey, (x + 0.1, y + size[1] - 2.1, z + 0.1), (x + 1.7, y + size[1] - 0.1, z + 0.5))
    builder.box("shelf", storey, (x + 0.1, y + 0.3, z), (x + 0.5, y + 2.8, z + 2.0))
    builder.box("wardrobe", storey, (x + size[0] - 0.7, y + 0.3, z), (x + size[0] - 0.1, y + 2.8, z + 2.1))


def house_of(
    storeys: int, size: tuple[float, float], height: float, slab: float, is_stair: bool = True, has_ceilings: bool = True
) -> House:
    """Furnished storeys of one plan above one another, with a flight of stairs and its well between each two."""
    builder, floors, slabs = Builder(), [], []
    for number in range(storeys):
        low = (0.0, 0.0, number * (height + slab))
        floors.append(low[2])
        builder.room(number, low, (*size, height), has_ceilings or number == storeys - 1)
        furnish(builder, number, low, (*size, height))
        if number:
            slabs.append((low[2] - slab if has_ceilings else low[2] - 0.3, low[2]))
            if is_stair:
                builder.add("stairs", number - 1, stairs(low[2] - height - slab, height + slab, size[1] - 3.3))
    return builder.house(floors, slabs)


def stairs(start: float, rise: float, y: float) -> Mesh:
    """A straight flight of steps without risers, from `start` up by `rise` [m], the first of them at x = 0.5 m."""
    count = round(rise / 0.2)
    meshes = [plate([0.5 + 0.15 * k, y, start + (k + 1) * rise / count], [0.15, 0, 0], [0, 1.0, 0], STEP) for k in range(count)]
    offsets = np.cumsum([0, *(len(points) for points, _ in meshes)])
    faces = [triangles + at for (_, triangles), at in zip(meshes, offsets, strict=False)]
    return np.concatenate([points for points, _ in meshes]), np.concatenate(faces)


def mezzanine(size: tuple[float, float], share: float, rise: float, has_ceiling: bool = True) -> House:
    """A hall with a gallery over a part of it, which carries a bed and has a railing."""
    builder = Builder()
    builder.room(0, (0, 0, 0), (*size, rise + 2.6), has_ceiling)
    furnish(builder, 0, (0, 0, 0), (*size, rise))
    deep = size[1] * share
    builder.box("floor", 0, (0, size[1] - deep, rise - 0.2), (size[0], size[1], rise))
    builder.box("bed", 0, (0.3, size[1] - 1.9, rise), (2.0, size[1] - 0.2, rise + 0.4))
    builder.box("railing", 0, (0, size[1] - deep, rise), (size[0], size[1] - deep + 0.05, rise + 1.0))
    return builder.house((0.0,))


def raised(size: tuple[float, float], rise: float) -> House:
    """A room half of which is a platform (rise above zero) or sunken."""
    builder = Builder()
    builder.room(0, (0, 0, min(rise, 0.0)), (*size, 2.6 + abs(rise)))
    half = size[1] / 2
    builder.box("floor", 0, (0, half, min(rise, 0.0) - 0.1), (size[0], size[1], max(rise, 0.0)))
    furnish(builder, 0, (0, 0, 0), (*size, 2.6))
    return builder.house((0.0,))


def half_storeys(size: tuple[float, float], rise: float) -> House:
    """Two halves of a house whose floors are half a storey apart, two above one another in each."""
    builder = Builder()
    for number in range(2):
        builder.room(number, (0, 0, 2 * rise * number), (size[0], size[1] / 2, 2 * rise - 0.3))
        builder.room(number, (0, size[1] / 2, 2 * rise * number + rise), (size[0], size[1] / 2, 2 * rise - 0.3))
    return builder.house((0.0,))


def flat_roof(size: tuple[float, float]) -> House:
    """A room that was scanned from above, too, with a parapet round its roof."""
    builder = Builder()
    builder.room(0, (0, 0, 0), (*size, 2.6))
    builder.box("roof", 0, (-0.3, -0.3, 2.8), (size[0] + 0.3, size[1] + 0.3, 3.0))
    builder.box("parapet", 0, (-0.3, -0.3, 3.0), (size[0] + 0.3, -0.2, 3.4))
    builder.box("mast", 0, (1.0, 1.0, 3.0), (1.1, 1.1, 6.0))
    return builder.house((0.0,))


def partial_cover(size: tuple[float, float]) -> House:
    """A hall, with rooms along one side of it whose ceilings are half as high as its own."""
    builder = Builder()
    builder.room(0, (0, 0, 0), (*size, 5.2))
    half = size[1] / 2
    builder.add("ceiling", 0, plate([0, half, 2.5], [0, half, 0], [size[0], 0, 0], STEP))
    builder.add("wall", 0, plate([0, half, 0], [0, 0, 2.5], [size[0], 0, 0], STEP))
    return builder.house((0.0,))


def scanned(house: House, noise: float, tilt: tuple[float, float], holes: float, seed: int) -> House:
    """The house as a scan has it. noise [m]: Of vertices. tilt: Slope of all of it, as drift leaves it. holes: Share of the faces that are
    missing, in patches of a metre."""
    rng = np.random.default_rng(seed)
    surface = house.surface
    vertices = surface.vertices + rng.normal(0.0, noise, surface.vertices.shape)
    vertices[:, 2] += vertices[:, :2] @ np.array(tilt)
    centers = surface.vertices[surface.faces].mean(axis=1)
    patch = np.unique(np.floor(centers).astype(int), axis=0, return_inverse=True)[1].ravel()
    gone = rng.random(patch.max() + 1) < holes
    kept = Surface(vertices, surface.faces[~gone[patch]], surface.colors)
    return dataclasses.replace(house, surface=kept)


SIZES = st.tuples(st.floats(5.0, 14.0), st.floats(6.0, 14.0))

SINGLE: dict[str, Callable[[Any], House]] = {
    "mezzanine": lambda draw: mezzanine(draw(SIZES), draw(st.floats(0.15, 0.5)), draw(st.floats(2.3, 3.2)), draw(st.booleans())),
    "platform": lambda draw: raised(draw(SIZES), draw(st.floats(0.2, 1.6))),
    "sunken floor": lambda draw: raised(draw(SIZES), -draw(st.floats(0.2, 1.6))),
    "half-storeys": lambda draw: half_storeys(draw(SIZES), draw(st.floats(1.25, 1.5))),
    "flat roof": lambda draw: flat_roof(draw(SIZES)),
    "low rooms in a hall": lambda draw: partial_cover(draw(SIZES)),
    "plain": lambda draw: house_of(1, draw(SIZES), draw(st.floats(2.3, 6.0)), 0.3),
}
"""Houses of one storey, by what might be taken for another."""
