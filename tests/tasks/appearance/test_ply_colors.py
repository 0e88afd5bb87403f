"""Colors of PLY meshes of every type, name, element and byte order come out the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from tasks.capture.files.ply import read_ply
from tasks.ingestion.materials import material_files

RGB = np.array([160, 60, 40])
BOX = trimesh.creation.box((2.0, 3.0, 2.5))
_CODES = {
    "uchar": "u1", "uint8": "u1", "ushort": "u2", "uint16": "u2", "short": "i2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "float32": "f4",
}  # fmt: skip


def write_ply(
    path: Path, kind: str = "uchar", values: np.ndarray | None = None, names: tuple[str, ...] = (), order: str = "<",
    face_names: tuple[str, ...] = (), wedge: np.ndarray | None = None, wedge_name: str = "texcoord", comment: str = "",
) -> Path:  # fmt: skip
    """A box with colors of its vertices or faces, and a list of floats for each face."""
    values = RGB if values is None else values
    code = _CODES[kind]
    form = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    head = [f"ply\nformat {form} 1.0", *([comment] if comment else []), f"element vertex {len(BOX.vertices)}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"property {kind} {name}" for name in names]
    head += [f"element face {len(BOX.faces)}", "property list uchar int vertex_indices"]
    head += [f"property {kind} {name}" for name in face_names]
    head += [f"property list uchar float {wedge_name}"] if wedge is not None else []
    text = "\n".join([*head, "end_header"]) + "\n"
    rows = np.zeros(len(BOX.vertices), [(a, order + "f4") for a in "xyz"] + [(f"c{i}", order + code) for i in range(len(names))])
    for i, axis in enumerate("xyz"):
        rows[axis] = BOX.vertices[:, i]
    for i in range(len(names)):
        rows[f"c{i}"] = values[i] if i < 3 else 255
    fields: list[tuple] = [("n", "u1"), ("i", order + "i4", 3)] + [(f"c{i}", order + code) for i in range(len(face_names))]
    fields += [("m", "u1"), ("t", order + "f4", wedge.shape[1])] if wedge is not None else []
    faces = np.zeros(len(BOX.faces), fields)
    faces["n"], faces["i"] = 3, BOX.faces
    for i in range(len(face_names)):
        faces[f"c{i}"] = values[i]
    if wedge is not None:
        faces["m"], faces["t"] = wedge.shape[1], wedge
    if order:
        path.write_bytes(text.encode() + rows.tobytes() + faces.tobytes())
    else:
        flat = [" ".join(str(x) for value in row for x in np.ravel(value)) for table in (rows.tolist(), faces.tolist()) for row in table]
        path.write_text(text + "\n".join(flat) + "\n")
    return path


def mean_color(path: Path) -> list[int]:
    return read_ply(path, path.name, is_in_metres=False).surface.colors.mean(axis=0).round().astype(int).tolist()


@pytest.mark.parametrize("order", ["<", ">", ""])
@pytest.mark.parametrize(
    ("kind", "scale"),
    [("uchar", 1), ("uint8", 1), ("ushort", 257), ("uint16", 257), ("ushort", 1), ("short", 1), ("int", 1), ("uint", 257),
     ("float", 1 / 255), ("float32", 1 / 255), ("double", 1 / 255), ("float", 1), ("double", 1)],
)  # fmt: skip
def test_colors_of_vertices_have_the_scale_of_their_type(tmp_path: Path, order: str, kind: str, scale: float) -> None:
    path = write_ply(tmp_path / "a.ply", kind, RGB * scale, ("red", "green", "blue"), order)
    assert mean_color(path) == RGB.tolist()


@pytest.mark.parametrize("order", ["<", ""])
@pytest.mark.parametrize(
    "names",
    [("red", "green", "blue"), ("r", "g", "b"), ("R", "G", "B"), ("diffuse_red", "diffuse_green", "diffuse_blue"),
     ("red", "green", "blue", "alpha"), ("Red", "Green", "Blue")],
)  # fmt: skip
def test_colors_have_several_names(tmp_path: Path, order: str, names: tuple[str, ...]) -> None:
    assert mean_color(write_ply(tmp_path / "a.ply", names=names, order=order)) == RGB.tolist()


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_colors_of_faces_and_corners_go_to_their_vertices(tmp_path: Path, order: str) -> None:
    assert mean_color(write_ply(tmp_path / "a.ply", face_names=("red", "green", "blue"), order=order)) == RGB.tolist()
    corners = np.tile(RGB / 255, (len(BOX.faces), 3))
    assert mean_color(write_ply(tmp_path / "b.ply", wedge=corners, wedge_name="color", order=order)) == RGB.tolist()


@pytest.mark.parametrize("order", ["<", ">", ""])
def test_an_image_that_a_comment_names_gives_the_colors(tmp_path: Path, order: str) -> None:
    pixels = np.zeros((8, 16, 3), np.uint8)
    pixels[:, 8:] = RGB
    Image.fromarray(pixels).save(tmp_path / "Room.png")
    wedge = np.tile([0.75, 0.5], (len(BOX.faces), 3))
    white = np.full(3, 255)
    path = write_ply(
        tmp_path / "a.ply", values=white, names=("red", "green", "blue"), order=order, wedge=wedge, comment="comment TextureFile room.png"
    )
    assert mean_color(path) == RGB.tolist()
    assert material_files(path, tmp_path) == [tmp_path / "Room.png"]


@pytest.mark.parametrize("comment", ["", "comment TextureFile gone.png", "comment TextureFile text.png", "comment TextureFile ../up.png"])
def test_colors_of_vertices_stay_if_an_image_cannot_be_read(tmp_path: Path, comment: str) -> None:
    folder = tmp_path / "scan"
    folder.mkdir()
    Image.new("RGB", (4, 4)).save(tmp_path / "up.png")
    (folder / "text.png").write_text("not an image")
    wedge = np.full((len(BOX.faces), 6), 0.5)
    path = write_ply(folder / "a.ply", names=("red", "green", "blue"), wedge=wedge, comment=comment)
    made = read_ply(path, path.name, is_in_metres=False)
    assert made.surface.colors.mean(axis=0).round().tolist() == RGB.tolist()
    assert len(made.notes) == bool(comment)
    assert all("is missing" in note or "cannot be decoded" in note for note in made.notes)


def test_polygons_of_any_size_become_triangles(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 5\n" + "".join(f"property float {a}\n" for a in "xyz")
    head += "property uchar r\nproperty uchar g\nproperty uchar b\nelement face 3\nproperty list uchar int vertex_index\nend_header\n"
    places = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 1.5, 0)]
    body = "".join(f"{x} {y} {z} 160 60 40\n" for x, y, z in places) + "4 0 1 2 3\n3 2 3 4\n2 0 1\n"
    (tmp_path / "a.ply").write_text(head + body)
    surface = read_ply(tmp_path / "a.ply", "a.ply", is_in_metres=False).surface
    assert surface.faces.tolist() == [[0, 1, 2], [0, 2, 3], [2, 3, 4]]
    assert (surface.colors == RGB).all()
