"""Color spaces there and back, and colors of foreign glTF files as they are displayed."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from schemas.errors import InputError
from tasks.containers import close_glb, open_glb
from tasks.geometry import colors as c
from tasks.geometry.meshes import dump_glb, load_glb, material_of, surface_of_glb, vertex_colors
from tests.conftest import REPOSITORY
from tests.tasks.geometry.colored import COLORED, MID, SATURATED, TINT, Colored, decoded, encoded

BYTES = np.arange(256, dtype=np.uint8)


def test_every_byte_survives_its_linear_value() -> None:
    rgba = np.stack([BYTES, BYTES[::-1], BYTES, BYTES], axis=1)
    assert np.array_equal(c.bytes_of_shorts(c.shorts_of_bytes(rgba)), rgba)
    assert np.array_equal(c.bytes_of_linear(c.linear_of_bytes(rgba)), rgba)
    assert np.array_equal(c.shorts_of_bytes(rgba)[:, 3], BYTES.astype(int) * 257), "alpha is linear"
    np.testing.assert_allclose(c.linear_of_bytes(BYTES), decoded(BYTES), atol=1e-12)
    assert (np.diff(c.linear_of_bytes(BYTES)) > 0).all()


@given(st.floats(0, 1))
def test_a_value_survives_its_linear_value(value: float) -> None:
    assert float(c.display_of(c.linear_of(value))) == pytest.approx(value, abs=1e-4)
    assert float(c.linear_of(c.display_of(value))) == pytest.approx(value, abs=1e-4)
    assert float(c.display_of(value)) == pytest.approx(float(encoded(value)[0]) / 255, abs=1e-12)


def test_values_that_are_not_colors_are_clipped() -> None:
    assert c.bytes_of_linear([-1.0, np.nan, 2.0, np.inf]).tolist() == [0, 0, 255, 255]


@given(st.tuples(*[st.floats(0, 1)] * 3))
def test_images_are_multiplied_as_light(factor: tuple[float, float, float]) -> None:
    image = np.stack([BYTES, BYTES, BYTES, BYTES], axis=1)
    product = c.tinted(image, factor)
    for channel in range(3):
        np.testing.assert_allclose(product[:, channel], encoded(decoded(BYTES) * factor[channel]), atol=0.51)
    assert np.array_equal(product[:, 3], BYTES), "alpha stays"


@pytest.mark.parametrize("made", COLORED, ids=lambda made: made.name)
def test_a_foreign_glb_shows_its_color_inside_and_after_each_copy(made: Colored) -> None:
    data = made.glb()
    for _ in range(3):
        (part,) = load_glb(data)
        np.testing.assert_allclose(vertex_colors(part), np.tile(made.displayed, (len(part.vertices), 1)), atol=1)
        assert np.array_equal(surface_of_glb(data).colors, vertex_colors(part))
        data = dump_glb([part])


def test_a_mesh_without_any_color_is_gray_for_other_readers_too() -> None:
    box = trimesh.creation.box()
    papered = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (2, 2), TINT))
    papered.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    for parts in ([box], [box, papered]):  # the plain writer, and the general one
        data = dump_glb(parts)
        assert (vertex_colors(load_glb(data)[0]) == 180).all()
        document, _ = open_glb(data)
        material = document["materials"][document["meshes"][0]["primitives"][0]["material"]]["pbrMetallicRoughness"]
        np.testing.assert_allclose(encoded(material["baseColorFactor"][:3]), 180, atol=0.1)
        assert material["metallicFactor"] == 0


def test_colored_vertices_have_a_material_that_viewers_light() -> None:
    box, papered = trimesh.creation.box(), trimesh.creation.box()
    box.visual.vertex_colors = np.tile([*MID, 255], (8, 1)).astype(np.uint8)
    papered.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)))
    for parts in ([box], [box, papered]):
        document, _ = open_glb(dump_glb(parts))
        primitive = document["meshes"][0]["primitives"][0]
        assert document["materials"][primitive["material"]]["pbrMetallicRoughness"]["metallicFactor"] == 0
        assert document["accessors"][primitive["attributes"]["COLOR_0"]]["normalized"] is True
        assert not [name for name in primitive["attributes"] if name.startswith("_")]
        assert "_COLOR_0" not in box.vertex_attributes, "the part itself stays as it was"


def test_factors_of_the_darkest_colors_are_not_taken_for_white() -> None:
    box = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=np.array([1, 0, 1, 255], np.uint8))
    box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
    assert vertex_colors(box)[0].tolist() == [1, 0, 1]
    np.testing.assert_allclose(material_of(box)[1], decoded([1, 0, 1]))


def test_sparse_interleaved_colors_without_alpha_are_read() -> None:
    document, binary = open_glb(Colored("vertices", vertex=decoded(MID)).glb())
    number = document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    rows = np.zeros((8, 20), np.uint8)
    rows[:, 4:16] = np.tile(decoded(MID).astype("<f4"), (8, 1)).view(np.uint8)
    places, values = np.array([2, 5], "<u2").tobytes(), np.tile(decoded(SATURATED).astype("<f4"), (2, 1)).tobytes()
    starts = [len(binary), len(binary) + rows.size, len(binary) + rows.size + 4]
    sizes = [rows.size, 4, len(values)]
    first = len(document["bufferViews"])
    for start, size in zip(starts, sizes, strict=True):
        document["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": size})
    document["bufferViews"][first]["byteStride"] = 20
    document["accessors"][number] = {
        "bufferView": first, "byteOffset": 4, "componentType": 5126, "type": "VEC3", "count": 8,
        "sparse": {
            "count": 2, "indices": {"bufferView": first + 1, "componentType": 5123}, "values": {"bufferView": first + 2},
        },
    }  # fmt: skip
    document["buffers"][0]["byteLength"] = starts[-1] + len(values)
    (part,) = load_glb(close_glb(document, binary + rows.tobytes() + places + values))
    expected = np.tile(np.array(MID), (8, 1))
    expected[[2, 5]] = SATURATED
    assert np.array_equal(vertex_colors(part), expected)


def _accessor(key: str, value: Any) -> Callable[[dict[str, Any], dict[str, Any]], None]:
    return lambda document, accessor: accessor.__setitem__(key, value)


DAMAGES = {
    "another count": _accessor("count", 7),
    "no count": _accessor("count", "8"),
    "another type": _accessor("type", "VEC2"),
    "whole numbers": _accessor("componentType", 5125),
    "another view": _accessor("bufferView", 99),
    "no view": _accessor("bufferView", None),
    "before the view": _accessor("byteOffset", -4),
    "after the view": _accessor("byteOffset", 4),
    "sparse without places": _accessor("sparse", {"count": 1}),
    "sparse in a word": _accessor("sparse", "all"),
    "no such accessor": lambda document, _: document["meshes"][0]["primitives"][0]["attributes"].update(COLOR_0=99),
    "accessor in a word": lambda document, _: document["meshes"][0]["primitives"][0]["attributes"].update(COLOR_0="colors"),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_vertex_colors_that_cannot_be_read_are_refused(damage: Callable[[Any, Any], None]) -> None:
    document, binary = open_glb(Colored("vertices", vertex=decoded(MID)).glb())
    damage(document, document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]])
    with pytest.raises(InputError, match=r"^chair\.glb: COLOR_0: is not an accessor of colors"):
        load_glb(close_glb(document, binary), "chair.glb")


FACTORS: list[Any] = [[0.0, 0.0, 0.0], [0.5, 0.5], "red", [1, 2, 3, "4"], [10**400, 0, 0, 1], None, {}, [True, 0, 0, 1], [[1, 0, 0, 1]]]


@pytest.mark.parametrize("factor", FACTORS, ids=str)
@pytest.mark.parametrize("is_painted", [False, True])
def test_factors_of_any_form_are_read_or_refused(factor: Any, is_painted: bool) -> None:
    document, binary = open_glb(Colored("factor", vertex=decoded(MID) if is_painted else None, factor=decoded(MID)).glb())
    document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = factor
    document["materials"][0]["emissiveFactor"] = [0.0, 1.0, 0.0]
    document["materials"][0]["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": factor}}
    try:
        load_glb(close_glb(document, binary), "chair.glb")
    except InputError as error:
        refusal = str(error)
    else:
        refusal = "chair.glb: "
    assert refusal.startswith("chair.glb: ")


def test_documents_that_lack_what_colors_need_are_refused() -> None:
    values: tuple[Any, ...] = (None, {}, [], 7)
    for name in ("bufferViews", "buffers", "accessors", "materials"):
        for value in values:
            document, binary = open_glb(Colored("both", vertex=decoded(MID), factor=decoded(MID)).glb())
            document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]].pop("bufferView")
            document[name] = value
            with pytest.raises(InputError, match=r"^mesh\.glb: "):
                load_glb(close_glb(document, binary))


def test_names_that_no_encoding_has_are_refused_next_to_colors() -> None:
    data = Colored("vertices", vertex=decoded(MID)).glb()
    assert data.count(b'"name": "box"') == 1
    for before, after in ((b'"name": "box"', b'"name":"\\ud8ff"'), (b'"nodes": ', b'"nodes":'), (b'"meshes": ', b'"meshes":')):
        assert before in data
        data = data.replace(before, after, 1)
    with pytest.raises(InputError, match="UnicodeEncodeError"):
        load_glb(data)


def test_the_document_of_a_reader_stays_as_it_is() -> None:
    from tasks.geometry.colors.gltf import displayed_glb

    data = COLORED[-2].glb()
    document, _ = open_glb(data)
    before = copy.deepcopy(document)
    displayed_glb(data, document, "box.glb")
    assert document == before


def test_no_other_module_knows_a_color_space() -> None:
    others = []
    for folder in ("tasks", "flows", "warehouse", "schemas", "bench"):
        for path in (REPOSITORY / folder).rglob("*.py"):
            text = path.read_text()
            if any(sign in text for sign in ("0.04045", "0.0031308", "** 2.4", "** 2.2", "1.055")):
                others.append(Path(path).relative_to(REPOSITORY).as_posix())
    assert others == ["tasks/geometry/colors/__init__.py"]
