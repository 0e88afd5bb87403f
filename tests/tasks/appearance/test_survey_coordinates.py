"""Meshes in coordinates of surveys are centered in doubles; messages state the true distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.bare_mesh import read_mesh
from tasks.capture.files.ply import check_vertices
from tasks.capture.glb import read_glb_scene
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan
from tasks.containers import close_glb, open_glb
from tasks.geometry.meshes import dump_glb, load_glb, surface_of
from tasks.geometry.transforms import matrix
from tasks.library.format import ReadModel
from tasks.library.formats import check_model
from tasks.stage import Context

UTM = np.array([441547.5, 345.0, 5121946.5])
"""Easting, height and northing [m]."""

BOX = trimesh.creation.box((5.2, 2.7, 4.2)).subdivide()
SIZE = sorted((5.2, 2.7, 4.2))


def write_scan(folder: Path, kind: str, shift: np.ndarray) -> Scan:
    folder.mkdir()
    moved = BOX.vertices + shift
    path = folder / f"room.{kind.partition('_')[0]}"
    if kind == "obj":
        lines = ["v {:.6f} {:.6f} {:.6f}".format(*row) for row in moved]
        path.write_text("\n".join([*lines, *("f {} {} {}".format(*(face + 1)) for face in BOX.faces)]) + "\n")
    else:
        code = "f8" if kind == "ply_double" else "f4"
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(moved)}\n"
        head += "".join(f"property {'double' if code == 'f8' else 'float'} {axis}\n" for axis in "xyz")
        head += f"element face {len(BOX.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        faces = np.zeros(len(BOX.faces), [("n", "u1"), ("i", "<i4", 3)])
        faces["n"], faces["i"] = 3, BOX.faces
        path.write_bytes(head.encode() + moved.astype("<" + code).tobytes() + faces.tobytes())
    return Scan("bare_mesh", folder, "mesh", "room")


def original(reading: Reading) -> np.ndarray:
    """Vertices in coordinates of the file."""
    assert reading.surface is not None
    assert reading.from_file is not None
    back = np.linalg.inv(reading.from_file)
    return reading.surface.vertices @ back[:3, :3].T + back[:3, 3]


@pytest.mark.parametrize("kind", ["obj", "ply_double"])
def test_a_survey_is_centered_and_its_offset_is_kept(tmp_path: Path, kind: str) -> None:
    reading = read_mesh(write_scan(tmp_path / "a", kind, UTM))
    assert reading.surface is not None
    assert np.abs(reading.surface.vertices).max() < 10
    assert np.allclose(np.sort(np.ptp(reading.surface.bounds, axis=0)), SIZE, atol=1e-5)
    found = original(reading)
    assert np.allclose(found.min(axis=0), (BOX.vertices + UTM).min(axis=0), atol=1e-5)
    assert np.allclose(found.max(axis=0), (BOX.vertices + UTM).max(axis=0), atol=1e-5)
    assert sum("coordinates of a survey were moved" in note for note in reading.degradations) == 1


@pytest.mark.parametrize("kind", ["obj", "ply_double"])
def test_the_lake_leads_back_to_coordinates_of_the_survey(tmp_path: Path, kind: str) -> None:
    scan = write_scan(tmp_path / "a", kind, UTM)
    outcome = run(scan=scan, context=Context(scan.scene_id, "capture", 3, {}), config=CaptureConfig())
    (scene,) = outcome.rows["scenes"]
    world = surface_of(load_glb(outcome.blobs[scene.mesh_blob])).vertices
    assert np.abs(world).max() < 10
    back = matrix(scene.to_original)
    found = world @ back[:3, :3].T + back[:3, 3]
    truth = BOX.vertices + UTM
    assert len(found) == len(truth)
    assert cKDTree(truth).query(found)[0].max() < 1e-4


def test_a_mesh_near_its_origin_stays(tmp_path: Path) -> None:
    reading = read_mesh(write_scan(tmp_path / "a", "ply_float", np.array([20.0, 3.0, 5.0])))
    assert np.allclose(np.abs(original(reading).mean(axis=0)), [20, 3, 5], atol=0.5)
    assert not any("survey" in note for note in reading.degradations)


def test_floats_that_lost_the_shape_are_refused_with_their_step(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"are 5,122 km from the origin and stored as 32-bit floats, in steps of 0\.5 m"):
        read_mesh(write_scan(tmp_path / "a", "ply_float", UTM))


@pytest.mark.parametrize("shift", [UTM, np.array([11000.0, 0.0, 0.0])])
def test_a_scene_with_an_offset_in_its_nodes_is_centered(tmp_path: Path, shift: np.ndarray) -> None:
    data = dump_glb([trimesh.creation.box((5.2, 4.2, 2.7)), trimesh.creation.box((1, 1, 1))], ["wall_1", "chair_1"])
    document, binary = open_glb(data)
    for node in document["nodes"]:
        if "mesh" in node:
            node.pop("matrix", None)
            node["translation"] = shift.tolist()
    (tmp_path / "a.glb").write_bytes(close_glb(document, binary))
    reading = read_glb_scene(Scan("glb", tmp_path / "a.glb", "glb", "a"))
    assert reading.surface is not None
    assert np.abs(reading.surface.vertices).max() < 10
    assert reading.glb is None
    assert np.allclose(original(reading).min(axis=0), shift - [2.6, 1.35, 2.1], atol=1e-3)


def test_messages_state_the_distance() -> None:
    far = np.asarray(BOX.vertices) + np.array([5_200_000.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"room\.ply: vertices: are 5,200 km from the origin \(limit 10 km\); subtract the survey offset"):
        check_vertices(far, "room.ply")
    mesh = trimesh.Trimesh(far, BOX.faces, process=False)
    with pytest.raises(InputError, match=r"are 5,200,003 units from the origin \(limit 1,000,000\); subtract the survey offset"):
        check_model(ReadModel([mesh], "obj", None, None), "a.obj")
