"""The benchmark of cameras, of a small room: every renderer draws, and the rasterizer what rays meet."""

from __future__ import annotations

import io
import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from rich.console import Console

from bench.policy import frames, renderers
from bench.policy.frames import FramesBench, benched_scenes, free_cameras, measure_frames, print_frames, seen_by_rays
from bench.policy.renderers import PYRENDER_PYTHON, RenderRequest, pyrender_answer
from schemas.errors import InputError
from tasks.geometry.rendering import Camera, RayScene
from tasks.simulation.cameras import camera_poses

SMALL = FramesBench(objects=(10,), sizes=(24, 48), poses=3, seconds=0.0)


def test_every_renderer_draws_and_says_how_much(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "broken.py"
    broken.write_text("raise SystemExit('no library')")
    done: list[str] = []
    report = measure_frames(SMALL, lambda: done.append("scene"))
    (scene,) = report["scenes"]
    assert done == ["scene"] * SMALL.scenes
    assert {"rasterizer", "rasterizer, textured", "rays"} <= set(scene["rates"])
    for name in ("MuJoCo", "pyrender"):
        assert (name in scene["rates"]) != (name in scene["missing"])
    assert all(set(rates) == {"24", "48"} and min(rates.values()) > 0 for rates in scene["rates"].values())
    assert all(goal["met"] for goal in report["goals"])
    assert len(report["goals"]) == 2
    monkeypatch.setattr(renderers, "MUJOCO_SCRIPT", broken)
    monkeypatch.delenv(PYRENDER_PYTHON, raising=False)
    report = measure_frames(SMALL)
    assert report["scenes"][0]["missing"] == {
        "MuJoCo": "egl: no library; osmesa: no library",
        "pyrender": "METASCENES_PYRENDER_PYTHON names no interpreter with requirements/pyrender.lock",
    }
    page = io.StringIO()
    print_frames(report, Console(file=page, width=160))
    assert "MuJoCo: egl: no library" in page.getvalue()
    assert "share of pixels with the part that a ray meets" in page.getvalue()


def test_an_interpreter_without_pyrender_is_told_from_none(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = RenderRequest(camera_poses(np.array([[0.0, 0.0, 0.0]]), 1.0).tolist(), (16,), 79.0, 0.0)
    ball = [trimesh.creation.icosphere(radius=0.2)]
    monkeypatch.setenv(PYRENDER_PYTHON, sys.executable)
    assert "No module named 'pyrender'" in pyrender_answer(ball, wanted)
    monkeypatch.setenv(PYRENDER_PYTHON, "no_such_python")
    with pytest.raises(InputError, match=r"no_such_python: METASCENES_PYRENDER_PYTHON: is no program .*pyrender\.lock"):
        pyrender_answer(ball, wanted)


@pytest.mark.slow
def test_pyrender_sees_what_rays_meet() -> None:
    """From the same place, the right way up, and it draws colors and parts at all."""
    if not os.environ.get(PYRENDER_PYTHON):
        pytest.skip(f"{PYRENDER_PYTHON} names no interpreter with requirements/pyrender.lock installed")
    (scene,) = benched_scenes(SMALL)
    poses = free_cameras(scene.parts, 1, 0)
    answer = pyrender_answer(scene.parts, RenderRequest(poses.tolist(), (64,), math.degrees(frames.HFOV), 0.0))
    assert isinstance(answer, dict), answer
    assert set(answer["rates"]) == {"pyrender", "pyrender, color and depth"}
    part, depth = seen_by_rays(RayScene(scene.parts), Camera.with_fov(poses[0], 64, 64, frames.HFOV))
    seen = np.array(answer["depth"])
    assert np.mean(np.abs(seen - depth) < 0.05 * depth) > 0.9  # it looks at pixels beside their centers
    assert np.mean(np.array(answer["parts"]) == part) > 0.9
    assert answer["color"] > 20
    assert np.mean(np.abs(seen[::-1] - depth) < 0.05 * depth) < 0.8


def test_cameras_stand_where_there_is_room() -> None:
    (scene,) = benched_scenes(SMALL)
    poses = free_cameras(scene.parts, 5, 0)
    assert poses.shape == (5, 4, 4)
    assert np.array_equal(poses, free_cameras(scene.parts, 5, 0))
    low, high = scene.parts[0].bounds
    assert ((poses[:, :2, 3] > low[:2]) & (poses[:, :2, 3] < high[:2])).all()
    with pytest.raises(ValueError, match="have no 1 places"):
        free_cameras(scene.parts[:1], 1, 0)


def test_a_house_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--realdata: holds no scene_aws_small_house/house\.glb"):
        measure_frames(FramesBench(objects=(), realdata=str(tmp_path)))
