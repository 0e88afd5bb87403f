"""Features of glTF that change geometry: the same table whichever of them states it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from schemas.errors import InputError
from schemas.machine.scratch import temporary_folders
from tasks.confinement import Limits, run_child
from tasks.containers import open_glb, weigh_glb
from tasks.geometry.gltf.plain import read_features, triangles_of
from tasks.geometry.meshes import Surface, load_glb, surface_of
from tests.tasks.geometry.gltf import files as gltf_files
from tests.tasks.geometry.gltf.files import TABLES, TOLERANCES, Gltf, box, instanced, table


def surface_in(made: Gltf) -> Surface:
    return surface_of(load_glb(made.data(), "table.glb"))


def corners_of(surface: Surface) -> np.ndarray:
    """Corners of all triangles, sorted, and turned so that each begins with its lowest, shape (m, 9)."""
    corners = surface.vertices[surface.faces].round(3)
    first = np.array([min(range(3), key=lambda k, face=face: tuple(face[k])) for face in corners.tolist()])
    turned = np.take_along_axis(corners, (first[:, None, None] + np.arange(3)[None, :, None]) % 3, axis=1).reshape(-1, 9)
    return turned[np.lexsort(turned.T[::-1])]


@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_the_same_by_every_feature(name: str) -> None:
    expected, found = surface_in(gltf_files.plain()), surface_in(TABLES[name]())
    tolerance = TOLERANCES.get(name, 1e-6)
    assert len(found.faces) == len(expected.faces) == 60
    assert np.allclose(found.bounds, expected.bounds, atol=tolerance)
    mesh = found.to_trimesh()
    mesh.merge_vertices()
    assert mesh.volume == pytest.approx(expected.to_trimesh().volume, abs=10 * tolerance), "faces look outward"
    if tolerance <= 1e-4 and name != "mirrored":  # whose diagonals are mirrored, too
        assert np.allclose(corners_of(found), corners_of(expected), atol=2e-3)


@pytest.mark.parametrize("name", ["draco", "meshopt"])
def test_compressed_contents_lie_in_a_folder_that_is_swept_after_a_kill(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[bool]()

    def watch(code: str, words: list[str], folder: Path, limits: Limits, file: str) -> Mapping[str, Any]:
        seen.append(folder in temporary_folders())
        return run_child(code, words, folder, limits, file)

    monkeypatch.setattr("tasks.geometry.gltf.decoding.run_child", watch)
    assert len(surface_in(TABLES[name]()).faces) == 60
    assert seen
    assert all(seen)


@pytest.mark.parametrize("name", TABLES)
def test_a_plain_glb_says_the_same_to_other_loaders(name: str) -> None:
    data = TABLES[name]().data()
    plain = read_features(data, "table.glb")
    document, _ = open_glb(plain.data)
    assert not document.get("extensionsRequired")
    assert read_features(plain.data, "table.glb").data == plain.data, "a plain file stays as it is"
    scene = trimesh.load_scene(trimesh.util.wrap_as_stream(plain.data), file_type="glb")
    low, high = scene.bounds
    assert np.allclose(high - low, gltf_files.SIZE, atol=TOLERANCES.get(name, 1e-5))


def test_instances_are_nodes_with_the_name_of_theirs() -> None:
    parts = {str(part.metadata["name"]): part for part in load_glb(instanced().data())}
    assert sorted(parts) == ["chair_1_0", "chair_1_1", "chair_1_2", "chair_1_3", "table_1"]
    assert parts["chair_1_0"].bounds.round(6).tolist() == [[-2.2, -1.8, 0.0], [-1.8, -1.2, 0.9]]
    assert np.ptp(parts["chair_1_1"].bounds, axis=0).round(3).tolist() == [0.6, 0.4, 0.9], "turned by 90 degrees"
    assert np.ptp(parts["chair_1_2"].bounds, axis=0).round(3).tolist() == [0.4, 0.6, 1.8], "twice as high"
    barred = sorted(str(part.metadata["name"]) for part in load_glb(instanced("c|chair|seat").data()))
    assert barred[:2] == ["c_0|chair|seat", "c_1|chair|seat"]


def test_instances_count_in_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    import dataclasses

    from tasks import containers

    data = instanced().data()
    weigh_glb(data, "room.glb")
    monkeypatch.setattr(containers, "BUDGET", dataclasses.replace(containers.BUDGET, faces=60 + 3 * 12))
    with pytest.raises(InputError, match=r"room.glb: faces: are 108"):
        weigh_glb(data, "room.glb")


def test_a_node_without_a_name_has_that_of_its_mesh() -> None:
    made = Gltf()
    made.node(mesh=made.mesh(*table(), name="desk_1"))
    made.node("lamp_1", mesh=made.mesh(*box((0.1, 0.1, 0.1), (0, 1, 0)), name="other"))
    assert [part.metadata["name"] for part in load_glb(made.data())] == ["desk_1", "lamp_1"]


def test_morph_weights_of_a_node_outrank_those_of_its_mesh() -> None:
    made = gltf_files.morphed()
    made.node("table_2", mesh=0, weights=[1.0, 0.0])
    heights = {part.metadata["name"]: round(float(np.ptp(part.bounds[:, 2])), 3) for part in load_glb(made.data())}
    assert heights == {"table_1": 0.75, "table_2": 1.5}


def test_primitives_of_all_modes_in_one_mesh() -> None:
    """Points and lines are left out, and a strip of four corners has two triangles that look the same way."""
    made = gltf_files.plain()
    square = made.accessor(np.array([[0, 2, 0], [0, 2, 1], [1, 2, 0], [1, 2, 1]], dtype=float))
    for mode in (0, 1, 2, 3, 5):
        made.document["meshes"][0]["primitives"].append({"attributes": {"POSITION": square}, "mode": mode})
    found = surface_in(made)
    assert len(found.faces) == 62
    assert found.bounds[1].round(6).tolist() == [1.0, 0.35, 2.0]
    assert any("points and lines (4 times)" in note for note in read_features(made.data(), "x.glb").notes)


def test_strips_and_fans_turn_as_the_standard_has_it() -> None:
    corners = np.arange(5)
    assert triangles_of(corners, 5).tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    assert triangles_of(corners, 6).tolist() == [[1, 2, 0], [2, 3, 0], [3, 4, 0]]
    assert triangles_of(corners, 4).tolist() == [[0, 1, 2]]
    assert triangles_of(corners[:1], 5).tolist() == triangles_of(corners[:0], 6).tolist() == []


def damaged(made: Gltf, change: str) -> bytes:
    """A file whose compressed data or arrays are broken."""
    if change == "no draco":
        view = made.document["bufferViews"][0]
        made.binary = made.binary.replace(made.binary[view["byteOffset"] : view["byteOffset"] + 20], bytes(20))
    elif change == "no meshopt":
        made.binary = bytes(len(made.binary))
    elif change == "other count":
        made.document["accessors"][0]["count"] -= 1
    elif change == "joint":
        made.document["skins"][0]["joints"].pop()
    elif change == "weights":
        made.binary = made.binary.replace(np.tile(np.array([0.25, 0.75, 0, 0], "<f4"), (40, 1)).tobytes(), bytes(40 * 16))
    elif change == "lengths":
        made.document["nodes"][1]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = 0
    elif change == "sparse":
        made.document["accessors"][0]["sparse"]["values"]["byteOffset"] = 10**6
    elif change == "index":
        made.document["accessors"][0]["count"] = 5
    return made.data()


@pytest.mark.parametrize(
    ("make", "change", "problem"),
    [
        (gltf_files.draco, "no draco", "KHR_draco_mesh_compression cannot be decoded"),
        (gltf_files.draco, "other count", "differs from its KHR_draco_mesh_compression"),
        (gltf_files.meshopt, "no meshopt", "EXT_meshopt_compression cannot be decoded"),
        (gltf_files.skinned, "joint", "names a joint that does not exist"),
        (gltf_files.skinned, "weights", "has no weights"),
        (instanced, "lengths", "EXT_mesh_gpu_instancing has attributes of different lengths"),
        (gltf_files.sparse, "sparse", "is not a readable GLB"),
        (gltf_files.stripped, "index", "triangles of vertices that are not there"),
    ],
)
def test_broken_features_are_refused_by_name(make: object, change: str, problem: str) -> None:
    data = damaged(make(), change)  # type: ignore[operator]
    with pytest.raises(InputError, match=rf"^table\.glb: .*{problem}"):
        load_glb(data, "table.glb")
