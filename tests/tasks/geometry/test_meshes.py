"""Meshes through GLB and PLY and back; rays against meshes whose answer is known."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from schemas.errors import InputError
from tasks.geometry import meshes
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import look_at


def colored_box(extents=(1.0, 2.0, 3.0), color=(200, 30, 40)) -> trimesh.Trimesh:
    box = trimesh.creation.box(extents)
    box.visual.vertex_colors = np.tile([*color, 255], (len(box.vertices), 1)).astype(np.uint8)
    return box


def test_a_glb_is_y_up_and_comes_back_z_up() -> None:
    box = colored_box()
    box.apply_translation([5, 6, 7])
    data = meshes.dump_glb([box], ["thing"])
    outside = trimesh.load_scene(io.BytesIO(data), file_type="glb")
    assert np.allclose(outside.bounds[0], [4.5, 5.5, -7.0]), "whoever reads it sees +Y up"
    (back,) = meshes.load_glb(data)
    assert back.metadata["name"] == "thing"
    assert np.allclose(back.bounds, box.bounds, atol=1e-6)
    assert back.is_volume
    assert np.array_equal(meshes.vertex_colors(back), np.tile([200, 30, 40], (8, 1)))


def test_the_same_parts_give_the_same_bytes() -> None:
    assert meshes.dump_glb([colored_box()]) == meshes.dump_glb([colored_box()])


@pytest.mark.parametrize("data", [b"", b"glTF", b"not a glb at all", meshes.dump_glb([colored_box()])[:-40]])
def test_what_is_no_glb_is_refused_by_name(data: bytes) -> None:
    with pytest.raises(InputError, match=r"chair\.glb"):
        meshes.load_glb(data, "chair.glb")


def textured(quality: int) -> tuple[bytes, bytes]:
    """A GLB with a JPEG texture, and that JPEG."""
    rng = np.random.default_rng(0)
    buffer = io.BytesIO()
    Image.fromarray(rng.integers(0, 255, (64, 64, 3), dtype=np.uint8)).save(buffer, "JPEG", quality=quality)
    box = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.open(io.BytesIO(buffer.getvalue())))
    box.visual = trimesh.visual.TextureVisuals(uv=rng.random((8, 2)), material=material)
    return bytes(trimesh.Scene(box).export(file_type="glb")), buffer.getvalue()


def test_textures_pass_through_without_a_second_loss() -> None:
    first, _ = textured(60)
    parts = meshes.load_glb(first)
    once = meshes.dump_glb(meshes.canonical(parts))
    assert meshes.dump_glb(meshes.canonical(parts)) == once, "writing must not use up the parts"
    twice = meshes.dump_glb(meshes.load_glb(once))
    tree = [np.asarray(meshes.material_of(meshes.load_glb(data)[0])[0]) for data in (first, once, twice)]
    assert np.array_equal(tree[0], tree[1])
    assert np.array_equal(tree[1], tree[2])
    assert len(twice) <= len(first) + 200


def test_a_house_by_others_goes_through(realdata: Callable[[str], Path]) -> None:
    data = (realdata("assets") / "aws_ChairA_01.glb").read_bytes()
    before = meshes.surface_of(meshes.load_glb(data))
    after = meshes.surface_of(meshes.load_glb(meshes.dump_glb(meshes.load_glb(data))))
    assert np.allclose(before.bounds, after.bounds, atol=1e-5)
    assert len(before.faces) == len(after.faces)
    assert before.bounds[0, 2] == pytest.approx(0, abs=0.05), "it stands upright"


@settings(max_examples=50)
@given(st.integers(1, 200), st.integers(0, 2**32 - 1))
def test_points_survive_their_file(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, colors = rng.normal(size=(count, 3)).astype(np.float32), rng.integers(0, 256, (count, 3), dtype=np.uint8)
    data = meshes.dump_points(points, colors)
    back, paint = meshes.read_points(data)
    assert np.array_equal(back, points.astype(np.float64))
    assert np.array_equal(paint, colors)
    cloud = trimesh.load(io.BytesIO(data), file_type="ply")
    assert np.allclose(cloud.vertices, points), "an independent reader agrees"
    with pytest.raises(InputError):
        meshes.read_points(data[:-1] + b"xx")


def test_samples_lie_on_the_surface_evenly() -> None:
    box = colored_box((1, 1, 4))
    surface = meshes.surface_of([box])
    points, colors, normals = meshes.sample_surface(surface, 4000, np.random.default_rng(0))
    half = np.array([0.5, 0.5, 2.0])
    assert np.allclose(np.max(np.abs(points) / half, axis=1), 1)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    assert (colors == [200, 30, 40]).all()
    ends = (np.abs(points[:, 2]) > 2 - 1e-9).mean()
    assert ends == pytest.approx(2 / 18, abs=0.01)


def test_canonical_stands_on_its_origin() -> None:
    box = colored_box()
    box.apply_translation([3, 4, 5])
    bounds = meshes.surface_of(meshes.canonical([box])).bounds
    assert np.allclose(bounds, [[-0.5, -1, 0], [0.5, 1, 3]])
    assert np.allclose(box.bounds[0], [2.5, 3, 3.5]), "the caller's own is untouched"


def test_rays_give_depth_identity_and_color() -> None:
    near, far = colored_box((1, 1, 1), (255, 0, 0)), colored_box((4, 4, 0.5), (0, 0, 255))
    near.apply_translation([0, 0, 1])
    far.apply_translation([0, 0, -1])
    camera = Camera.with_fov(look_at([0, 0, 5], [0, 0, 0]), 65, 65, 1.2)
    view = RayScene([near, far]).render(camera, shade=False)
    middle, corner = (32, 32), (32, 20)
    assert view.part[middle] == 0
    assert view.depth[middle] == pytest.approx(3.5, abs=1e-5)
    assert tuple(view.color[middle]) == (255, 0, 0)
    assert view.part[corner] == 1
    assert view.depth[corner] == pytest.approx(5.75, abs=1e-5), "depth, not distance along the ray"
    assert view.part[0, 0] == -1
    assert np.isinf(view.depth[0, 0])
    with pytest.raises(ValueError, match="face names a vertex"):
        meshes.Surface(np.zeros((1, 3)), np.array([[0, 1, 2]]), np.zeros((1, 3), np.uint8))


def test_a_surface_out_of_the_cache_is_the_one_that_went_in() -> None:
    data = meshes.dump_glb([colored_box(), colored_box((0.5, 0.5, 0.5), (1, 2, 3))])
    cache: dict[str, bytes] = {}
    first = meshes.asset_surface("a.glb", {"a.glb": data}, "a.glb", cache)
    expected = meshes.surface_of(meshes.load_glb(data))
    again = meshes.asset_surface("a.glb", {}, "a.glb", cache)
    for surface in (first, again):
        for name in ("vertices", "faces", "colors"):
            column = getattr(surface, name)
            assert np.array_equal(column, getattr(expected, name))
            assert column.dtype == getattr(expected, name).dtype
    with pytest.raises(InputError, match=r"b\.glb"):
        meshes.asset_surface("b.glb", {"b.glb": b"no mesh"}, "b.glb", cache)
    assert list(cache) == ["a.glb"], "what cannot be read is not remembered"


def test_a_union_is_all_of_its_surfaces_and_that_of_none_is_empty() -> None:
    rng = np.random.default_rng(0)
    parts = [
        meshes.Surface(rng.normal(size=(3 * n, 3)), rng.integers(0, 3 * n, (n, 3)), rng.integers(0, 256, (3 * n, 3)).astype(np.uint8))
        for n in (3, 1, 5)
    ]
    whole = meshes.union_of(parts)
    for values in ("vertices", "colors"):
        corners = [getattr(part, values)[part.faces] for part in parts]
        assert np.array_equal(getattr(whole, values)[whole.faces], np.concatenate(corners))
    for union in (whole, meshes.union_of([])):
        assert [values.dtype for values in (union.vertices, union.faces, union.colors)] == [np.float64, np.int64, np.uint8]
    assert len(meshes.union_of([]).vertices) == len(meshes.union_of([]).faces) == 0
