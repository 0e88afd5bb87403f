"""What a mesh file states and its reader does not use is a line of the scan, in every format whose annotation lies beside the mesh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tasks.capture.files.ply import read_labelled_ply
from tasks.capture.reading import Reading
from tests.tasks.capture.formats.test_arkitscenes import write_arkitscenes
from tests.tasks.capture.formats.written import (
    labelled_ply,
    only_scan,
    read,
    sample,
    write_matterport3d,
    write_multiscan,
    write_replica_v1,
    write_scannetpp,
    write_threerscan,
)

WRITERS: dict[str, Callable[[Path, Reading], object]] = {
    "scannetpp": write_scannetpp,
    "matterport3d": write_matterport3d,
    "replica_v1": write_replica_v1,
    "threerscan": write_threerscan,
    "multiscan numbered": write_multiscan,
    "multiscan listed": lambda folder, reading: write_multiscan(folder, reading, is_labelled=False),
    "arkitscenes": write_arkitscenes,
}


@pytest.mark.parametrize("kind", WRITERS)
def test_an_image_that_no_face_uses_is_a_note(kind: str, tmp_path: Path) -> None:
    WRITERS[kind](tmp_path / "a1", sample())
    before = read(tmp_path).degradations
    (mesh,) = tmp_path.rglob("*.ply")
    mesh.write_bytes(mesh.read_bytes().replace(b" 1.0\n", b" 1.0\ncomment TextureFile wood.png\n", 1))
    after = read(tmp_path)
    assert sorted(set(after.degradations) - set(before)) == [f"{mesh.name}: wood.png is not used: no texture coordinates belong to it"]
    assert only_scan(tmp_path).path is not None


def test_lines_of_the_textured_mesh_are_a_note(tmp_path: Path) -> None:
    write_threerscan(tmp_path / "a", sample())
    before = read(tmp_path).degradations
    mesh = tmp_path / "a" / "mesh.refined.v2.obj"
    mesh.write_text(mesh.read_text() + "l 1 2\nl 2 3\n")
    assert set(read(tmp_path).degradations) - set(before) == {"mesh.refined.v2.obj: 2 lines: are not read: they have no surface"}


def test_labelled_meshes_have_colors_of_every_type(tmp_path: Path) -> None:
    surface = sample().surface
    assert surface is not None
    text = labelled_ply(surface, np.zeros(len(surface.vertices), np.int64), is_text=True)
    path = tmp_path / "a.ply"
    path.write_bytes(text.replace(b"property uchar red", b"property float diffuse_red").replace(b"uchar green", b"float diffuse_green")
                     .replace(b"uchar blue", b"float diffuse_blue").replace(b" 9 9 9 ", b" 1 0.5 0 "))  # fmt: skip
    assert np.unique(read_labelled_ply(path, "a.ply", "vertex", "objectId").surface.colors, axis=0).tolist() == [[255, 128, 0]]


def test_a_label_is_that_of_each_triangle_of_its_polygon(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
    head += "property list uchar int vertex_indices\nproperty int object_id\nend_header\n"
    path = tmp_path / "a.ply"
    path.write_text(head + "0 0 0\n1 0 0\n1 1 0\n0.5 2 0\n0 1 0\n5 0 1 2 3 4 7\n3 0 1 2 8\n")
    assert read_labelled_ply(path, "a.ply", "face", "object_id").labels.tolist() == [7, 7, 7, 8]
