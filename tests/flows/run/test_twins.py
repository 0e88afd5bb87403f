"""Textured twins on the whole path: frames of a scan on an asset, chosen, placed, and seen in what is exported."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.candidates import Asset, Candidate, TextureCharts
from schemas.optimization import Placement
from schemas.selection import Selection
from tasks.geometry.encoded_images import encoded_file
from tasks.geometry.meshes import load_glb, material_of
from tests.capture_scans import OBJECTS, box_room, write_scannet
from tests.tasks.texturing.painting import paint
from tests.test_pipeline import QUICK, home, metascenes, stale
from warehouse.lake import Lake

__all__ = ["home"]

pytestmark = pytest.mark.whole

SCENE = "scannet/scene0007_00"
SLOTS = (
    'candidates.slots=[{provider={kind="textured", of=2, painter={kind="frames", twin={bake={max_px=256}}}}},'
    ' {provider="procedural"}, {provider={kind="textured", of=2, painter={kind="frames", unwrapper="smart_uv"}}}]'
)
"""A twin, its sibling, and a twin that nobody lays out, since no Blender is named."""
SET = [*QUICK, "--set", SLOTS, "--set", "selection.provider=color_histogram", "--set", 'exports.formats=["glb", "usd"]']


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scans")
    room = box_room(OBJECTS[:2])
    painted = dataclasses.replace(room.surface, colors=paint(room.surface.vertices).round().astype(np.uint8))
    write_scannet(folder / "scene0007_00", dataclasses.replace(room, surface=painted))
    return folder


@pytest.fixture(scope="module")
def lake(home: dict[str, str], scans: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lake") / "lake"
    done = metascenes(home, "run", "--scans", scans, "--lake", folder, *SET)
    assert done.returncode == 0, done.stderr + done.stdout
    return folder


def placed_twins(lake: Path) -> dict[str, Asset]:
    """Assets that stand in the scene and are twins, by instance."""
    reader = Lake.open(lake).snapshot()
    assets = {row.asset_id: row for row in reader.rows(Asset)}
    placed = {row.instance_id: assets[row.asset_id] for row in reader.rows(Placement, SCENE)}
    return {instance: asset for instance, asset in placed.items() if asset.provider.endswith(" textured")}


@pytest.mark.slow
def test_twins_are_made_ranked_and_placed(lake: Path) -> None:
    found = Lake.open(lake)
    reader = found.snapshot()
    rows = {(row.instance_id, row.slot): row for row in reader.rows(Candidate, SCENE)}
    twins = [row for (_, slot), row in rows.items() if slot == 1 and row.outcome == "filled"]
    assert len(twins) == 2
    assert all("is no program that can be run" in str(row.reason) for (_, slot), row in rows.items() if slot == 3)
    charts = {row.asset_id: row for row in reader.rows_by_key(TextureCharts, sorted(str(row.asset_id) for row in twins))}
    ranks = {(row.instance_id, row.slot): row.rank for row in reader.rows(Selection, SCENE)}
    for row in twins:
        sibling = rows[row.instance_id, 2]
        assert (row.twin_of, charts[str(row.asset_id)].of_asset_id) == (2, sibling.asset_id)
        assert {ranks[row.instance_id, 1], ranks[row.instance_id, 2]} == {1, 2}
    with reader.connect() as connection:
        (answer,) = connection.execute("SELECT * FROM twin_wins WHERE painter = 'textured:xatlas'").fetchall()
        names = [column[0] for column in connection.description or ()]
        won = dict(zip(names, answer, strict=True))
        layouts = connection.execute("SELECT method, assets FROM texture_layouts").fetchall()
    first = sum(ranks[row.instance_id, 1] == 1 for row in twins)
    assert (won["twins"], won["painted"], won["compared"], won["above"], won["chosen"]) == (2, 2, 2, first, first)
    assert layouts == [("xatlas", 2)]
    assert first == len(placed_twins(lake)) >= 1, "by colors, what was painted with the frames"


def textures_of_usd(path: Path) -> dict[str, set[bytes]]:
    """Pictures that the objects of a stage show, by the asset that they are of."""
    from pxr import Usd, UsdShade

    stage = Usd.Stage.Open(str(path))
    found: dict[str, set[bytes]] = {}
    for prim in stage.TraverseAll():
        about = prim.GetCustomDataByKey("metascenes") or {}
        if "asset_id" not in about:
            continue
        for below in Usd.PrimRange(prim, Usd.TraverseInstanceProxies()):
            material, _ = UsdShade.MaterialBindingAPI(below).ComputeBoundMaterial()
            for shader in Usd.PrimRange(material.GetPrim()) if material else ():
                file = UsdShade.Shader(shader).GetInput("file")
                value = file.Get() if file else None
                if value is not None:
                    found.setdefault(about["asset_id"], set()).add(Path(value.resolvedPath).read_bytes())
    return found


def test_the_painted_texture_is_in_what_is_exported(home: dict[str, str], lake: Path, tmp_path: Path) -> None:
    done = metascenes(home, "export", "--lake", lake, "--out", tmp_path / "out", "--format", "glb", "--format", "usd")
    assert done.returncode == 0, done.stderr + done.stdout
    blobs, twins = Lake.open(lake).blobs, placed_twins(lake)
    skins: dict[str, bytes] = {}
    for asset in twins.values():
        (part,) = load_glb(blobs[asset.mesh_blob])
        file = encoded_file(part)
        image, _ = material_of(part)
        assert file is not None
        assert image is not None
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20, "a picture, no one color"
        skins[asset.asset_id] = file[0]
    (scene,) = (tmp_path / "out" / "glb").glob("*.glb")
    shown: dict[str, Any] = {}
    document = json.loads(scene.read_bytes()[20 : 20 + int.from_bytes(scene.read_bytes()[12:16], "little")])
    about = {node["name"]: node["extras"]["asset_id"] for node in document["nodes"] if "asset_id" in node.get("extras", {})}
    for part in load_glb(scene.read_bytes()):
        owner = next((asset for name, asset in about.items() if str(part.metadata["name"]).startswith(name)), None)
        file = encoded_file(part)
        if owner in skins and file is not None:
            shown[owner] = file[0]
    assert shown == skins, "to the byte: no second loss of a JPEG"
    (stage,) = (tmp_path / "out" / "usd").glob("*/scene.usda")
    assert {asset: files for asset, files in textures_of_usd(stage).items() if asset in skins} == {
        asset: {data} for asset, data in skins.items()
    }


def test_nothing_is_made_again_and_other_slots_make_only_what_hangs_on_them(home: dict[str, str], lake: Path, scans: Path) -> None:
    assert stale(lake, scans, home, *SET) == {}
    plain = [word.replace(SLOTS, 'candidates.slots=[{provider="procedural"}]') for word in SET]
    changed = stale(lake, scans, home, *plain)
    assert (SCENE, "capture") not in changed
    assert changed[SCENE, "candidates"] == "config, scan changed"
