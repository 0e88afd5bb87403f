"""Materials of OBJ files as exporters write them keep their color; images are found by name inside the folder alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from schemas.errors import InputError
from tasks.candidates.assets import make_asset
from tasks.geometry.meshes import surface_of
from tasks.ingestion.materials import map_line, material_files
from tasks.ingestion.models import read_model

COLOR = (200, 120, 60)
BOX = trimesh.creation.box()


def write_obj(folder: Path, material: str, image: str = "wood.png", library: str = "mtllib box.mtl") -> Path:
    """A box with one material and an image of one color."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [library, "vt 0.5 0.5", "usemtl m", *(f"v {x} {y} {z}" for x, y, z in BOX.vertices)]
    lines += ["f " + " ".join(f"{corner + 1}/1" for corner in face) for face in BOX.faces]
    (folder / "box.obj").write_text("\n".join(lines) + "\n")
    (folder / "box.mtl").write_text(f"newmtl m\n{material}\n")
    (folder / image).parent.mkdir(exist_ok=True)
    Image.new("RGB", (8, 8), COLOR).save(folder / image)
    return folder / "box.obj"


def color_of(path: Path, root: Path) -> tuple[list[int], list[str]]:
    parts, notes = read_model(path, root, is_z_up=True)
    return surface_of(parts).colors.mean(axis=0).round().astype(int).tolist(), notes


@pytest.mark.parametrize(
    ("material", "image"),
    [
        ("Kd 1 1 1\nmap_Kd wood.png", "wood.png"),
        ("map_Kd wood.png", "wood.png"),
        ("Kd 1\nKa 0\nKs 0\nmap_Kd wood.png", "wood.png"),
        ("map_Kd wood.png\nKd spectral file.rfl", "wood.png"),
        ("Kd 0 0 0\nmap_Kd wood.png", "wood.png"),
        ("map_Kd textures\\wood.png", "textures/wood.png"),
        ("map_Kd C:\\Users\\me\\My scans\\wood.png", "wood.png"),
        ("map_Kd /home/me/textures/wood.png", "wood.png"),
        ("map_Kd \\\\server\\share\\wood.png", "wood.png"),
        ("map_Kd Textures/Wood.PNG", "textures/wood.png"),
        ("map_Kd gone/wood.png", "wood.png"),
        ("map_Kd wood.png", "textures/wood.png"),
        ("map_Kd -s 2 2 1 -o 0 0 0 wood.png", "wood.png"),
        ("map_Kd -bm 0.5 -blendu on -blendv off -clamp on -imfchan l -mm 0 1 wood.png", "wood.png"),
        ("map_Kd wood.png -bm 1", "wood.png"),
        ("map_Kd my wood.png", "my wood.png"),
        ('map_Kd "my wood.png"', "my wood.png"),
        ("map_Kd -s 1 1 1 my wood.png", "my wood.png"),
        ("MAP_KD wood.png\nPr 0.5\nPm 0\nd 1\nTr 0", "wood.png"),
        ("map_Ka wood.png", "wood.png"),
        ("map_Kd\twood.png", "wood.png"),
        ("map_Kd ../wood.png", "../wood.png"),
    ],
)
def test_an_image_gives_an_obj_its_color(tmp_path: Path, material: str, image: str) -> None:
    path = write_obj(tmp_path / "models" / "box", material, image)
    color, notes = color_of(path, tmp_path)
    assert color == list(COLOR)
    assert all("black" in note for note in notes)
    files = {file.resolve() for file in material_files(path, tmp_path)}
    assert files == {path.with_suffix(".mtl"), (path.parent / image).resolve()}


@pytest.mark.parametrize(
    "library",
    [
        "mtllib gone.mtl box.mtl",
        "mtllib box.mtl other.mtl",
        'mtllib "box.mtl"',
        "MTLLIB BOX.MTL",
        "mtllib C:\\x\\box.mtl",
        "mtllib other.mtl\nmtllib box.mtl",
    ],
)
def test_every_material_library_of_an_obj_is_read(tmp_path: Path, library: str) -> None:
    path = write_obj(tmp_path, "map_Kd wood.png", library=library)
    (tmp_path / "other.mtl").write_text("newmtl n\nKd 0 0 1\n")
    assert color_of(path, tmp_path)[0] == list(COLOR)


def test_an_image_of_the_name_of_the_obj_stands_in_for_a_missing_material_library(tmp_path: Path) -> None:
    path = write_obj(tmp_path, "", image="box.png", library="mtllib gone.mtl")
    color, notes = color_of(path, tmp_path)
    assert color == list(COLOR)
    assert [note.partition("box.obj: ")[2] for note in notes] == [
        "gone.mtl is missing, drawn without it", "box.png is taken for its image, by its name",
    ]  # fmt: skip


def test_scale_and_offset_of_an_image_move_its_coordinates(tmp_path: Path) -> None:
    path = write_obj(tmp_path, "map_Kd -s 0.5 0.5 -o 0.5 0 wood.png")
    pixels = np.zeros((8, 16, 3), np.uint8)
    pixels[:, 8:] = COLOR
    Image.fromarray(pixels).save(tmp_path / "wood.png")
    assert color_of(path, tmp_path)[0] == list(COLOR)


@pytest.mark.parametrize("damage", ["missing", "text"])
def test_an_image_that_cannot_be_read_is_told_and_is_not_a_texture(tmp_path: Path, damage: str) -> None:
    path = write_obj(tmp_path, "Kd 0.2 0.4 0.6\nmap_Kd wood.png")
    (tmp_path / "wood.png").unlink()
    if damage == "text":
        (tmp_path / "wood.png").write_text("not an image")
    parts, notes = read_model(path, tmp_path, is_z_up=True)
    problem = "is missing" if damage == "missing" else "cannot be decoded"
    assert [note.partition("box.obj: ")[2] for note in notes] == [f"wood.png {problem}, drawn without it"]
    made = make_asset(parts, provider="p", name="n", category="box", source="s", license="l")
    assert made.asset.has_texture is False
    assert surface_of(parts).colors.mean(axis=0).round().tolist() == [51, 102, 153]


def test_an_image_that_was_read_is_a_texture(tmp_path: Path) -> None:
    parts, _ = read_model(write_obj(tmp_path, "map_Kd wood.png"), tmp_path, is_z_up=True)
    assert make_asset(parts, provider="p", name="n", category="box", source="s", license="l").asset.has_texture is True


def test_nothing_outside_of_the_folder_is_opened(tmp_path: Path) -> None:
    path = write_obj(tmp_path / "library", "Kd 1 0 0\nmap_Kd ../secret.png", image="../secret.png")
    color, notes = color_of(path, path.parent)
    assert color == [255, 0, 0]
    assert "secret.png is missing" in notes[0]
    (path.parent / "wood.png").symlink_to(tmp_path / "secret.png")
    (path.parent / "box.mtl").write_text("newmtl m\nKd 1 0 0\nmap_Kd wood.png\n")
    assert color_of(path, path.parent)[0] == [255, 0, 0]
    path.write_text(path.read_text().replace("box.mtl", "../../box.mtl"))
    assert material_files(path, path.parent) == [path.parent / "box.mtl"]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_an_obj_with_a_byte_order_mark_is_read(tmp_path: Path, encoding: str) -> None:
    path = write_obj(tmp_path, "map_Kd wood.png")
    for file in (path, path.with_suffix(".mtl")):
        file.write_bytes(file.read_text().encode(encoding))
    assert color_of(path, tmp_path)[0] == list(COLOR)


@given(st.text(alphabet="-osbm wood.png01 \t\"'", max_size=40))
def test_any_line_of_an_image_has_a_name_and_finite_numbers(rest: str) -> None:
    line = map_line(rest)
    assert line.names
    assert np.isfinite([*line.scale, *line.offset]).all()


def test_a_library_that_leads_out_is_refused(tmp_path: Path) -> None:
    path = write_obj(tmp_path / "library", "Kd 1 0 0", library="mtllib ../secret.mtl")
    with pytest.raises(InputError, match="outside"):
        read_model(path, path.parent, is_z_up=True)


@pytest.mark.parametrize(
    ("material", "is_told"),
    [
        ("Kd 1 1 1", False),
        ("Kd 1 1 1\nd 1\nTr 1", False),
        ("Kd 1 1 1\nTr 0", False),
        ("Kd 1 1 1\nd 1.0", False),
        ("Kd 1 1 1\nd 0.3", True),
        ("Kd 1 1 1\nd -halo 0.3", True),
        ("Kd 1 1 1\nTr 0.7", True),
        ("map_Kd wood.png\nmap_d wood.png", True),
    ],
)
def test_materials_that_let_light_through_are_told_of(tmp_path: Path, material: str, is_told: bool) -> None:
    _, notes = color_of(write_obj(tmp_path, material), tmp_path)
    told = [note.partition("/")[2] for note in notes if "light" in note]
    assert told == ["box.obj: materials that let light through are read as solid: m"] * is_told
