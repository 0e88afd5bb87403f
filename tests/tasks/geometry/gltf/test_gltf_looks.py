"""Features of glTF that change looks: the color that a standard viewer shows, by whichever feature it is stated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.candidates.assets import make_asset
from tasks.containers import open_glb
from tasks.geometry.gltf.arrays import Arrays
from tasks.geometry.gltf.images import CLAMP, MIRROR, REPEAT, repeated_lookup
from tasks.geometry.gltf.plain import read_features
from tasks.geometry.meshes import load_glb, material_of, surface_of
from tests.tasks.geometry.colored import encoded
from tests.tasks.geometry.gltf.files import RED, Gltf, colored_by, painted, picture

LEFT, RIGHT = [0.25, 0.5], [0.75, 0.5]


def turned(**transform: Any) -> dict[str, Any]:
    return colored_by(extensions={"KHR_texture_transform": transform})


def gloss(**values: Any) -> dict[str, Any]:
    return {"extensions": {"KHR_materials_pbrSpecularGlossiness": values}}


def wrapped(uv: list[float], wrap_s: int, wrap_t: int = REPEAT) -> Gltf:
    made = painted(colored_by(), {"TEXCOORD_0": uv}, source=0, sampler=0)
    made.document["samplers"] = [{"wrapS": wrap_s, "wrapT": wrap_t}]
    return made


def whole(uv: list[float], dtype: str) -> Gltf:
    """Texture coordinates as normalized integers."""
    made = painted(colored_by(), {})
    rows = np.tile(np.round(np.array(uv) * np.iinfo(dtype).max), (8, 1))
    made.document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = made.accessor(rows, dtype, normalized=True)
    return made


def other_image(kind: str, extension: str) -> Gltf:
    return painted(colored_by(), {"TEXCOORD_0": RIGHT}, picture(kind), f"image/{kind.lower()}", extensions={extension: {"source": 0}}).use(
        extension
    )


def fallback() -> Gltf:
    """An image that cannot be decoded, and a second one that stands in for it."""
    made = painted(
        colored_by(), {"TEXCOORD_0": RIGHT}, picture("uastc")[:60], "image/ktx2", extensions={"KHR_texture_basisu": {"source": 0}}, source=1
    )
    made.document["images"].append({"bufferView": made.view(picture()), "mimeType": "image/png"})
    return made.use("KHR_texture_basisu", is_required=False)


RED_CUBES = {
    "plain": painted(colored_by(), {"TEXCOORD_0": RIGHT}),
    "offset": painted(turned(offset=[0.5, 0.0]), {"TEXCOORD_0": LEFT}),
    "scale": painted(turned(scale=[3.0, 1.0]), {"TEXCOORD_0": LEFT}),
    "half turn": painted(turned(rotation=np.pi, offset=[1.0, 1.0]), {"TEXCOORD_0": LEFT}),
    "quarter turn": painted(turned(rotation=np.pi / 2), {"TEXCOORD_0": [0.5, 0.75]}),
    "other set": painted(colored_by(texCoord=1), {"TEXCOORD_0": LEFT, "TEXCOORD_1": RIGHT}),
    "other set by its transform": painted(turned(texCoord=1), {"TEXCOORD_0": LEFT, "TEXCOORD_1": RIGHT}),
    "fourth set": painted(colored_by(texCoord=3), {"TEXCOORD_0": LEFT, "TEXCOORD_3": RIGHT}),
    "bytes": whole(RIGHT, "u1"),
    "shorts": whole(RIGHT, "u2"),
    "clamped": wrapped([1.2, 0.5], CLAMP),
    "clamped at the edge": wrapped([1.0, 1.0], CLAMP, CLAMP),
    "mirrored": wrapped([1.25, 0.5], MIRROR),
    "mirrored far away": wrapped([-4.75, 0.5], MIRROR),
    "repeated": wrapped([7.75, 0.5], REPEAT),
    "diffuse texture": painted(gloss(diffuseTexture={"index": 0}), {"TEXCOORD_0": RIGHT}),
    "WebP": other_image("WEBP", "EXT_texture_webp"),
    "UASTC": other_image("uastc", "KHR_texture_basisu"),
    "ETC1S": other_image("etc1s", "KHR_texture_basisu"),
    "second image": fallback(),
    "white vertices": painted(colored_by(), {"TEXCOORD_0": RIGHT, "COLOR_0": [1.0, 1.0, 1.0, 1.0]}),
}


@pytest.mark.parametrize("name", RED_CUBES)
def test_a_cube_is_red_by_every_feature(name: str) -> None:
    data = RED_CUBES[name].data()
    plain = read_features(data, "cube.glb")
    found = surface_of(load_glb(plain.data, "cube.glb")).colors
    assert np.abs(found.astype(int) - RED).max() <= 4
    assert [note for note in plain.notes if "cannot be decoded" not in note] == []
    assert any("KHR_texture_basisu: cannot be decoded" in note for note in plain.notes) == (name == "second image")


def test_avif_is_read_where_the_decoder_is() -> None:
    from PIL import features

    assert features.check("avif"), "Pillow's wheels have it"
    found = surface_of(load_glb(other_image("AVIF", "EXT_texture_avif").data())).colors
    assert np.abs(found.astype(int) - RED).max() <= 12


def linear_of(color: tuple[int, ...]) -> list[float]:
    return [(value / 255 + 0.055) ** 2.4 / 1.055**2.4 for value in color]


def test_vertex_colors_are_multiplied_by_the_factor() -> None:
    """Both are linear; their product is the color of a part without a material."""
    rows = np.column_stack([np.linspace(0.1, 0.8, 8), np.full((8, 2), 0.5), np.ones(8)])
    factor = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 1.0, 0.25, 1.0]}}
    product = rows * [0.5, 1.0, 0.25, 1.0]
    bare = Gltf()
    for values, more in ((rows, {"material": 0}), (product, {})):
        made = painted(factor, {"COLOR_0": values})
        made.document["images"], made.document["textures"] = [], []
        if not more:
            del made.document["meshes"][0]["primitives"][0]["material"]
        bare.document[str(len(more))] = surface_of(load_glb(made.data())).colors
    assert np.abs(bare.document["0"].astype(int) - bare.document["1"]).max() <= 1
    assert len(np.unique(bare.document["0"], axis=0)) == 8


VARYING = np.column_stack([np.linspace(0.1, 0.8, 8), np.full((8, 2), 0.5), np.ones(8)])


def untextured(material: dict[str, Any], is_rewritten: bool = False) -> Gltf:
    """A cube with varying vertex colors, and with a feature that has it rewritten."""
    made = painted(material, {"COLOR_0": VARYING})
    made.document["images"], made.document["textures"] = [], []
    return made.use("KHR_mesh_quantization") if is_rewritten else made


@pytest.mark.parametrize("is_rewritten", [False, True])
@pytest.mark.parametrize("factor", [None, [1, 1, 1], [0.5, 1.0, 0.25, 1.0]])
def test_vertex_colors_keep_their_material(factor: list[float] | None, is_rewritten: bool) -> None:
    """Without one, viewers show a metal. The factor is in the colors."""
    look = {"metallicFactor": 0} | ({} if factor is None else {"baseColorFactor": factor})
    others = {"doubleSided": True, "emissiveFactor": [0.0, 0.1, 0.0], "name": "paint"}
    made = untextured(others | {"pbrMetallicRoughness": look}, is_rewritten)
    plain = read_features(made.data(), "cube.glb")
    assert plain.notes == ()
    primitive = plain.document["meshes"][0]["primitives"][0]
    found = plain.document["materials"][primitive["material"]]
    assert {key: found[key] for key in others} == others
    assert found["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert set(found["pbrMetallicRoughness"].get("baseColorFactor", [1])) == {1}
    document, binary = open_glb(plain.data)
    stored = Arrays(document, [binary], {}, {}).numbers(primitive["attributes"]["COLOR_0"])
    product = VARYING * (np.ones(4) if factor is None else [*factor, 1.0][:4])
    np.testing.assert_allclose(stored, product, atol=1e-6)
    colors = surface_of(load_glb(made.data())).colors
    np.testing.assert_allclose(colors, encoded(product[:, :3]).reshape(-1, 3), atol=0.51)
    assert np.array_equal(surface_of(load_glb(plain.data)).colors, colors)
    assert read_features(plain.data).data == plain.data
    assert (plain.data == made.data()) == (not is_rewritten and factor != [0.5, 1.0, 0.25, 1.0])


@pytest.mark.parametrize("is_rewritten", [False, True])
@pytest.mark.parametrize(("strength", "shown"), [(None, (170, 124, 89)), (2.0, (231, 170, 124)), (100.0, (255, 255, 255)), (0, (0, 0, 0))])
@pytest.mark.parametrize("is_painted", [False, True])
def test_emitted_light_is_shown_times_its_strength(
    strength: float | None, shown: tuple[int, ...], is_rewritten: bool, is_painted: bool
) -> None:
    material: dict[str, Any] = {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}, "emissiveFactor": [0.4, 0.2, 0.1]}
    if strength is not None:
        material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
    made = untextured(material, is_rewritten)
    if not is_painted:
        del made.document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    plain = read_features(made.data(), "cube.glb")
    assert plain.notes == ()
    for data in (made.data(), plain.data):
        assert np.unique(surface_of(load_glb(data)).colors, axis=0).tolist() == [list(shown)]


def test_vertex_colors_over_a_texture_are_read_as_their_mean() -> None:
    factor = [0.5, 1.0, 0.25, 1.0]
    material = colored_by()
    material["pbrMetallicRoughness"]["baseColorFactor"] = factor
    made = painted(material, {"TEXCOORD_0": RIGHT, "COLOR_0": VARYING})
    light = VARYING.mean(axis=0)[:3] * factor[:3] * linear_of(RED)
    found = surface_of(load_glb(made.data())).colors
    np.testing.assert_allclose(found, np.tile(encoded(light), (8, 1)), atol=1)


def test_other_textures_of_painted_vertices_are_kept_in_the_file() -> None:
    material = {"normalTexture": {"index": 0}, "pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}}}
    plain = read_features(painted(material, {"TEXCOORD_0": RIGHT, "COLOR_0": VARYING}).data())
    assert any("other than the base color" in note for note in plain.notes)
    assert plain.document["materials"][0]["normalTexture"] == {"index": 0}
    assert set(plain.document["meshes"][0]["primitives"][0]["attributes"]) == {"POSITION", "TEXCOORD_0", "COLOR_0"}
    assert read_features(plain.data).data == plain.data
    assert len(np.unique(surface_of(load_glb(plain.data)).colors, axis=0)) == 8


def test_arrays_share_the_memory_of_their_buffer() -> None:
    """A copy of the view for each accessor would make the cost the product of both."""
    made = painted(colored_by(), {"TEXCOORD_0": RIGHT})
    document, binary = open_glb(made.data())
    arrays, buffer = Arrays(document, [binary], {}, {}), np.frombuffer(binary, np.uint8)
    assert all(np.shares_memory(arrays.raw(index), buffer) for index in range(len(document["accessors"])))


@pytest.mark.parametrize("is_normalized", [False, True])
@pytest.mark.parametrize(("dtype", "most"), [("u1", 255), ("u2", 65535)])
def test_vertex_colors_of_whole_numbers_are_those_of_floats(dtype: str, most: int, is_normalized: bool) -> None:
    floats = np.tile([1.0, 0.6, 0.2, 1.0], (8, 1))
    floats[0] = [0.2, 0.2, 1.0, 1.0]
    expected = painted({}, {"COLOR_0": floats})
    found = painted({}, {})
    found.document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = found.accessor(
        np.round(floats * most), dtype, normalized=is_normalized
    )
    for made in (expected, found):
        del made.document["meshes"][0]["primitives"][0]["material"]
    colors = [surface_of(load_glb(made.data())).colors.astype(int) for made in (expected, found)]
    assert np.abs(colors[0] - colors[1]).max() <= 1


@pytest.mark.parametrize(
    ("made", "note"),
    [
        (painted(colored_by(), {"TEXCOORD_0": RIGHT, "COLOR_0": np.eye(4)[[0, 1, 2, 3] * 2]}),
         "vertex colors over a texture are read as their mean"),
        (painted(colored_by(), {}), "lacks the texture coordinates 0 of its base color"),
        (painted(colored_by(texCoord=2), {"TEXCOORD_0": RIGHT}), "lacks the texture coordinates 2 of its base color"),
        (painted(colored_by() | {"normalTexture": {"index": 0, "texCoord": 1}}, {"TEXCOORD_0": RIGHT, "TEXCOORD_1": LEFT}),
         "its normalTexture has texture coordinates of its own"),
        (painted(colored_by(), {"TEXCOORD_0": RIGHT}, b"no image", "image/png"), "image 0 (image/png) cannot be decoded"),
        (painted(colored_by(), {"TEXCOORD_0": RIGHT}, picture("uastc")[:90], "image/ktx2"), "image 0: KHR_texture_basisu: cannot"),
        (painted(colored_by(), {"TEXCOORD_0": RIGHT}, extensions={"ACME_image": {"source": 0}}), "texture 0 names no image that is read"),
        (painted(gloss(diffuseFactor=[1, 0, 0, 1], specularFactor=[1, 1, 0]), {}), "specular colors are not read"),
        (painted(colored_by(), {"TEXCOORD_0": np.zeros((7, 2))}), "TEXCOORD_0 are not as many as its positions"),
    ],
)  # fmt: skip
def test_looks_that_are_not_read_are_noted(made: Gltf, note: str) -> None:
    plain = read_features(made.data(), "cube.glb")
    assert any(note in one for one in plain.notes), plain.notes
    assert len(load_glb(plain.data)[0].faces) == 12


def test_a_cut_image_that_would_be_extended_is_refused() -> None:
    made = wrapped([1.25, 0.5], MIRROR)
    image = made.document["bufferViews"][made.document["images"][0]["bufferView"]]
    image["byteLength"] = 60
    with pytest.raises(InputError, match=r"^cube\.glb: images: 0 cannot be decoded"):
        load_glb(made.data(), "cube.glb")


@pytest.mark.parametrize("image", [b"no image", picture("uastc")[:90]])
def test_a_texture_that_cannot_be_decoded_is_no_texture(image: bytes) -> None:
    made = painted(colored_by(), {"TEXCOORD_0": RIGHT}, image, "image/ktx2", extensions={"KHR_texture_basisu": {"source": 0}})
    parts = load_glb(made.use("KHR_texture_basisu").data())
    assert material_of(parts[0])[0] is None
    facts = {"provider": "library", "name": "a", "category": "box", "source": "a", "license": "CC0-1.0"}
    assert make_asset(parts, **facts).asset.has_texture is False
    assert make_asset(load_glb(RED_CUBES["UASTC"].data()), **facts).asset.has_texture is True


def shown(image: np.ndarray, uv: np.ndarray, wraps: tuple[int, int]) -> np.ndarray:
    """Pixels that a viewer shows at coordinates with wrap modes, nearest lookup."""
    found = []
    for axis, (wrap, length) in enumerate(zip(wraps, (image.shape[1], image.shape[0]), strict=True)):
        place = np.floor(uv[:, axis] * length).astype(int)
        if wrap == CLAMP:
            place = np.clip(place, 0, length - 1)
        elif wrap == MIRROR:
            place = place % (2 * length)
            place = np.minimum(place, 2 * length - 1 - place)
        else:
            place %= length
        found.append(place)
    return image[found[1], found[0]]


@example([(0.0, 0.0, 0.0, 1.0, 1.0, -0.0625)], (CLAMP, CLAMP))
@given(
    st.lists(st.tuples(*[st.floats(-1.4, 2.4)] * 6), min_size=1, max_size=4),  # farther out, images would grow too large
    st.tuples(*[st.sampled_from([CLAMP, MIRROR, REPEAT])] * 2),
)
def test_a_repeated_image_shows_what_its_wrap_modes_show(triangles: list[tuple[float, ...]], wraps: tuple[int, int]) -> None:
    """Everywhere in a triangle, not only at its corners."""
    uv = np.array(triangles).reshape(-1, 2)
    faces = np.arange(len(uv)).reshape(-1, 3)
    image = np.arange(5 * 7).reshape(5, 7)
    found = repeated_lookup(uv, faces, wraps, (7, 5))
    assert found.is_exact
    extended = image
    for axis, side in ((1, 0), (0, 1)):
        widths = [(0, 0), (0, 0)]
        widths[axis] = (found.padding.before[side], found.padding.after[side])
        extended = np.pad(extended, widths, mode="symmetric" if found.padding.is_mirrored[side] else "edge")
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], 40)
    there, here = (np.einsum("kc,fcd->fkd", weights, values[faces]).reshape(-1, 2) for values in (uv, found.uv))
    size = np.array([7, 5])
    # Corners within half a pixel outside of a clamped edge are drawn to it: places in their triangles move by no more.
    outside = np.maximum(np.maximum(-uv, uv - 1.0), 0.0) * size
    drawn = np.where((np.array(wraps) == CLAMP) & (outside <= 0.5), outside, 0.0).max(axis=0)
    is_clear = (np.abs((there * size) - np.round(there * size)) > 0.02 + drawn).all(axis=1)
    assert np.array_equal(shown(extended, here[is_clear], (REPEAT, REPEAT)), shown(image, there[is_clear], wraps))
