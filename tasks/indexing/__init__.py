"""Indexing: a folder of models becomes a library of the lake, from which candidates are taken."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

from schemas.indexing import IndexedLibrary, LibraryModel, RefusedModel
from tasks.library.catalog import Catalog
from tasks.library.entry import IndexEntry, dumped
from tasks.library.formats import skipped_note
from tasks.library.indexing import IndexConfig, ModelIndex, Shelf, index_folder
from tasks.library.search import LibrarySearch
from tasks.stage import Context, Outcome, Stage


@dataclasses.dataclass(frozen=True)
class ModelsFolder:
    """A folder that becomes a library. catalog: What is said of its models. shelf: Where files go at once, since those of a large library
    do not fit into memory."""

    folder: Path
    catalog: Catalog
    shelf: Shelf


def run(*, models_folder: ModelsFolder, context: Context, config: IndexConfig) -> Outcome:
    """The models of a folder, and what was refused of it. Files that were indexed before on this machine are remembered by content."""
    catalog, shelf = models_folder.catalog, models_folder.shelf
    notes = (*catalog.notes, *skipped_note(models_folder.folder))
    store, cut = context.caches["tasks.library.indexing"], context.caches["tasks.geometry.pieces"] if config.pieces else None
    index = index_folder(models_folder.folder, catalog, config, store, context.spread, shelf, cut)
    models = [model_row(context.scene_id, entry) for entry in index.entries]
    refused = [_refused_row(context.scene_id, file, reason) for file, reason in index.refused.items()]
    return Outcome(
        libraries=[_library_row(context.scene_id, index, notes, shelf)], library_models=models, refused_models=refused,
        degradations=notes,
    )  # fmt: skip


def model_row(library: str, entry: IndexEntry) -> LibraryModel:
    """The row of an entry, whose files have the names that their contents give them."""
    asset, bare = entry.asset, dataclasses.replace(entry, duplicate_of="", duplicate_by="")
    assert asset.thumbnail_blob is not None
    return LibraryModel(
        library=library, file=entry.file, content=entry.content, format=entry.format, unit_m=entry.unit_m, unit_known=entry.unit_known,
        up=entry.up, up_known=entry.up_known, front=entry.front or None, category=entry.category, category_known=entry.category_known,
        name=entry.name, license=entry.license, is_noncommercial=entry.is_noncommercial, author=entry.author or None,
        source_url=entry.source_url or None, extents=entry.extents, vertex_count=entry.vertex_count, face_count=entry.face_count,
        volume_m3=asset.volume_m3, is_watertight=asset.is_watertight, open_reason=asset.open_reason, has_texture=entry.has_texture,
        duplicate_of=entry.duplicate_of or None, duplicate_by=entry.duplicate_by or None, weights=entry.weights or None, notes=entry.notes,
        asset_id=asset.asset_id, model_blob=asset.mesh_blob, thumbnail_blob=asset.thumbnail_blob,
        entry_blob=f"{_sha256(dumped(bare))}.json",
    )  # fmt: skip


def _library_row(library: str, index: ModelIndex, notes: Sequence[str], shelf: Shelf) -> IndexedLibrary:
    search = LibrarySearch.of(index.entries)
    packed = search.packed()
    taken = [(entry.file, entry.asset, entry.charts) for entry in index.entries]
    assets = [[file, dataclasses.astuple(asset), charts and dataclasses.astuple(charts)] for file, asset, charts in taken]
    content = _sha256(json.dumps([_sha256(packed), assets]).encode())
    weights = {entry.weights for entry in index.entries}
    return IndexedLibrary(
        library=library, content=content, weights=weights.pop() or None if len(weights) == 1 else None, model_count=len(index.entries),
        duplicate_count=sum(bool(entry.duplicate_of) for entry in index.entries), refused_count=len(index.refused),
        search_blob=shelf.put(packed, "index"), notes=tuple(notes),
    )  # fmt: skip


def _refused_row(library: str, file: str, reason: str) -> RefusedModel:
    """The row of a refused file. Reasons are `field: problem; remedy` where its content was looked at."""
    field, sign, problem = reason.partition(": ")
    is_told = bool(sign) and field.isidentifier()
    return RefusedModel(library=library, file=file, field=field if is_told else "file", reason=problem if is_told else reason)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


STAGE = Stage(
    name="indexing",
    reads=(),
    writes=("libraries", "library_models", "refused_models"),
    config=IndexConfig,
    run=run,
    grain="library",
    outside=("models_folder",),
)
