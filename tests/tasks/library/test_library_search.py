"""Search over arrays gives what one comparison after the other gives, in whatever order entries come."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.captions.physics import known_name
from tasks.library.categories import category_similarity
from tasks.library.descriptors import extents_similarity, shape_similarity, similarity
from tasks.library.entry import IndexEntry, dumped, loaded
from tasks.library.fields import fits
from tasks.library.search import LibraryQuery, LibrarySearch, SearchWeights, softened
from tests.tasks.library.entries import CATEGORIES, LISTED, drawn, scanned

ENTRIES = [drawn(category, seed) for category in CATEGORIES for seed in range(3)]
SEARCH = LibrarySearch.of(ENTRIES)
PLAIN = SearchWeights(near_model=0.0, near_scan=0.0)


def compared(query: LibraryQuery, entry: IndexEntry, w: SearchWeights) -> float:
    """The score of one entry without its place on the short list."""
    d, other = query.descriptor, entry.descriptor
    total = w.extents + w.shape + w.color
    score = w.extents * extents_similarity(d.extents, entry.extents) + w.shape * shape_similarity(d, other)
    score += w.color * similarity(softened(d.colors), softened(other.colors))
    if known_name(query.category) or any(category_similarity(query.category, each.category) > 0 for each in ENTRIES):
        score, total = score + w.category * category_similarity(query.category, entry.category), total + w.category
    return score / total


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(CATEGORIES), st.integers(0, 9), st.sampled_from([*CATEGORIES, *LISTED]))
def test_arrays_compare_as_one_by_one(category: str, seed: int, name: str) -> None:
    query = scanned(category, seed, name)
    matches = SEARCH.find(query, len(ENTRIES), PLAIN)
    wanted = {entry.file: compared(query, entry, PLAIN) for entry in ENTRIES}
    assert {match.file for match in matches} == set(wanted)
    # Of histograms that are nearly equal, the root of a divergence that is rounded to single precision is taken.
    assert all(match.score == pytest.approx(wanted[match.file], abs=5e-4) for match in matches)
    assert [match.score for match in matches] == sorted((match.score for match in matches), reverse=True)


@settings(max_examples=10, deadline=None)
@given(st.permutations(range(len(ENTRIES))), st.sampled_from(CATEGORIES))
def test_the_order_of_indexing_changes_nothing(order: list[int], category: str) -> None:
    query = scanned(category, 1)
    other = LibrarySearch.of([ENTRIES[k] for k in order])
    assert other.packed() == SEARCH.packed()
    assert other.find(query, 9) == SEARCH.find(query, 9)


def test_arrays_lie_in_their_bytes() -> None:
    data = SEARCH.packed()
    again = LibrarySearch.unpacked(memoryview(data))
    assert again.packed() == data
    assert all(not array.flags.owndata for array in again.arrays.values())
    for category in CATEGORIES:
        assert again.find(scanned(category, 0), 5) == SEARCH.find(scanned(category, 0), 5)
    with pytest.raises(ValueError, match="no arrays"):
        LibrarySearch.unpacked(b"something else\n")


def test_an_empty_library_finds_nothing() -> None:
    empty = LibrarySearch.of([])
    assert empty.find(scanned("chair", 0), 5) == []
    assert LibrarySearch.unpacked(empty.packed()).find(scanned("chair", 0), 5) == []


@pytest.mark.parametrize("name", [None, ""])
def test_a_scan_finds_its_model_first_with_its_name_or_without(name: str | None) -> None:
    right = sum(SEARCH.find(scanned(c, seed, name), 1)[0].file == f"{c}_{seed}.glb" for c in CATEGORIES for seed in range(3))
    assert right >= len(ENTRIES) - 1


def test_equal_models_come_in_the_order_of_their_names_and_duplicates_once() -> None:
    same = [drawn("chair", 0, file) for file in ("c.glb", "a.glb", "b.glb")]
    assert [match.file for match in LibrarySearch.of(same).find(scanned("chair", 0), 5)] == ["a.glb", "b.glb", "c.glb"]
    marked = [dataclasses.replace(entry, duplicate_of="" if entry.file == "a.glb" else "a.glb", duplicate_by="bytes") for entry in same]
    assert [match.file for match in LibrarySearch.of(marked).find(scanned("chair", 0), 5)] == ["a.glb"]
    colors = np.roll(same[0].descriptor.colors, 7)
    repainted = dataclasses.replace(
        same[0],
        file="d.glb",
        duplicate_of="a.glb",
        duplicate_by="geometry",
        descriptor=dataclasses.replace(same[0].descriptor, colors=colors),
    )
    assert [match.file for match in LibrarySearch.of([*marked, repainted]).find(scanned("chair", 0), 5)] == ["a.glb", "d.glb"]


def test_only_the_short_list_is_laid_on() -> None:
    matches = SEARCH.find(scanned("chair", 0), len(ENTRIES), SearchWeights(short_list=4))
    laid = [match for match in matches if match.near_model is not None]
    assert len(laid) == 4
    assert all(0 < match.near_scan <= match.near_model <= 1 or match.near_model > 0 for match in laid)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_vectors_count_by_their_cosines(seed: int) -> None:
    """By definition (specs/models.md B.3): the text against the mean of the views, the picture against the nearest view."""
    rng = np.random.default_rng(seed)

    def unit(*shape: int) -> np.ndarray:
        values = rng.normal(size=shape).astype(np.float32)
        return values / np.linalg.norm(values, axis=-1, keepdims=True)

    entries = [dataclasses.replace(entry, image_vectors=unit(4, 8), text_vector=unit(8), weights="w") for entry in ENTRIES]
    query = dataclasses.replace(scanned("chair", 0), text=unit(8), image=unit(2, 8))
    weights = SearchWeights(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1, 0.6, 0.4)
    matches = {match.file: match.score for match in LibrarySearch.of(entries).find(query, 99, weights)}
    for entry in entries:
        mean = entry.image_vectors.mean(axis=0)
        text = float(mean @ query.text) / float(np.linalg.norm(mean))
        image = float(np.max(entry.image_vectors @ query.image.T))
        assert matches[entry.file] == pytest.approx(0.6 * text + 0.4 * image, abs=1e-5)


def test_vectors_of_two_models_are_not_compared() -> None:
    vectors = np.ones((4, 8), np.float32)
    mixed = [dataclasses.replace(entry, image_vectors=vectors, weights=str(k % 2)) for k, entry in enumerate(ENTRIES)]
    assert "views" not in LibrarySearch.of(mixed).arrays


def test_entries_are_the_same_after_bytes() -> None:
    vectors = np.linspace(0, 1, 32, dtype=np.float32).reshape(4, 8)
    for entry in (ENTRIES[0], dataclasses.replace(ENTRIES[1], image_vectors=vectors, text_vector=vectors[0], file="ä\ud7ff.glb")):
        again = loaded(dumped(entry))
        assert dumped(again) == dumped(entry)
        assert again.asset == entry.asset
        assert np.array_equal(again.field.values, entry.field.values)
        assert again.descriptor.colors.dtype == entry.descriptor.colors.dtype
    for broken in (b"", b"{}", b"[]", dumped(ENTRIES[0])[:-9], dumped(ENTRIES[0]).replace(b'"shape":[48]', b'"shape":[47]')):
        with pytest.raises(ValueError, match=r"\S"):
            loaded(broken)


def of_fields(entries: list[IndexEntry]) -> list[np.ndarray]:
    return [np.array([getattr(entry.field, name) for entry in entries]) for name in ("values", "low", "high", "samples", "size")]


@pytest.mark.parametrize("category", CATEGORIES)
def test_a_scan_lies_on_its_own_model_best_whatever_its_turn(category: str) -> None:
    """The search may lay it on in four ways; the grid has the same points in all of them."""
    own = CATEGORIES.index(category)
    entries = [drawn(other, 0) for other in CATEGORIES]
    near = fits(scanned(category, 0).field, *of_fields(entries), np.arange(len(entries)))
    assert near.shape == (len(entries), 2)
    assert ((near > 0) & (near <= 1)).all()
    assert near[:, 0].argmax() == own
    assert near[own, 0] > 0.5
    turned = [dataclasses.replace(entry, field=turned_field(entry)) for entry in entries]
    assert np.allclose(fits(scanned(category, 0).field, *of_fields(turned), np.arange(len(entries)))[own], near[own], atol=0.05)


def turned_field(entry: IndexEntry) -> object:
    """The field of a model that was turned by a quarter: its grid and its samples are, too."""
    field = entry.field
    values = np.ascontiguousarray(np.rot90(field.values, 1, (0, 1)))
    x, y, z = field.samples.T
    swapped = [1, 0, 2]
    return dataclasses.replace(
        field,
        values=values,
        low=field.low[swapped],
        high=field.high[swapped],
        samples=np.column_stack([-y, x, z]),
        size=field.size[swapped],
    )


def test_distances_of_a_field_are_those_to_the_surface() -> None:
    """At the points of the grid, by a search of its own."""
    field = ENTRIES[0].field
    from tests.tasks.library.entries import points_of

    points, _, _ = points_of("chair", 0)
    low, high = points.min(axis=0), points.max(axis=0)
    points = points - np.array([*(0.5 * (low + high))[:2], low[2]])
    axes = [np.linspace(a, b, len(field.values)) for a, b in zip(field.low, field.high, strict=True)]
    rng = np.random.default_rng(0)
    for i, j, k in rng.integers(0, len(field.values), (50, 3)):
        there = np.array([axes[0][i], axes[1][j], axes[2][k]])
        wanted = min(float(np.linalg.norm(points - there, axis=1).min()), field.reach)
        assert field.values[i, j, k] / 255 * field.reach == pytest.approx(wanted, abs=field.reach / 255)
