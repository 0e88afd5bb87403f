"""One scan written in every format, byte by byte after each format's public description, from what the native format says of it."""

from __future__ import annotations

import dataclasses
import io
import json
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tasks.capture.formats import find_scans, format_of
from tasks.capture.reading import FrameSource, Group, Reading
from tasks.capture.scan import Scan
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import inverse, quaternion_xyzw, rotation_vector
from tests.capture_scans import OBJECTS, box_room, ply_bytes, write_scannet

Array = NDArray[np.float64]


def only_scan(folder: Path, format: str = "auto") -> Scan:
    """The one scan in a folder."""
    (scan,), errors = find_scans(folder, format)
    assert errors == []
    return scan


def read(folder: Path, format: str = "auto") -> Reading:
    """What the one scan in a folder says."""
    scan = only_scan(folder, format)
    return format_of(scan).read(scan)


@cache
def sample() -> Reading:
    """A small room with a chair and three frames, as a ScanNet folder says it; nobody changes it."""
    room = box_room(OBJECTS[1:2], cameras=3, step=0.1)
    room = dataclasses.replace(room, cameras=tuple(dataclasses.replace(c, **_quarter(c)) for c in room.cameras))
    with tempfile.TemporaryDirectory() as place:
        reading = read(write_scannet(Path(place) / "scene0001_00", room, aligned=False, scene_type=None))
        return dataclasses.replace(reading, frames=tuple(_held(frame) for frame in reading.frames))


def _quarter(camera: object) -> dict[str, float]:
    names = {name: getattr(camera, name) // 4 for name in ("width", "height")}
    return names | {name: getattr(camera, name) / 4 for name in ("fx", "fy", "cx", "cy")}


def _held(frame: FrameSource) -> FrameSource:
    """A frame whose pixels are in memory."""
    assert frame.depth is not None
    color, depth = frame.color(), frame.depth()
    return dataclasses.replace(frame, color=lambda: color, depth=lambda: depth)


def owner_of(reading: Reading) -> NDArray[np.int64]:
    """Instance of each vertex, -1 for none, shape (n,)."""
    assert reading.surface is not None
    owner = np.full(len(reading.surface.vertices), -1, dtype=np.int64)
    for index, group in enumerate(reading.groups or ()):
        owner[group.vertices] = index
    return owner


def owner_of_faces(reading: Reading) -> NDArray[np.int64]:
    """Instance of each face, -1 for none, shape (m,)."""
    assert reading.surface is not None
    owner = np.full(len(reading.surface.faces), -1, dtype=np.int64)
    for index, group in enumerate(reading.groups or ()):
        owner[group.faces] = index
    return owner


def png(pixels: NDArray[np.generic]) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def millimeters(frame: FrameSource) -> NDArray[np.uint16]:
    assert frame.depth is not None
    return np.round(frame.depth() * 1000.0).astype(np.uint16)


def put(folder: Path, files: dict[str, bytes | str]) -> Path:
    """Files by their paths below a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return folder


def listed(values: NDArray[np.integer]) -> list[int]:
    return [int(value) for value in values]


def aggregation(groups: Sequence[Group], start: int = 0) -> str:
    """An aggregation in which every instance is one segment, numbered from `start`."""
    entries = [
        {"id": start + index, "objectId": start + index, "segments": [10 * index + 3], "label": group.raw_label}
        for index, group in enumerate(groups)
    ]
    return json.dumps({"sceneId": "x", "appId": "Aggregator.v2", "segGroups": entries, "segmentsFile": "x"})


def segmentation(owner: NDArray[np.int64]) -> str:
    """A segment for each vertex or face: one for each instance, another for what is nobody's."""
    return json.dumps({"params": {"kThresh": "0.01"}, "sceneId": "x", "segIndices": listed(10 * owner + 3)})


def write_scannetpp(folder: Path, reading: Reading) -> Path:
    assert reading.surface is not None
    files: dict[str, bytes | str] = {
        "scans/mesh_aligned_0.05.ply": ply_bytes(reading.surface),
        "scans/segments.json": segmentation(owner_of(reading)),
        "scans/segments_anno.json": aggregation(reading.groups or (), start=1),
    }
    return put(folder, files)


def write_matterport3d(folder: Path, reading: Reading) -> Path:
    assert reading.surface is not None
    files: dict[str, bytes | str] = {
        "region_segmentations/region0.ply": ply_bytes(reading.surface),
        "region_segmentations/region0.fsegs.json": segmentation(owner_of_faces(reading)),
        "region_segmentations/region0.semseg.json": aggregation(reading.groups or ()),
    }
    return put(folder, files)


def paired(faces: NDArray[np.int64], owner: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (a, b, c) and (a, c, d) of one owner as quads (a, b, c, d), with the owner of each; nothing is left over."""
    second = {(int(a), int(c)): (int(d), k) for k, (a, c, d) in enumerate(faces)}
    quads, owners, used = [], [], set()
    for k, (a, b, c) in enumerate(faces):
        other = second.get((int(a), int(c)))
        if k not in used and other is not None and other[1] not in used and owner[other[1]] == owner[k]:
            quads.append((int(a), int(b), int(c), other[0]))
            owners.append(owner[k])
            used |= {k, other[1]}
    assert len(used) == len(faces)
    return np.array(quads), np.array(owners)


def write_replica_v1(folder: Path, reading: Reading, is_quads: bool = True) -> Path:
    """Objects are numbered from 1; what is nobody's is of object 0, which has no class."""
    assert reading.surface is not None
    surface, owner = reading.surface, owner_of_faces(reading)
    faces, owner = paired(surface.faces, owner) if is_quads else (surface.faces, owner)
    vertex = np.zeros(len(surface.vertices), dtype=[("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 3)])
    vertex["p"], vertex["c"] = surface.vertices, surface.colors
    face = np.zeros(len(faces), dtype=[("k", "u1"), ("i", "<i4", faces.shape[1]), ("o", "<i4")])
    face["k"], face["i"], face["o"] = faces.shape[1], faces, owner + 1
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertex)}\n"
    header += "".join(f"property float {axis}\n" for axis in ("x", "y", "z", "nx", "ny", "nz"))
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    header += f"element face {len(face)}\nproperty list uchar int vertex_indices\nproperty int object_id\nend_header\n"
    names = sorted({group.raw_label for group in reading.groups or ()})
    objects = [
        {"id": index + 1, "class_id": names.index(group.raw_label) + 1, "class_name": group.raw_label}
        for index, group in enumerate(reading.groups or ())
    ]
    info = {
        "classes": [{"id": index + 1, "name": name} for index, name in enumerate(names)],
        "gravity_center": [0, 0, 0],
        "gravity_dir": [0, 0, -1],
        "id_to_label": [0, *(entry["class_id"] for entry in objects)],
        "objects": [{"id": 0, "class_id": 0, "class_name": "undefined"}, *objects],
    }
    files: dict[str, bytes | str] = {
        "habitat/mesh_semantic.ply": header.encode() + vertex.tobytes() + face.tobytes(),
        "habitat/info_semantic.json": json.dumps(info),
    }
    return put(folder, files)


def write_threerscan(folder: Path, reading: Reading, is_labelled: bool = True) -> Path:
    """With the labelled mesh, or with the segments of the textured one alone; `is_labelled` says which. The texture has a column of
    pixels for each color of the mesh."""
    assert reading.surface is not None
    surface = reading.surface
    palette, column = np.unique(surface.colors, axis=0, return_inverse=True)
    obj = ["mtllib mesh.refined.mtl", "usemtl x"]
    obj += [f"v {x!r} {y!r} {z!r}" for x, y, z in surface.vertices.tolist()]
    obj += [f"vt {(k + 0.5) / len(palette)!r} 0.5" for k in range(len(palette))]
    obj += ["f " + " ".join(f"{v + 1}/{column.ravel()[v] + 1}/{v + 1}" for v in face) for face in surface.faces.tolist()]
    files: dict[str, bytes | str] = {
        "mesh.refined.v2.obj": "\n".join(obj) + "\n",
        "mesh.refined_0.png": png(np.repeat(palette[None].astype(np.uint8), 2, axis=0)),
        "mesh.refined.0.010000.segs.v2.json": segmentation(owner_of(reading)),
        "semseg.v2.json": aggregation(reading.groups or (), start=1),
    }
    if is_labelled:
        files["labels.instances.annotated.v2.ply"] = labelled_ply(surface, owner_of(reading) + 1)
    if reading.frames:
        files |= _sequence(reading.frames)
    return put(folder, files)


def annotated_object(name: str, pose: Array, size: Array, **more: object) -> dict[str, object]:
    """An object as MultiScan lists it. pose: Of its box in the scan frame, 4x4 [m], z its height. Its axes are width, height, depth."""
    axes = np.array([pose[:3, 0], pose[:3, 2], -pose[:3, 1]])
    low, high = (pose[:3, 3] + sign * 0.5 * np.abs(pose[:3, :3]) @ size for sign in (-1, 1))
    box = {
        "centroid": pose[:3, 3].tolist(), "axesLengths": [float(size[0]), float(size[2]), float(size[1])],
        "normalizedAxes": axes.ravel().tolist(), "min": low.tolist(), "max": high.tolist(),
        "front": axes[2].tolist(), "up": axes[1].tolist(),
    }  # fmt: skip
    return {"label": name, "obb": box, **more}


def write_multiscan(folder: Path, reading: Reading, is_labelled: bool = True) -> Path:
    """As downloads have it, a number for each face and object; or as the older sample has it, lists of faces by names of objects and
    parts. `is_labelled` says which. Objects have two parts, the first of one face."""
    assert reading.surface is not None
    surface, owner = reading.surface, owner_of_faces(reading)
    objects, lists, counts = [], {}, dict[str, int]()
    for index, group in enumerate(reading.groups or ()):
        counts[group.raw_label] = counts.get(group.raw_label, 0) + 1
        name = f"{group.raw_label}.{counts[group.raw_label]}"
        corners = surface.vertices[group.vertices]
        pose, size = np.eye(4), np.ptp(corners, axis=0)
        pose[:3, 3] = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        numbers = {"objectId": index + 1, "partIds": [2 * index + 1, 2 * index + 2]} if is_labelled else {}
        objects.append(annotated_object(name, pose, size, mobilityType="movable", **numbers))
        lists |= {f"{name}:handle.1": listed(group.faces[:1]), f"{name}:{name}": listed(group.faces[1:])}
    document: dict[str, object] = {"version": "multiscan@0.0.1", "scanId": folder.name, "objects": objects}
    files: dict[str, bytes | str] = {}
    if is_labelled:
        document["parts"] = [{"partId": k + 1, "label": "handle.1"} for k in range(2 * len(objects))]
        files[f"{folder.name}.ply"] = numbered_ply(surface, owner + 1)
    else:
        files[f"{folder.name}.ply"] = ply_bytes(surface)
        files[f"{folder.name}.semseg.json"] = json.dumps({"scanId": folder.name, "triIndices": lists})
    return put(folder, files | {f"{folder.name}.annotations.json": json.dumps(document)})


def numbered_ply(surface: Surface, numbers: NDArray[np.int64]) -> bytes:
    """A PLY as MultiScan has them: coordinates in double precision, normals, and the object and part of each face."""
    vertex = np.zeros(len(surface.vertices), dtype=[("p", "<f8", 3), ("n", "<f8", 3), ("c", "u1", 4)])
    vertex["p"], vertex["c"][:, :3], vertex["c"][:, 3] = surface.vertices, surface.colors, 255
    face = np.zeros(len(surface.faces), dtype=[("k", "u1"), ("i", "<i4", 3), ("o", "<u2"), ("part", "<u2")])
    face["k"], face["i"], face["o"], face["part"] = 3, surface.faces, numbers, 2 * numbers
    header = f"ply\nformat binary_little_endian 1.0\ncomment VCGLIB generated\nelement vertex {len(vertex)}\n"
    header += "".join(f"property double {axis}\n" for axis in ("x", "y", "z", "nx", "ny", "nz"))
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue", "alpha"))
    header += (
        f"element face {len(face)}\nproperty list uchar int vertex_indices\nproperty ushort objectId\nproperty ushort partId\nend_header\n"
    )
    return header.encode() + vertex.tobytes() + face.tobytes()


def write_multiscan_boxes(folder: Path, boxes: Sequence[tuple[str, Array, Array]], turn: Array) -> Path:
    """An annotation alone. boxes: Name, pose in the world frame, 4x4, and size [m] of each object. turn: World to scan frame, 4x4."""
    objects = [annotated_object(name, turn @ pose, size) for name, pose, size in boxes]
    document = {"version": "multiscan@0.0.1", "scanId": folder.name, "objects": objects, "articulations": {}}
    return put(folder, {f"{folder.name}.annotations.json": json.dumps(document)})


def labelled_ply(surface: Surface, labels: NDArray[np.int64], is_text: bool = False) -> bytes:
    """A PLY whose vertices have a number, and colors that say nothing of the scan."""
    header = f"ply\nformat {'ascii' if is_text else 'binary_little_endian'} 1.0\nelement vertex {len(labels)}\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) + "property ushort objectId\nproperty ushort NYU40\n"
    header += f"element face {len(surface.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    if is_text:
        rows = [f"{x!r} {y!r} {z!r} 9 9 9 {label} 0" for (x, y, z), label in zip(surface.vertices.tolist(), labels.tolist(), strict=True)]
        rows += ["3 " + " ".join(map(str, face)) for face in surface.faces.tolist()]
        return (header + "\n".join(rows) + "\n").encode()
    vertex = np.zeros(len(labels), dtype=[("p", "<f4", 3), ("c", "u1", 3), ("o", "<u2"), ("n", "<u2")])
    vertex["p"], vertex["c"], vertex["o"] = surface.vertices, 9, labels
    face = np.zeros(len(surface.faces), dtype=[("k", "u1"), ("i", "<i4", 3)])
    face["k"], face["i"] = 3, surface.faces
    return header.encode() + vertex.tobytes() + face.tobytes()


def _sequence(frames: Sequence[FrameSource]) -> dict[str, bytes | str]:
    lens, depth_lens = frames[0].intrinsics, frames[0].depth_intrinsics
    info = [f"m_colorWidth = {frames[0].width}", f"m_colorHeight = {frames[0].height}"]
    assert frames[0].depth_size is not None
    info += [f"m_depthWidth = {frames[0].depth_size[0]}", f"m_depthHeight = {frames[0].depth_size[1]}", "m_depthShift = 1000"]
    for word, (fx, fy, cx, cy) in (("Color", lens), ("Depth", depth_lens)):
        info.append(f"m_calibration{word}Intrinsic = {fx!r} 0 {cx!r} 0 0 {fy!r} {cy!r} 0 0 0 1 0 0 0 0 1")
    files: dict[str, bytes | str] = {"sequence/_info.txt": "\n".join(info) + "\n"}
    for index, frame in enumerate(frames):
        assert frame.pose is not None
        depth = millimeters(frame)
        pgm = f"P5\n{depth.shape[1]} {depth.shape[0]}\n65535\n".encode() + depth.astype(">u2").tobytes()
        stem = f"sequence/frame-{index:06d}"
        text = "\n".join(" ".join(map(repr, row)) for row in frame.pose.tolist()) + "\n"
        files |= {f"{stem}.color.png": png(frame.color()), f"{stem}.depth.pgm": pgm, f"{stem}.pose.txt": text}
    return files


def write_arkitscenes(folder: Path, reading: Reading, boxes: Sequence[tuple[str, str, Array, Array]] = ()) -> Path:
    """With frames and mesh in the layout of the 3DOD part. boxes: Id, label, pose in the scan frame, 4x4, and size [m] of each."""
    name = folder.name
    files: dict[str, bytes | str] = {}
    if reading.surface is not None:
        files[f"{name}_3dod_mesh.ply"] = ply_bytes(reading.surface)
    if boxes:
        data = [
            {
                "uid": uid,
                "label": label,
                "segments": {
                    "obbAligned": {
                        "centroid": pose[:3, 3].tolist(), "axesLengths": size.tolist(), "normalizedAxes": pose[:3, :3].T.ravel().tolist(),
                    },
                },
            }
            for uid, label, pose, size in boxes
        ]  # fmt: skip
        files[f"{name}_3dod_annotation.json"] = json.dumps({"data": data, "skipped": False})
    lines = []
    for index, frame in enumerate(reading.frames):
        assert frame.pose is not None
        stamp = f"{300 + index / 10:.3f}"
        view = inverse(frame.pose)
        lines.append(" ".join(map(repr, [300 + index / 10 + 0.0004, *rotation_vector(view[:3, :3]), *view[:3, 3].tolist()])))
        pincam = " ".join(map(repr, (frame.width, frame.height, *frame.intrinsics)))
        for place, ending, content in (
            ("lowres_wide", "png", png(frame.color())), ("lowres_depth", "png", png(millimeters(frame))),
            ("lowres_wide_intrinsics", "pincam", f"{pincam}\n"),
        ):  # fmt: skip
            files[f"{name}_frames/{place}/{name}_{stamp}.{ending}"] = content
    if lines:
        files[f"{name}_frames/lowres_wide.traj"] = "\n".join(lines) + "\n"
    return put(folder, files)


def write_tum_rgbd(folder: Path, frames: Sequence[FrameSource], is_tracked: bool = True) -> Path:
    """Depth comes 10 ms after color and poses at 100 Hz; the first color image has no depth image."""
    start = 1305031102.0
    fx, fy, cx, cy = frames[0].intrinsics
    numbers = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": frames[0].width, "height": frames[0].height}
    files: dict[str, bytes | str] = {"intrinsics.json": json.dumps(numbers)}
    colors, depths, poses = ["# color images", "# timestamp filename"], ["# depth maps"], ["# timestamp tx ty tz qx qy qz qw"]
    colors.append(f"{start - 1:.6f} rgb/first.png")
    files["rgb/first.png"] = png(frames[0].color())
    for index, frame in enumerate(frames):
        assert frame.pose is not None
        time = start + index / 30
        colors.append(f"{time:.6f} rgb/{time:.6f}.png")
        depths.append(f"{time + 0.01:.6f} depth/{time + 0.01:.6f}.png")
        files[f"rgb/{time:.6f}.png"] = png(frame.color())
        files[f"depth/{time + 0.01:.6f}.png"] = png((millimeters(frame).astype(np.int64) * 5).astype(np.uint16))
        for late, pose in ((0.004, frame.pose), (0.014, np.eye(4))):
            quaternion = [float(v) for v in quaternion_xyzw(pose)]
            poses.append(" ".join([f"{time + late:.4f}", *map(repr, [*pose[:3, 3].tolist(), *quaternion])]))
    files |= {"rgb.txt": "\n".join(colors) + "\n", "depth.txt": "\n".join(depths) + "\n"}
    if is_tracked:
        files["groundtruth.txt"] = "\n".join(poses) + "\n"
    return put(folder, files)


def assert_same_frames(mine: Sequence[FrameSource], native: Sequence[FrameSource], is_lossy: bool = False) -> None:
    """Frames say the same: pixels and depth bit by bit, lenses and poses but for rounding. is_lossy: Pixels come of a JPEG."""
    assert len(mine) == len(native)
    for one, other in zip(mine, native, strict=True):
        assert (one.width, one.height, one.depth_size) == (other.width, other.height, other.depth_size)
        np.testing.assert_allclose([*one.intrinsics, *one.depth_intrinsics], [*other.intrinsics, *other.depth_intrinsics], atol=1e-9)
        if is_lossy:
            assert np.abs(one.color().astype(float) - other.color()).mean() < 6.0
        else:
            np.testing.assert_array_equal(one.color(), other.color())
        assert one.depth is not None
        assert other.depth is not None
        np.testing.assert_array_equal(one.depth(), other.depth())
        np.testing.assert_allclose(one.pose, other.pose, atol=1e-7)


def assert_same_instances(mine: Reading, native: Reading, same_order: bool = True) -> None:
    """Surface and instances say the same, number by number. same_order: Faces are in one order, too."""
    assert mine.surface is not None
    assert native.surface is not None
    np.testing.assert_array_equal(mine.surface.vertices, native.surface.vertices)
    np.testing.assert_array_equal(mine.surface.colors, native.surface.colors)
    assert [group.raw_label for group in mine.groups or ()] == [group.raw_label for group in native.groups or ()]
    for one, other in zip(mine.groups or (), native.groups or (), strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
        corners = (mine.surface.faces[one.faces], native.surface.faces[other.faces])
        if not same_order:
            corners = tuple(np.unique(np.sort(part, axis=1), axis=0) for part in corners)  # type: ignore[assignment]
        np.testing.assert_array_equal(*corners)
    if same_order:
        np.testing.assert_array_equal(mine.surface.faces, native.surface.faces)
