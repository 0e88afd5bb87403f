"""Scenery of a scene's rows: all of its parts, where they were placed, and whose they are."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from schemas.candidates import Asset
from schemas.capture import Instance, RoomSurface, Scene, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.replica import placed_parts
from tasks.shell import room_shell
from tasks.simulation.rasterizer import Rasterizer
from tasks.simulation.scenery import scenery
from tasks.simulation.soups import soup_of
from tests.furnished import furnished_lake
from tests.tasks.simulation.test_rasterizer import check_as_rays_on_the_whole, looking


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    lake = furnished_lake(Path(tmp_path_factory.mktemp("furnished")) / "lake", scenes=1)
    reader = lake.snapshot()
    scene = reader.rows(Scene)[0].scene_id
    return {
        "shell": reader.rows(Shell, scene)[0], "surfaces": reader.rows(RoomSurface, scene), "placements": reader.rows(Placement, scene),
        "assets": reader.rows(Asset), "instances": reader.rows(Instance, scene), "blobs": lake.blobs,
    }  # fmt: skip


def test_every_part_is_there_once_and_somebodys(rows: dict) -> None:
    seen = scenery(**rows)
    slabs = room_shell(rows["shell"])
    assets = {asset.asset_id: rows["blobs"][asset.mesh_blob] for asset in rows["assets"]}
    expected = [(None, name, mesh) for name, mesh in slabs]
    for placement in sorted(rows["placements"], key=lambda row: row.instance_id):
        category = next(row.category for row in rows["instances"] if row.instance_id == placement.instance_id)
        expected += [(placement.instance_id, category, mesh) for mesh in placed_parts(placement, assets[placement.asset_id])]
    assert list(zip(seen.instance_ids, seen.categories, strict=True)) == [(owner, name) for owner, name, _ in expected]
    for number, (_, _, mesh) in enumerate(expected):
        np.testing.assert_allclose(seen.soup.corners[seen.soup.part == number], mesh.triangles, atol=1e-5)


def test_what_is_seen_is_what_rays_meet(rows: dict) -> None:
    seen, slabs = scenery(**rows), [mesh for _, mesh in room_shell(rows["shell"])]
    blobs = {asset.asset_id: rows["blobs"][asset.mesh_blob] for asset in rows["assets"]}
    placed = [placed_parts(row, blobs[row.asset_id]) for row in sorted(rows["placements"], key=lambda row: row.instance_id)]
    parts = [*slabs, *(mesh for meshes in placed for mesh in meshes)]
    ring, rng = np.array(rows["shell"].floor_polygon), np.random.default_rng(0)
    eyes = np.column_stack([rng.uniform(ring.min(axis=0), ring.max(axis=0), (24, 2)), rng.uniform(1.0, 1.5, 24)])  # above all objects
    poses = np.array([looking(eye, *turn) for eye, turn in zip(eyes, rng.uniform([0, -0.2], [6.3, 0.8], (24, 2)), strict=True)])
    np.testing.assert_array_equal(soup_of(parts).corners, seen.soup.corners)
    check_as_rays_on_the_whole(parts, poses)


def test_from_above_each_object_is_in_its_place(rows: dict) -> None:
    seen = scenery(**rows)
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = np.diag([1.0, -1.0, -1.0]), [0, 0, 6.0]
    pictures = Rasterizer(seen.soup).render([camera], 160, 160, math.radians(60))
    owners = np.array([*seen.instance_ids, None])[pictures.part[0]]
    focal = 80 / math.tan(math.radians(30))
    for placement in rows["placements"]:
        ys, xs = np.nonzero(owners == placement.instance_id)
        if len(xs) < 20:
            continue
        depth = pictures.depth[0][ys, xs]
        middle = np.array([((xs - 79.5) / focal * depth).mean(), (-(ys - 79.5) / focal * depth).mean()])
        assert np.linalg.norm(middle - np.array(placement.optimized_pose).reshape(4, 4)[:2, 3]) < 0.25


def test_without_a_shell_there_are_no_slabs_and_what_is_missing_is_named(rows: dict) -> None:
    assert None not in scenery(**{**rows, "shell": None}).instance_ids
    with pytest.raises(InputError, match="its asset is not in assets; run the candidates stage again"):
        scenery(**{**rows, "assets": []})
    with pytest.raises(InputError, match="its instance is not in instances; run the capture stage again"):
        scenery(**{**rows, "instances": []})
    first = rows["placements"][0]
    with pytest.raises(InputError, match=f"placement {first.instance_id}"):
        scenery(**{**rows, "placements": [dataclasses.replace(first, asset_id="f" * 64)]})
