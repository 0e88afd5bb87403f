"""Captured rooms and structures as RoomPlan's JSON encoder writes them, after Apple's description of the types."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Element = dict[str, Any]

WIDTH, DEPTH, HEIGHT = 4.0, 3.0, 2.5
"""Of a room about the origin [m]."""


def placed(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Array:
    """A pose in ARKit's frame, +Y up, turned about y by an angle [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    pose = np.eye(4)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = [x, y, z]
    return pose


def element(category: str, pose: Array, size: Sequence[float], **more: Any) -> Element:
    """An element; its matrix by columns, as `simd_float4x4` is encoded."""
    return {
        "identifier": f"{category}-{'-'.join(f'{v:.2f}' for v in pose[:3, 3])}", "category": {category: {}}, "dimensions": list(size),
        "transform": pose.T.ravel().tolist(), "confidence": {"high": {}}, "parentIdentifier": None, "story": 0, **more,
    }  # fmt: skip


def surface(category: str, pose: Array, size: Sequence[float], **more: Any) -> Element:
    """A surface."""
    return element(category, pose, size, **{"polygonCorners": [], "completedEdges": [], "curve": None, **more})


def walls(height: float = 0.0, story: int | None = 0, x: float = 0.0) -> list[Element]:
    """Four walls of a room on a floor at a height [m], whose middle is at x."""
    half_x, half_z, y = WIDTH / 2, DEPTH / 2, height + HEIGHT / 2
    poses = [placed(x, y, -half_z), placed(x, y, half_z, np.pi), placed(x - half_x, y, 0, np.pi / 2), placed(x + half_x, y, 0, -np.pi / 2)]
    return [
        surface("wall", pose, [length, HEIGHT, 0], story=story) for pose, length in zip(poses, (WIDTH, WIDTH, DEPTH, DEPTH), strict=True)
    ]


def floor_lying(height: float = 0.0, x: float = 0.0, **more: Any) -> Element:
    """A floor whose corners have x and y: its frame is turned so that its z axis is up."""
    pose = np.array([[1, 0, 0, x], [0, 0, 1, height], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    corners = [[-WIDTH / 2, -DEPTH / 2, 0], [WIDTH / 2, -DEPTH / 2, 0], [WIDTH / 2, DEPTH / 2, 0], [-WIDTH / 2, DEPTH / 2, 0]]
    return surface("floor", pose, [WIDTH, DEPTH, 0], **{"polygonCorners": corners, **more})


def floor_upright(height: float = 0.0, **more: Any) -> Element:
    """A floor whose corners have x and z: its frame is that of the world."""
    corners = [[-WIDTH / 2, 0, -DEPTH / 2], [WIDTH / 2, 0, -DEPTH / 2], [WIDTH / 2, 0, DEPTH / 2], [-WIDTH / 2, 0, DEPTH / 2]]
    return surface("floor", placed(y=height), [WIDTH, 0, DEPTH], **{"polygonCorners": corners, **more})


def table(height: float = 0.0, x: float = 0.0, **more: Any) -> Element:
    """A table in the middle of a room."""
    return element("table", placed(x, height + 0.37), [1.2, 0.74, 0.7], **more)


def captured(**lists: Any) -> Element:
    """A captured room."""
    kinds = ("walls", "doors", "windows", "openings", "floors", "objects", "sections")
    return {"version": 2, "identifier": "room", "story": 0, **{kind: [] for kind in kinds}, **lists}


def write(folder: Path, document: Element, name: str = "CapturedRoom.json") -> Path:
    """Write a document into a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(json.dumps(document))
    return folder


def arc(radius: float, sweep: float, center_z: float, is_measured: bool = False, sign: float = 1.0) -> Element:
    """A curve about the middle of its wall. sign: of angles, 1 from x towards z. is_measured: angles as degrees with their unit."""
    ends = [sign * np.pi / 2 - sweep / 2, sign * np.pi / 2 + sweep / 2]
    unit = {"symbol": "°", "converter": {"coefficient": 1, "constant": 0}}
    angles = [{"value": float(np.degrees(end)), "unit": unit} if is_measured else float(end) for end in ends]
    return {"center": [0.0, center_z], "radius": radius, "startAngle": angles[0], "endAngle": angles[1]}
