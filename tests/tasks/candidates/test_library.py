"""Libraries of models: indexed whatever lies in them, and found again from partial scans."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flows.run.fingerprints import FileHashes
from flows.run.plan import _library_hash
from schemas.errors import InputError
from tasks.candidates.descriptors import describe, extents_similarity, shape_similarity, similarity
from tasks.candidates.library import category_of, index_library, library_asset, library_files
from tasks.candidates.retrieval import retrieve
from tasks.geometry.meshes import load_glb, sample_surface, surface_of
from tests import attacks
from tests.tasks.candidates.crops import (
    crop_of_parts,
)
from tests.tasks.candidates.libraries import write_library


def test_a_library_is_indexed_whatever_lies_in_it(tmp_path: Path) -> None:
    folder = write_library(tmp_path / "lib", SomeChair_01=("chair", (0.5, 0.5, 0.9)), b=("table", (0.8, 1.2, 0.7)))
    (folder / "broken.glb").write_bytes(b"glTF no more")
    (folder / "LICENSE").write_text("\nCC-BY-4.0\nmore words")
    (tmp_path / "outside.glb").write_bytes((folder / "b.glb").read_bytes())
    (folder / "link.glb").symlink_to(tmp_path / "outside.glb")
    (folder / "more").symlink_to(tmp_path)
    (folder / "gone.glb").symlink_to("nothing.glb")
    (folder / "loop.glb").symlink_to("loop.glb")
    os.mkfifo(folder / "pipe.glb")
    listed = {"file": "b.glb", "category": "dining table", "licence": "MIT-0", "author": "A. Maker"}
    (folder / "index.json").write_text(json.dumps([listed]))
    index = index_library(folder)
    assert [(e.file, e.category, e.license, e.author) for e in index.entries] == [
        ("SomeChair_01.glb", "chair", "CC-BY-4.0", None),
        ("b.glb", "dining table", "MIT-0", "A. Maker"),
    ]
    assert len(index.problems) == 6
    assert "broken.glb left out" in index.problems[-1]
    assert index.problems[:-1] == tuple(f"library: {name} left out: {why}" for name, why in [
        ("gone.glb", "a link that leads nowhere"),
        ("link.glb", "a link that leads out of the library"),
        ("loop.glb", "a link that leads nowhere"),
        ("more", "a link that leads out of the library"),
        ("pipe.glb", "no regular file"),
    ])  # fmt: skip
    assert [path.name for path in library_files(folder)] == ["LICENSE", "SomeChair_01.glb", "b.glb", "broken.glb", "index.json"]
    made = library_asset(index.entries[1])
    low, high = surface_of(load_glb(made.files[made.asset.mesh_blob])).bounds
    assert np.allclose([*(low + high)[:2], low[2]], 0, atol=1e-6)
    assert np.allclose(made.asset.extents, (0.8, 1.2, 0.7), atol=1e-5)
    for broken in ("{", "[" * 900 + "]" * 900, "[" * 100_000, "[{" * 4_000_000):
        (folder / "index.json").write_text(broken)
        assert "index.json not used" in index_library(folder).problems[0]
    with pytest.raises(InputError, match="is no folder"):
        index_library(tmp_path / "nowhere")


def test_a_bad_file_of_a_library_is_left_out_and_named_and_the_others_are_used(tmp_path: Path) -> None:
    """Whatever is wrong with one file, every scene goes on with the others."""
    folder = write_library(tmp_path / "lib", chair=("chair", (0.5, 0.5, 0.9)))
    sound = index_library(folder).entries
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
    index = index_library(folder)
    assert [(entry.file, entry.author) for entry in index.entries] == [("chair.glb", "A. ?")]
    assert np.array_equal(index.entries[0].descriptor.extents, sound[0].descriptor.extents)
    named = [problem.split()[1] for problem in index.problems]
    assert named == ["endless.glb", *sorted(f"{name}.glb" for name in [*bad, "large"]), "?.glb"]
    assert all(len(problem.splitlines()) == 1 and problem.isprintable() for problem in index.problems)
    made = _library_hash(folder, FileHashes(tmp_path / "hashes.json"))  # a plan is made of it all the same
    (folder / "cut.glb").unlink()
    assert _library_hash(folder, FileHashes(tmp_path / "hashes.json")) != made


@pytest.mark.parametrize("name", ["LICENSE", "LICENSE.txt", "index.json"])
def test_a_librarys_own_files_are_no_links_to_others(tmp_path: Path, name: str) -> None:
    folder = write_library(tmp_path / "lib", chair=("chair", (0.5, 0.5, 0.9)))
    (tmp_path / "secret").write_text("[]\nsecret")
    (folder / name).symlink_to(tmp_path / "secret")
    index = index_library(folder)
    assert [entry.license for entry in index.entries] == ["unknown"]
    assert index.problems == (f"library: {name} left out: a link that leads out of the library",)


@pytest.mark.parametrize(
    ("stem", "category"), [("aws_ChairA_01", "chair"), ("NightStand_02", "nightstand"), ("office-chair-3", "office chair"), ("x", "x")]
)
def test_a_file_name_tells_a_category(stem: str, category: str) -> None:
    assert category_of(stem) == category


@pytest.mark.whole
def test_real_assets_are_found_again_from_partial_scans(realdata: Callable[[str], Path]) -> None:
    folder = realdata("assets")
    index = index_library(folder)
    assert len(index.entries) == 39
    assert [line.split()[1] for line in index.problems] == ["aws_Dumbbell_01.glb", "aws_SeasoningBox_01.glb"]
    assert all(line.endswith("used as it is") for line in index.problems)
    assert all(entry.scale == 1.0 for entry in index.entries)
    by_stem = {entry.path.stem: entry for entry in index.entries}
    for stem in ("aws_ChairA_01", "aws_ChairD_01", "aws_SofaB_01", "aws_KitchenTable_01", "aws_AirconditionerB_01", "aws_Trash_01"):
        entry = by_stem[stem]
        crop = crop_of_parts(load_glb(entry.path.read_bytes()), seed=7)
        points, colors, _ = sample_surface(crop, 1500, np.random.default_rng(1))
        descriptor = describe(points, colors, np.ptp(crop.bounds, axis=0), np.random.default_rng(2))
        best = retrieve(entry.category, descriptor, index.entries, 4)
        assert best[0][1].file == entry.file
        # Even when the label says nothing, shape, size and color bring it among the first.
        blind = sorted(index.entries, key=lambda e, d=descriptor: -(0.25 * extents_similarity(d.extents, e.descriptor.extents)
                       + 0.2 * shape_similarity(d, e.descriptor) + 0.1 * similarity(d.colors, e.descriptor.colors)))  # fmt: skip
        assert entry in blind[:3]
    textured = library_asset(by_stem["aws_KitchenTable_01"])
    parts = load_glb(textured.files[textured.asset.mesh_blob])
    assert any(part.visual.kind == "texture" for part in parts)
    assert textured.asset.license.startswith("MIT-0")
