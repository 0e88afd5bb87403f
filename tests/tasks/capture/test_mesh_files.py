"""Bare meshes in each kind of file: the same instances as in a scan of ScanNet's without labels; units, axes and textures."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image

from schemas.errors import InputError
from tasks.capture import CaptureConfig, run
from tasks.capture.bare_mesh import read_mesh
from tasks.capture.files.ply import read_ply
from tasks.capture.formats import find_scans, scan_files
from tasks.furniture.rooms import furnish
from tasks.geometry.meshes import Surface, dump_glb, load_glb, material_of
from tasks.geometry.transforms import Y_UP_TO_Z_UP, Z_UP_TO_Y_UP, yaw_pose
from tasks.scanner import ScannerConfig, scan_scene
from tasks.stage import Context, Outcome
from tests.capture_scans import box_room, ply_bytes
from tests.tasks.library.models import as_usdz

KINDS = ("ply", "glb", "obj", "usdz")

SCANNER = ScannerConfig(
    depth_width=160, depth_height=120, color_width=160, color_height=120, view_limit=80, frames="none", axis_alignment=False
)
"""Coarse, so that a room takes seconds."""


def written(folder: Path, surface: Surface, kind: str) -> Path:
    """A surface with +Z up [m] as a file of a kind in a folder, with those that it draws on: GLB and OBJ +Y up, PLY and USDZ +Z up."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"room.{kind}"
    if kind == "ply":
        path.write_bytes(ply_bytes(surface))
    elif kind == "glb":
        path.write_bytes(dump_glb([surface.to_trimesh()], ["mesh"]))
    elif kind == "obj":
        _write_obj(path, surface)
    else:
        path.write_bytes(as_usdz({"room.usda": _usda(surface).encode()}))
    return path


def _write_obj(path: Path, surface: Surface) -> None:
    """As Polycam writes them: materials beside it, colors in a texture; here with a pixel for each vertex."""
    width = int(np.ceil(np.sqrt(len(surface.vertices))))
    pixels = np.zeros((width * width, 3), dtype=np.uint8)
    pixels[: len(surface.colors)] = surface.colors
    Image.fromarray(pixels.reshape(width, width, 3)).save(path.with_suffix(".png"))
    path.with_suffix(".mtl").write_text(f"newmtl scan\nKd 1 1 1\nmap_Kd {path.stem}.png\n")
    number = np.arange(len(surface.vertices))
    u, v = (number % width + 0.5) / width, 1.0 - (number // width + 0.5) / width
    places = surface.vertices.astype(np.float32).astype(np.float64) @ Z_UP_TO_Y_UP[:3, :3].T
    lines = [f"mtllib {path.stem}.mtl", *(f"v {x!r} {y!r} {z!r}" for x, y, z in places.tolist())]
    lines += [f"vt {a!r} {b!r}" for a, b in zip(u.tolist(), v.tolist(), strict=True)]
    lines += ["usemtl scan", *("f " + " ".join(f"{i}/{i}" for i in face) for face in (surface.faces + 1).tolist())]
    path.write_text("\n".join(lines) + "\n")


def _usda(surface: Surface, unit: float = 1.0, up: str = "Z") -> str:
    """A layer with a mesh that has display colors, which are linear."""
    value = np.arange(256) / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    points = ", ".join(f"({x!r}, {y!r}, {z!r})" for x, y, z in surface.vertices.astype(np.float32).astype(np.float64).tolist())
    colors = ", ".join(f"({r:.9g}, {g:.9g}, {b:.9g})" for r, g, b in linear[surface.colors].tolist())
    indices = ", ".join(map(str, surface.faces.ravel().tolist()))
    return (
        f'#usda 1.0\n(\n    metersPerUnit = {unit}\n    upAxis = "{up}"\n)\ndef Mesh "scan"\n{{\n'
        f"    int[] faceVertexCounts = [{', '.join(['3'] * len(surface.faces))}]\n    int[] faceVertexIndices = [{indices}]\n"
        f"    point3f[] points = [{points}]\n"
        f'    color3f[] primvars:displayColor = [{colors}] (\n        interpolation = "vertex"\n    )\n}}\n'
    )


def captured(path: Path) -> Outcome:
    (scan,), errors = find_scans(path, "bare_mesh" if path.suffix else "auto")
    assert not errors
    return run(scan=scan, context=Context("demo/room", "capture", 3, {}), config=CaptureConfig())


def instances(outcome: Outcome) -> list[tuple[str, str, float | None]]:
    return [(row.raw_label, row.category, row.category_probability) for row in outcome.rows["instances"]]


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> tuple[Surface, Outcome]:
    """The mesh of a scanned room, and what capture makes of it as a folder of ScanNet without labels."""
    root = tmp_path_factory.mktemp("native")
    scan_scene(furnish("bedroom", np.random.default_rng(5), 8), root, "scene0000_00", SCANNER, np.random.default_rng(6))
    folder = root / "scene0000_00"
    for path in folder.glob("*.json"):
        path.unlink()
    return read_ply(folder / "scene0000_00_vh_clean_2.ply", "mesh").surface, captured(folder)


@pytest.mark.whole
@pytest.mark.parametrize("kind", KINDS)
def test_a_room_in_any_kind_of_file_has_the_instances_of_the_native_one(native: tuple[Surface, Outcome], tmp_path: Path, kind: str) -> None:
    surface, expected = native
    found = captured(written(tmp_path, surface, kind))
    assert sum(not row.is_structure for row in found.rows["instances"]) >= 5
    assert [name[:2] for name in instances(found)] == [name[:2] for name in instances(expected)]
    for row, other in zip(found.rows["instances"], expected.rows["instances"], strict=True):
        assert row.box_pose == pytest.approx(other.box_pose, abs=1e-5)
        assert row.box_size == pytest.approx(other.box_size, abs=1e-5)
        assert row.category_probability == (pytest.approx(other.category_probability, abs=1e-3) if other.category_probability else None)
        assert (row.point_count, row.found_by) == (other.point_count, "geometry")
    assert found.rows["shells"][0].floor_polygon == pytest.approx(np.array(expected.rows["shells"][0].floor_polygon), abs=1e-5)


@pytest.mark.whole
def test_the_texture_of_a_mesh_is_kept_in_the_scene(native: tuple[Surface, Outcome], tmp_path: Path) -> None:
    surface, _ = native
    outcome = captured(written(tmp_path, surface, "obj"))
    (part,) = load_glb(outcome.blobs[outcome.rows["scenes"][0].mesh_blob])
    image, _ = material_of(part)
    assert image is not None
    assert (image == np.asarray(Image.open(tmp_path / "room.png").convert("RGB"))).all()
    assert len(part.faces) == len(surface.faces)


def furnished_box() -> Surface:
    """A room with things in it [m], +Z up, as it is scanned: from within, without undersides."""
    return box_room(cameras=1).surface


def notes_and_surface(folder: Path, surface: Surface, kind: str) -> tuple[str, Surface]:
    (scan,), _ = find_scans(written(folder, surface, kind), "bare_mesh")
    reading = read_mesh(scan)
    assert reading.surface is not None
    return "\n".join(reading.degradations), reading.surface


@pytest.mark.parametrize(("unit", "word"), [(0.01, "centimetres"), (0.001, "millimetres"), (1.0, "taken to be in metres")])
@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_a_file_that_says_no_unit_is_read_in_the_one_that_makes_it_as_high_as_rooms_are(
    tmp_path: Path, kind: str, unit: float, word: str
) -> None:
    room = furnished_box()
    scaled = dataclasses.replace(room, vertices=room.vertices / unit)
    notes, surface = notes_and_surface(tmp_path, scaled, kind)
    assert word in notes
    assert np.ptp(surface.vertices, axis=0) == pytest.approx(np.ptp(room.vertices, axis=0), rel=1e-4)


def test_units_and_axes_that_a_usd_file_states_are_taken(tmp_path: Path) -> None:
    room = furnished_box()
    turned = dataclasses.replace(room, vertices=room.vertices @ Z_UP_TO_Y_UP[:3, :3].T * 100)
    path = tmp_path / "room.usdz"
    path.write_bytes(as_usdz({"room.usda": _usda(turned, 0.01, "Y").encode()}))
    (scan,), _ = find_scans(path)
    reading = read_mesh(scan)
    assert reading.surface is not None
    assert np.ptp(reading.surface.vertices, axis=0) == pytest.approx(np.ptp(room.vertices, axis=0), rel=1e-4)
    assert any("y is taken to be up, as its file has it" in note for note in reading.degradations)
    assert not any("read as" in note for note in reading.degradations)


def tops(surface: Surface) -> Surface:
    """A room without what looks down below its ceiling: undersides that nobody scans."""
    corners = surface.vertices[surface.faces]
    down = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0
    return dataclasses.replace(surface, faces=surface.faces[~(down & (corners[:, :, 2].max(axis=1) < 2.0))])


@pytest.mark.parametrize("yaw", [0.0, 0.7])
@pytest.mark.parametrize("kind", ["glb", "obj", "ply"])
@pytest.mark.parametrize("is_other", [False, True])
def test_up_is_told_from_what_was_scanned_whatever_is_usual_for_the_file(tmp_path: Path, yaw: float, kind: str, is_other: bool) -> None:
    """A GLB or OBJ whose z axis is up, as in HM3D, and a PLY whose y axis is: read upright, and a note says who has it otherwise."""
    room = tops(furnished_box()).transformed(yaw_pose(yaw))
    change = np.eye(4)
    if is_other:  # `written` turns to +Y up, but for PLY: undone before, or done
        change = Z_UP_TO_Y_UP if kind == "ply" else Y_UP_TO_Z_UP
    notes, surface = notes_and_surface(tmp_path, room.transformed(change), kind)
    assert ("up by the geometry" in notes) == is_other
    assert np.ptp(surface.vertices[:, 2]) == pytest.approx(2.5, abs=1e-4)
    assert floor_share(surface) == floor_share(room)


def floor_share(surface: Surface) -> float:
    """Share of the faces at the lowest height."""
    return float((surface.vertices[surface.faces, 2].max(axis=1) < surface.vertices[:, 2].min() + 0.02).mean())


def test_files_of_an_obj_are_what_a_scene_depends_on(tmp_path: Path) -> None:
    written(tmp_path / "scan", furnished_box(), "obj")
    (scan,), errors = find_scans(tmp_path)
    assert (scan.scene_id, scan.format, errors) == ("mesh/scan", "bare_mesh", [])
    assert [path.name for path in scan_files(scan)] == ["room.mtl", "room.obj", "room.png"]


def _broken(kind: str, data: bytes) -> bytes:
    return data[: len(data) // 2] if kind != "obj" else data + b"f 1 2 999999999\n"


@pytest.mark.parametrize("kind", KINDS)
def test_a_broken_file_is_an_error_that_names_it(tmp_path: Path, kind: str) -> None:
    path = written(tmp_path / "scan", furnished_box(), kind)
    path.write_bytes(_broken(kind, path.read_bytes()))
    (scan,), _ = find_scans(path, "bare_mesh")
    with pytest.raises(InputError, match=rf"^(scan/)?room\.{kind}: "):
        read_mesh(scan)


def _flat(vertices: Sequence[Sequence[float]]) -> Surface:
    points: NDArray[np.float64] = np.array(vertices, dtype=np.float64)
    return Surface(points, np.array([[0, 1, 2]]), np.full((len(points), 3), 9, np.uint8))


@pytest.mark.parametrize(
    ("surface", "said"),
    [
        (_flat([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), "have no area"),
        (_flat([[0, 0, 0], [9e5, 0, 0], [0, 9e5, 9e5]]), "km from the origin and stored as 32-bit floats"),
    ],
)
def test_what_no_unit_explains_is_refused(tmp_path: Path, surface: Surface, said: str) -> None:
    (scan,), _ = find_scans(written(tmp_path, surface, "ply"), "bare_mesh")
    with pytest.raises(InputError, match=said):
        read_mesh(scan)


@pytest.mark.whole
def test_a_textured_model_of_others_keeps_its_image(realdata: Callable[[str], Path], tmp_path: Path) -> None:
    """A single piece of furniture: a scene with its own image in the lake's mesh."""
    path = realdata("assets") / "aws_NightStand_01.glb"
    outcome = captured(path)
    kept = [material_of(part)[0] for part in load_glb(outcome.blobs[outcome.rows["scenes"][0].mesh_blob])]
    own = [material_of(part)[0] for part in load_glb(path.read_bytes())]
    assert [None if image is None else image.shape for image in kept] == [None if image is None else image.shape for image in own]


def test_a_handful_of_points_is_refused(tmp_path: Path) -> None:
    cloud = trimesh.PointCloud(np.random.default_rng(0).random((50, 3)))
    data = cloud.export(file_type="ply")
    (tmp_path / "cloud.ply").write_bytes(data if isinstance(data, bytes) else io.BytesIO(data).getvalue())
    (scan,), _ = find_scans(tmp_path / "cloud.ply")
    with pytest.raises(InputError, match="points: are 50, a surface needs 100"):
        read_mesh(scan)
