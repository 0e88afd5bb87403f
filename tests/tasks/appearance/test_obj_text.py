"""OBJ text as exporters write it: indices, materials and colors keep their meaning, and what is not read is noted."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files import obj
from tasks.capture.files.obj import ObjText, parse_obj
from tasks.geometry.meshes import surface_of
from tasks.ingestion.models import read_model

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
MOVED = "v 5 0 0\nv 6 0 0\nv 6 1 0\nv 5 1 0\n"


def read(folder: Path, text: str | bytes, library: str | bytes | None = None) -> tuple[list[list[int]], list[str]]:
    """Colors of vertices by part, the first of each, and notes."""
    (folder / "a.obj").write_bytes(text.encode() if isinstance(text, str) else text)
    if library is not None:
        (folder / "a.mtl").write_bytes(library.encode() if isinstance(library, str) else library)
    parts, notes = read_model(folder / "a.obj", folder, is_z_up=True)
    return [surface_of([part]).colors[0].tolist() for part in parts], [note.partition("a.obj: ")[2] for note in notes]


def faces_of(text: ObjText) -> list[list[list[float]]]:
    return text.vertices[text.faces].tolist()


def test_negative_indices_count_backward_from_their_own_line() -> None:
    relative = parse_obj((SQUARE + "f -4 -3 -2 -1\n" + MOVED + "f -4 -3 -2 -1\n").encode(), "a.obj")
    absolute = parse_obj((SQUARE + MOVED + "f 1 2 3 4\nf 5 6 7 8\n").encode(), "a.obj")
    assert faces_of(relative) == faces_of(absolute)


@given(st.sampled_from([" ", "\t", "  ", " \t "]), st.sampled_from(["\n", "\r\n", "\r", "\n\n"]), st.booleans(), st.booleans())
def test_blanks_and_ends_of_lines_do_not_matter(blank: str, end: str, is_indented: bool, is_continued: bool) -> None:
    lines = [*SQUARE.splitlines(), "f 1 2 3 4", "# f 1 2 9"]
    if is_continued and end in ("\n", "\r\n"):
        lines[4] = f"f 1 2 \\{end} 3 4"
    text = end.join((blank if is_indented else "") + blank.join(line.split(" ")) for line in lines)
    assert faces_of(parse_obj(text.encode(), "a.obj")) == faces_of(parse_obj((SQUARE + "f 1 2 3 4\n").encode(), "a.obj"))


def test_corners_of_one_mesh_may_be_written_in_every_way() -> None:
    text = SQUARE + "vt 0 0\nvt 1 1\nvn 0 0 1\nf 1/1 2/2 3/1\nf 1//1 2//1 4//1\nf 1/2/1 3/1/1 4/2/1\nf 2 3 4\n"
    made = parse_obj(text.encode(), "a.obj")
    assert made.faces.tolist() == [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]
    assert made.corners.tolist() == [[0, 1, 0], [-1, -1, -1], [1, 0, 1], [-1, -1, -1]]


def test_outlines_of_many_corners_are_read() -> None:
    angles = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    lines = [f"v {np.cos(a):.9f} {np.sin(a):.9f} 0" for a in angles]
    made = parse_obj("\n".join([*lines, "f " + " ".join(map(str, range(1, 301)))]).encode(), "a.obj")
    assert len(made.faces) == 298


@pytest.mark.parametrize(
    ("used", "stated"),
    [
        ("usemtl", "newmtl"),
        ("usemtl ", "newmtl "),
        ("usemtl Terraind\xf6k", "newmtl Terraind\xf6k"),
        ("usemtl  old   oak  ", "newmtl old oak"),
        ("usemtl\tinitialShadingGroup", "newmtl\tinitialShadingGroup"),
        ("USEMTL a", "newmtl a"),
    ],
)
def test_materials_of_any_name_are_found(tmp_path: Path, used: str, stated: str) -> None:
    text = f"mtllib a.mtl\n{SQUARE}{used}\nf 1 2 3 4\n".encode("latin-1")
    assert read(tmp_path, text, f"{stated}\nKd 0.2 0.4 0.6\n".encode("latin-1")) == ([[51, 102, 153]], [])


def test_a_material_that_no_library_states_is_noted(tmp_path: Path) -> None:
    text = f"mtllib a.mtl\n{SQUARE}usemtl oak\nf 1 2 3\nusemtl pine\nf 1 3 4\n"
    colors, notes = read(tmp_path, text, "newmtl oak\nKd 0.2 0.4 0.6\n")
    assert colors == [[51, 102, 153], [180, 180, 180]]
    assert notes == ["material 'pine' is in no library, drawn without it"]


@pytest.mark.parametrize("name", ["gone.mat", "gone.mtl", "my gone.mat", "gone"])
def test_a_library_that_is_missing_is_noted_whatever_its_name(tmp_path: Path, name: str) -> None:
    assert read(tmp_path, f"mtllib {name}\n{SQUARE}f 1 2 3 4\n") == ([[180, 180, 180]], [f"{name} is missing, drawn without it"])


def test_texture_coordinates_alone_give_no_color(tmp_path: Path) -> None:
    assert read(tmp_path, SQUARE + "vt 0 0\nf 1/1 2/1 3/1 4/1\n") == ([[180, 180, 180]], [])


def test_colors_of_vertices_are_multiplied_by_their_material(tmp_path: Path) -> None:
    colored = "".join(f"v {place} 1 0.5 0\n" for place in ("0 0 0", "1 0 0", "1 1 0"))
    assert read(tmp_path, colored + "vt 0 0\nf 1/1 2/1 3/1\n") == ([[255, 128, 0]], [])
    assert read(tmp_path, f"mtllib a.mtl\n{colored}usemtl m\nf 1 2 3\n", "newmtl m\nKd 1 1 1\n") == ([[255, 128, 0]], [])
    # 0.5 and 0.6 are display values: 0.214 and 0.319 linear, whose product is 0.292 as a display value.
    dark = read(tmp_path, f"mtllib a.mtl\n{colored}usemtl m\nf 1 2 3\n", "newmtl m\nKd 0.5 0.6 1\n")
    assert dark == ([[128, 74, 0]], [])


def test_vertices_without_a_color_among_others_are_noted(tmp_path: Path) -> None:
    colors, notes = read(tmp_path, "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert colors == [[255, 0, 0]]
    assert notes == ["2 of 3 vertices state no color: they are gray"]


def test_points_and_lines_are_noted_or_named_if_alone(tmp_path: Path) -> None:
    assert read(tmp_path, SQUARE + "f 1 2 3\nl 1 2\nl 2 3\np 1\n")[1] == [
        "2 lines: are not read: they have no surface", "1 points: are not read: they have no surface",
    ]  # fmt: skip
    for text, only in (("l 1 2\np 1\n", "lines and points"), ("", "points")):
        with pytest.raises(InputError, match=f"holds no triangles, only {only}"):
            read(tmp_path, SQUARE + text)


def test_free_form_surfaces_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="surf: uses free-form curves or surfaces"):
        read(tmp_path, SQUARE + "f 1 2 3\nsurf 0 1 0 1 1 2 3 4\nend\n")


COMMENTS = ["# top", "#", "#f 1 2 9", "# origin of the room", "# 0.1 0.2 0.3", "\t# 9"]


@given(st.sampled_from(COMMENTS), st.sampled_from([" ", ""]))
def test_comments_behind_statements_change_nothing(comment: str, blank: str) -> None:
    lines = [*SQUARE.splitlines(), "vt 0 0", "vn 0 0 1", "s 1", "f 1/1 2/1 3/1", "f 1 3 4", "p 1", "l 1 2"]
    text, plain = (parse_obj("\n".join(line + end for line in lines).encode(), "a.obj") for end in (blank + comment, ""))
    assert faces_of(text) == faces_of(plain)
    assert text.colors is None
    assert (text.corners.tolist(), text.notes) == (plain.corners.tolist(), plain.notes)


def test_comments_behind_colors_are_cut_and_names_keep_their_signs(tmp_path: Path) -> None:
    library = "newmtl wood#2\nKd 1 0 0 # red\nd 1 # solid\nnewmtl glass\nKd 0 0 1#blue\nd 0.5 # half\n"
    text = "mtllib a.mtl\n" + SQUARE + "g a # b\nusemtl wood#2\nf 1 2 3 # top\nusemtl glass\nf 1 3 4\n"
    assert read(tmp_path, text, library) == (
        [[255, 0, 0], [0, 0, 255]],
        ["materials that let light through are read as solid: glass"],
    )
    colored = "".join(f"{line} 1 0 0 # corner\n" for line in SQUARE.splitlines())
    assert read(tmp_path, colored + "f 1 2 3 4\n") == ([[255, 0, 0]], [])


def test_a_mesh_of_text_has_the_limit_of_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(obj, "BUDGET", dataclasses.replace(BUDGET, model_bytes=40))
    (tmp_path / "a.obj").write_text(SQUARE + "f 1 2 3 4\n")
    with pytest.raises(InputError, match=r"^a\.obj: "):
        obj.read_obj(tmp_path / "a.obj", "a.obj")
