"""Scans, bare meshes and models that use features of glTF: read as stated, with notes on the rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.capture.formats import find_scans, format_of
from tasks.capture.reading import Reading
from tasks.containers import open_glb
from tasks.library.formats import read_model
from tests.tasks.geometry.gltf import files as gltf_files
from tests.tasks.geometry.gltf.files import Gltf, box, colored_by, painted, picture

WALLS = {
    "floor": ((5.0, 0.1, 4.0), (0, -0.05, 0)), "wall_1": ((0.1, 2.6, 4.0), (-2.55, 1.3, 0)), "wall_2": ((0.1, 2.6, 4.0), (2.55, 1.3, 0)),
}  # fmt: skip


def room_of(made: Gltf) -> Gltf:
    """A floor and two walls around what is there."""
    for name, (size, center) in WALLS.items():
        made.node(name, mesh=made.mesh(*box(size, center)))  # type: ignore[arg-type]
    return made


def reading_of(folder: Path, made: Gltf, format_: str = "auto") -> Reading:
    folder.mkdir()
    (folder / "room.glb").write_bytes(made.data())
    (scan,), errors = find_scans(folder.parent, format_)
    assert not errors
    return format_of(scan).read(scan)


def test_instances_of_a_room_are_instances_of_the_scene(tmp_path: Path) -> None:
    reading = reading_of(tmp_path / "room", room_of(gltf_files.instanced()))
    assert reading.surface is not None
    assert reading.groups is not None
    labels = sorted(group.raw_label for group in reading.groups)
    assert labels == ["chair"] * 4 + ["floor", "table", "wall", "wall"]
    centers = sorted(
        tuple(np.round(reading.surface.vertices[group.vertices].mean(axis=0)[:2], 3).tolist())
        for group in reading.groups if group.raw_label == "chair"
    )  # fmt: skip
    assert centers == [(-2.0, -1.5), (0.0, -2.5), (0.0, 1.5), (2.0, -1.5)]
    assert reading.glb is not None
    document, _ = open_glb(reading.glb)
    assert "extensionsUsed" not in document, "the lake keeps a file that every viewer shows"


@pytest.mark.parametrize("name", ["shorts", "draco", "meshopt", "sparse"])
def test_a_compressed_room_is_the_plain_room(tmp_path: Path, name: str) -> None:
    """Figures within the steps of quantization, names and labels as they are."""
    found = reading_of(tmp_path / "room", room_of(gltf_files.TABLES[name]()))
    assert found.surface is not None
    assert found.groups is not None
    assert sorted(group.raw_label for group in found.groups) == ["floor", "table", "wall", "wall"]
    (table,) = (group for group in found.groups if group.raw_label == "table")
    low, high = (find(found.surface.vertices[table.vertices], axis=0) for find in (np.min, np.max))
    assert np.allclose([low, high], [[-0.6, -0.35, 0], [0.6, 0.35, 0.75]], atol=1e-4)


def test_a_floor_that_was_joined_with_walls_and_furniture_comes_apart(tmp_path: Path) -> None:
    """`gltf-transform optimize` joins meshes of one material, under the name of the first."""
    parts = [*(box(*placed) for placed in WALLS.values()), gltf_files.table()]  # type: ignore[arg-type]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = np.concatenate([part[1] + start for part, start in zip(parts, starts[:-1], strict=True)])
    made = Gltf()
    made.node("floor", mesh=made.mesh(np.concatenate([part[0] for part in parts]), faces))
    made.node("chair_1", mesh=made.mesh(*box((0.4, 0.9, 0.6), (2, 0.45, 0))))
    reading = reading_of(tmp_path / "joined", made)
    assert reading.groups is not None
    assert reading.surface is not None
    counts = {(group.source_id, group.raw_label): (len(group.faces), len(group.vertices)) for group in reading.groups}
    assert counts == {
        ("floor", "floor"): (12, 8), ("floor_joined_1", "wall"): (12, 8), ("floor_joined_2", "wall"): (12, 8),
        ("floor_joined_3", "unnamed"): (60, 40), ("chair_1", "chair"): (12, 8),
    }  # fmt: skip
    assert sorted(np.concatenate([group.faces for group in reading.groups]).tolist()) == list(range(len(reading.surface.faces)))
    (note,) = [note for note in reading.degradations if "joined" in note]
    assert "room.glb: node 'floor' also has the shapes of 2 walls and 1 other objects, read as these: perhaps a program" in note


Boxes = Sequence[tuple[tuple[float, float, float], tuple[float, float, float]]]

LEVELS: dict[str, Boxes] = {
    "floor": [((8, 0.1, 8), (0, -0.05, 0)), ((6, 0.1, 6), (0, 3, 0))],
    "floor_steps": [((8, 0.1, 8), (0, -0.05, 0)), *(((1, 0.18, 0.3), (3, 0.18 * k, 0.3 * k)) for k in range(9))],
    "floor_platform": [((8, 0.1, 8), (0, -0.05, 0)), ((3, 0.45, 2.5), (2, 0.23, 2)), ((1.2, 0.05, 0.3), (-3, 0.5, 0))],
    "ceiling": [((8, 0.1, 8), (0, 2.6, 0)), ((4, 0.05, 3), (0, 2.1, 0)), ((0.5, 0.2, 0.5), (0, 1.9, 0))],
}  # fmt: skip


def joined_boxes(boxes: Boxes) -> tuple[np.ndarray, np.ndarray]:
    parts = [box(*placed) for placed in boxes]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate([part[1] + 8 * k for k, part in enumerate(parts)])


@pytest.mark.parametrize("name", LEVELS)
def test_flat_pieces_at_any_height_keep_the_label_of_their_node(tmp_path: Path, name: str) -> None:
    made = room_of(gltf_files.plain())
    made.node(f"{name.partition('_')[0]}_2", mesh=made.mesh(*joined_boxes(LEVELS[name])))
    reading = reading_of(tmp_path / "room", made)
    assert sorted(group.raw_label for group in reading.groups or ()) == sorted([name.partition("_")[0], "floor", "table", "wall", "wall"])
    assert not any("shapes of" in note for note in reading.degradations)


def test_levels_of_a_floor_that_was_joined_with_furniture_stay_a_floor(tmp_path: Path) -> None:
    """Also with a rug on the upper level, and a ring of moldings that is no level."""
    ring: Boxes = [((8, 0.1, 0.1), (0, 2, -4)), ((8, 0.1, 0.1), (0, 2, 4)), ((0.1, 0.1, 7.9), (-4, 2, 0)), ((0.1, 0.1, 7.9), (4, 2, 0))]
    boxes = [*LEVELS["floor"], ((1, 0.02, 1), (0, 3.1, 0)), ((0.6, 1.8, 0.6), (2, 3.95, 2)), *ring]
    made = Gltf()
    made.node("floor", mesh=made.mesh(*joined_boxes(boxes)))
    made.node("chair_1", mesh=made.mesh(*box((0.4, 0.9, 0.6), (2, 0.45, 0))))
    reading = reading_of(tmp_path / "room", made)
    faces = {group.source_id: len(group.faces) for group in reading.groups or ()}
    assert faces == {"floor": 36, "floor_joined_1": 12, "floor_joined_2": 48, "chair_1": 12}


def test_a_floor_with_steps_and_skirting_boards_is_a_floor(tmp_path: Path) -> None:
    made = room_of(gltf_files.plain())
    parts = [box((5.0, 0.2, 1.0), (0, 0.1, -1.5)), box((5.0, 0.1, 0.02), (0, 0.05, -1.99)), box((5.0, 0.1, 4.0), (0, -0.05, 0))]
    faces = np.concatenate([part[1] + 8 * number for number, part in enumerate(parts)])
    made.node("floor_2", mesh=made.mesh(np.concatenate([part[0] for part in parts]), faces))
    reading = reading_of(tmp_path / "room", made)
    assert sorted(group.raw_label for group in reading.groups or ()) == ["floor", "floor", "table", "wall", "wall"]
    assert not any("joined" in note for note in reading.degradations)


@pytest.mark.parametrize("format_", ["auto", "bare_mesh"])
def test_textures_that_cannot_be_decoded_are_degradations(tmp_path: Path, format_: str) -> None:
    basis = {"KHR_texture_basisu": {"source": 0}}
    made = painted(colored_by(), {"TEXCOORD_0": [0.7, 0.5]}, picture("uastc")[:90], "image/ktx2", extensions=basis)
    reading = reading_of(tmp_path / "room", room_of(made.use("KHR_texture_basisu")), format_)
    (note,) = [note for note in reading.degradations if "KHR_texture_basisu" in note]
    assert "room.glb: image 0: KHR_texture_basisu: cannot be decoded" in note


@pytest.mark.parametrize("format_", ["auto", "bare_mesh"])
def test_scans_with_unknown_required_extensions_are_refused(tmp_path: Path, format_: str) -> None:
    with pytest.raises(InputError, match=r"room\.glb: extensionsRequired: uses ACME_walls: "):
        reading_of(tmp_path / "room", room_of(gltf_files.plain()).use("ACME_walls"), format_)


def test_models_of_a_library_have_the_notes_of_their_features(tmp_path: Path) -> None:
    made = gltf_files.plain().use("KHR_materials_variants", is_required=False)
    (tmp_path / "table.glb").write_bytes(made.data())
    model = read_model(tmp_path / "table.glb", tmp_path)
    assert [note.partition(": ")[2] for note in model.notes] == ["KHR_materials_variants: are not read: the default materials are"]
    (tmp_path / "other.glb").write_bytes(gltf_files.plain().use("ACME_walls").data())
    with pytest.raises(InputError, match="ACME_walls"):
        read_model(tmp_path / "other.glb", tmp_path)
