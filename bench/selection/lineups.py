"""Ten candidates of an instance whose model is known: the model itself, and what is hard to tell from it.

A provider for the benchmark alone. What it draws is called as the generator's own candidates are, by category alone, so that no row tells
which of them was scanned; slots are shuffled.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from bench.selection.rooms import TrueModel
from schemas.candidates import Candidate
from tasks.candidates.assets import MadeAsset, make_asset
from tasks.candidates.parametric import PARAMETRIC, Parametric
from tasks.candidates.procedural import Procedural
from tasks.candidates.provider import NothingToOffer
from tasks.candidates.request import CandidateRequest
from tasks.candidates.scan_crop import SCAN_CROP, ScanCrop
from tasks.furniture import generate, typical_extents
from tasks.geometry.meshes import surface_of
from tasks.geometry.triangles import face_crosses

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Color = tuple[int, int, int]
Extents = tuple[float, float, float]

Kind = Literal["scanned", "recolored", "reshaped", "variant", "twin", "other", "crop", "parametric"]
"""What a candidate is: the scanned model; the same in another color; its category and color in other proportions; its category, near in
size and color; one of these in another color; another category in the same box; the scan's own surface, closed; a template fitted to the
scan."""

OF_SCANNED: tuple[Kind, ...] = ("scanned", "recolored", "crop")
"""What shares the scanned model's mesh or the scan's own surface."""

SLOTS = 10


@dataclasses.dataclass(frozen=True)
class LineupSettings:
    """What is offered."""

    scanned_share: float = 0.85  # of instances have their own model among the ten; a library holds no more than that
    crop_share: float = 0.3  # of instances have the scan's own crop: in the product all have, and it is the dearest to make
    size_jitter: float = 0.06  # of each side of a variant, as a standard deviation: catalogs come in sizes
    color_jitter: float = 9.0  # of 255, of each channel of a variant: below what a scan's exposure moves colors by
    reshaped: float = 0.35  # largest change of a side of what has other proportions, as a logarithm
    other_categories: int = 2  # candidates of other categories
    near_categories: int = 10  # from which these are drawn: those whose usual proportions come nearest
    color_apart: float = 90.0  # of 442, between the color of the scanned model and that in which it is offered again
    twin_share: float = 0.5  # of lineups offer a variant in two colors and not the scanned model: two of one mesh tell nothing


@dataclasses.dataclass(frozen=True)
class Offered:
    """A candidate and what it is, which its rows do not say."""

    kind: Kind
    made: MadeAsset


def lineup(
    true: TrueModel, request: CandidateRequest, categories: Sequence[str], settings: LineupSettings, rng: np.random.Generator
) -> list[Offered]:
    """Ten candidates of an instance in the order of their slots. categories: that may be offered."""
    main = main_color(true.parts)
    # What is drawn lies round a size and color that are a little off, or the scanned model would be the mean of all that is offered.
    around = jittered(main, settings.color_jitter, rng)
    middle = rng.normal(0.0, settings.size_jitter, 3)

    def near(category: str, spread: Array, color_spread: float) -> list[trimesh.Trimesh]:
        sides = scaled(true.extents, middle + spread)
        return generate(category, sides, rng, color=jittered(around, color_spread, rng)).parts

    def variant() -> list[trimesh.Trimesh]:
        return near(true.category, rng.normal(0.0, settings.size_jitter, 3), settings.color_jitter)

    offered: list[Offered] = []
    if rng.random() < settings.scanned_share:
        offered.append(Offered("scanned", drawn(true.parts, true.category)))
    other = another_color(main, settings.color_apart, rng)
    if rng.random() < settings.twin_share:
        parts = variant()
        offered.append(Offered("variant", drawn(parts, true.category)))
        offered.append(Offered("twin", drawn(recolored(parts, main_color(parts), other), true.category)))
    else:
        offered.append(Offered("recolored", drawn(recolored(true.parts, main, other), true.category)))
    reshaped = near(true.category, rng.uniform(-settings.reshaped, settings.reshaped, 3), 0.0)
    offered.append(Offered("reshaped", drawn(reshaped, true.category)))
    for name in _near(true, categories, settings, rng):
        parts = near(name, rng.normal(0.0, settings.size_jitter, 3), 2 * settings.color_jitter)
        offered.append(Offered("other", drawn(parts, name)))
    if rng.random() < settings.crop_share:
        offered += _of_scan("crop", request)
    offered += _of_scan("parametric", request)
    known = {each.made.asset.asset_id for each in offered}
    while len(offered) < SLOTS:
        made = drawn(variant(), true.category)
        if made.asset.asset_id not in known:
            known.add(made.asset.asset_id)
            offered.append(Offered("variant", made))
    return [offered[int(k)] for k in rng.permutation(SLOTS)]


def candidate_rows(request: CandidateRequest, offered: Sequence[Offered]) -> list[Candidate]:
    """Rows of candidates, in the order of their slots."""
    version = {"crop": ScanCrop().version, "parametric": Parametric().version}
    return [
        Candidate(
            scene_id=request.context.scene_id, instance_id=request.instance.instance_id, slot=slot, provider=each.made.asset.provider,
            provider_version=version.get(each.kind, Procedural().version), is_fallback=False, outcome="filled", reason=None,
            asset_id=each.made.asset.asset_id,
        )
        for slot, each in enumerate(offered, start=1)
    ]  # fmt: skip


def drawn(parts: Sequence[trimesh.Trimesh], category: str, pieces: Sequence[trimesh.Trimesh] = ()) -> MadeAsset:
    """An asset of what the generator drew, called by its category alone."""
    return make_asset(
        parts, provider=Procedural.kind, name=category, category=category, source="furniture generator", license="CC0-1.0", pieces=pieces
    )


def _of_scan(kind: Literal["crop", "parametric"], request: CandidateRequest) -> list[Offered]:
    """What the product's own providers make of the scan; nothing where they have nothing, or fail on it."""
    try:
        made = SCAN_CROP.offer(request, ScanCrop()) if kind == "crop" else PARAMETRIC.offer(request, Parametric())
    except (NothingToOffer, ValueError):
        return []
    return [Offered(kind, made)]


def _near(true: TrueModel, categories: Sequence[str], settings: LineupSettings, rng: np.random.Generator) -> list[str]:
    """Other categories of about the same proportions."""
    far = {
        name: float(np.abs(np.log(np.array(typical_extents(name)) / np.array(true.extents))).sum())
        for name in categories
        if name != true.category
    }
    nearest = sorted(far, key=lambda name: (far[name], name))[: settings.near_categories]
    return [nearest[int(k)] for k in rng.permutation(len(nearest))[: settings.other_categories]]


def scaled(extents: Extents, logarithms: Array) -> Extents:
    """Sides times the exponentials of three numbers, none thinner than 5 mm [m]."""
    x, y, z = np.maximum(np.array(extents) * np.exp(logarithms), 0.005).tolist()
    return x, y, z


def main_color(parts: Sequence[trimesh.Trimesh]) -> Color:
    """The color of most of a model's surface."""
    surface = surface_of(parts)
    area = 0.5 * np.linalg.norm(face_crosses(surface.vertices, surface.faces), axis=1)
    colors, which = np.unique(surface.colors[surface.faces[:, 0]] // 12, axis=0, return_inverse=True)
    best = int(np.bincount(which.reshape(-1), area, minlength=len(colors)).argmax())
    r, g, b = np.round(np.average(surface.colors[surface.faces[which.reshape(-1) == best, 0]], axis=0)).astype(int).tolist()
    return r, g, b


def jittered(color: Color, spread: float, rng: np.random.Generator) -> Color:
    """A color with each channel moved by chance."""
    r, g, b = np.clip(np.round(np.array(color) + rng.normal(0.0, spread, 3)), 0, 255).astype(int).tolist()
    return r, g, b


def another_color(color: Color, apart: float, rng: np.random.Generator) -> Color:
    """A color at least so far from another, of 442 from black to white."""
    while True:
        r, g, b = rng.integers(20, 236, 3).tolist()
        if np.linalg.norm(np.array([r, g, b]) - color) >= apart:
            return r, g, b


def recolored(parts: Sequence[trimesh.Trimesh], main: Color, color: Color, reach: float = 60.0) -> list[trimesh.Trimesh]:
    """Parts with what is within `reach` of a color moved to another one; the rest keeps its own."""
    from trimesh.visual import ColorVisuals

    moved = []
    for part in parts:
        part = part.copy()
        colors = np.column_stack([surface_of([part]).colors.astype(np.float64), np.full(len(part.vertices), 255.0)])
        near = np.linalg.norm(colors[:, :3] - main, axis=1) <= reach
        colors[near, :3] += np.array(color, dtype=np.float64) - main
        part.visual = ColorVisuals(part, vertex_colors=np.clip(np.round(colors), 0, 255).astype(np.uint8))
        moved.append(part)
    return moved
