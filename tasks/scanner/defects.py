"""What is wrong with real scans: surfaces that no sensor saw, segments merged and split, labels misspelled, coarse meshes.

Every defect is drawn from a generator and written down, so that each can be traced back to what is true.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.furniture.drafting import ALIASES
from tasks.geometry.meshes import Surface
from tasks.scanner.scenery import STRUCTURE, Scenery

Array = NDArray[np.float64]

THIN_M = 0.055
"""What is thinner than this in two directions, and longer than `LONG_M` in the third, is a leg, post or rail."""

LONG_M = 0.15

GLASS: tuple[str, ...] = ("panes", "screen", "glass")
"""Parts that a depth sensor looks through or past."""


@dataclasses.dataclass(frozen=True)
class DefectSettings:
    """How much of what is wrong."""

    legs_lost: float = 0.6  # share of the objects with thin legs that lose them: fusion at 2 to 4 cm keeps none thinner than its voxel
    glass_lost: float = 0.7  # share of windows, screens and mirrors without a surface
    holes: float = 0.35  # holes per object and per square metre of its footprint's share, see `draw_holes`
    hole_m: tuple[float, float] = (0.06, 0.2)  # radii: a dark spot, a shiny table top
    merged: float = 0.2  # share of the objects that are annotated together with what they touch, where that is annotated itself
    split: float = 0.1  # share of the instances that are annotated as two
    misspelled: float = 0.15  # share of the labels with a slip of the hand
    other_words: float = 0.2  # share of the labels with another word for the same thing
    vertices: int = 80_000  # of the whole mesh, as ScanNet's cleaned ones have it for a room


@dataclasses.dataclass(frozen=True)
class Blindness:
    """What the sensor does not get depth of. faces: by part of the scenery, True where a face is lost. centers, radii: of holes in
    whatever lies there, shapes (n, 3) and (n,) [m]; they go through thin boards from both sides. lost_legs, lost_glass: objects."""

    faces: tuple[NDArray[np.bool_], ...]
    centers: Array
    radii: Array
    lost_legs: tuple[int, ...]
    lost_glass: tuple[int, ...]

    def hides(self, part: NDArray[np.int64], face: NDArray[np.int64], points: Array) -> NDArray[np.bool_]:
        """Whether hits give no depth: part and face, shape (n,), and where, shape (n, 3) [m]."""
        from scipy.spatial import cKDTree

        first = np.cumsum([0, *(len(flags) for flags in self.faces)])
        hidden: NDArray[np.bool_] = np.concatenate(self.faces)[first[part] + face]
        if len(points) and len(self.radii):
            for inside in cKDTree(points).query_ball_point(self.centers, self.radii):
                hidden[inside] = True
        return hidden


def draw_blindness(scenery: Scenery, settings: DefectSettings, rng: np.random.Generator) -> Blindness:
    """Legs, panes and holes that are lost in a scene."""
    lost = [np.zeros(len(part.faces), dtype=np.bool_) for part in scenery.parts]
    legs, glass = [], []
    for index, obj in enumerate(scenery.objects):
        drawn = rng.random(2)
        if obj.category in STRUCTURE:
            continue
        parts = [k for k in range(len(scenery.parts)) if scenery.object_of[k] == index]
        thin = {k: thin_faces(np.asarray(scenery.parts[k].vertices), np.asarray(scenery.parts[k].faces), obj.pose) for k in parts}
        if any(flags.any() for flags in thin.values()) and drawn[0] < settings.legs_lost:
            legs.append(index)
            for k, flags in thin.items():
                lost[k] |= flags
        panes = [k for k in parts if scenery.parts[k].metadata.get("name") in GLASS or obj.category == "mirror"]
        if panes and drawn[1] < settings.glass_lost:
            glass.append(index)
            for k in panes:
                lost[k][:] = True
    centers, radii = draw_holes(scenery, settings, rng)
    return Blindness(tuple(lost), centers, radii, tuple(legs), tuple(glass))


def thin_faces(vertices: Array, faces: NDArray[np.int64], pose: Array) -> NDArray[np.bool_]:
    """Faces of the solids of a part that are thin bars along any axis of their object, shape (faces,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    number, solid = connected_components(graph, directed=False)
    local = (vertices - pose[:3, 3]) @ pose[:3, :3]
    low, high = np.full((number, 3), np.inf), np.full((number, 3), -np.inf)
    np.minimum.at(low, solid, local)
    np.maximum.at(high, solid, local)
    sides = np.sort(high - low, axis=1)
    is_thin = (sides[:, 1] < THIN_M) & (sides[:, 2] > LONG_M)
    return np.asarray(is_thin[solid[faces[:, 0]]], dtype=np.bool_)


def draw_holes(scenery: Scenery, settings: DefectSettings, rng: np.random.Generator) -> tuple[Array, Array]:
    """Balls about points on objects; in them nothing is seen. The larger an object's faces, the more."""
    centers: list[Array] = []
    radii: list[float] = []
    for index, obj in enumerate(scenery.objects):
        sides = np.sort(obj.extents)
        parts = [k for k in range(len(scenery.parts)) if scenery.object_of[k] == index]
        for _ in range(int(rng.poisson(settings.holes * min(float(sides[1] * sides[2]), 6.0)))):
            part = scenery.parts[parts[int(rng.integers(len(parts)))]]
            corner = np.asarray(part.vertices)[np.asarray(part.faces)[int(rng.integers(len(part.faces)))]]
            weights = rng.dirichlet([1.0, 1.0, 1.0])
            centers.append(weights @ corner)
            radii.append(float(rng.uniform(*settings.hole_m)))
    return np.array(centers).reshape(-1, 3), np.array(radii)


def decimated(surface: Surface, vertices: int) -> Surface:
    """The surface with about so many vertices; colors are those of the nearest vertices of before."""
    import fast_simplification
    from scipy.spatial import cKDTree

    if len(surface.vertices) <= vertices:
        return surface
    wanted = round(len(surface.faces) * vertices / len(surface.vertices))
    points, triangles = fast_simplification.simplify(
        np.ascontiguousarray(surface.vertices, dtype=np.float32), np.ascontiguousarray(surface.faces, dtype=np.int32), target_count=wanted
    )
    used, dense = np.unique(triangles, return_inverse=True)
    points, triangles = np.asarray(points, dtype=np.float64)[used], dense.reshape(-1, 3).astype(np.int64)
    nearest = cKDTree(surface.vertices).query(points)[1]
    return Surface(points, triangles, surface.colors[nearest])


@dataclasses.dataclass(frozen=True)
class Annotated:
    """An instance as an annotator left it. label: as written; segments: ids; objects: what of it is truly there, by number of the
    scenery's object, as a share of its vertices, the largest first. is_merged, is_split: how it is wrong."""

    label: str
    segments: tuple[int, ...]
    objects: tuple[tuple[int, float], ...]
    is_merged: bool
    is_split: bool


def annotate(
    scenery: Scenery, groups: Sequence[tuple[int, list[int]]], segments: NDArray[np.int64], owner: NDArray[np.int64], points: Array,
    settings: DefectSettings, rng: np.random.Generator,
) -> list[Annotated]:  # fmt: skip
    """Instances with the slips that people make: merged with what they touch, split in two, called by other words.

    groups: objects and their segments, as nobody but the generator knows them. segments, owner: by vertex, shape (n,). points: the
    vertices, shape (n, 3) [m].
    """
    ids, dense = np.unique(segments, return_inverse=True)
    place = {int(v): k for k, v in enumerate(ids)}
    sizes = np.bincount(dense)
    middles = np.stack([np.bincount(dense, points[:, k]) for k in range(3)], axis=1) / sizes[:, None]
    mine = {index: [place[v] for v in listed] for index, listed in groups}
    partner = _partners(scenery, mine, middles, settings, rng)
    taken = set(partner)
    annotated: list[Annotated] = []
    for index, listed in groups:
        if index in taken:
            continue
        places = [*mine[index], *(p for other, into in sorted(partner.items()) if into == index for p in mine[other])]
        is_merged = len(places) > len(listed)
        category = scenery.objects[index].category
        halves = [places]
        if category not in STRUCTURE and len(places) > 3 and rng.random() < settings.split:
            halves = _halves(places, middles, sizes)
        for half in halves:
            owners = np.bincount(owner[np.isin(dense, half)] + 1, minlength=len(scenery.objects) + 1)[1:]
            total = max(int(sizes[half].sum()), 1)
            order = [int(k) for k in np.argsort(-owners, kind="stable") if owners[k] > 0]
            shares = tuple((k, round(float(owners[k]) / total, 4)) for k in order)
            label = category if category in STRUCTURE else written(category, settings, rng)
            annotated.append(Annotated(label, tuple(int(ids[p]) for p in half), shares, is_merged, len(halves) > 1))
    return annotated


def _partners(
    scenery: Scenery, mine: dict[int, list[int]], middles: Array, settings: DefectSettings, rng: np.random.Generator
) -> dict[int, int]:
    """Which objects are annotated as a part of which: of what carries them, or of a neighbor of their own category."""
    names = {obj.name: index for index, obj in enumerate(scenery.objects)}
    partner: dict[int, int] = {}
    for index in sorted(mine):
        obj = scenery.objects[index]
        if obj.category in STRUCTURE or rng.random() >= settings.merged:
            continue
        at = middles[mine[index]].mean(axis=0)
        near = [
            (float(np.linalg.norm(middles[mine[k]].mean(axis=0) - at)), k)
            for k in mine
            if k != index and scenery.objects[k].category == obj.category
        ]
        carrier = names.get(obj.parent)
        into = carrier if carrier in mine else None
        if near and min(near)[0] < 0.8:
            into = min(near)[1]
        if into is not None and into not in partner and index not in partner.values():
            partner[index] = into
    return partner


def _halves(places: list[int], middles: Array, sizes: NDArray[np.int64]) -> list[list[int]]:
    """Segments on either side of a plane across their longest axis, each side with about half of the vertices."""
    points = middles[places]
    axis = int(np.ptp(points, axis=0).argmax())
    order = np.argsort(points[:, axis], kind="stable")
    total = np.cumsum(sizes[places][order])
    cut = int(np.clip(np.searchsorted(total, 0.5 * total[-1]), 1, len(places) - 1))
    return [[places[int(k)] for k in order[:cut]], [places[int(k)] for k in order[cut:]]]


def written(category: str, settings: DefectSettings, rng: np.random.Generator) -> str:
    """A category as an annotator writes it: often so, at times another word for it, at times with a slip."""
    drawn = rng.random(3)
    text = category
    if drawn[0] < settings.other_words:
        words = sorted(word for word, known in ALIASES.items() if known == category)
        text = words[int(rng.integers(len(words)))] if words else text
    if drawn[1] < settings.misspelled:
        text = misspelled(text, rng)
    return text.upper() if drawn[2] < 0.02 else text


def misspelled(word: str, rng: np.random.Generator) -> str:
    """A word with one slip of the hand: a letter too few, twice, or changed places with the next. It always differs."""
    letters = list(word)
    spots = [k for k in range(len(letters) - 1) if letters[k].isalpha() and letters[k + 1].isalpha() and letters[k] != letters[k + 1]]
    if not spots:
        return word + "s"
    at = spots[int(rng.integers(len(spots)))]
    slip = int(rng.integers(3))
    if slip == 0:
        del letters[at]
    elif slip == 1:
        letters.insert(at, letters[at])
    else:
        letters[at], letters[at + 1] = letters[at + 1], letters[at]
    return "".join(letters)
