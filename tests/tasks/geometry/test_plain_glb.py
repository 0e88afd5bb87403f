"""GLBs without a scene graph: the documents and meshes of the general writer and reader, and nothing of what is not as plain."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.containers import close_glb, open_glb
from tasks.exports.gltf import aimed_glb
from tasks.geometry import meshes
from tasks.geometry.plain_glb import PlainBody, read_plain, write_plain

NAMES = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "Z")), min_size=1, max_size=12).filter(lambda name: name != "world")


@st.composite
def bodies(draw: st.DrawFn) -> list[PlainBody]:
    """Bodies of which some share faces, vertices or colors, with zeros of either sign."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    made: list[PlainBody] = []
    for name in draw(st.lists(NAMES, min_size=1, max_size=6, unique=True)):
        count = draw(st.integers(3, 9))
        vertices = np.round(rng.normal(size=(count, 3)), draw(st.integers(0, 6)))
        faces = rng.integers(0, count, (draw(st.integers(1, 5)), 3))
        colors = rng.integers(0, 256, (count, 4)).astype(np.uint8) if draw(st.booleans()) else None
        if made and draw(st.booleans()):
            last = made[-1]
            vertices, faces, colors = last.vertices + draw(st.sampled_from([0.0, 1.0])), last.faces, last.colors
        made.append(PlainBody(name, vertices, faces, colors))
    return made


def generally_written(made: list[PlainBody]) -> bytes:
    """The GLB that the general writer makes of the same bodies."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(meshes, "write_plain", lambda bodies: None)
        return meshes.dump_glb([body.mesh() for body in made], [body.name for body in made])


@settings(max_examples=60, deadline=None)
@given(made=bodies(), aims=st.booleans())
def test_documents_and_meshes_are_those_of_the_general_writer_and_reader(made: list[PlainBody], aims: bool) -> None:
    data = meshes.dump_glb([body.mesh() for body in made], [body.name for body in made])
    assert data == write_plain(made) == meshes.dump_bodies(made)
    assert open_glb(data) == open_glb(generally_written(made))
    if aims:  # what each part of the buffer holds is said, as in exports
        data = aimed_glb(data)
        assert read_plain(data, open_glb(data)[0]) is not None
    plain = meshes.load_glb(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(meshes, "read_plain", lambda data, document: None)
        general = meshes.load_glb(data)
        merged = meshes.surface_of_glb(data)
    assert [part.metadata for part in plain] == [part.metadata for part in general]
    for part, other in zip(plain, general, strict=True):
        assert np.asarray(part.vertices).tobytes() == np.asarray(other.vertices).tobytes()
        assert np.array_equal(part.faces, other.faces)
        assert np.array_equal(meshes.vertex_colors(part), meshes.vertex_colors(other))
    surface = meshes.surface_of_glb(data)
    for name in ("vertices", "faces", "colors"):
        assert np.array_equal(getattr(surface, name), getattr(merged, name))


BOX = PlainBody("box", np.array(trimesh.creation.box().vertices), np.array(trimesh.creation.box().faces), np.full((8, 4), 255, np.uint8))


def test_what_is_not_plain_is_left_to_the_general_writer() -> None:
    assert write_plain([]) is None
    assert write_plain([BOX, BOX]) is None, "two of one name"
    assert write_plain([PlainBody("world", BOX.vertices, BOX.faces)]) is None, "the root's own name"
    assert write_plain([PlainBody("bare", BOX.vertices, BOX.faces[:0])]) is None
    assert write_plain([PlainBody("short", BOX.vertices, BOX.faces, BOX.colors[:3] if BOX.colors is not None else None)]) is None
    painted = BOX.mesh()
    painted.visual.face_colors = np.tile([10, 20, 30, 255], (12, 1))
    assert PlainBody.of(painted, "painted") is None
    papered = BOX.mesh()
    papered.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)))
    assert PlainBody.of(papered, "papered") is None


def _other(key: str, value: Any) -> Callable[[dict[str, Any]], None]:
    """A change that puts a value where dots lead to."""

    def change(document: dict[str, Any]) -> None:
        *way, last = [int(step) if step.isdigit() else step for step in key.split(".")]
        place: Any = document
        for step in way:
            place = place[step]
        place[last] = value

    return change


CHANGES = [
    _other("nodes.0.translation", [1.0, 2.0, 3.0]),
    _other("nodes.0.name", "another"),
    _other("nodes.0.mesh", 1),
    _other("scenes.0.nodes", [0, 0]),
    _other("scene", 1),
    _other("asset.generator", "by hand"),
    _other("extensionsUsed", ["KHR_texture_transform"]),
    _other("meshes.0.extras", {"units": "inch"}),
    _other("meshes.0.primitives.0.mode", 1),
    _other("meshes.0.primitives.0.material", 1),
    _other("materials.0.pbrMetallicRoughness.metallicFactor", 1.0),
    _other("materials.0.name", "paint"),
    _other("meshes.0.primitives.0.attributes.NORMAL", 1),
    _other("meshes.0.primitives.0.indices", 1),
    _other("meshes.0.primitives.0.indices", -3),
    _other("meshes.0.primitives.0.attributes.POSITION", 99),
    _other("accessors.0.count", 10**12),
    _other("accessors.0.count", 33.0),
    _other("accessors.0.bufferView", -1),
    _other("accessors.1.byteOffset", 4),
    _other("accessors.1.sparse", {}),
    _other("accessors.2.normalized", False),
    _other("bufferViews.1.byteOffset", -12),
    _other("bufferViews.1.byteOffset", 10**9),
    _other("bufferViews.1.byteStride", 12),
    _other("buffers.0.byteLength", 7),
    _other("buffers.0.uri", "elsewhere.bin"),
    _other("meshes", None),
]


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_not_plain_is_left_to_the_general_reader(change: Callable[[dict[str, Any]], None]) -> None:
    data = write_plain([BOX])
    assert data is not None
    document, binary = open_glb(data)
    assert read_plain(data, document) is not None
    change(document)
    changed = close_glb(document, binary)
    assert read_plain(changed, json.loads(json.dumps(document))) is None


def test_corners_that_are_not_there_and_numbers_without_end_are_refused() -> None:
    vertices = BOX.vertices.copy()
    vertices[3, 1] = np.inf
    for body in (PlainBody("far", vertices, BOX.faces), PlainBody("lost", BOX.vertices, np.array([[0, 1, 8]]))):
        data = write_plain([body])
        assert data is not None
        with pytest.raises(InputError, match=r"chair\.glb"):
            meshes.load_glb(data, "chair.glb")
