"""The stage: rows of a library follow from its files, and the files that they name are where they were put."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from schemas.indexing import IndexedLibrary, LibraryModel, RefusedModel
from schemas.record import check
from schemas.tables import TABLES
from tasks.geometry.meshes import load_glb, surface_of
from tasks.indexing import STAGE, ModelsFolder, run
from tasks.library.catalog import Catalog, catalog_of
from tasks.library.entry import loaded
from tasks.library.indexing import IndexConfig
from tasks.library.search import LibrarySearch
from tasks.stage import Context, Outcome
from tests import attacks
from tests.tasks.library.models import as_glb, as_obj, chair


class Files(dict[str, bytes]):
    """A shelf in memory."""

    def refresh(self, name: str) -> bool:
        return name in self

    def put(self, data: bytes, extension: str) -> str:
        name = f"{hashlib.sha256(data).hexdigest()}.{extension}"
        self[name] = data
        return name


def indexed(folder: Path, files: Files, catalog: Catalog | None = None, **context: Any) -> Outcome:
    source = ModelsFolder(folder, catalog if catalog is not None else catalog_of(folder), files)
    return run(models_folder=source, context=Context("models", STAGE.name, 0, {}, **context), config=IndexConfig())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("models")
    (place / "a_chair.glb").write_bytes(as_glb(chair()))
    (place / "b_chair.glb").write_bytes(as_glb(chair()))
    (place / "stool.obj").write_bytes(as_obj(chair(5), 0.01))
    (place / "broken.glb").write_bytes(b"glTF")
    (place / "cut.glb").write_bytes(attacks.textured(attacks.png(300)[:100]))
    (place / "huge.glb").write_bytes(as_glb(chair(), 3000.0))
    (place / "out.glb").symlink_to("/etc/hostname")
    (place / "LICENSE").write_text("CC BY-NC 4.0")
    listed = [{"file": "stool.obj", "category": "stool", "license": "cc0", "author": "A. Maker"}, {"file": "huge.glb", "category": "gizmo"}]
    (place / "index.json").write_text(json.dumps(listed))
    return place


def test_rows_name_files_that_hold_what_they_say(folder: Path) -> None:
    files = Files()
    outcome = indexed(folder, files)
    (library,), models, refused = (outcome.rows[name] for name in STAGE.writes)
    for rows, record in (([library], IndexedLibrary), (models, LibraryModel), (refused, RefusedModel)):
        check(rows, record)
    assert (library.model_count, library.duplicate_count, library.refused_count, library.weights) == (3, 1, 4, None)
    assert [(row.file, row.license, row.is_noncommercial, row.author) for row in models] == [
        ("a_chair.glb", "CC-BY-NC-4.0", True, None),
        ("b_chair.glb", "CC-BY-NC-4.0", True, None),
        ("stool.obj", "CC0-1.0", False, "A. Maker"),
    ]
    assert [(row.duplicate_of, row.duplicate_by) for row in models] == [(None, None), ("a_chair.glb", "bytes"), (None, None)]
    named = {getattr(row, name) for table in STAGE.writes for row in outcome.rows[table] for name in TABLES[table].blob_columns}
    assert named == set(files)
    for row in models:
        entry = loaded(files[row.entry_blob])
        surface = surface_of(load_glb(files[row.model_blob]))
        low, high = surface.bounds
        assert [*(low + high)[:2], low[2]] == pytest.approx([0, 0, 0], abs=1e-6)
        assert tuple(high - low) == pytest.approx(row.extents, abs=1e-6)
        assert (row.asset_id, row.model_blob) == (entry.asset.asset_id, entry.asset.mesh_blob)
        assert row.thumbnail_blob == entry.asset.thumbnail_blob
        assert files[row.thumbnail_blob].startswith(b"\x89PNG"), "the asset's own: candidates name it"
        stated = {field.name: getattr(row, field.name) for field in dataclasses.fields(row) if hasattr(entry, field.name)}
        assert {name: value or "" for name, value in stated.items() if not name.startswith("duplicate")} == {
            name: getattr(entry, name) or "" for name in stated if not name.startswith("duplicate")
        }
    assert LibrarySearch.unpacked(files[library.search_blob]).files == ["a_chair.glb", "stool.obj"]


def test_every_refused_file_says_why(folder: Path) -> None:
    refused = {row.file: (row.field, row.reason) for row in indexed(folder, Files()).rows["refused_models"]}
    assert {file: field for file, (field, _) in refused.items()} == {
        "broken.glb": "content", "cut.glb": "images", "huge.glb": "size", "out.glb": "file",
    }  # fmt: skip
    assert refused["out.glb"][1] == "is a link that leads out of the library"
    assert "which is no object of a room" in refused["huge.glb"][1]
    assert all(file not in reason for file, (_, reason) in refused.items())


def test_the_same_folder_gives_the_same_rows_and_files_however_it_is_spread(folder: Path) -> None:
    def in_threads(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(function, reversed(items)))[::-1]

    one, other = Files(), Files()
    assert indexed(folder, one).rows == indexed(folder, other, spread=in_threads).rows
    assert one == other


def test_content_follows_from_what_retrieval_takes(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(as_glb(chair()))

    def content(**facts: str) -> str:
        (tmp_path / "index.json").write_text(json.dumps([{"file": "a.glb", "category": "chair", **facts}]))
        row: IndexedLibrary = indexed(tmp_path, Files()).rows["libraries"][0]
        return row.content

    before = content()
    assert content() == before
    (tmp_path / "broken.glb").write_bytes(b"glTF")
    assert content() == before, "what is refused is no candidate"
    assert content(license="CC-BY-4.0") != before
    assert content(author="A. Maker") != before
    assert content(category="stool") != before
    (tmp_path / "a.glb").write_bytes(as_glb(chair(4)))
    assert content() != before


def test_what_was_lost_from_the_shelf_is_put_there_again(folder: Path) -> None:
    caches: dict[str, dict[str, bytes]] = {"tasks.library.indexing": {}}
    first, again = Files(), Files()
    rows = indexed(folder, first, caches=caches).rows
    assert indexed(folder, again, caches=caches).rows == rows
    assert again == first
