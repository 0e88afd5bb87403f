"""Tiny scans with known truth for the tests of capture: a room of boxes, written in every format that is read."""

from __future__ import annotations

import dataclasses
import io
import json
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.record import check
from schemas.tables import TABLES
from tasks.geometry.meshes import Surface
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import inverse, look_at, yaw_pose
from tasks.stage import Outcome

ROOM = np.array([4.0, 3.0, 2.5])
"""Extents of the room [m]; it is centered, its floor at z = 0."""

OBJECTS = (
    ("table", (0.8, 0.5, 0.35), (1.2, 0.7, 0.7), 0.0),
    ("chair", (-0.9, 0.6, 0.45), (0.5, 0.5, 0.9), 0.5),
    ("cabinet", (-1.6, -1.0, 0.5), (0.6, 0.8, 1.0), 0.0),
    ("box", (0.9, 0.5, 0.8), (0.3, 0.2, 0.2), 0.3),
)
"""Label, center [m], extents [m] and yaw [rad] of each object, in the world frame."""

TILT = 0.03
"""Angle between the floor and the scan's horizontal [rad]."""

_TILTED = np.eye(4)
_TILTED[1:3, 1:3] = [[np.cos(TILT), -np.sin(TILT)], [np.sin(TILT), np.cos(TILT)]]
SCAN_FROM_WORLD = inverse(yaw_pose(0.4, [1.0, -2.0, 0.3]) @ _TILTED)
"""The scan lies turned, tilted and moved against the world."""

Shot = tuple[NDArray[np.uint8], NDArray[np.uint16], NDArray[np.float64]]
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]


@dataclasses.dataclass(frozen=True)
class BoxRoom:
    """The room in the world frame: surface, instance of each vertex, label of each instance, cameras."""

    surface: Surface
    instance: NDArray[np.int64]
    labels: tuple[str, ...]
    cameras: tuple[Camera, ...]


def well_formed(outcome: Outcome) -> Outcome:
    """The outcome, all of whose rows the lake's tables take."""
    for table, rows in outcome.rows.items():
        check(rows, TABLES[table].record)
    return outcome


def plate(corner: Sequence[float], u: Sequence[float], v: Sequence[float], step: float = 0.05) -> Mesh:
    """Vertices and triangles of a rectangle from `corner` along `u` and `v`, with a vertex every `step` [m]."""
    nu, nv = (max(2, round(float(np.linalg.norm(w)) / step) + 1) for w in (u, v))
    a, b = np.meshgrid(np.linspace(0, 1, nu), np.linspace(0, 1, nv), indexing="ij")
    vertices = np.asarray(corner, float) + a.reshape(-1, 1) * np.asarray(u, float) + b.reshape(-1, 1) * np.asarray(v, float)
    i = (np.arange(nu - 1)[:, None] * nv + np.arange(nv - 1)).ravel()
    return vertices, np.concatenate([np.stack([i, i + nv, i + nv + 1], axis=1), np.stack([i, i + nv + 1, i + 1], axis=1)])


def box_plates(size: Sequence[float], pose: NDArray[np.float64], step: float = 0.05) -> Mesh:
    """Vertices and triangles of a box, facing outward."""
    h = np.asarray(size, float) / 2
    vertices, faces, count = [], [], 0
    for axis in range(3):
        for sign in (-1, 1):
            u, v = np.roll(np.eye(3), axis, axis=0)[[1, 2]]
            if sign < 0:
                u, v = v, u
            u, v = u * 2 * h, v * 2 * h
            corner = sign * h * np.roll(np.eye(3), axis, axis=0)[0] - (u + v) / 2
            p, f = plate(corner, u, v, step)
            vertices.append(p)
            faces.append(f + count)
            count += len(p)
    points = np.concatenate(vertices)
    return points @ pose[:3, :3].T + pose[:3, 3], np.concatenate(faces)


def box_room(
    objects: Sequence[tuple[str, tuple[float, ...], tuple[float, ...], float]] = OBJECTS, ceiling: bool = True, cameras: int = 12,
    step: float = 0.05,
) -> BoxRoom:  # fmt: skip
    """Floor, walls, ceiling and boxes, as a scanner would see them, with a vertex every `step` [m]."""
    x, y, z = ROOM
    pieces = [("floor", plate([-x / 2, -y / 2, 0], [x, 0, 0], [0, y, 0], step))]
    pieces += [
        ("wall", plate([-x / 2, -y / 2, 0], [0, 0, z], [x, 0, 0], step)), ("wall", plate([-x / 2, y / 2, 0], [x, 0, 0], [0, 0, z], step)),
        ("wall", plate([-x / 2, -y / 2, 0], [0, y, 0], [0, 0, z], step)), ("wall", plate([x / 2, -y / 2, 0], [0, 0, z], [0, y, 0], step)),
    ]  # fmt: skip
    if ceiling:
        pieces.append(("ceiling", plate([-x / 2, -y / 2, z], [0, y, 0], [x, 0, 0], step)))
    pieces += [(label, box_plates(size, yaw_pose(yaw, center), step)) for label, center, size, yaw in objects]
    vertices, faces, instance, colors, count = [], [], [], [], 0
    for index, (_, (points, triangles)) in enumerate(pieces):
        vertices.append(points)
        faces.append(triangles + count)
        instance.append(np.full(len(points), index))
        color = np.array([40 + 23 * index % 200, 60 + 57 * index % 190, 80 + 91 * index % 170], dtype=np.uint8)
        colors.append(np.tile(color, (len(points), 1)))
        count += len(points)
    surface = Surface(np.concatenate(vertices), np.concatenate(faces), np.concatenate(colors))
    views = []
    for k in range(cameras):
        angle = 2 * np.pi * k / cameras
        eye = [1.1 * np.cos(angle), 0.8 * np.sin(angle), 1.5]
        target = [-0.9 * np.cos(angle + 0.3), -0.9 * np.sin(angle + 0.3), 0.4]
        views.append(Camera.with_fov(look_at(eye, target), 160, 120, 1.15))
    return BoxRoom(surface, np.concatenate(instance), tuple(label for label, _ in pieces), tuple(views))


def ply_bytes(surface: Surface, order: str = "<") -> bytes:
    """A binary PLY as ScanNet writes it."""
    word = "binary_little_endian" if order == "<" else "binary_big_endian"
    vertex = np.zeros(len(surface.vertices), dtype=[("p", order + "f4", 3), ("c", "u1", 4)])
    vertex["p"], vertex["c"][:, :3], vertex["c"][:, 3] = surface.vertices, surface.colors, 255
    face = np.zeros(len(surface.faces), dtype=[("n", "u1"), ("i", order + "i4", 3)])
    face["n"], face["i"] = 3, surface.faces
    header = f"ply\nformat {word} 1.0\ncomment a scan\nelement vertex {len(vertex)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue", "alpha"))
    header += f"element face {len(face)}\nproperty list uchar int vertex_indices\nend_header\n"
    return header.encode() + vertex.tobytes() + face.tobytes()


def rendered(room: BoxRoom) -> list[Shot]:
    """Color, depth [mm] and pose (camera to scan frame) of each camera."""
    scene = RayScene([room.surface.to_trimesh()])
    shots = []
    for camera in room.cameras:
        view = scene.render(camera)
        depth = np.where(np.isfinite(view.depth), view.depth * 1000, 0).round().astype(np.uint16)
        shots.append((view.color, depth, SCAN_FROM_WORLD @ camera.pose))
    return shots


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    out = io.BytesIO()
    Image.fromarray(image).save(out, format="JPEG", quality=92)
    return out.getvalue()


def matrix_text(matrix: NDArray[np.float64]) -> str:
    """Rows of a matrix as text."""
    return "\n".join(" ".join(f"{v:.8f}" for v in row) for row in matrix) + "\n"


def write_frames(folder: Path, shots: Sequence[Shot], camera: Camera) -> None:
    """Exported frames: color, depth, pose, intrinsic."""
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for index, (color, depth, pose) in enumerate(shots):
        (folder / "color" / f"{index}.jpg").write_bytes(_jpeg(color))
        Image.fromarray(depth).save(folder / "depth" / f"{index}.png")
        (folder / "pose" / f"{index}.txt").write_text(matrix_text(pose))
    full = np.eye(4)
    full[:3, :3] = camera.intrinsic
    for name in ("intrinsic_color", "intrinsic_depth"):
        (folder / "intrinsic" / f"{name}.txt").write_text(matrix_text(full))


def sens_bytes(shots: Sequence[Shot], camera: Camera) -> bytes:
    """A `.sens` container of version 4, jpeg and zlib_ushort."""
    full = np.eye(4, dtype=np.float32)
    full[:3, :3] = camera.intrinsic
    name = b"StructureSensor"
    out = [struct.pack("<IQ", 4, len(name)), name, *([full.tobytes(), np.eye(4, dtype=np.float32).tobytes()] * 2)]
    out.append(struct.pack("<2i4IfQ", 2, 1, camera.width, camera.height, camera.width, camera.height, 1000.0, len(shots)))
    for index, (color, depth, pose) in enumerate(shots):
        jpeg, packed = _jpeg(color), zlib.compress(depth.astype("<u2").tobytes())
        out += [pose.astype("<f4").tobytes(), struct.pack("<4Q", index, index, len(jpeg), len(packed)), jpeg, packed]
    return b"".join(out)


def write_scannet(
    folder: Path,
    room: BoxRoom,
    *,
    frames: str = "exported",
    aligned: bool = True,
    prefix: str = "",
    aggregation: str = ".aggregation.json",
    labels: Sequence[str] | None = None,
    scene_type: str | None = "Bedroom / Hotel",
) -> Path:
    """A ScanNet scan in `folder`; `frames` is exported, flat, 2d, sens or none."""
    folder.mkdir(parents=True, exist_ok=True)
    scan = folder.name
    metadata = ["numDepthFrames = 12"]
    if aligned:
        metadata.append("axisAlignment = " + " ".join(f"{v:.6f}" for v in inverse(SCAN_FROM_WORLD).ravel()) + " ")
    if scene_type:
        metadata.append(f"sceneType = {scene_type}")
    (folder / f"{scan}.txt").write_text("\n".join(metadata) + "\n")
    (folder / f"{scan}_vh_clean_2.ply").write_bytes(ply_bytes(room.surface.transformed(SCAN_FROM_WORLD)))
    # Two segments an instance, numbers with gaps between them.
    half = (np.arange(len(room.instance)) % 2) * 5
    segments = room.instance * 10 + half + 3
    name = f"{prefix}{scan}_vh_clean_2.0.010000.segs.json"
    segs = {"params": {"kThresh": "0.0001"}, "sceneId": prefix + scan, "segIndices": segments.tolist()}
    (folder / f"{scan}_vh_clean_2.0.010000.segs.json").write_text(json.dumps(segs))
    names = labels or room.labels
    groups = [
        {"id": i, "objectId": i, "segments": np.unique(segments[room.instance == i]).tolist(), "label": label}
        for i, label in enumerate(names)
    ]
    document = {"sceneId": prefix + scan, "appId": "Aggregator.v2", "segGroups": groups, "segmentsFile": name}
    (folder / f"{scan}{aggregation}").write_text(json.dumps(document))
    if frames == "none":
        return folder
    shots = rendered(room)
    camera = room.cameras[0]
    if frames == "sens":
        (folder / f"{scan}.sens").write_bytes(sens_bytes(shots, camera))
    elif frames == "flat":
        for index, (color, depth, pose) in enumerate(shots):
            (folder / f"frame-{index:06d}.color.jpg").write_bytes(_jpeg(color))
            Image.fromarray(depth).save(folder / f"frame-{index:06d}.depth.png")
            (folder / f"frame-{index:06d}.pose.txt").write_text(matrix_text(pose))
        (folder / "intrinsic.txt").write_text(matrix_text(camera.intrinsic))
    else:
        write_frames(folder / f"{scan}_2d" if frames == "2d" else folder, shots, camera)
    return folder


def write_posed_rgbd(folder: Path, room: BoxRoom) -> Path:
    """A plain folder of posed frames: color, depth, pose.txt with quaternions, intrinsics.json."""
    from tasks.geometry.transforms import quaternion_xyzw

    shots, camera = rendered(room), room.cameras[0]
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    lines = []
    for index, (color, depth, pose) in enumerate(shots, start=1):
        Image.fromarray(color).save(folder / "color" / f"{index}.png")
        Image.fromarray(depth).save(folder / "depth" / f"{index}.png")
        lines.append(" ".join(f"{v:.8f}" for v in (*pose[:3, 3], *quaternion_xyzw(pose))))
    (folder / "pose.txt").write_text("\n".join(lines) + "\n")
    numbers = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "width": camera.width, "height": camera.height}
    (folder / "intrinsics.json").write_text(json.dumps({**numbers, "depth_scale": 1000}))
    return folder
