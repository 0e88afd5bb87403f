"""What of a library comes near enough to an instance, also where nobody knows what that is; models in odd units; vectors."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bench.shelves import models_in
from schemas.errors import InputError
from tasks.candidates.retrieval import MIN_FIT, MIN_UNNAMED_FIT, Retrieval
from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb, sample_surface, surface_of
from tasks.library.descriptors import describe
from tasks.library.entry import IndexEntry
from tasks.library.folder import library_in
from tasks.library.indexing import IndexConfig
from tasks.library.library import OpenLibrary
from tasks.library.search import LibraryMatch, LibraryQuery, LibrarySearch, SearchWeights
from tests.tasks.library.entries import drawn

SIDES = (-0.3, -0.5)
"""Least x and z of the normals of what a scan sees: it walks round three sides and looks down."""

SIZES = {
    "mug": (0.1, 0.08, 0.1), "vase": (0.14, 0.14, 0.32), "chair": (0.5, 0.5, 0.9), "desk": (0.7, 1.4, 0.74), "bed": (2.0, 1.5, 0.6),
    "bookshelf": (0.3, 0.9, 1.9), "kettle": (0.2, 0.15, 0.22), "desk lamp": (0.2, 0.2, 0.45),
}  # fmt: skip


def scan_of(parts: object, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points and colors of a model in a noisy scan from three sides."""
    points, colors, normals = sample_surface(surface_of(parts), 4000, rng)  # type: ignore[arg-type]
    seen = (normals[:, 0] > SIDES[0]) & (normals[:, 2] > SIDES[1])
    points = points[seen] + rng.normal(0.0, 0.003, (int(seen.sum()), 3))
    return points, np.clip(colors[seen] * 0.85 + 10, 0, 255).astype(np.uint8)


def near(search: LibrarySearch, category: str, points: np.ndarray, colors: np.ndarray) -> list[LibraryMatch]:
    """What the provider would take."""
    rng = np.random.default_rng(5)
    descriptor = describe(points, colors, np.ptp(points, axis=0), rng)
    least = MIN_FIT if search.names(category) else MIN_UNNAMED_FIT
    return [match for match in search.find(LibraryQuery.of(category, descriptor, points, rng), 3) if match.fit >= least]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> OpenLibrary:
    """A library of drawn models, each called by its category."""
    folder = tmp_path_factory.mktemp("library")
    for number, (category, size) in enumerate(SIZES.items()):
        (folder / f"{category}.glb").write_bytes(dump_glb(generate(category, size, np.random.default_rng(number)).parts))
    return library_in(folder, IndexConfig(), {})


def drawn_scan(category: str) -> tuple[np.ndarray, np.ndarray]:
    number = list(SIZES).index(category)
    return scan_of(generate(category, SIZES[category], np.random.default_rng(number)).parts, np.random.default_rng(9))


@pytest.mark.parametrize("category", ["mug", "vase", "kettle"])
@pytest.mark.parametrize("name", ["gizmo", "thingamajig 3", ""])
def test_small_things_that_nobody_named_find_their_model(library: OpenLibrary, category: str, name: str) -> None:
    best = near(library.search, name, *drawn_scan(category))
    assert best
    assert best[0].file == f"{category}.glb"
    assert all(MIN_UNNAMED_FIT <= match.fit == match.score <= 1.0 for match in best)


def test_what_is_named_is_not_stood_in_for_by_what_only_looks_alike(library: OpenLibrary) -> None:
    """A trash can looks like a vase: its name is known, and no model has it."""
    scan = drawn_scan("vase")
    unnamed, named = near(library.search, "gizmo", *scan), near(library.search, "trash can", *scan)
    assert [match.file for match in unnamed][:1] == ["vase.glb"]
    assert all(match.fit < unnamed[0].fit for match in named)


def test_a_mug_is_not_stood_in_for_by_a_bed(tmp_path: Path) -> None:
    (tmp_path / "bed.glb").write_bytes(dump_glb(generate("bed", SIZES["bed"], np.random.default_rng(0)).parts))
    search = library_in(tmp_path, IndexConfig(), {}).search
    for name in ("mug", "gizmo", ""):
        assert near(search, name, *drawn_scan("mug")) == []
    assert [match.file for match in near(search, "bed", *drawn_scan("bed"))] == ["bed.glb"]


@pytest.mark.slow
@pytest.mark.whole
def test_real_models_are_found_without_a_name_and_rarely_taken_for_others(realdata: Callable[[str], Path]) -> None:
    models, rng = models_in(realdata("assets")), np.random.default_rng(0)
    search = models[0].library.search
    right = wrong = 0
    for model in models:
        points, colors = scan_of(model.parts(), rng)
        best = near(search, "gizmo", points, colors)
        right += bool(best) and best[0].file == model.file
        wrong += any(match.file != model.file for match in best)
    assert right >= 38
    assert wrong <= len(models) // 4, "two of its sofas are hardly told apart by anybody"


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
    library = library_in(tmp_path, IndexConfig(), {})
    made = {file: library.asset_of(file).asset.extents for file in ("chair.glb", *(["gizmo.glb"] if 0.15 <= factor <= 39.37 else []))}
    assert np.allclose(made["chair.glb"], np.array(size) * factor * scale, rtol=1e-3)
    if "gizmo.glb" in made:  # nobody knows how large a gizmo is
        assert np.allclose(made["gizmo.glb"], np.array(size) * factor, rtol=1e-3)
    lines = [line for line in library.notes if line.startswith("chair.glb")]
    assert (odd in lines[0] and "of a chair" not in lines[0] and "chair usually is" in lines[0]) if odd else not lines


def shelved(entries: list[IndexEntry]) -> OpenLibrary:
    """A library of entries without files."""
    weights = {entry.weights for entry in entries}
    return OpenLibrary(
        "named", LibrarySearch.of(entries), weights.pop(), ("one note",), lambda file: pytest.fail(file), {}, (shelved, (entries,))
    )


def with_vectors(weights: str, *directions: int) -> list[IndexEntry]:
    """Chairs that only their vectors tell apart, along these axes."""
    views = [np.eye(4, dtype=np.float32)[[axis, axis]] for axis in directions]
    return [drawn("chair", 0, f"{k}.glb", content=str(k), image_vectors=view, weights=weights) for k, view in enumerate(views)]


def test_vectors_rank_what_is_near_enough_without_them() -> None:
    search = LibrarySearch.of(with_vectors("w" * 64, 0, 1, 2))
    points, colors, _ = sample_surface(surface_of(generate("chair", None, np.random.default_rng(0)).parts), 1500, np.random.default_rng(0))
    descriptor = describe(points, colors, np.ptp(points, axis=0), np.random.default_rng(1))
    plain = LibraryQuery.of("chair", descriptor, points, np.random.default_rng(2))
    toward = dataclasses.replace(plain, text=np.eye(4, dtype=np.float32)[2], image=np.eye(4, dtype=np.float32)[[2]])
    without, ranked = search.find(plain, 3), search.find(toward, 3)
    assert ranked[0].file == "2.glb"
    assert {match.file: match.fit for match in ranked} == {match.file: match.score for match in without}
    assert ranked[0].score > ranked[1].score


def test_a_library_whose_vectors_are_of_another_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "model.safetensors").write_bytes(b"weights")
    (tmp_path / "config.json").write_bytes(b"{}")
    with pytest.raises(InputError, match=r"^candidates: encoder: is the model [0-9a-f]{12}, the library was indexed by the model w{12};"):
        _ = Retrieval(shelved(with_vectors("w" * 64, 0)), SearchWeights(), str(tmp_path)).notes
    with pytest.raises(InputError, match="indexed without one"):
        _ = Retrieval(shelved([drawn("chair", 0)]), SearchWeights(), str(tmp_path)).notes
    notes = Retrieval(shelved(with_vectors("w" * 64, 0)), SearchWeights()).notes
    assert notes[0] == "library: one note"
    assert "has vectors" in notes[1]
    assert Retrieval(shelved([drawn("chair", 0)]), SearchWeights()).notes == ("library: one note",)
