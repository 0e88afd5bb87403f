"""What cameras see and see past, against every ray held against every triangle; and where cameras come from."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.capture import Frame, Shell
from tasks.fidelity.cameras import frame_cameras, virtual_cameras
from tasks.fidelity.replicas import ReplicaRays, ReplicaSurface
from tasks.fidelity.visibility import seen_past, visible
from tasks.geometry.meshes import union_of
from tasks.geometry.rendering import Camera, RayScene, in_picture
from tasks.geometry.transforms import flat, look_at
from tests.samples import sample

SEEDS = st.integers(0, 2**32 - 1)
BEHIND, MARGIN = 0.1, 0.05


def first_hit(eye: np.ndarray, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """How far rays from an eye through points get before they meet a triangle [m], by solving for each of them, (n,)."""
    reached = np.full(len(points), np.inf)
    for row, point in enumerate(points):
        way = (point - eye) / np.linalg.norm(point - eye)
        for a, b, c in triangles:
            system = np.stack([b - a, c - a, -way], axis=1)
            if abs(np.linalg.det(system)) < 1e-12:
                continue
            u, v, t = np.linalg.solve(system, eye - a)
            if u >= 0 and v >= 0 and u + v <= 1 and t > 0:
                reached[row] = min(reached[row], t)
    return reached


def triangles(rng: np.random.Generator, count: int) -> trimesh.Trimesh:
    corners = rng.uniform(-1, 1, (count, 1, 3)) + 0.5 * rng.normal(size=(count, 3, 3))
    return trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), process=False)


def rays_of(*parts: trimesh.Trimesh) -> ReplicaRays:
    """A replica without a room."""
    return ReplicaRays(ReplicaSurface({"0001": parts}, union_of([])))


@pytest.mark.whole
@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_rays_say_what_every_triangle_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    replica, scan = triangles(rng, 6), triangles(rng, 6)
    eyes = [np.array(eye) for eye in ((4.0, 0.5, 0.3), (-0.2, 4.0, 1.0))]
    cameras = [Camera.with_fov(look_at(eye, (0, 0, 0)), 64, 48, 1.0) for eye in eyes]
    weights = rng.dirichlet((1, 1, 1), (6, 8))
    points = np.einsum("fnk,fkd->fnd", weights, replica.triangles).reshape(-1, 3)
    wanted, past, doubtful = (np.zeros(len(points), dtype=bool) for _ in range(3))
    for camera, eye in zip(cameras, eyes, strict=True):
        inside = in_picture(camera, points)
        pixel, depth = camera.project(points)
        assert (inside == ((depth > 0.003) & (np.abs(pixel - (31.5, 23.5)) <= (32, 24)).all(axis=1))).all()
        length = np.linalg.norm(points - eye, axis=1)
        own, read = first_hit(eye, points, replica.triangles), first_hit(eye, points, scan.triangles)
        wanted |= inside & (np.abs(own - length) <= 0.003) & np.isfinite(read) & (read >= length - BEHIND)
        past |= inside & np.isfinite(read) & (read >= length + MARGIN)
        # a ray that just passes an edge, or just reaches a limit, may go either way
        for step in 1e-4 * np.eye(3):
            for before, mesh in ((own, replica), (read, scan)):
                doubtful |= ~np.isclose(before, first_hit(eye + step, points, mesh.triangles), rtol=0, atol=0.01)
        for limit in (own - length + 0.003, own - length - 0.003, read - length + BEHIND, read - length - MARGIN):
            doubtful |= np.abs(limit) < 1e-4
    sure = ~doubtful
    assert (visible(points, rays_of(replica), RayScene([scan]), cameras, BEHIND) == wanted)[sure].all()
    assert (seen_past(points, RayScene([scan]), cameras, MARGIN) == past)[sure].all()


def test_more_cameras_see_no_less_and_none_sees_nothing() -> None:
    rng = np.random.default_rng(5)
    mesh, scan = triangles(rng, 20), RayScene([triangles(rng, 20)])
    replica, points = rays_of(mesh), np.asarray(mesh.sample(300, seed=0))
    cameras = [Camera.with_fov(look_at(3 * way, (0, 0, 0)), 32, 24, 1.0) for way in np.eye(3)]
    before = np.zeros(len(points), dtype=bool)
    for count in range(4):
        now = visible(points, replica, scan, cameras[:count], BEHIND)
        assert (now >= before).all()
        before = now
        assert now.any() == (count > 0)
    assert not seen_past(points, RayScene([]), cameras, MARGIN).any(), "without a reading nothing is known to be empty"


def frame(number: int, pose: np.ndarray | None) -> Frame:
    return sample(
        Frame, frame_id=f"{number:06d}", width=640, height=480, intrinsics=(500.0, 510.0, 320.0, 235.0),
        pose=None if pose is None else flat(pose),
    )  # fmt: skip


def test_cameras_of_frames_are_evenly_chosen_and_see_what_the_frames_saw() -> None:
    poses = [look_at((0.1 * n, 0, 1), (0.1 * n, 1, 1)) for n in range(50)]
    frames = [frame(n, None if n % 7 == 3 else pose) for n, pose in enumerate(poses)]
    cameras = frame_cameras(frames[::-1], 5, 160)
    posed = [n for n in range(50) if n % 7 != 3]
    assert [round(camera.pose[0, 3] * 10) for camera in cameras] == [
        posed[i] for i in np.linspace(0, len(posed) - 1, 5).round().astype(int)
    ]
    full = Camera(poses[0], 500.0, 510.0, 320.0, 235.0, 640, 480)
    points = np.random.default_rng(0).uniform((-2, 0.5, -1), (2, 3, 3), (500, 3))
    pixel, _ = full.project(points)
    small, _ = cameras[0].project(points)
    assert small == pytest.approx((pixel + 0.5) / 4 - 0.5)
    assert (in_picture(cameras[0], points) == in_picture(full, points)).all()
    assert len(frame_cameras(frames, 1000, 160)) == len(posed)
    assert frame_cameras([frame(0, None)], 5, 160) == []


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.floats(2.2, 3.2))
def test_virtual_cameras_stand_free_over_the_floor_and_are_always_the_same(seed: int, height: float) -> None:
    rng = np.random.default_rng(seed)
    polygon = ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 3.5), (0.0, 3.5))
    room = sample(Shell, floor_polygon=polygon, height_m=height)
    points = np.concatenate([[[0, 0, 0], [4.0, 3.5, height]], rng.uniform((0, 0, 0), (4, 3.5, height), (12, 3))])
    cameras = virtual_cameras(room, points, 160)
    assert len(cameras) % 4 == 0
    assert 4 <= len(cameras) <= 16
    for camera, again in zip(cameras, virtual_cameras(room, points[rng.permutation(len(points))], 160), strict=True):
        assert np.array_equal(camera.pose, again.pose)
        eye = camera.pose[:3, 3]
        assert shapely.Polygon(polygon).contains(shapely.Point(eye[:2]))
        assert eye[2] == pytest.approx(min(1.5, 0.6 * height))
        assert np.linalg.norm(points - eye, axis=1).min() >= 0.3
    assert len(virtual_cameras(None, np.zeros((1, 3)), 160)) == 4, "a scan of one point has a camera, too"


@pytest.mark.parametrize("stray", [(0.0, 1e5, 1.0), (-1e6, 1e6, 1.0)])
@pytest.mark.parametrize("has_room", [True, False])
def test_a_stray_point_far_away_costs_no_more_cameras_nor_memory(stray: tuple[float, float, float], has_room: bool) -> None:
    polygon = ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0))
    room = sample(Shell, floor_polygon=polygon, height_m=2.5) if has_room else None
    points = np.array([[0, 0, 0], [4, 3, 2.5], [4, 0, 0], [0, 3, 0], [-3, -3, 0]], dtype=float)
    cameras = virtual_cameras(room, np.concatenate([points, [stray]]), 160)
    assert 4 <= len(cameras) <= 16
    if room is not None:
        assert all(shapely.Polygon(polygon).contains(shapely.Point(camera.pose[:2, 3])) for camera in cameras)
        assert len(cameras) == 16, "there are places in the room, as without the point"
