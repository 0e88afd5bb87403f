"""Entries of an index without files: drawn models, described."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.furniture import generate
from tasks.geometry.meshes import sample_surface, surface_of
from tasks.library.descriptors import describe
from tasks.library.duplicates import signature_of
from tasks.library.entry import IndexEntry
from tasks.library.fields import field_of
from tasks.library.search import LibraryQuery
from tests.samples import sample

CATEGORIES = ("chair", "table", "sofa", "bed", "vase", "mug", "bookshelf", "desk lamp")
LISTED = ("couch", "chair", "garden chair", "gizmo", "", "dining table", "nightstand")


def points_of(category: str, seed: int, count: int = 1500) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float64]]:
    """Surface points [m], colors and normals of a drawn model."""
    surface = surface_of(generate(category, None, np.random.default_rng(seed)).parts)
    return sample_surface(surface, count, np.random.default_rng(seed))


def drawn(category: str, seed: int, file: str = "", **changes: object) -> IndexEntry:
    """The entry of a drawn model."""
    points, colors, _ = points_of(category, seed)
    x, y, z = np.ptp(points, axis=0).tolist()
    entry = IndexEntry(
        file=file or f"{category}_{seed}.glb", content=f"{category} {seed}", format="glb", unit_m=1.0, unit_known="file", up="y",
        up_known="file", front="", front_known="assumed", category=category, category_known="index", name=category, license="CC0-1.0",
        is_noncommercial=False, author="", source_url="", extents=(x, y, z), vertex_count=8, face_count=12,
        has_texture=False, descriptor=describe(points, colors, (x, y, z), np.random.default_rng(seed)), field=field_of(points),
        signature=signature_of(points), image_vectors=None, text_vector=None, weights="",
        asset=sample(Asset, asset_id=hashlib.sha256(f"{category} {seed}".encode()).hexdigest(), pieces_blob=None, extents=(x, y, z)),
        charts=None,
        notes=("odd",),
    )  # fmt: skip
    return dataclasses.replace(entry, **changes)  # type: ignore[arg-type]


def scanned(category: str, seed: int, name: str | None = None) -> LibraryQuery:
    """A query for a drawn model seen from three sides, with noise."""
    rng = np.random.default_rng([seed, 7])
    points, colors, normals = points_of(category, seed, 4000)
    seen = (normals[:, 0] > -0.3) & (normals[:, 2] > -0.5)
    kept = points[seen] + rng.normal(0.0, 0.003, (int(seen.sum()), 3))
    descriptor = describe(kept, colors[seen], np.ptp(kept, axis=0), rng)
    return LibraryQuery.of(category if name is None else name, descriptor, kept, rng)
