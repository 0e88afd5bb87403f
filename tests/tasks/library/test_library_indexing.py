"""Indexing: every entry follows from a file and its facts, and one that was killed goes on with what is missing."""

from __future__ import annotations

import json
from collections import UserDict
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import trimesh

from schemas.errors import InputError
from tasks.furniture import generate
from tasks.geometry.meshes import Surface, dump_glb, surface_of
from tasks.geometry.pieces import PieceConfig, asset_pieces
from tasks.geometry.transforms import yaw_pose
from tasks.library import indexing
from tasks.library.catalog import Catalog, catalog_of
from tasks.library.entry import dumped
from tasks.library.indexing import IndexConfig, ModelIndex, entry_parts, index_folder, refused_first
from tasks.library.metadata import ModelFacts
from tests import attacks
from tests.tasks.library.models import as_glb, as_obj, chair, farthest


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library of chairs that are the same, others, and what is broken."""
    place = tmp_path_factory.mktemp("library")
    parts = chair()
    (place / "b_chair.glb").write_bytes(as_glb(parts))
    (place / "a_chair.glb").write_bytes(as_glb(parts))
    turned = [part.copy().apply_transform(yaw_pose(0.7, (2.0, 1.0, 0.0))) for part in parts]
    (place / "c_chair.obj").write_bytes(as_obj(turned, 0.01))
    (place / "other_chair.glb").write_bytes(as_glb(chair(5)))
    (place / "TableLamp_02.glb").write_bytes(dump_glb(generate("table lamp", None, np.random.default_rng(0)).parts))
    (place / "broken.glb").write_bytes(b"glTF")
    (place / "cut.glb").write_bytes(attacks.textured(attacks.png(300)[:100]))
    (place / "huge.glb").write_bytes(dump_glb([part.copy().apply_scale(300.0) for part in parts]))
    return place


CATALOG = {
    "other_chair.glb": ModelFacts("Windsor", "Chair", "index", author="A. Maker", source_url="here"),
    "huge": ModelFacts(category="gizmo"),
}


@pytest.fixture(scope="module")
def index(folder: Path) -> ModelIndex:
    return index_folder(folder, Catalog(CATALOG), IndexConfig(), {})


def bytes_of(index: ModelIndex) -> list[bytes]:
    return [dumped(entry) for entry in index.entries]


def test_what_a_library_holds(folder: Path, index: ModelIndex) -> None:
    entries = {entry.file: entry for entry in index.entries}
    assert list(entries) == ["TableLamp_02.glb", "a_chair.glb", "b_chair.glb", "c_chair.obj", "other_chair.glb"]
    assert {file: (entry.duplicate_of, entry.duplicate_by) for file, entry in entries.items() if entry.duplicate_of} == {
        "b_chair.glb": ("a_chair.glb", "bytes"),
        "c_chair.obj": ("a_chair.glb", "geometry"),
    }
    assert list(index.refused) == ["broken.glb", "cut.glb", "huge.glb"]
    assert "no object of a room" in index.refused["huge.glb"]
    assert all(line.isprintable() for line in refused_first(index))
    a, c, other, lamp = (entries[name] for name in ("a_chair.glb", "c_chair.obj", "other_chair.glb", "TableLamp_02.glb"))
    assert (lamp.category, lamp.category_known) == ("table lamp", "file name")
    assert (other.category, other.category_known, other.name, other.author) == ("chair", "index", "Windsor", "A. Maker")
    assert np.allclose(a.extents, (0.5, 0.55, 0.95), atol=1e-5)
    assert (c.unit_m, c.unit_known, c.up, c.up_known) == (0.01, "plausibility", "y", "assumed"), "turned, it is as broad as it is high"
    assert a.face_count == c.face_count == sum(len(part.faces) for part in chair())
    assert a.asset.is_watertight
    assert farthest(entry_parts(a, folder, ModelFacts()), chair()) < 1e-5
    for entry in entries.values():
        assert entry.image_vectors is entry.text_vector is None


def test_an_entry_is_the_same_wherever_and_whenever_it_is_made(folder: Path, index: ModelIndex) -> None:
    def in_threads(work: Callable[[Path], object], files: Iterable[Path]) -> list[object]:
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(work, reversed(list(files))))[::-1]

    assert bytes_of(index_folder(folder, Catalog(CATALOG), IndexConfig(), {}, in_threads)) == bytes_of(index)  # type: ignore[arg-type]


class Mortal(UserDict[str, bytes]):
    """A store whose process is killed before it has put as many values as it was given lives."""

    def __init__(self, lives: int, kept: dict[str, bytes]) -> None:
        self.lives = len(kept) + lives
        super().__init__(kept)

    def __setitem__(self, key: str, value: bytes) -> None:
        if self.lives <= 0:
            raise KeyboardInterrupt
        self.lives -= 1
        super().__setitem__(key, value)


def test_a_killed_indexing_goes_on_with_what_is_missing(folder: Path, index: ModelIndex, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: dict[str, bytes] = {}
    deaths = 0
    while True:
        store = Mortal(2, kept)
        try:
            done = index_folder(folder, Catalog(CATALOG), IndexConfig(), store)
            break
        except KeyboardInterrupt:
            assert len(store) > len(kept)
            kept, deaths = dict(store.data), deaths + 1
    assert deaths == 3
    assert bytes_of(done) == bytes_of(index)
    assert done.refused == index.refused

    def never(*_: object) -> None:
        raise AssertionError("made again")

    monkeypatch.setattr(indexing, "index_file", never)
    assert bytes_of(index_folder(folder, Catalog(CATALOG), IndexConfig(), dict(store.data))) == bytes_of(index)


def test_only_what_changed_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    index_file = indexing.index_file
    monkeypatch.setattr(indexing, "index_file", lambda path, *rest: made.append(path.name) or index_file(path, *rest))
    store: dict[str, bytes] = {}

    def index_now(facts: dict[str, ModelFacts], config: IndexConfig | None = None) -> list[str]:
        made.clear()
        index_folder(tmp_path, Catalog(facts), config or IndexConfig(), store)
        return list(made)

    (tmp_path / "a.glb").write_bytes(as_glb(chair()))
    (tmp_path / "b.glb").write_bytes(as_glb(chair(1)))
    assert index_now({}) == ["a.glb", "b.glb"]
    assert index_now({}) == []
    (tmp_path / "b.glb").write_bytes(as_glb(chair(2)))
    assert index_now({}) == ["b.glb"]
    assert index_now({"a.glb": ModelFacts(category="stool")}) == ["a.glb"]
    assert index_now({}, IndexConfig(views=3)) == ["a.glb", "b.glb"]
    assert index_now({}, IndexConfig(views=3, pieces=True)) == [], "pieces are no part of an entry"
    assert index_now({}, IndexConfig(version="next")) == ["a.glb", "b.glb"]
    store = dict.fromkeys(store, b"damaged")
    assert index_now({}) == ["a.glb", "b.glb"]


def test_a_file_that_changed_since_is_not_taken_for_its_entry(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(as_glb(chair()))
    (entry,) = index_folder(tmp_path, Catalog({}), IndexConfig(), {}).entries
    (tmp_path / "a.glb").write_bytes(as_glb(chair(1)))
    with pytest.raises(InputError, match="is another than when it was indexed"):
        entry_parts(entry, tmp_path, ModelFacts())


@pytest.mark.parametrize(
    ("part", "reason"),
    [("whole", None), ("listed twice", None), ("hole", "3 edges of one face"), ("fin", "2 edges of one face, 1 of more than two")],
)
def test_why_a_model_is_open(tmp_path: Path, part: str, reason: str | None) -> None:
    surface = surface_of([trimesh.creation.box((0.4, 0.5, 0.9))])
    faces = {
        "whole": surface.faces,
        "listed twice": np.concatenate([surface.faces, surface.faces[:1, ::-1]]),
        "hole": surface.faces[1:],
        "fin": np.concatenate([surface.faces, [[*surface.faces[0, :2], 8]]]),
    }[part]
    vertices, colors = np.vstack([surface.vertices, np.zeros(3)]), np.vstack([surface.colors, surface.colors[:1]])
    surface = Surface(vertices, faces, colors)
    (tmp_path / "chair.glb").write_bytes(as_glb([surface.to_trimesh()]))
    (entry,) = index_folder(tmp_path, Catalog({}), IndexConfig(), {}).entries
    assert (entry.asset.is_watertight, entry.asset.open_reason) == (reason is None, reason)


@pytest.mark.whole
def test_pieces_that_are_cut_while_indexing_are_those_that_scenes_ask_for(tmp_path: Path) -> None:
    """Stages find them where they remember pieces, by the asset; a second indexing cuts nothing."""
    (tmp_path / "chair.glb").write_bytes(as_glb(chair()))
    store: dict[str, bytes] = {}
    cut: dict[str, bytes] = {}
    (entry,) = index_folder(tmp_path, Catalog({}), IndexConfig(), store, cut=cut).entries
    assert len(cut) == 1
    before = dict(cut)
    made = asset_pieces(entry.asset.asset_id, lambda: pytest.fail("cut again"), None, PieceConfig(), cut)
    assert made.hulls
    assert index_folder(tmp_path, Catalog({}), IndexConfig(), store, cut=cut).entries[0].asset == entry.asset
    assert cut == before


def test_weights_that_are_not_there_are_refused_at_once(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no"):
        index_folder(folder, Catalog({}), IndexConfig(weights=str(tmp_path)), {})


@pytest.mark.slow
@pytest.mark.whole
def test_real_models_are_indexed(realdata: Callable[[str], Path]) -> None:
    place = realdata("assets")
    rows = json.loads((place / "index.json").read_bytes())
    index = index_folder(place, catalog_of(place), IndexConfig(), {})
    assert [entry.file for entry in index.entries] == sorted(row["file"] for row in rows)
    assert not index.refused
    by_file = {row["file"]: row for row in rows}
    for entry in index.entries:
        x, y, z = by_file[entry.file]["extents_m"]  # +Y up
        assert np.allclose(entry.extents, (x, z, y), atol=2e-3), entry.file
        assert entry.license == "MIT-0"
        assert entry.face_count == by_file[entry.file]["faces"]
        assert not entry.duplicate_of
