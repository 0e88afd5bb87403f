"""Pictures of triangles against rays that Embree casts, and against what a picture must be whoever draws it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from bench.policy.frames import EQUAL_DEPTHS, EQUAL_PARTS, HFOV, free_cameras, seen_by_rays
from tasks.geometry.meshes import load_glb
from tasks.geometry.rendering import Camera, RayScene
from tasks.simulation.rasterizer import NEAR_M, Pictures, Rasterizer
from tasks.simulation.soups import closed, soup_of

FOV = HFOV
Array = NDArray[np.float64]


def looking(eye: Sequence[float], yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Array:
    """An OpenCV camera at a point, heading `yaw`, turned down by `pitch` and about its axis by `roll` [rad]."""
    level = np.array([[math.sin(yaw), 0, math.cos(yaw)], [-math.cos(yaw), 0, math.sin(yaw)], [0, -1, 0]], dtype=float)
    turned = trimesh.transformations.euler_matrix(-pitch, 0, roll, "rxyz")[:3, :3]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = level @ turned, eye
    return pose


def seen_beside(scene: RayScene, pose: Array, width: int, height: int, aside: float) -> tuple[NDArray[np.int64], Array]:
    """Part and depth of rays that pass the middle of the pixels by a part of a pixel."""
    plain = Camera.with_fov(pose, width, height, FOV)
    return seen_by_rays(scene, Camera(pose, plain.fx, plain.fy, plain.cx - aside, plain.cy - aside, width, height))


def solids(seed: int, count: int) -> list[trimesh.Trimesh]:
    """Boxes, spheres and cones at random places."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        kind = rng.integers(3)
        mesh = [
            lambda: trimesh.creation.box(rng.uniform(0.1, 1.5, 3)), lambda: trimesh.creation.icosphere(2, rng.uniform(0.1, 0.7)),
            lambda: trimesh.creation.cone(rng.uniform(0.1, 0.6), rng.uniform(0.1, 1.2), sections=12),
        ][kind]()  # fmt: skip
        mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        mesh.apply_translation(rng.uniform(-2.5, 2.5, 3))
        mesh.visual = trimesh.visual.ColorVisuals(mesh, face_colors=np.tile([*rng.integers(0, 255, 3), 255], (len(mesh.faces), 1)))
        made.append(mesh)
    return made


def sheets(seed: int, count: int) -> list[trimesh.Trimesh]:
    """Triangles of all sizes, turned every way, each a part; many reach behind the camera and are seen from behind."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-2.5, 2.5, (count, 1, 3)) + rng.normal(0, rng.choice([0.05, 0.5, 5.0], (count, 1, 1)), (count, 3, 3))
    return [trimesh.Trimesh(corner, [[0, 1, 2]], process=False) for corner in corners]


def check_as_rays(parts: list[trimesh.Trimesh], poses: Sequence[Array], width: int = 48, height: int = 40) -> None:
    """Every pixel is what a ray through it meets; beside the edge of a face, what a ray a hundredth of a pixel aside meets."""
    pictures, rays = Rasterizer(soup_of(parts)).render(np.array(poses), width, height, FOV), RayScene(parts)
    for index, pose in enumerate(poses):
        part, depth = seen_beside(rays, pose, width, height, 0.0)
        is_other = (part != pictures.part[index]) | (np.abs(depth - pictures.depth[index]) > 1e-4 * np.maximum(1.0, depth**2))
        explained = ~is_other
        for aside in (-0.01, 0.01, -0.03, 0.03):
            near, far = seen_beside(rays, pose, width, height, aside)
            explained |= (near == pictures.part[index]) & (np.abs(far - pictures.depth[index]) < 0.02 * np.maximum(1.0, far**2))
        assert is_other.mean() < 0.01
        assert explained.all(), f"pose {index}: {np.argwhere(~explained)[:3].tolist()}"


def check_as_rays_on_the_whole(parts: list[trimesh.Trimesh], poses: Array) -> None:
    """Parts and depths of nearly all pixels are those of rays: of all but what lies on edges, to rounding."""
    pictures, rays = Rasterizer(soup_of(parts)).render(poses, 128, 128, FOV), RayScene(parts)
    seen = [seen_by_rays(rays, Camera.with_fov(pose, 128, 128, FOV)) for pose in poses]
    assert np.mean([part == drawn for (part, _), drawn in zip(seen, pictures.part, strict=True)]) >= EQUAL_PARTS
    assert np.mean([np.abs(depth - drawn) <= 1e-3 for (_, depth), drawn in zip(seen, pictures.depth, strict=True)]) >= EQUAL_DEPTHS
    assert len(np.unique(pictures.part)) > 5


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 30), st.floats(0, 6.3), st.floats(-1.5, 1.5), st.floats(0, 6.3))
def test_solids_are_what_rays_meet_from_outside_and_inside(seed: int, count: int, yaw: float, pitch: float, roll: float) -> None:
    parts = solids(seed, count)
    eyes = [*np.random.default_rng(seed + 1).uniform(-3, 3, (2, 3)), parts[0].center_mass]
    check_as_rays(parts, [looking(eye, yaw, pitch, roll) for eye in eyes])


@settings(max_examples=30)
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(1e-4, 2 * NEAR_M), st.floats(-0.9, 0.9))
def test_solids_that_the_near_plane_cuts_open_show_their_inside(y: float, z: float, before: float, yaw: float) -> None:
    box = trimesh.creation.box((1, 1, 1))
    assert not soup_of([box]).double_sided.any()
    check_as_rays([box], [looking((-0.5 - before, y, z), yaw)])


def test_right_below_a_corner_and_an_edge_a_camera_is_outside() -> None:
    box = trimesh.creation.box((1, 1, 1)).apply_translation([0, 0, 2])
    for eye in ((0.5, 0.5, 0), (0.5, 0, 0), (0, 0, 0), (-0.5, -0.5, 0)):
        for pitch in (-1.4, 0.0):
            check_as_rays([box], [looking(eye, yaw, pitch) for yaw in (0.1, 2.0, 4.0)])


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 60), st.floats(0, 6.3), st.floats(-1.5, 1.5), st.floats(0, 6.3))
def test_sheets_are_what_rays_meet_from_either_side_and_through_the_camera(
    seed: int, count: int, yaw: float, pitch: float, roll: float
) -> None:
    parts = sheets(seed, count)
    assert soup_of(parts).double_sided.all()
    check_as_rays(parts, [looking((0, 0, 0), yaw, pitch, roll)])


def test_a_point_is_where_it_is_projected_to() -> None:
    pose, at = looking((0.3, -0.2, 0.9), 0.4, 0.2), np.array([2.0, 1.1, 0.6])
    dot = trimesh.creation.icosphere(1, 0.004)
    dot.apply_translation(at)
    pictures = Rasterizer(soup_of([dot])).render([pose], 401, 301, FOV)
    (pixel,), (depth,) = Camera.with_fov(pose, 401, 301, FOV).project(at[None])
    rows, columns = np.nonzero(pictures.part[0] == 0)
    np.testing.assert_allclose([columns.mean(), rows.mean()], pixel, atol=0.5)
    np.testing.assert_allclose(pictures.depth[0][rows, columns], depth, atol=0.005)


def test_a_batch_is_its_pictures_one_by_one_by_any_number_of_threads_into_any_buffer() -> None:
    rasterizer = Rasterizer(soup_of(solids(3, 20)))
    poses = np.array([looking((0, 0, 0), 0.3 * number, 0.1) for number in range(12)])
    batch = rasterizer.render(poses, 40, 30, FOV)
    used = Pictures(*(np.full_like(array, 77) for array in (batch.rgb, batch.depth, batch.part)))
    assert rasterizer.render(poses, 40, 30, FOV, used) is used
    with ThreadPoolExecutor(4) as pool:
        single = list(pool.map(lambda pose: rasterizer.render(pose, 40, 30, FOV), poses))
    for name in ("rgb", "depth", "part"):
        together = getattr(batch, name)
        assert together.tobytes() == getattr(used, name).tobytes()
        assert together.tobytes() == np.concatenate([getattr(one, name) for one in single]).tobytes()
    with pytest.raises(ValueError, match="has room for"):
        rasterizer.render(poses[:3], 40, 30, FOV, used)


def test_nothing_is_black_far_away_and_no_part() -> None:
    for parts in ([], [trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False)]):
        pictures = Rasterizer(soup_of(parts)).render([np.eye(4)], 8, 6, FOV)
        assert (pictures.rgb == 0).all()
        assert (pictures.depth == 0).all()
        assert (pictures.part == -1).all()


def test_textures_and_colors_are_those_that_rays_find_times_a_light_that_stands() -> None:
    image = np.random.default_rng(0).integers(0, 255, (16, 32, 3)).astype(np.uint8)
    vertices = np.array([[2, 1, -1], [2, -1, -1], [2, -1, 1], [2, 1, 1]], dtype=float)
    uv = np.array([[-0.3, 0.1], [1.4, 0.1], [1.4, 0.8], [-0.3, 0.8]])
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(image))
    wall = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)
    wall.visual = trimesh.visual.TextureVisuals(uv, material=material)
    ball = trimesh.creation.icosphere(3, 0.3)
    ball.apply_translation([1.5, 0.2, 0.1])
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=np.tile([40, 160, 90, 255], (len(ball.vertices), 1)))
    parts, pose = [wall, ball], looking((0, 0, 0), 0.0)
    soup = soup_of(parts)
    pictures = Rasterizer(soup).render([pose], 120, 90, FOV)
    rays = RayScene(parts).render(Camera.with_fov(pose, 120, 90, FOV), (0, 0, 0), shade=False)
    seen = np.abs(rays.normal)
    light = 0.6 + 0.25 * seen[..., 2] + 0.15 * seen[..., 0]
    expected = np.where((rays.part >= 0)[..., None], rays.color * light[..., None], 0)
    same = np.abs(expected - pictures.rgb[0]).max(axis=-1) <= 1.5
    plain = Rasterizer(soup).render([pose], 120, 90, FOV, textured=False)
    assert (plain.rgb[0] == pictures.rgb[0])[rays.part == 1].all()
    assert len(np.unique(plain.rgb[0][rays.part == 0], axis=0)) == 2, "a color for each face"
    assert same[rays.part == 1].all(), "colors of vertices"
    assert same[rays.part == 0].mean() > 0.99, "texels, but where a pixel lies on the border of two"
    assert len(np.unique(pictures.rgb[0][rays.part == 0], axis=0)) > 100


def test_large_textures_are_shrunk_to_their_mean() -> None:
    image = np.zeros((1024, 512, 3), np.uint8)
    image[::2], image[1::2] = 100, 200
    wall = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(image), baseColorFactor=[0.5, 1.0, 1.0, 1.0])
    wall.visual = trimesh.visual.TextureVisuals(np.zeros((3, 2)), material=material)
    (texture,) = soup_of([wall]).textures
    assert texture.shape == (128, 64, 3)
    assert np.abs(texture.astype(int) - [73, 150, 150]).max() <= 1


def test_only_what_has_an_inside_and_shows_its_outside_is_seen_from_one_side() -> None:
    box = trimesh.creation.box((1, 1, 1))
    lid = trimesh.Trimesh(box.vertices, box.faces[:-1], process=False)
    inside_out = trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False)
    seams = trimesh.Trimesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    twice = trimesh.Trimesh(box.vertices, np.concatenate([box.faces, box.faces[:, ::-1]]), process=False)
    for mesh, expected in ((box, True), (lid, False), (inside_out, False), (seams, True), (twice, False)):
        assert closed(mesh.vertices, mesh.faces).tolist() == [expected] * len(mesh.faces)
    both = trimesh.util.concatenate([box, inside_out.copy().apply_translation([3, 0, 0])])
    assert closed(both.vertices, both.faces).tolist() == [True] * 12 + [False] * 12
    assert closed(np.zeros((0, 3)), np.zeros((0, 3), int)).shape == (0,)


@pytest.mark.whole
@pytest.mark.realdata
def test_a_house_by_others_is_what_rays_meet(realdata: Callable[[str], Path]) -> None:
    parts = load_glb((realdata("scene_aws_small_house") / "house.glb").read_bytes())
    check_as_rays_on_the_whole(parts, free_cameras(parts, 40, 0))
