"""One scan as apps on phones record it, byte by byte after each format's public description."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tasks.capture.reading import FrameSource
from tasks.geometry.transforms import OPENGL_TO_OPENCV, Z_UP_TO_Y_UP, quaternion_xyzw
from tasks.scanner.folder import jpeg
from tests.tasks.capture.formats.written import millimeters, png, put

Array = NDArray[np.float64]


def write_stray_scanner(folder: Path, frames: Sequence[FrameSource], is_extracted: bool = True) -> Path:
    """Poses are of an OpenCV camera in ARKit's frame, +Y up; a quarter of each depth image is where the sensor has no confidence."""
    fx, fy, cx, cy = frames[0].intrinsics
    files: dict[str, bytes | str] = {"camera_matrix.csv": f"{fx!r}, 0.0, {cx!r}\n0.0, {fy!r}, {cy!r}\n0.0, 0.0, 1.0\n", "rgb.mp4": b"ftyp"}
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for index, frame in enumerate(frames):
        assert frame.pose is not None
        pose = Z_UP_TO_Y_UP @ frame.pose
        numbers = [*pose[:3, 3].tolist(), *map(float, quaternion_xyzw(pose))]
        rows.append(", ".join([repr(index / 60), f"{index:06d}", *map(repr, numbers)]))
        depth = millimeters(frame)
        confidence = np.full(depth.shape, 2, dtype=np.uint8)
        confidence[:, : depth.shape[1] // 4] = 0
        files |= {f"depth/{index:06d}.png": png(depth), f"confidence/{index:06d}.png": png(confidence)}
        if is_extracted:
            files[f"rgb/{index:06d}.png"] = png(frame.color())
    files["odometry.csv"] = "\n".join(rows) + "\n"
    return put(folder, files)


def write_video(path: Path, images: Sequence[NDArray[np.uint8]]) -> None:
    """A video of images, shape (h, w, 3) each, as an MP4."""
    import av

    with av.open(path, "w", format="mp4") as container:
        stream = container.add_stream("mpeg4", rate=60)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 8_000_000
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())


def pack_record3d(folder: Path) -> None:
    """Pack depth and confidence of a recording with LZFSE, as the app does."""
    import lzfse

    for path in [*folder.glob("rgbd/*.depth"), *folder.glob("rgbd/*.conf")]:
        path.write_bytes(lzfse.compress(path.read_bytes()))


def zip_record3d(folder: Path, archive: Path, below: str = "") -> None:
    """A recording as the app shares it."""
    with zipfile.ZipFile(archive, "w") as target:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            target.write(path, below + path.relative_to(folder).as_posix())


def write_record3d(folder: Path, frames: Sequence[FrameSource]) -> Path:
    """An unzipped `.r3d` whose depth maps were unpacked. Poses are of an OpenGL camera in ARKit's frame, +Y up."""
    fx, fy, cx, cy = frames[0].intrinsics
    assert frames[0].depth_size is not None
    poses = []
    files: dict[str, bytes | str] = {}
    for index, frame in enumerate(frames):
        assert frame.pose is not None
        pose = Z_UP_TO_Y_UP @ frame.pose @ OPENGL_TO_OPENCV
        poses.append([*map(float, quaternion_xyzw(pose)), *pose[:3, 3].tolist()])
        assert frame.depth is not None
        files |= {f"rgbd/{index}.jpg": jpeg(frame.color()), f"rgbd/{index}.depth": frame.depth().astype("<f4").tobytes()}
        files[f"rgbd/{index}.conf"] = np.full(frame.depth().shape, 2, dtype=np.uint8).tobytes()
    metadata = {
        "w": frames[0].width, "h": frames[0].height, "dw": frames[0].depth_size[0], "dh": frames[0].depth_size[1], "fps": 60,
        "K": [fx, 0.0, 0.0, 0.0, fy, 0.0, cx, cy, 1.0], "poses": poses,
    }  # fmt: skip
    files["metadata"] = json.dumps(metadata)
    return put(folder, files)


def write_roomplan(
    folder: Path, boxes: Sequence[tuple[str, Array, Array]], room: Array, doors: Sequence[tuple[int, float, float, float]] = ()
) -> Path:
    """A room of four walls about the origin, its floor at height 0, in ARKit's frame, +Y up. boxes: Category, pose in the world frame,
    4x4, and size [m]. room: Extents [m]. doors: In which wall, how far along it from its middle, width and height [m]."""
    x, y, z = room
    ends = [
        ((-x / 2, -y / 2), (x / 2, -y / 2)),
        ((x / 2, -y / 2), (x / 2, y / 2)),
        ((x / 2, y / 2), (-x / 2, y / 2)),
        ((-x / 2, y / 2), (-x / 2, -y / 2)),
    ]

    def upright(a: tuple[float, float], b: tuple[float, float], center: float, height: float) -> Array:
        """A frame whose x is along a wall and whose y is up, in the world frame."""
        along = np.array([b[0] - a[0], b[1] - a[1], 0.0]) / np.hypot(b[0] - a[0], b[1] - a[1])
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 1], pose[:3, 2] = along, [0, 0, 1], np.cross(along, [0, 0, 1])
        pose[:3, 3] = [*(0.5 * (np.array(a) + b) + center * along[:2]), height]
        return pose

    def element(kind: str, pose: Array, size: Sequence[float], **more: object) -> dict[str, object]:
        columns = (Z_UP_TO_Y_UP @ pose).T.ravel().tolist()
        return {"dimensions": list(map(float, size)), "transform": columns, "category": {kind: {}}, "confidence": {"high": {}}, **more}

    walls = [
        element("wall", upright(a, b, 0.0, z / 2), [np.hypot(b[0] - a[0], b[1] - a[1]), z, 0.0], identifier=f"WALL-{k}")
        for k, (a, b) in enumerate(ends)
    ]
    leaves = [
        element(
            "door", upright(*ends[wall], center, height / 2), [width, height, 0.0], identifier=f"DOOR-{k}", parentIdentifier=f"WALL-{wall}"
        )
        for k, (wall, center, width, height) in enumerate(doors)
    ]
    objects = []
    for category, pose, size in boxes:
        turned = pose @ np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])  # its height along its own y
        objects.append(element(category, turned, [size[0], size[2], size[1]]))
    floor = element(
        "floor", np.eye(4), [x, y, 0.0], polygonCorners=[[-x / 2, -y / 2, 0], [x / 2, -y / 2, 0], [x / 2, y / 2, 0], [-x / 2, y / 2, 0]]
    )
    document = {
        "version": 2, "walls": walls, "doors": leaves, "windows": [], "openings": [], "objects": objects, "floors": [floor],
        "sections": [{"label": "livingRoom", "center": [0, 0, 0], "story": 0}],
    }  # fmt: skip
    return put(folder, {"CapturedRoom.json": json.dumps(document), "Room.usdz": b"PK"})
