"""Fusion of depth images: surfaces that are known, seen without noise."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry import fusion
from tasks.geometry.fusion import Volume, without_small_pieces
from tasks.geometry.meshes import Surface
from tasks.geometry.rendering import Camera, RayScene

VOXEL = 0.02


def looking(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """OpenCV camera to world of a camera that looks at a target."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross([0.1, 0.2, -1.0], z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), eye
    return pose


def integrate(volume: Volume, scene: RayScene, pose: np.ndarray, color: tuple[int, int, int] = (200, 100, 50), width: int = 160) -> None:
    camera = Camera.with_fov(pose, width, width * 3 // 4, 1.0)
    depth = scene.cast(camera.rays())["t_hit"]
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    image = np.full((*depth.shape, 3), color, dtype=np.uint8)
    volume.integrate(np.where(np.isfinite(depth), depth, 0), image, lens, lens, pose, 5.0)


def around(mesh: trimesh.Trimesh, distance: float, count: int = 10, offset: float = 0.0) -> list[np.ndarray]:
    directions = trimesh.creation.icosphere(subdivisions=0).vertices[:count]
    return [looking(mesh.centroid + distance * (d + offset), mesh.centroid) for d in directions]


def test_a_fused_sphere_lies_within_a_fraction_of_a_voxel_of_the_truth() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    ball.apply_translation([0.3, -0.2, 1.0])
    volume, scene = Volume(VOXEL, 4.0), RayScene([ball])
    for pose in around(ball, 1.6, 12):
        integrate(volume, scene, pose)
    surface = volume.surface(0.5, 100)
    off = np.linalg.norm(surface.vertices - [0.3, -0.2, 1.0], axis=1) - 0.5
    assert np.abs(off).mean() < 0.15 * VOXEL
    assert abs(off.mean()) < 0.1 * VOXEL
    assert np.quantile(np.abs(off), 0.99) < 0.5 * VOXEL
    mesh = surface.to_trimesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.5**3, rel=0.03)  # positive: faces look at the cameras
    assert (surface.colors == (200, 100, 50)).all()


@settings(max_examples=15, deadline=None)
@given(tilt=st.floats(-0.9, 0.9), turn=st.floats(-3, 3), distance=st.floats(0.8, 2.5), width=st.sampled_from([64, 160, 320]))
def test_a_slanted_plane_is_where_it_is(tilt: float, turn: float, distance: float, width: int) -> None:
    """Pixels stand for what is around their centers: half a pixel aside would put a plane of 45 degrees off by half a pixel's size."""
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    frame = trimesh.geometry.align_vectors([0, 0, 1], normal)
    frame[:3, 3] = [0, 0, distance]
    plane = trimesh.creation.box((20, 20, 0.001), transform=frame)
    volume = Volume(VOXEL, 4.0)
    integrate(volume, RayScene([plane]), np.eye(4), width=width)
    surface = volume.surface(0.5, 50)
    off = (surface.vertices - [0, 0, distance]) @ normal - 0.0005
    pixel = distance / (0.5 * width / np.tan(0.5))
    assert abs(off.mean()) < 0.1 * VOXEL + 0.05 * pixel
    inner = np.linalg.norm(surface.vertices[:, :2], axis=1) < 0.2
    assert inner.any()
    assert abs(off[inner].mean()) < 0.1 * VOXEL + 0.1 * pixel


def test_colors_are_means_and_single_looks_do_not_count() -> None:
    wall = trimesh.creation.box((4, 4, 0.01))
    scene, pose = RayScene([wall]), looking(np.array([0, 0, 1.5]), np.zeros(3))
    volume = Volume(VOXEL, 4.0)
    for level in (10, 20, 60):
        integrate(volume, scene, pose, (level, 0, 255))
    surface = volume.surface(2.0)
    assert len(surface.faces) > 1000
    assert (surface.colors == (30, 0, 255)).all()
    assert not len(volume.surface(3.0).faces), "more than three looks were asked for, three were had"


def test_the_same_frames_give_the_same_bytes_however_often_the_grid_grew(monkeypatch: pytest.MonkeyPatch) -> None:
    box = trimesh.creation.box((0.8, 0.6, 0.5))
    scene, found = RayScene([box]), []
    for first in (4096, 4096, 2, 64):
        monkeypatch.setattr(fusion, "_FIRST_BLOCKS", first)
        volume = Volume(VOXEL, 3.0)
        for pose in around(box, 1.5):
            integrate(volume, scene, pose)
        surface = volume.surface(0.5)
        found.append((volume.blocks, surface.vertices.tobytes(), surface.faces.tobytes(), surface.colors.tobytes()))
    assert found[0][0] > 64
    assert found.count(found[0]) == len(found)


def test_a_move_of_the_world_by_whole_voxels_moves_the_mesh() -> None:
    box = trimesh.creation.box((0.8, 0.6, 0.5))
    scene, shift = RayScene([box]), np.array([-317, 1204, -55]) * VOXEL
    volumes = [Volume(VOXEL, 3.0), Volume(VOXEL, 3.0)]
    camera = Camera.with_fov(np.eye(4), 160, 120, 1.0)
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    for pose in around(box, 1.5, offset=0.0371):  # off the axes: no voxel falls between two pixels
        depth = scene.cast(Camera(pose, *lens, 160, 120).rays())["t_hit"]
        for volume, by in zip(volumes, (np.zeros(3), shift), strict=True):
            moved = pose.copy()
            moved[:3, 3] += by
            volume.integrate(np.where(np.isfinite(depth), depth, 0), np.zeros((120, 160, 3), np.uint8), lens, lens, moved, 5.0)
    here, there = (volume.surface(0.5) for volume in volumes)
    assert here.to_trimesh().area == pytest.approx(there.to_trimesh().area, rel=0.01)
    assert np.abs(here.bounds + shift - there.bounds).max() < 0.5 * VOXEL


@pytest.mark.parametrize("reading", [0.0, -1.0, np.nan, np.inf, 5.1])
def test_what_is_no_reading_leaves_no_trace(reading: float) -> None:
    volume = Volume(VOXEL, 4.0)
    volume.integrate(
        np.full((120, 160), reading), np.zeros((120, 160, 3), np.uint8), (140, 140, 79.5, 59.5), (140, 140, 79.5, 59.5), np.eye(4), 5
    )
    assert volume.blocks == 0
    assert not len(volume.surface(0.5).vertices)


def test_a_pose_beyond_the_grid_is_harmless() -> None:
    volume, pose = Volume(VOXEL, 4.0), np.eye(4)
    pose[0, 3] = 1e12
    volume.integrate(np.ones((120, 160)), np.zeros((120, 160, 3), np.uint8), (140, 140, 79.5, 59.5), (140, 140, 79.5, 59.5), pose, 5.0)
    assert volume.blocks == 0


def test_small_pieces_and_loose_vertices_go() -> None:
    big, small = trimesh.creation.icosphere(subdivisions=2), trimesh.creation.box((0.1, 0.1, 0.1))
    vertices = np.concatenate([small.vertices, [[9, 9, 9]], big.vertices])
    colors = np.arange(3 * len(vertices)).reshape(-1, 3).astype(np.uint8)
    whole = Surface(vertices, np.concatenate([small.faces, big.faces + 9]).astype(np.int64), colors)
    for least, corners in ((13, big.vertices), (12, np.concatenate([small.vertices, big.vertices])), (321, np.zeros((0, 3)))):
        kept = without_small_pieces(whole, least)
        assert np.array_equal(kept.vertices, corners)
        assert len(np.unique(kept.faces)) == len(kept.vertices)
    left = without_small_pieces(whole, 13)
    assert np.array_equal(left.vertices[left.faces], big.vertices[big.faces])
    assert np.array_equal(left.colors, colors[9:])


def test_no_block_is_missed_wherever_an_object_lies_on_the_grid() -> None:
    """An object in a room, seen from everywhere: its mesh has no border."""
    for shift in itertools.product((0.0, 0.083), (0.0, 0.161), (0.04,)):
        box, room = trimesh.creation.box((0.5, 0.4, 0.3)), trimesh.creation.box((4, 4, 4))
        box.apply_translation(shift)
        volume, scene = Volume(VOXEL, 3.0), RayScene([box, room])
        for pose in around(box, 1.2, 12):
            integrate(volume, scene, pose, width=240)
        surface = volume.surface(0.5, 500)
        edges = np.sort(np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]]), axis=1)
        pairs, times = np.unique(edges @ [len(surface.vertices), 1], return_counts=True)
        near = np.linalg.norm(surface.vertices[pairs // len(surface.vertices)] - box.centroid, axis=1) < 0.5
        assert near.sum() > 5000
        assert (times[near] == 2).all()
