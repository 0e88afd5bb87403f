"""Replica: quads whose faces say which object they are of, and the way that gravity points."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.files.ply import read_labelled_ply
from tests.tasks.capture.formats.written import assert_same_instances, labelled_ply, only_scan, read, sample, write_replica_v1


def write_sample(folder: Path) -> None:
    """A room with a chair."""
    write_replica_v1(folder, sample())


@pytest.mark.parametrize("is_quads", [True, False])
def test_instances_are_those_of_the_native_format(is_quads: bool, tmp_path: Path) -> None:
    write_replica_v1(tmp_path / "room_0", sample(), is_quads)
    assert_same_instances(read(tmp_path), sample(), same_order=not is_quads)
    assert only_scan(tmp_path).scene_id == "replica/room_0"
    assert only_scan(tmp_path / "room_0" / "habitat").scene_id == "replica/room_0"


def test_gravity_points_down(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "habitat" / "info_semantic.json"
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"gravity_dir": [0.0, -2.0, 0.0]}))
    surface, native = read(tmp_path).surface, sample().surface
    assert surface is not None
    assert native is not None
    np.testing.assert_allclose(surface.vertices, native.vertices[:, [0, 2, 1]] * [1, -1, 1], atol=1e-12)
    path.write_text(json.dumps(document | {"gravity_dir": [0.0, 0.0, 0.0]}))
    with pytest.raises(InputError, match=r"^a/habitat/info_semantic.json: gravity_dir: is no direction"):
        read(tmp_path)


def test_an_object_without_a_class_is_nobodys(tmp_path: Path) -> None:
    write_sample(tmp_path / "a")
    path = tmp_path / "a" / "habitat" / "info_semantic.json"
    document = json.loads(path.read_text())
    document["objects"][1]["class_name"] = "undefined"
    del document["objects"][2]
    path.write_text(json.dumps(document))
    assert [group.source_id for group in read(tmp_path).groups or ()] == [group.source_id for group in _numbered()][2:]


def _numbered() -> list:  # type: ignore[type-arg]
    from dataclasses import replace

    return [replace(group, source_id=str(index + 1)) for index, group in enumerate(sample().groups or ())]


@pytest.mark.parametrize("is_text", [True, False])
def test_a_labelled_mesh_reads_alike_as_text_and_as_bytes(is_text: bool, tmp_path: Path) -> None:
    surface = sample().surface
    assert surface is not None
    labels = np.arange(len(surface.vertices)) % 700
    path = tmp_path / "a.ply"
    path.write_bytes(labelled_ply(surface, labels, is_text))
    read_back = read_labelled_ply(path, "a.ply", "vertex", "objectId")
    mine = read_back.surface
    np.testing.assert_array_equal(read_back.labels, labels)
    np.testing.assert_array_equal(mine.vertices, surface.vertices)
    np.testing.assert_array_equal(mine.faces, surface.faces)
    assert (mine.colors == 9).all()
    with pytest.raises(InputError, match=r"^a.ply: element vertex: has no property wrong, only NYU40, blue,"):
        read_labelled_ply(path, "a.ply", "vertex", "wrong")


@pytest.mark.parametrize(
    ("before", "after", "problem"),
    [
        (b"element face 2", b"element face 3", "the file ends"),
        (b"0 0 0 1", b"0 0 0 1.5", "no integers"),
        (b"3 1 2 3", b"3 1 2 9", "vertex that does not exist"),
        (b"3 1 2 3", b"3 1 2", "cut or broken"),
        (b"1 1 0 2", b"1 nan 0 2", "is nan"),
    ],
)
def test_a_labelled_mesh_that_is_broken_is_refused(before: bytes, after: bytes, problem: str, tmp_path: Path) -> None:
    head = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty int objectId\n"
    sound = (
        head + b"element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1\n1 0 0 1\n0 1 0 2\n1 1 0 2\n3 0 1 2\n3 1 2 3\n"
    )
    path = tmp_path / "a.ply"
    path.write_bytes(sound)
    assert read_labelled_ply(path, "a.ply", "vertex", "objectId").labels.tolist() == [1, 1, 2, 2]
    path.write_bytes(sound.replace(before, after))
    with pytest.raises(InputError, match=problem):
        read_labelled_ply(path, "a.ply", "vertex", "objectId")
