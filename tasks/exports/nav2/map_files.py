"""Maps as nav2's `map_server` reads them: a YAML file with the name of an image, and what its gray values mean.

After the rules of `nav2_map_server` (`map_io.cpp`): darker is more occupied unless `negate` is set, rows of the image go down from the
greatest y, and `origin` is the pose of the lower left pixel's lower left corner.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import is_there, read_file
from tasks.exports.nav2.grid import FREE, OCCUPIED, UNKNOWN, Raster
from tasks.unpacking import image_pixels

MODES = ("trinary", "scale", "raw")

GRAYS = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
"""Gray values that savers of maps write, and that tools for maps take for granted."""

OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
"""Above the former a cell is occupied, below the latter free. The unknown gray has an occupancy of 50/255, which is 0.19608: with
nav2's own 0.25 it would read as free."""

_NEEDED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_TRUE, _FALSE = ("true", "yes", "on", "y"), ("false", "no", "off", "n")


@dataclasses.dataclass(frozen=True)
class MapSettings:
    """A map's YAML file. origin: x and y [m] and yaw [rad] of the lower left pixel's lower left corner."""

    image: str
    mode: str
    resolution_m: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_threshold: float
    free_threshold: float


def dump_map(cells: NDArray[np.int8], raster: Raster, image: str) -> tuple[bytes, bytes]:
    """The YAML file and the image (PGM, binary) of cells, shape (rows, columns), the lowest row first."""
    x, y = raster.origin
    text = (
        f"image: {image}\nmode: trinary\nresolution: {raster.resolution_m!r}\norigin: [{x!r}, {y!r}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESHOLD!r}\nfree_thresh: {FREE_THRESHOLD!r}\n"
    )
    grays = np.select([cells == FREE, cells == OCCUPIED], [GRAYS[FREE], GRAYS[OCCUPIED]], GRAYS[UNKNOWN]).astype(np.uint8)
    return text.encode(), b"P5\n%d %d\n255\n" % (raster.columns, raster.rows) + grays[::-1].tobytes()


def read_settings(path: Path) -> MapSettings:
    """A map's YAML file.

    Raises:
        InputError: it cannot be read, a key is missing, or its value is none that `map_server` takes.
    """
    import yaml

    name = path.name
    try:
        document = yaml.load(read_file(path, name, BUDGET.settings_bytes), Loader=yaml.BaseLoader)  # texts only: nothing is guessed
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(name, "content", f"is no YAML ({' '.join(str(error).split())[:100]})") from error
    if not isinstance(document, dict):
        raise InputError(name, "content", "is no table of keys and values")
    for key in _NEEDED:
        if key not in document:
            raise InputError(name, key, "is missing")
    origin, image, mode = document["origin"], document["image"], document.get("mode", MODES[0])
    if not isinstance(origin, list) or len(origin) != 3:
        raise InputError(name, "origin", "is not three numbers: x, y, yaw")
    if not isinstance(image, str) or not image:
        raise InputError(name, "image", "is no name of a file")
    if mode not in MODES:
        raise InputError(name, "mode", f"is none of {', '.join(MODES)}")
    x, y, yaw = (_number(name, "origin", value) for value in origin)
    numbers = [_number(name, key, document[key]) for key in ("resolution", "occupied_thresh", "free_thresh")]
    return MapSettings(image, mode, numbers[0], (x, y, yaw), _negated(name, document), numbers[1], numbers[2])


def image_path(path: Path, image: str) -> Path:
    """Where the image that a YAML file names lies.

    Raises:
        InputError: by an absolute path, outside of the YAML file's folder, or nowhere.
    """
    pure = PurePosixPath(image)
    if pure.is_absolute() or ".." in pure.parts or "\\" in image or ":" in image:
        raise InputError(path.name, "image", f"{pure.name!r} is absolute or leaves the folder")
    if not is_there(path.parent / image):
        raise InputError(path.name, "image", f"{image!r} does not exist")
    return path.parent / image


def read_cells(path: Path, settings: MapSettings) -> NDArray[np.int8]:
    """Cells of the map that an image makes, shape (rows, columns), the lowest row first: free, occupied, unknown, or between.

    Raises:
        InputError: the image cannot be read, or has more pixels than the budget.
    """
    from PIL import Image

    data = read_file(path, path.name, BUDGET.image_bytes)
    pixels = image_pixels(data)
    if pixels is None or not 0 < pixels <= BUDGET.pixels:
        raise InputError(path.name, "content", "is no image" if pixels is None else f"has {pixels} pixels, more than {BUDGET.pixels}")
    try:
        with Image.open(io.BytesIO(data)) as opened:
            opened.load()
            shade, opaque = _shades(opened, settings.mode)
    except Exception as error:  # the reader raises whatever the bytes lead it to
        raise InputError(path.name, "content", f"cannot be decoded ({type(error).__name__})") from error
    return _cells(shade, opaque, settings)[::-1]


def raster_of(settings: MapSettings, cells: NDArray[np.int8]) -> Raster:
    """Where the cells of a map lie; its yaw is left to who asks."""
    return Raster(settings.origin[:2], settings.resolution_m, *cells.shape)


def _shades(image: Any, mode: str) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """How bright each pixel is, 0 to 1, and whether it is opaque, shape (h, w) each, as in the file from top to bottom."""
    if image.mode.startswith(("I", "F")):  # 16 bits, in which images of one channel may be
        values = np.asarray(image, dtype=np.float64) / 65535.0
        return values, np.ones(values.shape, dtype=np.bool_)
    has_alpha = "A" in image.getbands() or "transparency" in image.info
    channels = np.asarray(image.convert("RGBA"), dtype=np.float64) / 255.0
    used = channels if has_alpha and mode == "trinary" else channels[:, :, :3]
    return used.mean(axis=2), channels[:, :, 3] == 1.0


def _cells(shade: NDArray[np.float64], opaque: NDArray[np.bool_], settings: MapSettings) -> NDArray[np.int8]:
    """Values of cells, in the order of the image."""
    if settings.mode == "raw":
        values = np.round(shade * 255.0)
        return np.where(values <= OCCUPIED, values, UNKNOWN).astype(np.int8)
    occupied = shade if settings.negate else 1.0 - shade
    between = np.full(shade.shape, float(UNKNOWN))
    if settings.mode == "scale":
        span = settings.occupied_threshold - settings.free_threshold
        between = np.clip(np.rint((occupied - settings.free_threshold) / span * 100.0), 0.0, 100.0) if span > 0.0 else between
    cells = np.select([occupied > settings.occupied_threshold, occupied < settings.free_threshold], [OCCUPIED, FREE], between)
    return np.where(opaque | (settings.mode == "trinary"), cells, UNKNOWN).astype(np.int8)


def _number(name: str, key: str, value: object) -> float:
    """A finite number.

    Raises:
        InputError: it is none.
    """
    try:
        number = float(value) if isinstance(value, str) else np.nan
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InputError(name, key, "is no finite number")
    return number


def _negated(name: str, document: Mapping[str, Any]) -> bool:
    """Whether whiter is more occupied.

    Raises:
        InputError: the value is neither a whole number nor a truth.
    """
    text = str(document["negate"]).lower()
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    try:
        return int(text) != 0
    except ValueError:
        raise InputError(name, "negate", "is neither 0 nor 1") from None
