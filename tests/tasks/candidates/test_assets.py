"""Assets: solids of any mesh, with the volume that they enclose."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tasks.candidates.assets import MAX_FACES, make_asset


def test_an_asset_without_a_solid_is_refused() -> None:
    facts = {"provider": "x", "name": "x", "category": "x", "source": "x", "license": "x"}
    box = trimesh.creation.box((1, 1, 1))
    broken = box.copy()
    broken.vertices[0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        make_asset([broken], **facts)
    with pytest.raises(ValueError, match="no object of a room"):
        make_asset([trimesh.creation.box((1000, 1, 1))], **facts)
    with pytest.raises(ValueError, match="four of each"):
        make_asset([trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)], **facts)


def test_volume_and_closedness_are_those_of_the_solid() -> None:
    facts = {"provider": "x", "name": "x", "category": "x", "source": "x", "license": "x"}
    box = trimesh.creation.box((1, 2, 0.5))
    closed = make_asset([box], **facts).asset
    assert (closed.is_watertight, closed.volume_m3) == (True, pytest.approx(1.0))
    split = trimesh.Trimesh(box.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    assert make_asset([split], **facts).asset.is_watertight
    open_box = trimesh.Trimesh(box.vertices, box.faces[2:], process=False)
    opened = make_asset([open_box], **facts).asset
    assert (opened.is_watertight, opened.volume_m3) == (False, pytest.approx(1.0))


@pytest.mark.slow
def test_huge_meshes_are_decimated() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=8)
    made = make_asset([sphere], provider="x", name="x", category="x", source="x", license="x").asset
    assert len(sphere.faces) > MAX_FACES >= made.face_count
    assert made.volume_m3 == pytest.approx(sphere.volume, rel=0.01)
