"""The benchmark of cameras, of a small room: every renderer draws, and the rasterizer what rays meet."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bench.policy import frames
from bench.policy.frames import FramesBench, benched_scenes, free_cameras, measure_frames, print_frames
from schemas.errors import InputError

SMALL = FramesBench(objects=(10,), sizes=(24, 48), poses=3, seconds=0.0)


def test_every_renderer_draws_and_says_how_much(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "broken.py"
    broken.write_text("raise SystemExit('no library')")
    done: list[str] = []
    report = measure_frames(SMALL, lambda: done.append("scene"))
    (scene,) = report["scenes"]
    assert done == ["scene"] * SMALL.scenes
    assert {"rasterizer", "rasterizer, textured", "rays"} <= set(scene["rates"])
    assert ("MuJoCo" in scene["rates"]) == (scene["no_mujoco"] is None)
    assert all(set(rates) == {"24", "48"} and min(rates.values()) > 0 for rates in scene["rates"].values())
    assert all(goal["met"] for goal in report["goals"])
    assert len(report["goals"]) == 2
    monkeypatch.setattr(frames, "SCRIPT", broken)
    report = measure_frames(SMALL)
    assert report["scenes"][0]["no_mujoco"] == "egl: no library; osmesa: no library"
    page = io.StringIO()
    print_frames(report, Console(file=page, width=160))
    assert "MuJoCo: egl: no library" in page.getvalue()
    assert "share of pixels with the part that a ray meets" in page.getvalue()


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
