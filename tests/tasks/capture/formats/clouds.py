"""Point clouds with known truth, written in every kind of file."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.triangles import spread
from tests.capture_scans import BoxRoom, box_room

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Cloud:
    """Points on a room, shape (n, 3), their colors, shape (n, 3), and the number of the piece that each is on, shape (n,)."""

    points: Array
    colors: NDArray[np.uint8]
    owner: NDArray[np.int64]


def sampled(room: BoxRoom, count: int, noise_m: float = 0.0, seed: int = 0) -> Cloud:
    """Points spread over a room, with millimeter coordinates."""
    rng = np.random.default_rng(seed)
    surface = room.surface
    face, weights = spread(surface.vertices, surface.faces, count, rng)
    points = np.einsum("nk,nkd->nd", weights, surface.vertices[surface.faces[face]]) + rng.normal(0, noise_m, (count, 3))
    corner = surface.faces[face, 0]
    return Cloud(np.round(points, 3), surface.colors[corner], room.instance[corner])


def small_cloud(count: int = 3000) -> Cloud:
    """A corner of a room, as small as a cloud can be that has a surface."""
    cloud = sampled(box_room(()), 40 * count)
    order = np.argsort(np.linalg.norm(cloud.points - [-2.0, -1.5, 0.0], axis=1))[:count]
    return Cloud(cloud.points[order], cloud.colors[order], cloud.owner[order])


def pcd_bytes(cloud: Cloud, form: str, size: Sequence[int] | None = None, viewpoint: str = "0 0 0 1 0 0 0") -> bytes:
    """A PCD with packed colors. form: ascii, binary or binary_compressed. size: width and height of a grid."""
    count = len(cloud.points)
    width, height = size or (count, 1)
    wide = cloud.colors.astype(np.uint32)
    rgb = (wide[:, 0] << 16 | wide[:, 1] << 8 | wide[:, 2]).astype("<u4")
    head = f"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F {'U' if form == 'ascii' else 'F'}\nCOUNT 1 1 1 1\n"
    head += f"WIDTH {width}\nHEIGHT {height}\nVIEWPOINT {viewpoint}\nPOINTS {count}\nDATA {form}\n"
    if form == "ascii":
        rows = (" ".join(f"{v:.9g}" for v in point) + f" {color}" for point, color in zip(cloud.points, rgb, strict=True))
        return head.encode() + "\n".join(rows).encode() + b"\n"
    columns = [*cloud.points.T.astype("<f4"), rgb]
    if form == "binary":
        table = np.stack([column.view("<u4") for column in columns], axis=1)
        return head.encode() + table.tobytes()
    plain = b"".join(column.tobytes() for column in columns)
    packed = lzf(plain)
    return head.encode() + struct.pack("<II", len(packed), len(plain)) + packed


def lzf(plain: bytes) -> bytes:
    """LZF, with a reference wherever three bytes were met in the last 8 KB."""
    out, literals, seen, at = bytearray(), bytearray(), dict[bytes, int](), 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literals.clear()

    while at < len(plain):
        before = seen.get(plain[at : at + 3])
        seen[plain[at : at + 3]] = at
        if before is None or at - before > 8192 or at + 3 > len(plain):
            literals.append(plain[at])
            at += 1
            continue
        length = 3
        while length < 264 and at + length < len(plain) and plain[before + length] == plain[at + length]:
            length += 1
        flush()
        offset, stated = at - before - 1, length - 2
        out.append(min(stated, 7) << 5 | offset >> 8)
        out.extend([stated - 7] if stated >= 7 else [])
        out.append(offset & 255)
        at += length
    flush()
    return bytes(out)


def ply_bytes(cloud: Cloud, is_text: bool = False, objects: bool = False) -> bytes:
    """A PLY without faces. objects: with an integer for the object of each point, and for its class."""
    kinds = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    kinds += [("instance", "<i4"), ("label", "<i4")] if objects else []
    rows = np.zeros(len(cloud.points), kinds)
    for i, name in enumerate("xyz"):
        rows[name] = cloud.points[:, i]
    for i, name in enumerate(("red", "green", "blue")):
        rows[name] = cloud.colors[:, i]
    if objects:
        rows["instance"], rows["label"] = cloud.owner, cloud.owner + 10
    words = {"<f8": "double", "u1": "uchar", "<i4": "int"}
    form = "ascii" if is_text else "binary_little_endian"
    head = f"ply\nformat {form} 1.0\nelement vertex {len(rows)}\n"
    head += "".join(f"property {words[kind]} {name}\n" for name, kind in kinds) + "end_header\n"
    body = "".join(" ".join(map(str, row.tolist())) + "\n" for row in rows).encode() if is_text else rows.tobytes()
    return head.encode() + body


def text_rows(cloud: Cloud, separator: str = " ", intensity: bool = False) -> str:
    """Rows of x y z, with intensity if asked for, and r g b."""
    rows = []
    for point, color in zip(cloud.points.tolist(), cloud.colors.tolist(), strict=True):
        words = [*(f"{v:.3f}" for v in point), *(["-1203"] if intensity else []), *map(str, color)]
        rows.append(separator.join(words))
    return "\n".join(rows) + "\n"


def write_las(path: Path, cloud: Cloud, shift: Sequence[float] = (0.0, 0.0, 0.0), wide: bool = True) -> None:
    """LAS or LAZ, by the ending. wide: colors of 16 bits, as the standard says."""
    import laspy

    head = laspy.LasHeader(point_format=2, version="1.2")
    head.scales, head.offsets = np.full(3, 0.001), np.floor(cloud.points.min(axis=0) + shift)
    las = laspy.LasData(head)
    las.x, las.y, las.z = (cloud.points + shift).T
    las.red, las.green, las.blue = (cloud.colors.astype(np.uint16) * (257 if wide else 1)).T
    las.write(path)


def write_e57(path: Path, cloud: Cloud, sensor: Sequence[float] = (0.5, 0.2, 1.4)) -> None:
    """An E57 with one scan whose scanner stands in the room."""
    import pye57

    local = cloud.points - sensor
    data = {f"cartesian{axis}": np.ascontiguousarray(local[:, i]) for i, axis in enumerate("XYZ")}
    data |= {f"color{word}": np.ascontiguousarray(cloud.colors[:, i]) for i, word in enumerate(("Red", "Green", "Blue"))}
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw(data, rotation=np.array([1.0, 0, 0, 0]), translation=np.asarray(sensor, float))


WRITERS: dict[str, Callable[[Path, Cloud], object]] = {
    "room.pcd": lambda path, cloud: path.write_bytes(pcd_bytes(cloud, "binary_compressed")),
    "text.pcd": lambda path, cloud: path.write_bytes(pcd_bytes(cloud, "ascii")),
    "plain.pcd": lambda path, cloud: path.write_bytes(pcd_bytes(cloud, "binary")),
    "room.xyz": lambda path, cloud: path.write_text(text_rows(cloud)),
    "room.pts": lambda path, cloud: path.write_text(f"{len(cloud.points)}\n" + text_rows(cloud, intensity=True)),
    "room.las": write_las,
    "room.laz": write_las,
    "room.e57": write_e57,
    "room.ply": lambda path, cloud: path.write_bytes(ply_bytes(cloud)),
    "text.ply": lambda path, cloud: path.write_bytes(ply_bytes(cloud, is_text=True)),
}
"""A writer for each kind of file, by an example of a name."""


def write_s3dis(folder: Path, cloud: Cloud, labels: Sequence[str]) -> None:
    """A room of S3DIS in a folder, with its objects; a label for each piece."""
    (folder / "Annotations").mkdir(parents=True)
    counted: dict[str, int] = {}
    for number, label in enumerate(labels):
        counted[label] = counted.get(label, 0) + 1
        own = cloud.owner == number
        part = Cloud(cloud.points[own], cloud.colors[own], cloud.owner[own])
        (folder / "Annotations" / f"{label}_{counted[label]}.txt").write_text(text_rows(part))
    (folder / f"{folder.name}.txt").write_text(text_rows(cloud))
