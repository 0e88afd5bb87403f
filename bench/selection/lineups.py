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

from bench.selection.catalog import Catalog, Color, Extents, cell, features, main_color
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

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

Kind = Literal["scanned", "recolored", "reshaped", "variant", "twin", "other", "crop", "parametric"]
"""What a candidate is: the scanned model; the same in another color; one of its category in other proportions; one of its category, near in
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
    size_jitter: float = 0.06  # of each side of another category's model, as a standard deviation
    color_jitter: float = 18.0  # of 255, of each channel of its color: what a scan's exposure moves colors by
    reshaped: float = 0.35  # largest change of a side of what has other proportions, as a logarithm
    other_categories: int = 2  # candidates of other categories, and more where the catalog has few of the scanned one's
    near_categories: int = 10  # from which these are drawn: those whose usual proportions come nearest
    color_apart: float = 90.0  # of 442, between the color of a model and that in which it is offered again


@dataclasses.dataclass(frozen=True)
class Offered:
    """A candidate and what it is, which its rows do not say."""

    kind: Kind
    made: MadeAsset


def lineup(
    true: TrueModel, request: CandidateRequest, categories: Sequence[str], catalog: Catalog, settings: LineupSettings,
    rng: np.random.Generator,
) -> list[Offered]:  # fmt: skip
    """Ten candidates of an instance in the order of their slots. categories: that may be offered.

    Where the scanned model is offered, all that is drawn follows from the models in its cell of the catalog, any of which is about as
    likely to be the one. Crop and template, which are made of the scan, are the exception, and so is what a dwelling draws with its
    room (kitchen units, sofas and desks round a corner): the catalog has their category and size, drawn in the usual form.
    """
    of_scan = _of_scan("crop", request) if rng.random() < settings.crop_share else []
    of_scan += _of_scan("parametric", request)
    has_scanned = bool(rng.random() < settings.scanned_share)
    models = near_models(true, catalog, SLOTS - 2 - settings.other_categories - len(of_scan), has_scanned, rng)
    offered = [Offered(kind, drawn(parts, true.category)) for kind, parts in models]
    kind, parts = models[int(rng.integers(len(models)))]
    main = main_color(parts)
    other = drawn(recolored(parts, main, another_color(main, settings.color_apart, rng)), true.category)
    offered.append(Offered("recolored" if kind == "scanned" else "twin", other))
    around = models[int(rng.integers(len(models)))][1]
    sides, color = scaled(extents_of(around), rng.uniform(-settings.reshaped, settings.reshaped, 3)), main_color(around)
    offered.append(Offered("reshaped", drawn(generate(true.category, sides, rng, color=color).parts, true.category)))
    around = models[int(rng.integers(len(models)))][1]
    sides, color = extents_of(around), main_color(around)
    offered += of_scan
    known = {each.made.asset.asset_id for each in offered}
    if len(known) < len(offered):  # two of the catalog are one model: what is twice tells nothing, and goes
        own_last = sorted(offered, key=lambda each: each.kind in OF_SCANNED)
        offered = list({each.made.asset.asset_id: each for each in own_last}.values())
    for name in _near(true.category, sides, categories, settings, rng)[: SLOTS - len(offered)]:
        box = scaled(sides, rng.normal(0.0, settings.size_jitter, 3))
        model = generate(name, box, rng, color=jittered(color, settings.color_jitter, rng))
        offered.append(Offered("other", drawn(model.parts, name)))
    return [offered[int(k)] for k in rng.permutation(len(offered))]


def near_models(
    true: TrueModel, catalog: Catalog, count: int, has_scanned: bool, rng: np.random.Generator
) -> list[tuple[Kind, list[trimesh.Trimesh]]]:
    """Models of the scanned one's cell, so many at most, in no order; it is one of them; or was, and is exchanged for another,
    where the catalog has one."""
    listed = catalog.get(true.category, ())
    values = features([true.extents, *(m.extents for m in listed)], [main_color(true.parts), *(m.color for m in listed)])
    rows = cell(values, 0, count if has_scanned else count + 1, rng)
    if not has_scanned and len(rows) > 1:
        rows.remove(0)
    return [("scanned", true.parts) if row == 0 else ("variant", listed[row - 1].parts()) for row in rows]


def candidate_rows(request: CandidateRequest, offered: Sequence[Offered]) -> list[Candidate]:
    """Rows of candidates, in the order of their slots."""
    version = {"crop": ScanCrop().version, "parametric": Parametric().version}
    return [
        Candidate(
            scene_id=request.context.scene_id, instance_id=request.instance.instance_id, slot=slot, provider=each.made.asset.provider,
            provider_version=version.get(each.kind, Procedural().version), is_fallback=False, outcome="filled", reason=None,
            asset_id=each.made.asset.asset_id, seed=None, call_id=None, library=None, library_file=None, library_score=None,
            twin_of=None, seen_share=None, seconds=None,
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


def _near(category: str, extents: Extents, categories: Sequence[str], settings: LineupSettings, rng: np.random.Generator) -> list[str]:
    """Other categories of about these proportions, in no order."""
    usual = {name: np.array(typical_extents(name)) for name in categories if name != category}
    far = {name: float(np.abs(np.log(sides / np.array(extents))).sum()) for name, sides in usual.items()}
    nearest = sorted(far, key=lambda name: (far[name], name))[: settings.near_categories]
    return [nearest[int(k)] for k in rng.permutation(len(nearest))]


def extents_of(parts: Sequence[trimesh.Trimesh]) -> Extents:
    """Sides of a model's box [m]."""
    x, y, z = np.ptp(surface_of(parts).vertices, axis=0).tolist()
    return x, y, z


def scaled(extents: Extents, logarithms: Array) -> Extents:
    """Sides times the exponentials of three numbers, none thinner than 5 mm [m]."""
    x, y, z = np.maximum(np.array(extents) * np.exp(logarithms), 0.005).tolist()
    return x, y, z


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
