"""A scan as ScanNet lays it out: mesh, segments, aggregation, text file, frames as files or in a .sens container."""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.meshes import Surface
from tasks.rendering import Camera
from tasks.scanner.config import ScannerConfig
from tasks.scanner.sensor import Shot, camera_at

STRUCTURE = ("wall", "floor", "ceiling")


def depth_intrinsics(camera: Camera) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy [px] of the depth camera, whose pixels are every second one of the color camera."""
    return camera.fx / 2, camera.fy / 2, camera.cx / 2, camera.cy / 2


def write_mesh(
    place: Path,
    scan: str,
    surface: Surface,
    segment: NDArray[np.int64],
    owner: NDArray[np.int64],
    labels: Sequence[tuple[str, str]],
    config: ScannerConfig,
) -> None:
    """The fused mesh (scan frame), its segments and the aggregation of segments into objects."""
    _write_ply(place / f"{scan}_vh_clean_2.ply", surface)
    prefix = "scannet." if config.has_dataset_prefix else ""
    segments_file = f"{scan}_vh_clean_2.0.010000.segs.json"
    document = {"params": {"kThresh": "0.01", "segMinVerts": "20"}, "sceneId": f"{prefix}{scan}", "segIndices": segment.tolist()}
    (place / segments_file).write_text(json.dumps(document, separators=(",", ":")))
    groups: list[dict[str, Any]] = []
    for index, (_, label) in enumerate(labels):
        own = np.unique(segment[owner == index])
        if len(own):
            groups.append({"id": len(groups), "objectId": len(groups), "segments": own.tolist(), "label": label})
    name = f"{scan}_vh_clean.aggregation.json" if config.has_long_aggregation_name else f"{scan}.aggregation.json"
    aggregation = {"sceneId": f"{prefix}{scan}", "appId": "virtual-scanner", "segGroups": groups, "segmentsId": f"{prefix}{segments_file}"}
    (place / name).write_text(json.dumps(aggregation, separators=(",", ":")))


def write_text(place: Path, scan: str, config: ScannerConfig, alignment: NDArray[np.float64], frames: int, scene_type: str) -> None:
    """`<scan>.txt`: cameras, frame counts, and the scan frame to the world frame where the config says so."""
    camera = camera_at(np.eye(4), config)
    fx, fy, cx, cy = depth_intrinsics(camera)
    lines = [f"axisAlignment = {' '.join(f'{v:.6f}' for v in alignment.reshape(-1))}"] if config.writes_alignment else []
    count = 0 if config.frames == "none" else frames
    lines += [
        f"colorHeight = {camera.height}", f"colorToDepthExtrinsics = {_numbers(np.eye(4))}", f"colorWidth = {camera.width}",
        f"depthHeight = {camera.height // 2}", f"depthWidth = {camera.width // 2}",
        f"fx_color = {camera.fx:.6f}", f"fx_depth = {fx:.6f}", f"fy_color = {camera.fy:.6f}", f"fy_depth = {fy:.6f}",
        f"mx_color = {camera.cx:.6f}", f"mx_depth = {cx:.6f}", f"my_color = {camera.cy:.6f}", f"my_depth = {cy:.6f}",
        f"numColorFrames = {count}", f"numDepthFrames = {count}", "numIMUmeasurements = 0",
    ]  # fmt: skip
    if scene_type:
        lines.append(f"sceneType = {scene_type}")
    (place / f"{scan}.txt").write_text("\n".join(lines) + "\n")


def write_frames(place: Path, scan: str, shots: Sequence[Shot], lost: Collection[int], config: ScannerConfig) -> None:
    """The frames, as the config wants them. Frames whose tracking was lost have a pose of -inf."""
    if config.frames == "none":
        return
    poses = [np.full((4, 4), -np.inf) if i in lost else shot.pose for i, shot in enumerate(shots)]
    if config.frames == "sens":
        _write_sens(place / f"{scan}.sens", shots, poses, config)
        return
    for name in ("color", "depth", "pose", "intrinsic"):
        (place / name).mkdir()
    camera = camera_at(np.eye(4), config)
    for name, (fx, fy, cx, cy) in (("color", (camera.fx, camera.fy, camera.cx, camera.cy)), ("depth", depth_intrinsics(camera))):
        rows = [[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        (place / "intrinsic" / f"intrinsic_{name}.txt").write_text("\n".join(_numbers(row) for row in rows) + "\n")
        (place / "intrinsic" / f"extrinsic_{name}.txt").write_text("\n".join(_numbers(row) for row in np.eye(4)) + "\n")
    for index, (shot, pose) in enumerate(zip(shots, poses, strict=True)):
        (place / "color" / f"{index}.jpg").write_bytes(_jpeg(shot.color, config.jpeg_quality))
        (place / "depth" / f"{index}.png").write_bytes(_png(shot.depth))
        (place / "pose" / f"{index}.txt").write_text("\n".join(_numbers(row) for row in pose) + "\n")


def _write_sens(path: Path, shots: Sequence[Shot], poses: Sequence[NDArray[np.float64]], config: ScannerConfig) -> None:
    """A .sens container, version 4: jpeg color, zlib depth."""
    camera = camera_at(np.eye(4), config)
    color, depth = np.eye(4, dtype="<f4"), np.eye(4, dtype="<f4")
    color[[0, 1, 0, 1], [0, 1, 2, 2]] = camera.fx, camera.fy, camera.cx, camera.cy
    depth[[0, 1, 0, 1], [0, 1, 2, 2]] = depth_intrinsics(camera)
    sensor, identity = b"virtual", np.eye(4, dtype="<f4").tobytes()
    height, width = shots[0].depth.shape
    with path.open("wb") as file:
        file.write(struct.pack("<IQ", 4, len(sensor)) + sensor + color.tobytes() + identity + depth.tobytes() + identity)
        file.write(struct.pack("<2i4IfQ", 2, 1, camera.width, camera.height, width, height, 1000.0, len(shots)))
        for index, (shot, pose) in enumerate(zip(shots, poses, strict=True)):
            image, packed = _jpeg(shot.color, config.jpeg_quality), zlib.compress(shot.depth.astype("<u2").tobytes(), 6)
            file.write(pose.astype("<f4").tobytes() + struct.pack("<4Q", index * 33333, index * 33333, len(image), len(packed)))
            file.write(image + packed)


def _write_ply(path: Path, surface: Surface) -> None:
    vertices = np.empty(len(surface.vertices), dtype=[("position", "<f4", 3), ("color", "u1", 4)])
    vertices["position"], vertices["color"][:, :3], vertices["color"][:, 3] = surface.vertices, surface.colors, 255
    faces = np.empty(len(surface.faces), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, surface.faces
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue", "alpha")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    path.write_bytes(("\n".join(head) + "\n").encode() + vertices.tobytes() + faces.tobytes())


def _jpeg(color: NDArray[np.uint8], quality: int) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(color).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


def _png(depth: NDArray[np.uint16]) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(depth).save(buffer, "PNG", compress_level=3)
    return buffer.getvalue()


def _numbers(values: object) -> str:
    return " ".join(f"{float(v):.6f}" for v in np.asarray(values).reshape(-1))
