"""Retrieval from a library where nobody knows what an instance is, by size, shape and color alone; and models in odd units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tasks.candidates.assets import MAX_EXTENT_M
from tasks.candidates.descriptors import Descriptor, describe
from tasks.candidates.library import LibraryEntry, index_library, library_asset
from tasks.candidates.retrieval import MIN_UNNAMED_SCORE, retrieve
from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb, load_glb, sample_surface, surface_of

SIDES = (-0.3, -0.5)
"""Least x and z of the normals of what a scan sees: it walks round three sides and looks down."""


def of_model(parts: object, rng: np.random.Generator, is_scanned: bool) -> Descriptor:
    """What a model is compared by, or what a noisy scan from three sides would be."""
    points, colors, normals = sample_surface(surface_of(parts), 4000, rng)
    if is_scanned:
        seen = (normals[:, 0] > SIDES[0]) & (normals[:, 2] > SIDES[1])
        points = points[seen] + rng.normal(0.0, 0.003, (int(seen.sum()), 3))
        colors = np.clip(colors[seen] * 0.85 + 10, 0, 255).astype(np.uint8)
    return describe(points, colors, np.ptp(points, axis=0), rng)


@pytest.fixture(scope="module")
def library() -> list[LibraryEntry]:
    """A library of generated models."""
    sizes = {
        "mug": (0.1, 0.08, 0.1), "vase": (0.14, 0.14, 0.32), "chair": (0.5, 0.5, 0.9), "desk": (0.7, 1.4, 0.74), "bed": (2.0, 1.5, 0.6),
        "bookshelf": (0.3, 0.9, 1.9), "kettle": (0.2, 0.15, 0.22), "desk lamp": (0.2, 0.2, 0.45),
    }  # fmt: skip
    entries = []
    for number, (category, size) in enumerate(sizes.items()):
        rng = np.random.default_rng(number)
        descriptor = of_model(generate(category, size, rng).parts, rng, is_scanned=False)
        entries.append(LibraryEntry(Path(f"{number}.glb"), f"{number}.glb", category, "CC0-1.0", None, "test", descriptor))
    return entries


@pytest.mark.parametrize(("category", "size"), [("mug", (0.1, 0.08, 0.1)), ("vase", (0.14, 0.14, 0.32)), ("kettle", (0.2, 0.15, 0.22))])
@pytest.mark.parametrize("name", ["gizmo", "thingamajig 3", ""])
def test_small_things_that_nobody_named_find_their_model(
    library: list[LibraryEntry], category: str, size: tuple[float, float, float], name: str
) -> None:
    number = [entry.category for entry in library].index(category)
    scan = of_model(generate(category, size, np.random.default_rng(number)).parts, np.random.default_rng(9), is_scanned=True)
    best = retrieve(name, scan, library, 3)
    assert best
    assert best[0][1].category == category
    assert all(MIN_UNNAMED_SCORE <= score <= 1.0 for score, _ in best)


def test_what_is_named_is_never_stood_in_for_by_what_only_looks_alike(library: list[LibraryEntry]) -> None:
    """A trash can looks like a vase: its name is known, and no entry has it."""
    scan = of_model(generate("vase", (0.14, 0.14, 0.32), np.random.default_rng(1)).parts, np.random.default_rng(9), is_scanned=True)
    unnamed, named = retrieve("gizmo", scan, library, 3), retrieve("trash can", scan, library, 3)
    assert [entry.category for _, entry in unnamed][:1] == ["vase"]
    assert all(score < value for (score, _), (value, _) in zip(named, unnamed, strict=False))


def test_what_shares_a_word_with_an_entry_is_named(library: list[LibraryEntry]) -> None:
    scan = of_model(generate("mug", (0.1, 0.08, 0.1), np.random.default_rng(0)).parts, np.random.default_rng(9), is_scanned=True)
    entries = [*library, LibraryEntry(Path("g.glb"), "g.glb", "gizmo", "CC0-1.0", None, "test", scan)]
    assert retrieve("red gizmo", scan, entries, 1)[0][1].category == "gizmo"


@pytest.mark.whole
def test_real_models_are_found_without_a_name_and_rarely_taken_for_others(realdata: Callable[[str], Path]) -> None:
    index, rng = index_library(realdata("assets")), np.random.default_rng(0)
    right = wrong = 0
    for entry in index.entries:
        scan = of_model(load_glb(entry.path.read_bytes(), entry.file), rng, is_scanned=True)
        best = retrieve("gizmo", scan, index.entries, 1)
        right += bool(best) and best[0][1].file == entry.file
        others = [other for other in index.entries if other.file != entry.file]
        wrong += bool(retrieve("gizmo", scan, others, 1))
    assert right >= 36
    assert wrong <= len(index.entries) // 4, "two of its sofas are hardly told apart by anybody"


@pytest.mark.parametrize(
    ("factor", "scale", "odd"),
    [
        (1.0, 1.0, ""), (3.0, 1.0, ""), (100.0, 0.01, "read as centimetres"), (1000.0, 0.001, "read as millimetres"),
        (39.37, 0.0254, "read as inches"), (0.01, 100.0, "read as hundreds of metres"), (6.0, 1.0, "used as it is"),
        (0.15, 1.0, "used as it is"),
    ],
)  # fmt: skip
def test_a_model_in_other_units_is_scaled_where_its_category_says_so(tmp_path: Path, factor: float, scale: float, odd: str) -> None:
    size = (0.5, 0.5, 0.9)
    parts = generate("chair", size, np.random.default_rng(0)).parts
    for part in parts:
        part.apply_scale(factor)
    for name in ("chair", "gizmo"):
        (tmp_path / f"{name}.glb").write_bytes(dump_glb(parts))
    index = index_library(tmp_path)
    made = {entry.category: library_asset(entry).asset.extents for entry in index.entries}
    assert np.allclose(made["chair"], np.array(size) * factor * scale, rtol=1e-3)
    assert ("gizmo" in made) == (max(size) * factor <= MAX_EXTENT_M), "nobody knows how large a gizmo is"
    lines = [line for line in index.problems if "chair.glb" in line]
    assert (odd in lines[0] and "of a chair" not in lines[0] and "chair usually is" in lines[0]) if odd else not lines
    entry = next(entry for entry in index.entries if entry.category == "chair")
    assert np.allclose(entry.descriptor.extents, np.array(size) * factor * scale, rtol=1e-3)
