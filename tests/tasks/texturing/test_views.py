"""Frames as views, and which of them an object is painted with."""

from __future__ import annotations

import dataclasses
from itertools import combinations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.capture.reading import FrameSource
from tasks.geometry.rendering import Camera
from tasks.geometry.transforms import flat, yaw_pose
from tasks.texturing.views import ColorView, ViewsConfig, best_views, views_of
from tests.tasks.texturing.painting import ring, taken

ALL = ViewsConfig(frames=1000, views=1000)


@pytest.fixture(scope="module")
def body() -> trimesh.Trimesh:
    return trimesh.creation.box((0.8, 0.6, 0.7))


@pytest.fixture(scope="module")
def views(body: trimesh.Trimesh) -> list[ColorView]:
    return [taken(camera, [body]) for camera in ring(12)]


@pytest.fixture(scope="module")
def points(body: trimesh.Trimesh) -> np.ndarray:
    return np.asarray(trimesh.sample.sample_surface(body, 2000, seed=0)[0])


def test_frames_become_views_where_the_lake_has_their_pose() -> None:
    pose = yaw_pose(-0.4, (1.0, 2.0, 1.5))

    def frame(number: int, has_depth: bool) -> FrameSource:
        return FrameSource(
            frame_id=f"{number:06d}", color_file="c", depth_file="d" if has_depth else None, width=64, height=48,
            intrinsics=(50.0, 51.0, 31.0, 23.0), depth_size=(32, 24) if has_depth else None, depth_intrinsics=(25.0, 25.5, 15.0, 11.0),
            depth_scale=1000.0, pose=np.eye(4), color=lambda: np.full((48, 64, 3), number, np.uint8),
            depth=(lambda: np.full((24, 32), number, np.float32)) if has_depth else None,
        )  # fmt: skip

    poses = {"000001": flat(pose), "000003": flat(pose), "000009": flat(np.eye(4))}
    views = views_of([frame(1, True), frame(2, True), frame(3, False)], poses)
    assert [int(view.color()[0, 0, 0]) for view in views] == [1, 3]
    camera, depth_camera = views[0].camera, views[0].depth_camera
    assert isinstance(depth_camera, Camera)
    assert (camera.width, camera.height, camera.fx, camera.cy) == (64, 48, 50.0, 23.0)
    assert (depth_camera.width, depth_camera.height, depth_camera.fy, depth_camera.cx) == (32, 24, 25.5, 15.0)
    assert camera.pose == pytest.approx(pose)
    assert (views[1].depth, views[1].depth_camera) == (None, None)


def direction(view: ColorView) -> np.ndarray:
    return view.camera.pose[:3, 3] / np.linalg.norm(view.camera.pose[:3, 3])


def test_the_first_views_are_from_as_many_sides_as_there_are(views: list[ColorView], points: np.ndarray) -> None:
    found, problems = best_views(views, {"box": points}, dataclasses.replace(ALL, views=4))
    assert (len(found["box"]), problems) == (4, [])
    widest = min(np.degrees(np.arccos(direction(a) @ direction(b))) for a, b in combinations(found["box"][:2], 2))
    assert widest > 90
    closest = max(float(direction(a) @ direction(b)) for a, b in combinations(found["box"], 2))
    usual = np.median([max(float(direction(a) @ direction(b)) for a, b in combinations(some, 2)) for some in combinations(views, 4)])
    assert closest < usual


@given(order=st.permutations(range(12)))
@settings(max_examples=10, deadline=None)
def test_the_order_of_frames_decides_nothing(views: list[ColorView], points: np.ndarray, order: list[int]) -> None:
    few = dataclasses.replace(ALL, views=5)
    known, _ = best_views(views, {"box": points}, few)
    found, _ = best_views([views[k] for k in order], {"box": points}, few)
    assert {id(view) for view in found["box"]} == {id(view) for view in known["box"]}


def test_what_stands_before_it_hides_an_object(body: trimesh.Trimesh, points: np.ndarray) -> None:
    """A wall on one side of it: frames from behind the wall have it in their picture, and do not show it."""
    wall = trimesh.creation.box((0.05, 6.0, 6.0))
    wall.apply_translation([1.0, 0, 0])
    views = [taken(camera, [body, wall]) for camera in ring(12)]
    found, _ = best_views(views, {"box": points, "nothing": np.zeros((0, 3))}, ALL)
    assert set(found) == {"box"}
    assert found["box"]
    assert all(view.camera.pose[0, 3] < 1.0 for view in found["box"])


def test_views_without_depth_say_nothing_and_broken_ones_are_named(views: list[ColorView], points: np.ndarray) -> None:
    def broken() -> np.ndarray:
        raise InputError("depth/000003.png", "content", "is cut off", "export it again")

    blind = [dataclasses.replace(view, depth=None, depth_camera=None) for view in views]
    assert best_views(blind, {"box": points}, ALL) == ({"box": ()}, [])
    some = [*views[:3], dataclasses.replace(views[3], depth=broken)]
    found, problems = best_views(some, {"box": points}, ALL)
    assert problems == ["depth/000003.png: content: is cut off; export it again"]
    assert {id(view) for view in found["box"]} <= {id(view) for view in views[:3]}


def test_many_frames_are_thinned_evenly(views: list[ColorView], points: np.ndarray) -> None:
    read = []

    def noted(number: int, view: ColorView) -> ColorView:
        def depth() -> np.ndarray:
            read.append(number)
            assert view.depth is not None
            return view.depth()

        return dataclasses.replace(view, depth=depth)

    best_views([noted(number, view) for number, view in enumerate(views)], {"a": points, "b": points}, ViewsConfig(frames=4))
    assert read == [0, 3, 6, 9], "each once, for all objects"
