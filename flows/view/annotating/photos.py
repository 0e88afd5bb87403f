"""Photos of what a batch asks about: the best view, which the lake keeps, and other frames, whose pictures stay with the scan."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from flows.view.annotating.drafts import Key
from flows.view.frames import are_at_hand
from flows.view.scene import Scenes
from schemas.capture import Frame, Instance
from tasks.geometry.transforms import matrix
from tasks.geometry.windows import view_window


@dataclasses.dataclass(frozen=True)
class Photo:
    """A photo of an object. window: the part x0, y0, x1, y1 of its frame that it shows [px]. camera: from where it was taken, as
    `photo_camera` says. is_best: the lake keeps it."""

    frame: Frame
    window: tuple[int, int, int, int]
    camera: dict[str, Any]
    is_best: bool


def photos_of(scenes: Scenes, instances: Sequence[Instance]) -> dict[Key, list[Photo]]:
    """Photos of objects from known places, the best first; none of those without one."""
    photos: dict[Key, list[Photo]] = {}
    for scene in sorted({row.scene_id for row in instances}):
        frames = {row.frame_id: row for row in scenes.reader.rows(Frame, scene)}
        masks = scenes.reader.matching("masks", {"scene_id": [scene]}, ["pixel_box"]).to_pylist()
        boxes = {(row["instance_id"], row["frame_id"]): row["pixel_box"] for row in masks}
        for row in instances:
            if row.scene_id != scene or row.view_blob is None:
                continue
            for place, frame_id in enumerate(row.best_frames):
                frame = frames.get(frame_id)
                if frame is None or frame.pose is None or not (place == 0 or are_at_hand(scenes.scan_path(scene), frame)):
                    continue
                box = boxes.get((row.instance_id, frame_id))
                window = (0, 0, frame.width, frame.height) if box is None else view_window(box, frame.width, frame.height)
                photo = Photo(frame, window, photo_camera(frame, window, row), place == 0)
                photos.setdefault((scene, row.instance_id), []).append(photo)
    return photos


def photo_camera(frame: Frame, window: tuple[int, int, int, int], instance: Instance) -> dict[str, Any]:
    """A camera that sees what a photo of an instance shows, a part x0, y0, x1, y1 of its frame [px]: position and target in the world
    frame [m], the target in the photo's middle as far away as the instance is; the photo's vertical angle [degrees]."""
    assert frame.pose is not None
    x0, y0, x1, y1 = window
    fx, fy, cx, cy = frame.intrinsics
    pose = matrix(frame.pose)
    ray = pose[:3, :3] @ np.array([((x0 + x1) / 2 - cx) / fx, ((y0 + y1) / 2 - cy) / fy, 1.0])
    distance = float(np.linalg.norm(matrix(instance.box_pose)[:3, 3] - pose[:3, 3]))
    target = pose[:3, 3] + ray / np.linalg.norm(ray) * max(distance, 0.1)
    angle = math.degrees(math.atan((y1 - cy) / fy) - math.atan((y0 - cy) / fy))
    return {"position": pose[:3, 3].tolist(), "target": target.tolist(), "fov_degrees": angle}
