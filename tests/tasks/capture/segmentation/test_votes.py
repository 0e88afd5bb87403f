"""Tables seen from above in frames without labels: up for any pitch of the camera, and instances that views agree on."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from bench.capture.frames import write_scan
from schemas.record import check
from schemas.tables import TABLES
from tasks.capture import CaptureConfig, find_scans, run
from tasks.capture.fusion import FusionConfig, voxel_side
from tasks.capture.instances.segmentation import GeometryInstances
from tasks.capture.instances.views import camera_up
from tasks.capture.leveling import read_scan
from tasks.capture.reading import FrameSource, Reading, groups_of
from tasks.capture.segmentation.frame import FrameConfig
from tasks.capture.segmentation.gravity import scan_level
from tasks.capture.segmentation.votes import VoteConfig, _without_ground, is_tabletop, room_pixels, shown_share, voted_groups
from tasks.capture.small_objects.lifting import DepthView
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import matrix, translation
from tasks.stage import Context, Outcome
from tests.capture_scans import well_formed
from tests.tasks.capture.segmentation.test_frame import FLOOR, SHOWN, TOP, shown
from tests.tasks.capture.segmentation.test_strips import EYE_M, block, room


def reading_of(folder: Path, views: list[DepthView]) -> Reading:
    (scan,), _ = find_scans(write_scan(folder, views))
    return read_scan(scan)


def captured(folder: Path, views: list[DepthView]) -> Outcome:
    (scan,), _ = find_scans(write_scan(folder, views))
    return well_formed(run(scan=scan, context=Context(scan.scene_id, "capture", 0, {}), config=CaptureConfig()))


@pytest.mark.parametrize("pitch", [0.35, 0.8, 1.2])
def test_up_is_over_the_table_however_steep_the_camera_looks(pitch: float, tmp_path: Path) -> None:
    view, _ = shown(SHOWN, pitch)
    frames = reading_of(tmp_path / "table", [view]).frames
    level, up = scan_level(frames, 0.01, FrameConfig()), view.pose[2, :3]
    assert level is not None
    assert np.degrees(np.arccos(min(1.0, float(level.up @ up)))) < 0.3
    by_cameras = camera_up(frames)
    assert by_cameras is not None
    assert np.degrees(np.arccos(by_cameras @ up)) == pytest.approx(np.degrees(pitch), abs=1.0), "what was believed before"


def test_walls_that_level_cameras_see_are_not_what_carries_things(tmp_path: Path) -> None:
    """Three of four frames show a wall and no floor, which has a fifth of all pixels."""
    views = [room([], np.array([4.0, side, EYE_M]))[0] for side in (-0.4, 0.0, 0.4)]
    views = [*views, room([])[0]]
    level, up = scan_level(reading_of(tmp_path / "room", views).frames, 0.02, FrameConfig()), np.array([0.0, 0.0, 1.0])
    assert level is not None
    assert np.degrees(np.arccos(min(1.0, float(level.up @ up)))) < 0.5
    assert level.height_along(level.up) == pytest.approx(0.0, abs=0.01)


def test_pixels_of_the_room_are_those_whose_nearest_vertex_is(tmp_path: Path) -> None:
    view, owner = room([[block((0.4, 0.8, 0.9), 0.3, 0.0)]])
    points, has_depth = view.points(), view.depth > 0
    world = Surface(points[has_depth], np.zeros((0, 3), dtype=np.int64), view.color[has_depth])
    (seen,) = room_pixels(world, owner[has_depth] < 0, [view], 0.02)
    assert seen is not None
    assert (seen == (has_depth & (owner < 0))).all(), "each pixel lies on its own vertex"
    (moved,) = room_pixels(world.transformed(translation([0, 0, 5.0])), owner[has_depth] < 0, [view], 0.02)
    assert moved is not None
    assert not moved.any()
    assert room_pixels(world, np.zeros(has_depth.sum(), dtype=bool), [view], 0.02) == [None]


def test_the_share_that_a_view_shows_is_of_the_surface_and_not_of_its_vertices() -> None:
    """Half of the vertices are behind what is seen; they have a third of the area."""
    view, _ = room([])
    seen = view.points()[view.depth > 0]
    behind = view.pose[:3, 3] + 1.2 * (seen - view.pose[:3, 3])
    world = Surface(np.concatenate([seen, behind]), np.zeros((0, 3), dtype=np.int64), np.zeros((2 * len(seen), 3), dtype=np.uint8))
    areas = np.repeat([2.0, 1.0], len(seen))
    assert shown_share(world, areas, [view], 0.02) == pytest.approx(2 / 3)
    away = dataclasses.replace(view, pose=view.pose @ translation([0, 0, -50.0]))
    assert shown_share(world, areas, [view, view, away], 0.02) == pytest.approx(2 / 3), "the median"
    assert shown_share(world, areas, [away, away, view], 0.02) == 0.0
    assert shown_share(world, areas, [], 0.02) == 0.0
    assert shown_share(world, 0 * areas, [view], 0.02) == 0.0


def test_regions_of_the_surface_come_first_only_where_no_frame_shows_most_of_it(tmp_path: Path) -> None:
    """A cupboard that the surface has in two halves, and a frame as one: the frame is right where it shows all, not a fifth."""
    view, owner = room([[block((0.4, 0.8, 0.9), 0.3, 0.0)]])
    reading = reading_of(tmp_path / "room", [view])
    rows, columns = np.indices(view.depth.shape)
    pixel = rows * view.depth.shape[1] + columns
    quads = np.stack([part.ravel() for part in (pixel[:-1, :-1], pixel[1:, :-1], pixel[:-1, 1:], pixel[1:, 1:])], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [1, 3, 2]]])
    depths = view.depth.ravel()[faces]
    faces = faces[(depths.min(axis=1) > 0) & (np.ptp(depths, axis=1) < 0.1)]
    points, of = view.points().reshape(-1, 3), owner.ravel()
    labels = np.where(of < 0, 0, np.where(columns.ravel() > np.median(columns[owner >= 0]), 2, 1))

    def cupboards(more: int) -> list[int]:
        """Vertices of what is found of the cupboard, where so many walls as large as what is seen are far behind the camera."""
        vertices = np.concatenate([points - [20.0 * k, 0, 0] for k in range(more + 1)])
        joined = np.concatenate([faces + k * len(points) for k in range(more + 1)])
        world = Surface(vertices, joined, np.full(vertices.shape, 120, dtype=np.uint8))
        whose = np.concatenate([labels, np.zeros(more * len(points), dtype=np.int64)])
        named = [(str(i), f"geometry:{name}", np.flatnonzero(whose == i)) for i, name in enumerate(("wall", "unknown", "unknown"))]
        by_surface = GeometryInstances(groups_of(named, whose, world), {}, ())
        found = voted_groups(world, by_surface, reading.frames, view.pose, CaptureConfig().segmentation.naming, VoteConfig()).groups
        return [len(group.vertices) for group in found if not group.raw_label.endswith(":wall")]

    halves = [int((labels == 1).sum()), int((labels == 2).sum())]
    assert cupboards(0) == [pytest.approx(sum(halves), rel=0.05)]
    assert cupboards(4) == halves


@pytest.mark.parametrize("category", ["floor", "wall"])
def test_a_floor_that_drifting_frames_show_twice_is_one(category: str) -> None:
    heights = np.repeat([0.0, -0.06, 0.05], 50)
    world = Surface(np.column_stack([np.arange(150.0), np.zeros(150), heights]), np.zeros((0, 3), np.int64), np.zeros((150, 3), np.uint8))
    first, drifted, box = np.split(np.arange(150), 3)
    owner = np.where(np.arange(150) < 50, 0, -1)
    named = [(category, first)]
    kept = _without_ground(world, owner, named, [(drifted, False), (box, True)])
    is_floor = category == "floor"
    assert [members.tolist() for members, _ in kept] == ([box.tolist()] if is_floor else [drifted.tolist(), box.tolist()])
    assert np.array_equal(owner[drifted], np.full(50, 0 if is_floor else -1))
    assert len(named[0][1]) == (100 if is_floor else 50)


def test_frames_without_depth_or_plane_leave_it_to_cameras(tmp_path: Path) -> None:
    view, _ = shown(SHOWN, 0.8)
    empty = dataclasses.replace(view, depth=np.zeros_like(view.depth))
    level = scan_level(reading_of(tmp_path / "table", [empty]).frames, 0.01, FrameConfig())
    assert level is not None
    assert level.height_along(level.up) is None
    assert level.up == pytest.approx([0, -1, 0])
    assert scan_level((), 0.01, FrameConfig()) is None


@pytest.mark.parametrize(("away", "is_below"), [(1.5, True), (5.0, False)])
def test_a_plane_farther_off_than_anybody_holds_a_camera_is_a_wall(away: float, is_below: bool, tmp_path: Path) -> None:
    view, _ = shown(SHOWN, 0.8)
    facing = dataclasses.replace(view, depth=np.full_like(view.depth, away))
    level = scan_level(reading_of(tmp_path / "wall", [facing]).frames, 0.01, FrameConfig())
    assert level is not None
    assert level.up == pytest.approx([0, 0, -1] if is_below else [0, -1, 0], abs=0.02)  # the scan's frame is the camera's


@pytest.mark.parametrize(("away", "side"), [(0.3, 0.005), (1.0, 0.0081), (3.0, 0.02)])
def test_voxels_are_as_fine_as_noise_and_pixels_allow(away: float, side: float) -> None:
    """At 1 m: four times 1.9 mm of noise, two and a half pixels of 2 mm."""
    depth = np.full((240, 320), away, dtype=np.float32)
    frame = FrameSource(
        "0", "", "0", 320, 240, (500.0, 500.0, 159.5, 119.5), (320, 240), (500.0, 500.0, 159.5, 119.5), 1000.0, np.eye(4),
        lambda: np.zeros((240, 320, 3), np.uint8), lambda: depth,
    )  # fmt: skip
    assert voxel_side([frame], [0], FusionConfig()) == pytest.approx(side, abs=6e-4)
    assert voxel_side([frame], [0], FusionConfig(voxel_m=0.003)) == 0.003, "the coarsest that is allowed"
    assert voxel_side([dataclasses.replace(frame, pose=None)], [0], FusionConfig()) == 0.02


def test_a_table_is_told_from_a_floor_by_how_near_eyes_are() -> None:
    def at(height: float) -> FrameSource:
        pose = np.eye(4)
        pose[2, 3] = height
        return FrameSource("0", "", None, 1, 1, (1, 1, 0, 0), None, (1, 1, 0, 0), 1.0, pose, lambda: np.zeros((1, 1, 3), np.uint8), None)

    assert is_tabletop(["floor"], [at(0.5), at(0.6), at(1.5)], np.eye(4), VoteConfig())
    assert not is_tabletop(["floor", "wall"], [at(0.5)], np.eye(4), VoteConfig())
    assert not is_tabletop(["floor"], [at(1.4)], np.eye(4), VoteConfig())
    assert not is_tabletop([], [], np.eye(4), VoteConfig())


@pytest.mark.whole
def test_things_on_a_table_are_instances_of_a_scan_without_labels(tmp_path: Path) -> None:
    """Two looks from 46 and 57 degrees: each box is one instance where it stands, the table is another, and the world is level."""
    views = [shown(SHOWN, pitch)[0] for pitch in (0.8, 1.0)]
    outcome = captured(tmp_path / "table", views)
    for name, rows in outcome.rows.items():
        check(rows, TABLES[name].record)
    (scene,) = outcome.rows["scenes"]
    assert scene.segmentation == "geometry"
    pose = matrix(scene.alignment)
    assert np.degrees(np.arccos(pose[2, 2])) < 1.0
    assert min(abs(pose[2, 3] + FLOOR), abs(pose[2, 3] + TOP)) < 0.01, "the room's floor, or the table's top"
    objects = [row for row in outcome.rows["instances"] if not row.is_structure]
    assert all(row.raw_label.startswith(("geometry:", "classical:")) for row in objects)
    for mesh in SHOWN:
        expected = (pose @ [*mesh.bounds.mean(axis=0), 1.0])[:3]
        near = min(objects, key=lambda row: float(np.linalg.norm(matrix(row.box_pose)[:3, 3] - expected)))
        assert np.linalg.norm(matrix(near.box_pose)[:3, 3] - expected) < 0.03
        assert np.allclose(sorted(near.box_size), sorted(np.ptp(mesh.bounds, axis=0)), atol=0.035)
    assert any(max(row.box_size) > 0.9 for row in objects), "the table"
