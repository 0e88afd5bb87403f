"""Galleries: which candidate is marked, what is said where something is missing, and the sheets as SVG and PNG."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ET
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from flows.stats import answers_of
from flows.stats.scenes import _chosen, strip_of
from tasks.geometry.meshes import dump_glb
from tasks.stats import contact_sheets, thumbnails
from tasks.stats.thumbnails import CandidateStrip, CandidateTile, SceneTile
from tests.furnished import furnished_lake, solid
from tests.tasks.test_stats_charts import texts
from warehouse.lake import Lake


def row(slot: int, rank: int | None, asset: str | None, placed: str | None) -> dict[str, Any]:
    return {"slot": slot, "rank": rank, "asset_id": asset, "placed_asset_id": placed}


def test_what_was_placed_is_chosen_and_else_what_ranks_first() -> None:
    assert _chosen([row(1, 2, "a", "a"), row(2, 1, "b", "a")]) == 1  # a person chose another than the first
    assert _chosen([row(1, 2, "a", None), row(2, 1, "b", None)]) == 2
    assert _chosen([row(1, 3, "a", "a"), row(2, 1, "b", "a"), row(7, 2, "a", "a")]) == 7  # one asset in two slots: the better fit
    assert _chosen([row(1, None, None, None), row(2, None, "b", None)]) is None
    assert _chosen([row(1, 1, "a", "gone")]) is None  # what stands there is none of the candidates


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return furnished_lake(tmp_path_factory.mktemp("gallery") / "lake", scenes=2, objects=4)


@pytest.mark.whole
def test_the_gallery_has_one_object_of_each_category_with_all_its_candidates(lake: Lake) -> None:
    reader = lake.snapshot()
    rows = answers_of(reader).rows["instances.gallery"].to_pylist()
    candidates = {(r["scene_id"], r["instance_id"], r["slot"]): r for r in reader.arrow("candidates").to_pylist()}
    categories = {r["category"] for r in reader.arrow("instances").to_pylist() if not r["is_structure"]}
    assert {r["category"] for r in rows} == categories
    objects = {(r["scene_id"], r["instance_id"]) for r in rows}
    assert len(objects) == len(categories)
    assert {(r["scene_id"], r["instance_id"], r["slot"]) for r in rows} == {key for key in candidates if key[:2] in objects}
    for found in rows:
        truth = candidates[found["scene_id"], found["instance_id"], found["slot"]]
        assert {name: found[name] for name in ("provider", "is_fallback", "outcome", "asset_id")} == {
            name: truth[name] for name in ("provider", "is_fallback", "outcome", "asset_id")
        }


@pytest.mark.whole
def test_a_candidate_that_cannot_be_read_costs_its_picture_only(lake: Lake) -> None:
    rows = answers_of(lake.snapshot()).rows["instances.gallery"].to_pylist()
    first = [found for found in rows if found["instance_id"] == rows[0]["instance_id"] and found["scene_id"] == rows[0]["scene_id"]]
    strip = strip_of(lake, first)
    assert [tile.slot for tile in strip.tiles] == [1, 2]
    filled, empty = strip.tiles
    assert (filled.is_filled, filled.is_chosen, filled.score, filled.picture is not None) == (True, True, 0.75, True)
    assert (empty.is_filled, empty.is_chosen, empty.is_fallback, empty.picture) == (False, False, True, None)
    bad = lake.blobs.put(b"no GLB", "glb")
    broken = strip_of(lake, [{**first[0], "asset_blob": bad}, first[1]])
    assert broken.tiles[0].picture is None
    assert broken.tiles[0].is_chosen
    assert broken.tiles[0].note
    assert broken.tiles[1] == empty


def test_the_scan_of_an_object_is_its_best_view_else_its_faces(lake: Lake) -> None:
    rows = answers_of(lake.snapshot()).rows["instances.gallery"].to_pylist()[:1]
    assert strip_of(lake, rows).crop is None
    view = io.BytesIO()
    Image.new("RGB", (60, 30), (200, 20, 20)).save(view, "JPEG")
    mesh = lake.blobs.put(dump_glb([solid(1)]), "glb")
    crop = strip_of(lake, [{**rows[0], "view_blob": lake.blobs.put(view.getvalue(), "jpg"), "mesh_blob": mesh}]).crop
    assert crop == thumbnails.fitted(view.getvalue(), (thumbnails.OBJECT_PX, thumbnails.OBJECT_PX))
    faces = strip_of(lake, [{**rows[0], "view_blob": lake.blobs.put(b"no image", "jpg"), "mesh_blob": mesh}]).crop
    assert faces is not None
    assert faces == strip_of(lake, [{**rows[0], "mesh_blob": mesh}]).crop != crop


def photo(size: tuple[int, int], color: tuple[int, int, int]) -> bytes:
    made = io.BytesIO()
    Image.new("RGB", size, color).save(made, "JPEG", quality=95)
    return made.getvalue()


def images_of(svg: str) -> list[bytes]:
    root = ET.fromstring(svg)
    return [base64.b64decode(str(node.get("href")).partition(",")[2]) for node in root.iter("{http://www.w3.org/2000/svg}image")]


@pytest.mark.whole
@given(count=st.integers(1, 9), missing=st.integers(0, 3))
@settings(max_examples=10, deadline=None)
def test_the_sheet_of_scenes_holds_every_scene_once(count: int, missing: int) -> None:
    tiles = [
        SceneTile(f"demo/<{n}>", photo(thumbnails.SCENE_PX, (20 * n, 0, 0)), photo(thumbnails.SCENE_PX, (0, 20 * n, 0)))
        for n in range(count)
    ]
    tiles += [SceneTile(f"demo/gone {n}", None, None, "its mesh cannot be read") for n in range(missing)]
    sheet = contact_sheets.scene_sheet(tiles, 1000)
    assert sheet is not None
    assert images_of(sheet.svg) == [file for tile in tiles for file in (tile.scan, tile.replica) if file is not None]
    labels = texts(sheet.svg)
    assert [label for label in labels if label.startswith("demo/")] == [tile.scene_id for tile in tiles]
    assert sum("cannot be read" in label for label in labels) == missing
    assert any(f"{len(tiles)} of 1000 drawn by chance" in label for label in labels)
    with Image.open(io.BytesIO(sheet.png)) as drawn:
        size = re.search(r'viewBox="0 0 (\d+) (\d+)"', sheet.svg)
        assert size is not None
        assert drawn.size == (int(size[1]), int(size[2]))
    assert sheet == contact_sheets.scene_sheet(tiles, 1000)


def test_the_sheet_of_candidates_marks_what_was_chosen_and_names_fallbacks() -> None:
    edge = (thumbnails.OBJECT_PX, thumbnails.OBJECT_PX)
    tiles = (
        CandidateTile(1, "library", 0.5, False, False, True, "", photo(edge, (90, 90, 90))),
        CandidateTile(2, "procedural", 0.75, True, True, True, "no library given", photo(edge, (30, 30, 90))),
        CandidateTile(3, "text_to_3d", None, False, False, False, "no endpoint", None),
    )
    sheet = contact_sheets.candidate_sheet(
        [CandidateStrip("demo/a", "0003", "mug & <saucer>", photo(edge, (200, 0, 0)), "selection", tiles)]
    )
    assert sheet is not None
    labels = texts(sheet.svg)
    assert "mug & <saucer>  demo/a 0003" in labels
    assert [label for label in labels if "chosen" in label] == ["0.750 chosen"]
    assert labels.count("fallback") == 1
    assert labels.count("empty") == 1
    assert len(images_of(sheet.svg)) == 3
    with Image.open(io.BytesIO(sheet.png)) as drawn:
        green = sum(count for count, color in drawn.getcolors(1 << 24) if color == (0x2F, 0x7D, 0x55))  # type: ignore[union-attr]
    assert green > 4 * 4 * thumbnails.OBJECT_PX  # a frame of four pixels
    assert contact_sheets.candidate_sheet([]) is None
    assert contact_sheets.scene_sheet([], 0) is None
