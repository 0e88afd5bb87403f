"""Retrieval over an index: ten thousand models in a fraction of a second, and then a short list that the scan is laid on.

Category, size, shape and color come first, as histograms, with cosines of vectors where the index has some. Of the best, how well the
scan lies on the model decides with them.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.captions.physics import known_name
from tasks.library.categories import category_similarity
from tasks.library.descriptors import Descriptor, similarity
from tasks.library.entry import IndexEntry
from tasks.library.fields import SurfaceField, field_of, fits
from tasks.settings import Config, Count, NonNegative

Floats = NDArray[np.float32]

SHOWN = 6000
"""Points of a scan that its field is made of: as many as of a model."""

REPAINTED = 0.75
"""Color histograms of one surface that is sampled twice share more than this; in other paint they share a third."""

SHORTEST = 0.01
"""Sides are compared as if none were thinner [m]."""


@dataclasses.dataclass(frozen=True)
class SearchWeights(Config):
    """What counts how much. Scores are divided by the sum of what counts, so that they lie in 0..1 but for cosines below zero."""

    category: NonNegative = 0.45  # a wrong category is the one error that everybody sees
    extents: NonNegative = 0.25  # selection may scale within narrow limits only
    shape: NonNegative = 0.1  # histograms of partial scans are blurred, and laying the scan on says the same more clearly
    color: NonNegative = 0.1  # light changes color, and a material can be exchanged
    near_model: NonNegative = 0.3  # share of scanned points on the model: what tells models of one size apart
    near_scan: NonNegative = 0.2  # share of the model that was seen: never all of it
    short_list: Count = 24  # models that the scan is laid on; twice as many gave the same firsts among 439
    text: NonNegative = 0.5  # cosines of texts and pictures differ by a tenth between right and wrong
    image: NonNegative = 0.5  # those of two pictures by three tenths, but a crop shows its room, too


@dataclasses.dataclass(frozen=True)
class LibraryQuery:
    """What is looked for. category: In anybody's words, '' for unknown. field: Of its points. text: vector of its caption, shape (d,);
    image: of its pictures, shape (m, d)."""

    category: str
    descriptor: Descriptor
    field: SurfaceField
    text: Floats | None = None
    image: Floats | None = None

    @staticmethod
    def of(category: str, descriptor: Descriptor, points: ArrayLike, rng: np.random.Generator) -> LibraryQuery:
        """The query for scanned points, shape (n, 3) [m], +Z up, sides along those of the descriptor's extents."""
        p = np.asarray(points, dtype=np.float64)
        chosen = p[rng.permutation(len(p))[:SHOWN]]
        return LibraryQuery(category, descriptor, field_of(chosen, descriptor.extents))


@dataclasses.dataclass(frozen=True)
class LibraryMatch:
    """A model that was found. score: In 0..1, larger is better. fit: The same without vectors, whose cosines are small even for what goes
    together. near_model: Share of scanned points on it, near_scan: share of it that was seen, both None for what was not on the short
    list."""

    file: str
    score: float
    fit: float
    near_model: float | None
    near_scan: float | None


_HISTOGRAMS = ("distances", "heights", "colors")
_OF_FIELD = ("values", "low", "high", "samples", "size")


class LibrarySearch:
    """Arrays of an index, by the names of files, that are searched. Duplicates are found by the first of their kind alone, but for those
    that are painted otherwise."""

    def __init__(self, arrays: dict[str, NDArray[Any]]) -> None:
        self.arrays = arrays
        self.files: list[str] = [str(name) for name in arrays["files"]]
        self.categories: list[str] = [str(name) for name in arrays["categories"]]
        self._histograms = {name: _Histograms(arrays[name]) for name in _HISTOGRAMS}

    @staticmethod
    def of(entries: Sequence[IndexEntry]) -> LibrarySearch:
        """The search over entries, in whatever order they come. Vectors are used where all entries have them, by one model."""
        kept = _distinct(entries)
        categories, which = np.unique([entry.category for entry in kept] or [""], return_inverse=True)
        arrays: dict[str, NDArray[Any]] = {
            "files": np.array([entry.file for entry in kept], dtype=np.str_),
            "categories": np.array(categories, dtype=np.str_),
            "category": which[: len(kept)].astype(np.int32),
            "sides": np.array([entry.extents for entry in kept], dtype=np.float32).reshape(-1, 3),
        }
        for name in _HISTOGRAMS:
            rows = [_compared(name, entry.descriptor) for entry in kept]
            arrays[name] = np.ascontiguousarray(np.array(rows, dtype=np.float32).reshape(len(kept), -1 if kept else 0).T)
        for name in _OF_FIELD:
            arrays[f"field_{name}"] = np.array([getattr(entry.field, name) for entry in kept])
        models = {entry.weights for entry in kept}
        views = [entry.image_vectors for entry in kept if entry.image_vectors is not None]
        if len(models) == 1 and models != {""} and len(views) == len(kept) and len({view.shape for view in views}) == 1:
            arrays["views"] = np.array(views, dtype=np.float32)
        return LibrarySearch(arrays)

    def packed(self) -> bytes:
        """The arrays as bytes, to be mapped into memory or kept; the same for the same entries."""
        buffer = io.BytesIO()
        for name in sorted(self.arrays):
            array = np.ascontiguousarray(self.arrays[name])
            head = f"{name} {array.dtype.str} {','.join(map(str, array.shape))}\n".encode()
            buffer.write(head)
            buffer.write(bytes(-buffer.tell() % _ALIGNED))
            buffer.write(array.tobytes())
        return buffer.getvalue()

    @staticmethod
    def unpacked(data: bytes | memoryview) -> LibrarySearch:
        """The search whose arrays lie in bytes of `packed`, or in a file that is mapped into memory; nothing is copied.

        Raises:
            ValueError: they are none.
        """
        view, at, arrays = memoryview(data), 0, {}
        while at < len(view):
            head = bytes(view[at : at + 200]).partition(b"\n")[0]
            try:
                name, kind, sides = head.decode().split(" ")
                shape = tuple(int(side) for side in sides.split(","))
                dtype = np.dtype(kind)
            except (ValueError, TypeError) as error:
                raise ValueError(f"no arrays of a library at byte {at}") from error
            at += len(head) + 1
            at += -at % _ALIGNED
            count = int(np.prod(shape))
            arrays[name] = np.frombuffer(view, dtype=dtype, count=count, offset=at).reshape(shape) if count else np.zeros(shape, dtype)
            at += count * dtype.itemsize
        return LibrarySearch(arrays)

    def find(self, query: LibraryQuery, count: int, weights: SearchWeights | None = None) -> list[LibraryMatch]:
        """The `count` models that fit best, best first; equal ones by the names of their files."""
        if not self.files:
            return []
        w = weights or SearchWeights()
        fit, of_fit = self._fits(query, w)
        alike, of_vectors = self._cosines(query, w)
        scores = fit + alike
        order = np.argsort(-scores, kind="stable")
        chosen = np.sort(order[: w.short_list]).astype(np.int64)
        values, low, high, samples, sizes = (self.arrays[f"field_{name}"] for name in _OF_FIELD)
        near = fits(query.field, values, low, high, samples, sizes, chosen)
        fit[chosen] += w.near_model * near[:, 0] + w.near_scan * near[:, 1]
        total = of_fit + w.near_model + w.near_scan
        scores = np.round((fit + alike) / max(total + of_vectors, 1e-9), 7)
        fit = np.round(fit / max(total, 1e-9), 7)
        known = dict(zip(chosen.tolist(), near.tolist(), strict=True))
        ranked = np.argsort(-scores, kind="stable")[:count]
        return [LibraryMatch(self.files[row], float(scores[row]), float(fit[row]), *known.get(int(row), (None, None))) for row in ranked]

    def names(self, category: str) -> bool:
        """Whether a category says something: the project knows it, or it has a word in common with one of the models'."""
        return known_name(category) is not None or any(category_similarity(category, other) > 0.0 for other in self.categories)

    def _fits(self, query: LibraryQuery, w: SearchWeights) -> tuple[NDArray[np.float64], float]:
        """Weighted sums of what is compared without laying the scan on models, and the sum of the weights."""
        d = query.descriptor
        of = {name: self._histograms[name].similarities(_compared(name, d)) for name in _HISTOGRAMS}
        scores = w.extents * self._extents_similarities(d.extents)
        scores = scores + w.shape * 0.5 * (of["distances"] + of["heights"]) + w.color * of["colors"]
        total = w.extents + w.shape + w.color
        if self.names(query.category):  # else nobody knows what it is, and nothing is said against any
            alike = np.array([category_similarity(query.category, category) for category in self.categories])
            scores, total = scores + w.category * alike[self.arrays["category"]], total + w.category
        return scores.astype(np.float64), total

    def _cosines(self, query: LibraryQuery, w: SearchWeights) -> tuple[NDArray[np.float64], float]:
        """The same of vectors: 0 where the index or the query has none."""
        scores, total = np.zeros(len(self.files)), 0.0
        views = self.arrays.get("views")
        if views is not None and query.text is not None:
            scores, total = scores + w.text * (self._means @ query.text), total + w.text
        if views is not None and query.image is not None:
            flat = views.reshape(-1, views.shape[2]) @ np.atleast_2d(query.image).T
            scores, total = scores + w.image * flat.reshape(len(views), -1).max(axis=1), total + w.image
        return scores.astype(np.float64), total

    def _extents_similarities(self, extents: ArrayLike) -> Floats:
        """exp(-sum of |log ratio|) over the axes, the better of both ways to lay the horizontal ones, shape (n,)."""
        mine = np.log(np.maximum(np.asarray(extents, dtype=np.float32), SHORTEST))
        theirs = np.log(np.maximum(self.arrays["sides"], SHORTEST))
        ways = [np.abs(theirs - mine[order]).sum(axis=1) for order in ([0, 1, 2], [1, 0, 2])]
        return np.asarray(np.exp(-np.minimum(*ways)), dtype=np.float32)

    @cached_property
    def _means(self) -> Floats:
        """Mean vectors of models' pictures, of length 1, shape (n, d)."""
        means = self.arrays["views"].mean(axis=1)
        return np.asarray(means / np.maximum(np.linalg.norm(means, axis=1, keepdims=True), 1e-9), dtype=np.float32)


def softened(colors: ArrayLike) -> NDArray[np.float64]:
    """A histogram over CIELAB, shape (245,), in which neighboring bins share what they hold: twice in lightness, once in hue.

    Light and shade move colors by a bin, and one material seldom fills more than two.
    """
    values = np.asarray(colors, dtype=np.float64).reshape(5, 7, 7)
    for axis in (0, 0, 1, 2):
        padded = np.pad(values, [(1, 1) if k == axis else (0, 0) for k in range(3)], mode="edge")
        below, here, above = (np.take(padded, np.arange(values.shape[axis]) + k, axis=axis) for k in range(3))
        values = 0.25 * below + 0.5 * here + 0.25 * above
    return np.asarray(values.ravel() / max(float(values.sum()), 1e-12))


def _compared(name: str, descriptor: Descriptor) -> NDArray[np.float64]:
    """A histogram as it is compared."""
    values: NDArray[np.float64] = getattr(descriptor, name)
    return softened(values) if name == "colors" else values


def _distinct(entries: Sequence[IndexEntry]) -> list[IndexEntry]:
    """Entries by their files' names, without those that are and look like another."""
    by_file = {entry.file: entry for entry in entries}

    def is_kept(entry: IndexEntry) -> bool:
        first = by_file.get(entry.duplicate_of)
        if first is None:
            return True
        return entry.duplicate_by == "geometry" and similarity(first.descriptor.colors, entry.descriptor.colors) < REPAINTED

    return sorted(filter(is_kept, entries), key=lambda entry: entry.file)


_ALIGNED = 64
"""Arrays begin at multiples of this [B], as processors like it."""


class _Histograms:
    """Histograms that sum to one, a column each, shape (bins, n), and their entropies bin by bin."""

    def __init__(self, values: Floats) -> None:
        self._values = values
        self._entropies = _entropies(values)
        self._entropy = self._entropies.sum(axis=0)

    def similarities(self, query: ArrayLike) -> Floats:
        """1 - Jensen-Shannon distance (base 2) to a histogram, shape (n,).

        Bins that the query lacks are not looked at: there half of the other is left, whose entropy is known.
        """
        q = np.asarray(query, dtype=np.float32)
        bins = np.flatnonzero(q > 0)
        mine, values = q[bins, None], self._values[bins]
        middle = _entropies(0.5 * (mine + values)).sum(axis=0)
        rest = 0.5 * (self._entropy - self._entropies[bins].sum(axis=0) + 1.0 - values.sum(axis=0))
        divergence = middle + rest - 0.5 * (self._entropy + _entropies(mine).sum())
        return np.asarray(1.0 - np.sqrt(np.clip(divergence, 0.0, 1.0)), dtype=np.float32)


def _entropies(shares: Floats) -> Floats:
    """-p log2 p of every share, 0 for none."""
    return -shares * np.log2(np.where(shares > 0, shares, 1.0))
