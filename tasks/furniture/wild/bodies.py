"""Furniture that no template draws: sofas round a bend under cushions and throws, shelves that fill a wall, instruments, dish racks.

Models are in the canonical frame: +Z up, front +X, origin at the bottom center of the box [m].
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from tasks.furniture.drafting import Draft, Extents
from tasks.furniture.dwellings.corners import ShapedModel, corner_sofa
from tasks.furniture.palette import BRASSES, CERAMICS, COVERS, DARKS, FABRICS, GLASSES, LINENS, METALS, PAINTS, WHITES, WOODS, pick, shade
from tasks.furniture.solids import Solid, Span, bar, box, cushion, cylinder, rotation
from tasks.furniture.wild.sheets import SizedModel, assembled, part_of, throw

if TYPE_CHECKING:
    import trimesh

BOARD_M = 0.025
"""Board of a wall of shelves."""


@dataclasses.dataclass(frozen=True)
class WallShelf:
    """A wall of shelves. openings: compartments that are empty, as spans of y and z in the model's frame [m]; screen: the one for a TV."""

    sized: SizedModel
    openings: tuple[tuple[Span, Span], ...]
    screen: tuple[Span, Span]


def draped_sofa(rng: np.random.Generator, width: float, reach: float) -> ShapedModel:
    """A U-shaped sofa, `width` along the wall and `reach` deep [m], with loose cushions against its backs and throws over its seats."""
    shape = corner_sofa(rng, 2, width, reach, 1)
    hx, hy, tall = 0.5 * reach, 0.5 * width, shape.extents[2]
    seat, back = 0.5 * tall, 0.2
    parts, hulls = list(shape.model.parts), list(shape.model.hulls)
    spots = [(-hx + back + 0.02, float(y), 0.0) for y in rng.uniform(-hy + 0.5, hy - 0.5, int(rng.integers(1, 4)))]
    for side in (-1, 1):
        along = rng.uniform(-hx + 0.9, hx - 0.5, int(rng.integers(0, 3)))
        spots += [(float(x), side * (hy - back - 0.02), -side * 0.5 * np.pi) for x in along]
    for number, (x, y, turn) in enumerate(spots):
        length = float(rng.uniform(0.36, 0.5))
        # Cushions lean on the back: their lower edge is on the seat, half a thickness before it.
        pad = cushion((-0.07, 0.07), (-0.5 * length, 0.5 * length), (0.0, length), 0.06).turned("y", -float(rng.uniform(0.2, 0.5)))
        pad = pad.turned("x", float(rng.uniform(-0.2, 0.2))).turned("z", turn + float(rng.uniform(-0.3, 0.3)))
        out = 0.12 * np.array([np.cos(turn), np.sin(turn)])
        pad = pad.at(x + out[0], y + out[1], seat - float(pad.vertices[:, 2].min()) - 0.01)
        parts.append(part_of(f"cushion {number}", pad, np.tile(pick(COVERS + LINENS + FABRICS, rng), (len(pad.vertices), 1))))
        hulls += pad.pieces
    deep = shape.bend[0][0] + hx
    for at in rng.uniform(-hy + 0.5, hy - 0.5, 2):
        front = -hx + deep + 0.004
        path = np.array([[front, 0.12], [front, seat + 0.004], [-hx + back + 0.22, seat + 0.004], [-hx + back + 0.16, tall - 0.12]])
        if abs(at) > hy - deep:  # over a return there is no front to hang down
            path = path[1:] - [0.05, 0.0]
        blanket, pieces = throw(rng, path, float(rng.uniform(0.5, 0.8)), float(at))
        parts.append(blanket)
        hulls += pieces
    sized = assembled("draped " + shape.model.name, "sofa", _numbered(parts), hulls)
    blocks = tuple((x, y, (0.0, sized.extents[2])) for x, y, _ in shape.blocks)
    return dataclasses.replace(shape, model=sized.model, extents=sized.extents, blocks=blocks)


def _numbered(parts: list[trimesh.Trimesh]) -> list[trimesh.Trimesh]:
    """Parts with names of their own."""
    seen: dict[str, int] = {}
    for part in parts:
        name = str(part.metadata["name"])
        seen[name] = seen.get(name, -1) + 1
        if seen[name]:
            part.metadata["name"] = f"{name} {seen[name]}"
    return parts


def wall_shelf(rng: np.random.Generator, width: float, tall: float) -> WallShelf:
    """Shelves over a whole wall, without doors: most compartments hold rows of books, some are empty, one is large enough for a TV."""
    deep = float(rng.uniform(0.3, 0.38))
    d = Draft("bookshelf", (deep, width, tall), rng, None)
    d.one_of("wall")
    wood = d.main(WOODS + PAINTS[:2] + WHITES)
    columns, rows = round(width / 0.68), round(tall / 0.36)
    ys, zs = np.linspace(-d.hy, d.hy, columns + 1), np.linspace(0.0, tall, rows + 1)
    first, low = int(rng.integers(0, columns - 1)), 2
    hidden = {(first, low), (first + 1, low), (first, low + 1), (first + 1, low + 1)}
    for k, y in enumerate(ys):
        y0, y1 = float(np.clip(y - 0.5 * BOARD_M, -d.hy, d.hy - BOARD_M)), float(np.clip(y + 0.5 * BOARD_M, -d.hy + BOARD_M, d.hy))
        for z0, z1 in ((0.0, float(zs[low])), (float(zs[low + 2]), tall)) if k == first + 1 else ((0.0, tall),):
            d.box("uprights", wood, (-d.hx, d.hx), (y0, y1), (z0, z1))
    for column, (left, right) in enumerate(pairwise(ys)):
        for row, z in enumerate(zs):
            if (column, row) in hidden and row == low + 1:
                continue
            z1 = float(np.clip(z + 0.5 * BOARD_M, BOARD_M, tall))
            span = (float(left) + 0.4 * BOARD_M, float(right) - 0.4 * BOARD_M)
            d.box("boards", wood, (-d.hx, d.hx - 0.004), span, (z1 - BOARD_M, z1))
    openings = []
    for column, (left, right) in enumerate(pairwise(ys)):
        for row, (bottom, top) in enumerate(pairwise(zs)):
            if (column, row) in hidden:
                continue
            y = (float(left) + 0.52 * BOARD_M, float(right) - 0.52 * BOARD_M)
            z = (max(float(bottom) + 0.5 * BOARD_M, BOARD_M), min(float(top) - 0.5 * BOARD_M, tall - BOARD_M))
            if rng.random() < 0.62:
                _books(d, y, z)
            else:
                openings.append((y, z))
    screen = ((float(ys[first]) + BOARD_M, float(ys[first + 2]) - BOARD_M), (float(zs[low]) + 0.5 * BOARD_M, float(zs[low + 2]) - BOARD_M))
    sized = SizedModel(d.model((deep, width, tall)), (deep, width, tall))
    return WallShelf(sized, tuple(openings), screen)


def _books(d: Draft, y: Span, z: Span) -> None:
    """A row of books between two uprights; the row ends somewhere, and no two books are alike."""
    at, end = y[0] + 0.004, y[1] - d.between(0.0, 0.25)
    while True:
        thick, deep, tall = d.between(0.018, 0.06), d.between(0.15, 0.26), d.between(0.55, 0.92) * (z[1] - z[0])
        if at + thick > end:
            return
        front = d.hx - d.between(0.02, 0.07)
        d.box("books", d.pick(COVERS + LINENS + DARKS), (max(front - deep, -d.hx), front), (at, at + thick), (z[0], z[0] + tall))
        at += thick + 0.0008


def screen(rng: np.random.Generator, width: float) -> SizedModel:
    """A flat TV on a foot, `width` wide [m]."""
    size: Extents = (0.2, width, 0.58 * width + 0.05)
    d = Draft("tv", size, rng, None)
    d.one_of("flat")
    dark = d.main(DARKS)
    d.box("panel", dark, (-0.02, 0.02), (-d.hy, d.hy), (0.05, d.Z))
    d.box("picture", shade(dark, 0.6), (0.02, 0.024), (-d.hy + 0.015, d.hy - 0.015), (0.065, d.Z - 0.015))
    d.box("foot", dark, (-d.hx, d.hx), (-0.3 * d.hy, 0.3 * d.hy), (0.0, 0.012))
    d.box("foot", dark, (-0.02, 0.02), (-0.1 * d.hy, 0.1 * d.hy), (0.012, 0.05))
    return SizedModel(d.model(size), size)


def guitar(rng: np.random.Generator, lean: float) -> SizedModel:
    """A guitar that leans back by an angle [rad]: its head is to touch the wall behind it."""
    wood, neck = pick(WOODS, rng), pick(WOODS[2:4], rng)
    lower = cylinder(0.19, (-0.05, 0.05), 20).turned("y", 0.5 * np.pi).at(0.0, 0.0, 0.19)
    upper = cylinder(0.14, (-0.05, 0.05), 20).turned("y", 0.5 * np.pi).at(0.0, 0.0, 0.38)
    solids: list[tuple[str, tuple[int, int, int], Solid]] = [
        ("body", wood, lower), ("body", wood, upper), ("foot", pick(DARKS, rng), box((0.0, 0.05), (-0.08, 0.08), (-0.02, 0.03))),
        ("rose", pick(DARKS, rng), cylinder(0.05, (0.05, 0.053), 14).turned("y", 0.5 * np.pi).at(0.0, 0.0, 0.34)),
        ("neck", neck, box((0.03, 0.055), (-0.028, 0.028), (0.5, 0.9))),
        ("head", neck, box((0.025, 0.05), (-0.04, 0.04), (0.9, 1.04))),
        ("bridge", pick(DARKS, rng), box((0.05, 0.06), (-0.07, 0.07), (0.14, 0.165))),
    ]  # fmt: skip
    tilt = rotation("y", -lean)
    return _drawn("leaning guitar", "guitar", [(name, color, solid.moved(tilt)) for name, color, solid in solids])


def leaning(rng: np.random.Generator, lean: float) -> tuple[str, SizedModel]:
    """Something flat or long that leans back by an angle [rad], and its category: a framed picture, a broom, a skateboard, a board."""
    kind = ("picture", "broom", "skateboard", "ironing board")[int(rng.integers(4))]
    wood, cloth, metal = pick(WOODS, rng), pick(COVERS + FABRICS, rng), pick(METALS, rng)
    if kind == "picture":
        y, z = float(rng.uniform(0.3, 0.45)), float(rng.uniform(0.7, 1.1))
        solids = [("frame", wood, box((-0.015, 0.015), (-y, y), (0.0, z)))]
        bands = np.linspace(0.04, z - 0.04, 6)
        for a, b in pairwise(bands):
            span = (float(a), float(b))
            solids.append(("canvas", pick(COVERS + LINENS, rng), box((0.015, 0.018), (-y + 0.04, y - 0.04), span)))
    elif kind == "broom":
        solids = [
            ("stick", wood, box((-0.014, 0.014), (-0.014, 0.014), (0.14, 1.35))),
            ("brush", cloth, box((-0.03, 0.03), (-0.16, 0.16), (0.0, 0.15))),
        ]
    elif kind == "skateboard":
        solids = [("deck", cloth, box((-0.012, 0.012), (-0.1, 0.1), (0.0, 0.8)))]
        for z in (0.16, 0.64):
            solids.append(("wheels", metal, box((0.012, 0.07), (-0.09, 0.09), (z - 0.03, z + 0.03))))
    else:
        solids = [
            ("top", cloth, box((-0.02, 0.02), (-0.19, 0.19), (0.12, 1.4))),
            ("legs", metal, box((-0.045, -0.02), (-0.15, 0.15), (0.0, 1.0))),
        ]
    tilt = rotation("y", -lean)
    return kind, _drawn(f"leaning {kind}", kind, [(name, color, solid.moved(tilt)) for name, color, solid in solids])


def glass_shelf(rng: np.random.Generator, width: float) -> SizedModel:
    """A pane on two thin brackets that a depth sensor mostly looks through, `width` wide [m]."""
    size: Extents = (0.24, width, 0.1)
    d = Draft("shelf", size, rng, None)
    d.one_of("glass")
    d.box("glass", d.main(GLASSES), (-d.hx, d.hx), (-d.hy, d.hy), (d.Z - 0.01, d.Z))
    for s in (-1, 1):
        d.box("brackets", d.pick(METALS), (-d.hx, -d.hx + 0.02), (s * 0.7 * d.hy - 0.008, s * 0.7 * d.hy + 0.008), (0.0, d.Z - 0.01))
    return SizedModel(d.model(size), size)


def loose_cushion(rng: np.random.Generator) -> SizedModel:
    """A cushion that leans back, by so much that its lower edge keeps it."""
    side = float(rng.uniform(0.4, 0.52))
    pad = cushion((-0.07, 0.07), (-0.5 * side, 0.5 * side), (0.0, side), 0.05).turned("y", -float(rng.uniform(0.35, 0.6)))
    return _drawn("loose cushion", "cushion", [("cushion", pick(COVERS + LINENS + FABRICS, rng), pad)])


def piano(rng: np.random.Generator) -> SizedModel:
    """An upright piano: case, key bed with keys on two legs, music stand, pedals."""
    size: Extents = (0.62, float(rng.uniform(1.44, 1.54)), float(rng.uniform(1.12, 1.26)))
    d = Draft("piano", size, rng, None)
    d.one_of("upright")
    wood = d.main((*DARKS, *WOODS[1:3], *WHITES[:1]))
    back = -d.hx + 0.34
    d.box("case", wood, (-d.hx, back), (-d.hy, d.hy), (0.0, d.Z))
    d.box("bed", wood, (back, d.hx), (-d.hy, d.hy), (0.6, 0.68))
    for s in (-1, 1):
        y0, y1 = sorted((s * d.hy, s * (d.hy - 0.06)))
        d.box("cheeks", wood, (back, d.hx), (y0, y1), (0.68, 0.78))
        d.box("legs", wood, (d.hx - 0.09, d.hx - 0.01), (y0, y1), (0.0, 0.6))
    keys = np.linspace(-d.hy + 0.07, d.hy - 0.07, 53)
    for k, (a, b) in enumerate(pairwise(keys)):
        d.box("keys", (244, 242, 234), (back + 0.06, d.hx - 0.03), (float(a) + 0.001, float(b) - 0.001), (0.68, 0.7))
        if k % 7 not in (2, 6):
            d.box("black keys", (24, 24, 26), (back + 0.06, d.hx - 0.1), (float(b) - 0.007, float(b) + 0.007), (0.7, 0.712))
    d.box("stand", shade(wood, 1.2), (back, back + 0.02), (-0.35, 0.35), (0.84, 1.06))
    brass = d.pick(BRASSES)
    for y in (-0.08, 0.0, 0.08):
        d.box("pedals", brass, (back, back + 0.1), (y - 0.015, y + 0.015), (0.03, 0.045))
    return SizedModel(d.model(size), size)


def dish_rack(rng: np.random.Generator) -> SizedModel:
    """A rack of wires with plates on edge and cups in it."""
    metal, hx, hy = pick(METALS + WHITES, rng), 0.17, 0.23
    solids: list[tuple[str, tuple[int, int, int], Solid]] = [
        ("tray", shade(metal, 0.8), box((-hx, hx), (-hy, hy), (0.0, 0.012))),
    ]  # fmt: skip
    for z in (0.05, 0.13):
        for s in (-1, 1):
            solids.append(("wires", metal, box((-hx, hx), (s * (hy - 0.004) - 0.004, s * (hy - 0.004) + 0.004), (z - 0.004, z + 0.004))))
            solids.append(("wires", metal, box((s * (hx - 0.004) - 0.004, s * (hx - 0.004) + 0.004), (-hy, hy), (z - 0.004, z + 0.004))))
    for y in np.linspace(-hy + 0.02, hy - 0.02, 9):
        for s in (-1, 1):
            x = s * (hx - 0.004)
            solids.append(("wires", metal, bar((x, y, 0.01), (x, y, 0.132), 0.006)))
    plates = np.arange(-hy + 0.05, 0.08, 0.035)
    for y in plates[: int(rng.integers(4, len(plates) + 1))]:
        radius = float(rng.uniform(0.1, 0.125))
        plate = cylinder(radius, (-0.006, 0.006), 22).turned("x", 0.5 * np.pi + 0.14).at(-0.01, float(y), 0.0)
        solids.append(("plates", pick(CERAMICS, rng), plate.at(0.0, 0.0, 0.013 - plate.vertices[:, 2].min())))
    for x in (-0.08, 0.05):
        solids.append(("cups", pick(CERAMICS, rng), cylinder(0.042, (0.012, 0.11), 16).at(x, hy - 0.07, 0.0)))
    return _drawn("dish rack", "dish rack", solids)


def _drawn(name: str, category: str, solids: list[tuple[str, tuple[int, int, int], Solid]]) -> SizedModel:
    """A model of solids as they are, one part for each name; its extents are those of what was drawn."""
    points = np.concatenate([solid.vertices for _, _, solid in solids])
    x, y, z = (float(v) for v in np.ptp(points, axis=0))
    d = Draft(category, (x, y, z), np.random.default_rng(0), None)
    d.variant = name.removesuffix(f" {category}") if name != category else ""
    for part, color, solid in solids:
        d.add(part, color, solid)
    return SizedModel(d.model((x, y, z)), (x, y, z))
