"""A scan on disk as ScanNet lays it out: text file, mesh, segments, aggregation, frames exported or in a container."""

from __future__ import annotations

import io
import json
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.meshes import Surface
from tasks.scanner.sensor import Shot, color_camera, depth_camera

if TYPE_CHECKING:
    from tasks.scanner import ScannerConfig

Array = NDArray[np.float64]

LICENSE = "CC0-1.0"
"""Of everything that the scanner writes."""

DEPTH_SCALE = 1000.0
"""Depth units per metre."""


def write_metadata(path: Path, config: ScannerConfig, frames: int, alignment: Array | None) -> None:
    """`<scan>.txt`: sizes, intrinsics, kind of scene, and scan frame to world frame unless None."""
    color, depth = color_camera(np.eye(4), config), depth_camera(np.eye(4), config)
    lines = [] if alignment is None else [f"axisAlignment = {' '.join(f'{v:.8f}' for v in alignment.reshape(-1))} "]
    for word, camera in (("color", color), ("depth", depth)):
        lines += [f"{word}Height = {camera.height}", f"{word}Width = {camera.width}"]
        lines += [
            f"fx_{word} = {camera.fx:.6f}",
            f"fy_{word} = {camera.fy:.6f}",
            f"mx_{word} = {camera.cx:.6f}",
            f"my_{word} = {camera.cy:.6f}",
        ]
    lines += [f"numColorFrames = {frames}", f"numDepthFrames = {frames}", "numIMUmeasurements = 0"]
    if config.scene_type:
        lines.append(f"sceneType = {config.scene_type}")
    path.write_text("\n".join(lines) + "\n")


def write_mesh(path: Path, surface: Surface) -> None:
    """Binary PLY with vertex colors, scan frame [m]."""
    rows = np.empty(len(surface.vertices), dtype=[("p", "<f4", 3), ("c", "u1", 4)])
    rows["p"], rows["c"][:, :3], rows["c"][:, 3] = surface.vertices, surface.colors, 255
    triangles = np.empty(len(surface.faces), dtype=[("n", "u1"), ("i", "<i4", 3)])
    triangles["n"], triangles["i"] = 3, surface.faces
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue", "alpha")]
    head += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header"]
    path.write_bytes(("\n".join(head) + "\n").encode() + rows.tobytes() + triangles.tobytes())


def write_segments(path: Path, scan: str, config: ScannerConfig, segments: NDArray[np.int64]) -> None:
    """`.segs.json`: a segment per vertex."""
    params = {"kThresh": f"{config.segment_threshold:.6f}", "segMinVerts": str(config.segment_least)}
    path.write_text(json.dumps({"params": params, "sceneId": config.prefix + scan, "segIndices": segments.tolist()}))


def write_aggregation(path: Path, scan: str, config: ScannerConfig, segments_file: str, groups: list[tuple[str, list[int]]]) -> None:
    """`.aggregation.json`: instances as (label, segments), numbered in their order."""
    listed: list[dict[str, Any]] = [
        {"id": index, "objectId": index, "segments": segments, "label": label} for index, (label, segments) in enumerate(groups)
    ]
    document = {
        "sceneId": config.prefix + scan,
        "appId": "virtual-scanner",
        "segGroups": listed,
        "segmentsFile": config.prefix + segments_file,
    }
    path.write_text(json.dumps(document))


def write_exported(folder: Path, config: ScannerConfig, shots: list[Shot], poses: list[Array]) -> None:
    """`color/N.jpg`, `depth/N.png` (16 bit, mm), `pose/N.txt`, `intrinsic/*.txt`. `poses`: as written, they may be -inf."""
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir()
    for index, (shot, pose) in enumerate(zip(shots, poses, strict=True)):
        (folder / "color" / f"{index}.jpg").write_bytes(jpeg(shot.color))
        (folder / "depth" / f"{index}.png").write_bytes(png(shot.depth))
        (folder / "pose" / f"{index}.txt").write_text(_matrix_text(pose))
    for word, camera in (("color", color_camera(np.eye(4), config)), ("depth", depth_camera(np.eye(4), config))):
        matrix = np.eye(4)
        matrix[:3, :3] = camera.intrinsic
        (folder / "intrinsic" / f"intrinsic_{word}.txt").write_text(_matrix_text(matrix))
        (folder / "intrinsic" / f"extrinsic_{word}.txt").write_text(_matrix_text(np.eye(4)))


def write_sens(path: Path, config: ScannerConfig, shots: list[Shot], poses: list[Array]) -> None:
    """A `.sens` container of version 4: JPEG color, zlib-packed 16-bit depth."""
    color, depth = color_camera(np.eye(4), config), depth_camera(np.eye(4), config)
    name = b"virtual scanner"
    with path.open("wb") as stream:
        stream.write(struct.pack("<IQ", 4, len(name)) + name)
        for camera in (color, depth):
            matrix = np.eye(4, dtype="<f4")
            matrix[:3, :3] = camera.intrinsic
            stream.write(matrix.tobytes() + np.eye(4, dtype="<f4").tobytes())
        stream.write(struct.pack("<2i4If", 2, 1, color.width, color.height, depth.width, depth.height, DEPTH_SCALE))
        stream.write(struct.pack("<Q", len(shots)))
        for index, (shot, pose) in enumerate(zip(shots, poses, strict=True)):
            image, packed = jpeg(shot.color), zlib.compress(shot.depth.astype("<u2").tobytes(), 6)
            micros = index * 33_333
            stream.write(pose.astype("<f4").tobytes() + struct.pack("<4Q", micros, micros, len(image), len(packed)))
            stream.write(image)
            stream.write(packed)


def jpeg(color: NDArray[np.uint8]) -> bytes:
    """A color image as JPEG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(color).save(buffer, "JPEG", quality=88)
    return buffer.getvalue()


def png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """An image as PNG, as it is."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG", compress_level=4)
    return buffer.getvalue()


def _matrix_text(matrix: Array) -> str:
    return "".join(" ".join(f"{v:.6f}" for v in row) + "\n" for row in matrix)
