"""Intrinsics of color and depth images, as files state them, at the size of the images."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import floats, name_of, read_json, read_text
from tasks.capture.files.sens import focal_and_center
from tasks.capture.files.trajectory import rows_of
from tasks.capture.layout import FrameLayout

Intrinsics = tuple[float, float, float, float]

DEPTH_SCALE = 1000.0
"""Depth images hold millimetres unless the scan says otherwise: what ScanNet, Kinect and RealSense exporters write."""

MAX_STRETCH = 1.05
"""Ratio of two image sizes' shapes from which on they are not one image resized: ScanNet's color and depth differ by 0.4 %."""


def color_intrinsics(
    layout: FrameLayout, folder: Path, stated: dict[str, str], size: tuple[int, int], usual: float = DEPTH_SCALE
) -> tuple[Intrinsics, float]:
    """Color intrinsics at the images' own size [px], and depth units per metre, which are `usual` unless a file says so."""
    path = layout.color_intrinsics
    if path is not None:
        return intrinsics_file(path, folder, size, usual, _stated_size(stated, "color"))
    values = _stated_intrinsics(stated, "color", folder)
    if values is None:
        remedy = "write intrinsics.json with fx, fy, cx, cy, width, height, depth_scale"
        raise InputError(folder.name, "intrinsics", "the scan states none", remedy)
    return _scaled_to_fit(values, _stated_size(stated, "color"), size, folder.name), usual


def intrinsics_file(
    path: Path, folder: Path, size: tuple[int, int], scale: float, stated: tuple[int, int] | None = None
) -> tuple[Intrinsics, float]:
    """Intrinsics that a file states, at the images' own `size` [px], and depth units per metre, which are `scale` unless it says so.
    stated: Size that the intrinsics are for, where that is known.

    Raises:
        InputError: it states none.
    """
    name = name_of(path, folder)
    if path.suffix == ".json":
        return _json_intrinsics(read_json(path, name), name, size, scale)
    return _scaled_to_fit(matrix_intrinsics(read_text(path, name), name), stated, size, name), scale


def depth_intrinsics(
    layout: FrameLayout, folder: Path, stated: dict[str, str], color: Intrinsics, color_size: tuple[int, int], size: tuple[int, int]
) -> Intrinsics:
    """Depth intrinsics at the images' own size [px]: those of a file, or else the color intrinsics, resized."""
    if layout.depth_intrinsics is not None:
        name = name_of(layout.depth_intrinsics, folder)
        values = matrix_intrinsics(read_text(layout.depth_intrinsics, name), name)
        return _scaled_to_fit(values, _stated_size(stated, "depth"), size, name)
    if (intrinsics := _stated_intrinsics(stated, "depth", folder)) is not None:
        return _scaled_to_fit(intrinsics, _stated_size(stated, "depth"), size, folder.name)
    return of_depth(color, color_size, size, folder.name)


def of_depth(color: Intrinsics, color_size: tuple[int, int], size: tuple[int, int], name: str) -> Intrinsics:
    """Intrinsics of depth images without their own: those of the color images, resized.

    Raises:
        InputError: the shapes of the two kinds of images differ, so that one is not the other resized.
    """
    if difference := _difference(color_size, size):
        problem = f"the depth images have {_pixels(size)}, the color images {_pixels(color_size)}: {difference}"
        raise InputError(name, "intrinsics", problem, "write intrinsic_depth.txt, or export both in one shape")
    return scaled_intrinsics(color, color_size, size)


def resized_intrinsics(values: Intrinsics, stated: tuple[int, int], size: tuple[int, int], name: str) -> Intrinsics:
    """Intrinsics that are stated for images of one size, for images of another, both (width, height) [px].

    Raises:
        InputError: the shapes of the two sizes differ.
    """
    if difference := _difference(stated, size):
        problem = f"are for images of {_pixels(stated)}, and the images have {_pixels(size)}: {difference}"
        raise InputError(name, "intrinsics", problem, "write intrinsics for the size and turn of the images")
    return scaled_intrinsics(values, stated, size)


def _difference(size: tuple[int, int], other: tuple[int, int]) -> str:
    """Difference between the shapes of two sizes, empty where one is the other resized."""
    stretch = size[0] * other[1] / (size[1] * other[0])
    if 1 / MAX_STRETCH < stretch < MAX_STRETCH:
        return ""
    turned = size[1] * other[1] / (size[0] * other[0])
    return "turned by 90 degrees" if 1 / MAX_STRETCH < turned < MAX_STRETCH else "another shape, so cropped or stretched"


def _pixels(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]} pixels"


def scaled_intrinsics(values: Intrinsics, size: tuple[int, int], target: tuple[int, int]) -> Intrinsics:
    """Intrinsics of an image of `size` resized to `target`, both (width, height) [px]; pixel centers are integers."""
    kx, ky = target[0] / size[0], target[1] / size[1]
    fx, fy, cx, cy = values
    return fx * kx, fy * ky, (cx + 0.5) * kx - 0.5, (cy + 0.5) * ky - 0.5


def _scaled_to_fit(values: Intrinsics, stated: tuple[int, int] | None, size: tuple[int, int], name: str) -> Intrinsics:
    """Intrinsics of the camera brought to the exported size, where images were shrunk and intrinsics were not."""
    centered = 0.25 * size[0] <= values[2] <= 0.75 * size[0]
    return values if centered or stated is None else resized_intrinsics(values, stated, size, name)


def matrix_intrinsics(text: str, name: str) -> Intrinsics:
    """fx, fy, cx, cy [px] from a text: a 3x3, 3x4 or 4x4 matrix, or the four numbers; raises InputError."""
    plain = " ".join(word for row in rows_of(text)[0] for word in row)
    count = len(plain.split())
    if count == 4:
        fx, fy, cx, cy = floats(plain, name, "intrinsics", 4)
        return focal_and_center(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), name, "intrinsics")
    columns = 3 if count == 9 else 4
    values = floats(plain, name, "intrinsics", count if count in (9, 12) else 16)
    return focal_and_center(_by_rows(values.reshape(-1, columns)[:3, :3]), name, "intrinsics")


def _by_rows(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """An intrinsic matrix, 3x3, by rows: its last row is 0 0 1. Written by columns, its last column is."""
    is_transposed = not np.array_equal(matrix[2], [0, 0, 1]) and np.array_equal(matrix[:, 2], [0, 0, 1])
    return matrix.T if is_transposed else matrix


def _json_intrinsics(document: dict[str, object], name: str, size: tuple[int, int], usual: float) -> tuple[Intrinsics, float]:
    """Intrinsics as fx, fy, cx, cy, or as `intrinsic_matrix` by columns, as in Open3D, or by rows; and `depth_scale`."""
    listed = document.get("intrinsic_matrix")
    if isinstance(listed, list) and len(listed) == 9 and all(isinstance(v, int | float) for v in listed):
        matrix = _by_rows(np.array(listed, dtype=np.float64).reshape(3, 3))
    else:
        fx, fy, cx, cy = (_number(document.get(key), name, key) for key in ("fx", "fy", "cx", "cy"))
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    values = focal_and_center(matrix, name, "intrinsics")
    scale = _number(document.get("depth_scale", usual), name, "depth_scale")
    if not 1 <= scale <= 1e6:
        raise InputError(name, "depth_scale", f"is {scale:g}, must be 1 to 1,000,000 units per metre", "1000 for millimetres")
    if "width" in document and "height" in document:
        stated = (round(_number(document["width"], name, "width")), round(_number(document["height"], name, "height")))
        if min(stated) > 0 and stated != size:
            values = resized_intrinsics(values, stated, size, name)
    return values, scale


def _number(value: object, name: str, field: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e9:
        raise InputError(name, field, f"must be a number, is {json.dumps(value, default=str)[:40]}", "write it in pixels")
    return float(value)


def _stated_intrinsics(stated: dict[str, str], camera: str, folder: Path) -> Intrinsics | None:
    keys = [f"{key}_{camera}" for key in ("fx", "fy", "mx", "my")]
    if not all(key in stated for key in keys):
        return None
    fx, fy, cx, cy = (float(floats(stated[key], folder.name, key, 1)[0]) for key in keys)
    return focal_and_center(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), folder.name, f"fx_{camera}")


def _stated_size(stated: dict[str, str], camera: str) -> tuple[int, int] | None:
    width, height = stated.get(f"{camera}Width", ""), stated.get(f"{camera}Height", "")
    if not (width.isascii() and height.isascii() and width.isdigit() and height.isdigit() and len(width) < 6 and len(height) < 6):
        return None
    return (int(width), int(height)) if int(width) and int(height) else None
