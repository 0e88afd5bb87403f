"""Folders of models as libraries: opened whatever lies in them, and found again from partial scans."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flows.run.fingerprints import FileHashes
from flows.run.libraries import folder_hash
from schemas.errors import InputError
from tasks.geometry.meshes import load_glb, sample_surface, surface_of
from tasks.library.catalog import library_files
from tasks.library.categories import category_of
from tasks.library.descriptors import describe
from tasks.library.folder import library_in
from tasks.library.indexing import IndexConfig
from tasks.library.library import OpenLibrary
from tasks.library.search import LibraryQuery
from tests import attacks
from tests.tasks.candidates.crops import crop_of_parts
from tests.tasks.candidates.libraries import write_library


def opened(folder: Path) -> OpenLibrary:
    return library_in(folder, IndexConfig(), {})


def test_a_library_is_opened_whatever_lies_in_it(tmp_path: Path) -> None:
    folder = write_library(tmp_path / "lib", SomeChair_01=("chair", (0.5, 0.5, 0.9)), b=("table", (0.8, 1.2, 0.7)))
    (folder / "broken.glb").write_bytes(b"glTF no more")
    (folder / "LICENSE").write_text("\nCC-BY-4.0\nmore words")
    (tmp_path / "outside.glb").write_bytes((folder / "b.glb").read_bytes())
    (folder / "link.glb").symlink_to(tmp_path / "outside.glb")
    (folder / "more").symlink_to(tmp_path)
    (folder / "gone.glb").symlink_to("nothing.glb")
    (folder / "loop.glb").symlink_to("loop.glb")
    os.mkfifo(folder / "pipe.glb")
    listed = {"file": "b.glb", "category": "dining table", "licence": "MIT-0", "author": "A. Maker", "source": "here"}
    (folder / "index.json").write_text(json.dumps([listed]))
    library = opened(folder)
    assets = {file: library.asset_of(file).asset for file in library.search.files}
    assert {file: (a.category, a.license, a.author, a.source) for file, a in assets.items()} == {
        "SomeChair_01.glb": ("chair", "CC-BY-4.0", None, "SomeChair_01.glb"),
        "b.glb": ("dining table", "MIT-0", "A. Maker", "here"),
    }
    refused = dict(note.split(": ", 1) for note in library.notes)
    assert {name: why for name, why in refused.items() if name != "broken.glb"} == {
        "gone.glb": "is a link that leads nowhere",
        "link.glb": "is a link that leads out of the library",
        "loop.glb": "is a link that leads nowhere",
        "more": "is a link to a folder, which is not followed",
        "pipe.glb": "is no regular file",
    }
    assert "broken.glb" in refused
    assert [path.name for path in library_files(folder)] == ["LICENSE", "SomeChair_01.glb", "b.glb", "broken.glb", "index.json"]
    made = library.asset_of("b.glb")
    low, high = surface_of(load_glb(made.files[made.asset.mesh_blob])).bounds
    assert np.allclose([*(low + high)[:2], low[2]], 0, atol=1e-6)
    assert np.allclose(made.asset.extents, (0.8, 1.2, 0.7), atol=1e-5)
    for broken in ("{", "[" * 900 + "]" * 900, "[" * 100_000, "[{" * 4_000_000):
        (folder / "index.json").write_text(broken)
        assert "index.json is not used" in opened(folder).notes[0]
    with pytest.raises(InputError, match="is no folder"):
        opened(tmp_path / "nowhere")


def test_a_bad_file_of_a_library_is_left_out_and_named_and_the_others_are_used(tmp_path: Path) -> None:
    """Whatever is wrong with one file, every scene goes on with the others."""
    folder = write_library(tmp_path / "lib", chair=("chair", (0.5, 0.5, 0.9)))
    sound = opened(folder).asset_of("chair.glb").asset
    bad = {
        "number": attacks.textured(attacks.png(4), {"pbrMetallicRoughness": {"baseColorTexture": 7}}),
        "text": attacks.textured(attacks.png(4), {"pbrMetallicRoughness": {"baseColorTexture": "wood"}}),
        "factor": attacks.textured(attacks.png(4), {"pbrMetallicRoughness": {"baseColorFactor": 1}}),
        "cut": attacks.textured(attacks.png(300)[:100]),
        "hollow": attacks.without_buffer(),
        "deep": attacks.nested(),
        "json": attacks.deep_json(),
    }
    for name, data in bad.items():
        (folder / f"{name}.glb").write_bytes(data)
    (folder / "endless.glb").symlink_to("/dev/zero")
    with (folder / "large.glb").open("wb") as file:
        file.truncate(2**38)
    (folder / os.fsdecode(b"\xff.glb")).write_bytes((folder / "chair.glb").read_bytes())
    (folder / "index.json").write_text(json.dumps([{"file": "chair.glb", "category": "chair", "author": "A. \ud800"}]))
    library = opened(folder)
    assert library.search.files == ["chair.glb"]
    made = library.asset_of("chair.glb").asset
    assert (made.author, made.extents) == ("A. ?", sound.extents)
    named = sorted(note.split(": ")[0] for note in library.notes)
    assert named == sorted([*(f"{name}.glb" for name in [*bad, "large", "endless"]), "?.glb"])
    assert all(len(note.splitlines()) == 1 and note.isprintable() for note in library.notes)
    before = folder_hash(folder, FileHashes(tmp_path / "hashes.json"))  # a plan is made of it all the same
    (folder / "cut.glb").unlink()
    assert folder_hash(folder, FileHashes(tmp_path / "hashes.json")) != before


@pytest.mark.parametrize("name", ["LICENSE", "LICENSE.txt", "index.json"])
def test_a_librarys_own_files_are_no_links_to_others(tmp_path: Path, name: str) -> None:
    folder = write_library(tmp_path / "lib", chair=("chair", (0.5, 0.5, 0.9)))
    (tmp_path / "secret").write_text("[]\nsecret")
    (folder / name).symlink_to(tmp_path / "secret")
    library = opened(folder)
    assert library.asset_of("chair.glb").asset.license == "unknown"
    (note,) = library.notes
    assert note.startswith(f"{name} is not used")
    assert "a link that leads out of the library" in note


def test_a_process_opens_a_folder_again_when_a_file_of_it_changed(tmp_path: Path) -> None:
    folder = write_library(tmp_path / "lib", chair=("chair", (0.5, 0.5, 0.9)))
    first = opened(folder)
    assert opened(folder) is first
    assert pickle.loads(pickle.dumps(first)) is first, "processes are sent the way to it"
    (folder / "index.json").write_text(json.dumps([{"file": "chair.glb", "category": "stool"}]))
    assert opened(folder).asset_of("chair.glb").asset.category == "stool"
    (folder / "chair.glb").write_bytes((folder / "chair.glb").read_bytes() + b"\0")
    with pytest.raises(InputError, match="is another than when it was indexed"):
        first.asset_of("chair.glb")


@pytest.mark.parametrize(
    ("stem", "category"), [("aws_ChairA_01", "chair"), ("NightStand_02", "nightstand"), ("office-chair-3", "office chair"), ("x", "x")]
)
def test_a_file_name_tells_a_category(stem: str, category: str) -> None:
    assert category_of(stem) == category


@pytest.mark.slow
@pytest.mark.whole
def test_real_assets_are_found_again_from_partial_scans(realdata: Callable[[str], Path]) -> None:
    library = opened(realdata("assets"))
    assert len(library.search.files) == 39
    assert library.notes == ()
    for stem in ("aws_ChairA_01", "aws_ChairD_01", "aws_SofaB_01", "aws_KitchenTable_01", "aws_AirconditionerB_01", "aws_Trash_01"):
        made = library.asset_of(f"{stem}.glb")
        crop = crop_of_parts(load_glb(made.files[made.asset.mesh_blob]), seed=7)
        points, colors, _ = sample_surface(crop, 1500, np.random.default_rng(1))
        descriptor = describe(points, colors, np.ptp(crop.bounds, axis=0), np.random.default_rng(2))
        for category in (made.asset.category, "gizmo"):  # even when the label says nothing
            query = LibraryQuery.of(category, descriptor, points, np.random.default_rng(3))
            assert library.search.find(query, 1)[0].file == f"{stem}.glb"
    textured = library.asset_of("aws_KitchenTable_01.glb")
    parts = load_glb(textured.files[textured.asset.mesh_blob])
    assert any(part.visual.kind == "texture" for part in parts)
    assert textured.asset.license == "MIT-0"
