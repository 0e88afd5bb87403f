"""The process that reads LAS, LAZ and E57 files: their native readers meet foreign bytes in it alone.

It leaves the columns of the points in `points.bin`, and as facts dtype, shape and offset of each, and notes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.point_cloud.points import INSTANCE_NAMES, LABEL_NAMES, check_count
from tasks.capture.point_cloud.projections import units_of_las
from tasks.confinement import answer, limit

COLUMNS = "points.bin"
"""The file of the columns, one after the other."""

CHUNK = 1_000_000
"""Points that are read at once."""

NOISE = (7, 18)
"""Classes of points that LAS calls noise, low and high."""

AGAIN = "copy or export the cloud again"

Columns = dict[str, NDArray[Any]]


def main() -> None:
    """Read the file that the arguments name into the folder that they name."""
    kind, path, name, folder, written = sys.argv[1], Path(sys.argv[2]), sys.argv[3], Path(sys.argv[4]), int(sys.argv[5])
    limit(int(sys.argv[6]), int(sys.argv[7]), written)
    read = {"las": _read_las, "e57": _read_e57}[kind]
    answer(folder, lambda: read(path, name, folder), AGAIN)


class _Writer:
    """Columns that grow by chunks: each in a file of its own, joined at the end."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._files, self._kinds = folder, dict[str, BinaryIO](), dict[str, tuple[str, int]]()
        self.rows = 0

    def add(self, columns: Columns) -> None:
        """Append rows of all columns, shape (n,) or (n, k) each."""
        for key, values in columns.items():
            if key not in self._files:
                self._files[key] = (self._folder / f"{key}.part").open("wb")
                self._kinds[key] = (values.dtype.str, values.shape[1] if values.ndim == 2 else 1)
            self._files[key].write(np.ascontiguousarray(values).tobytes())
        self.rows += len(next(iter(columns.values())))

    def facts(self) -> dict[str, list[Any]]:
        """Join the files, and return dtype, width and offset of each column."""
        stated: dict[str, list[Any]] = {}
        with (self._folder / COLUMNS).open("wb") as whole:
            for key, file in self._files.items():
                file.close()
                part = self._folder / f"{key}.part"
                stated[key] = [*self._kinds[key], whole.tell()]
                with part.open("rb") as source:
                    while data := source.read(1 << 24):
                        whole.write(data)
                part.unlink()
        return stated


def _read_las(path: Path, name: str, folder: Path) -> dict[str, Any]:
    import laspy

    _check_records(path, name)
    notes: list[str] = []
    writer = _Writer(folder)
    withheld = noise = 0
    with laspy.open(path) as reader:
        head = reader.header
        check_count(head.point_count, name)
        units = units_of_las(head, name)
        names = list(head.point_format.dimension_names)
        objects = _object_columns(head.point_format)
        has_color = set(_CHANNELS) <= set(names)
        for chunk in reader.chunk_iterator(CHUNK):
            out = np.asarray(chunk.withheld).astype(bool) if "withheld" in names else np.zeros(len(chunk), bool)
            is_noise = np.isin(np.asarray(chunk.classification), NOISE) & ~out
            withheld, noise = withheld + int(out.sum()), noise + int(is_noise.sum())
            used = ~(out | is_noise)
            heights = np.asarray(chunk.z) * units.height_factor
            columns: Columns = {"positions": np.stack([chunk.x, chunk.y, heights], axis=1).astype("<f8")[used]}
            if has_color:
                columns["colors"] = np.stack([chunk[word] for word in _CHANNELS], axis=1).astype("<u2")[used]
            columns |= {key: np.asarray(chunk[word])[used].astype("<f8") for key, word in objects.items()}
            writer.add(columns)
        if head.point_count != writer.rows + withheld + noise:
            raise InputError(name, "points", f"are {writer.rows + withheld + noise}, the header states {head.point_count}", AGAIN)
        reasons = {"are marked as withheld": withheld, "are classified as noise": noise}
        notes += [f"{name}: {count} points {reason}: left out" for reason, count in reasons.items() if count]
        taken = {"X", "Y", "Z", "withheld", *objects.values(), *(_CHANNELS if has_color else ())}
        notes += _unused([word for word in names if word not in taken], name)
        notes += [f"{name}: {note}" for note in units.notes]
    facts = {"unit_m": units.plane_m, "height_factor": units.height_factor, "notes": notes, "sensors": []}
    return {"columns": writer.facts(), **facts}


def _check_records(path: Path, name: str) -> None:
    """Raise InputError for more records than the file has room for: the library reads on, behind its end."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(247)
    if len(head) < 104:
        raise InputError(name, "header", f"ends after {len(head)} bytes", AGAIN)
    short = int.from_bytes(head[100:104], "little")
    is_new = head[24:26] >= b"\x01\x04" and len(head) == 247
    long = int.from_bytes(head[243:247], "little") if is_new else 0
    if short * 54 + long * 60 > size:  # bytes of their headers
        raise InputError(name, "header", f"states {short + long} records, more than its {size} bytes hold", AGAIN)


_CHANNELS = ("red", "green", "blue")


def _object_columns(form: Any) -> dict[str, str]:
    """Extra columns that state the object of each point and its class, by `instance` and `label`; classes need objects."""
    extra: dict[str, str] = {}
    for word in form.extra_dimension_names:
        if form.dimension_by_name(word).num_elements == 1:
            extra.setdefault(word.lower(), word)
    words_of = {"instance": INSTANCE_NAMES, "label": LABEL_NAMES}
    columns = {key: extra[word] for key, words in words_of.items() if (word := next((w for w in words if w in extra), None)) is not None}
    return columns if "instance" in columns else {}


def _unused(words: Iterable[str], name: str) -> list[str]:
    """A line on columns without a use. Names are foreign text, of which a line takes the printable characters."""
    shown = ["".join(c if c.isprintable() else "?" for c in word)[:64] for word in words]
    return [f"{name}: {', '.join(shown)}: not used"] if shown else []


_CARTESIAN, _SPHERICAL = ("cartesianX", "cartesianY", "cartesianZ"), ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLOR = ("colorRed", "colorGreen", "colorBlue")


def _read_e57(path: Path, name: str, folder: Path) -> dict[str, Any]:
    import pye57

    notes: list[str] = []
    writer = _Writer(folder)
    sensors: list[list[float]] = []
    unplaced: list[int] = []
    unused: dict[str, None] = {}
    invalid = 0
    with pye57.E57(str(path)) as file:
        headers = [file.get_header(number) for number in range(file.scan_count)]
        check_count(sum(header.point_count for header in headers), name)
        is_colored = bool(headers) and all(set(_COLOR) <= set(header.point_fields) for header in headers)
        if not is_colored and any(set(_COLOR) <= set(header.point_fields) for header in headers):
            notes.append(f"{name}: some of the {len(headers)} scans have no colors: colors are not used")
        for number, header in enumerate(headers):
            fields = header.point_fields
            axes = next((axes for axes in (_CARTESIAN, _SPHERICAL) if set(axes) <= set(fields)), None)
            if axes is None:
                notes.append(f"{name}: scan {number} has no coordinates: left out")
                continue
            # A scanner stands where its pose says; without a pose, a grid begins at the scanner.
            is_known = header.has_pose() or "rowIndex" in fields
            count = 0
            for columns, left_out in _e57_chunks(file, header, axes, is_colored):
                count += len(columns["positions"]) + left_out
                invalid += left_out
                columns["sensor_of"] = np.full(len(columns["positions"]), len(sensors) if is_known else -1, "<i4")
                writer.add(columns)
            if count != header.point_count:
                raise InputError(name, f"points of scan {number}", f"are {count}, the header states {header.point_count}", AGAIN)
            if is_known:
                sensors.append([float(v) for v in header.translation])
            else:
                unplaced.append(number)
            taken = {*axes, _state_of(axes), *(_COLOR if is_colored else ()), *(() if header.has_pose() else ("rowIndex",))}
            unused |= dict.fromkeys(field for field in fields if field not in taken)
        notes += [f"{name}: {invalid} points are marked as invalid: left out"] if invalid else []
        if unplaced and sensors:
            numbers = ", ".join(map(str, unplaced[:8])) + (" and others" if len(unplaced) > 8 else "")
            notes.append(f"{name}: no pose in scan {numbers}: the place of the sensor is not known there")
        notes += _unused(unused, name)
        images = len(file.root["images2D"]) if file.root.isDefined("images2D") else 0
        notes += [f"{name}: {images} images: not used"] if images else []
    return {"columns": writer.facts(), "unit_m": 1.0, "height_factor": 1.0, "notes": notes, "sensors": sensors}


def _state_of(axes: tuple[str, ...]) -> str:
    """Field that marks points whose coordinates are not valid."""
    return f"{'cartesian' if axes is _CARTESIAN else 'spherical'}InvalidState"


def _e57_chunks(file: Any, header: Any, axes: tuple[str, ...], is_colored: bool) -> Iterator[tuple[Columns, int]]:
    """Valid points of a scan in the frame of the file, some at a time, and the number of those between them that are not valid."""
    from pye57 import libe57

    count = min(CHUNK, max(header.point_count, 1))
    state = _state_of(axes)
    wanted = dict.fromkeys([*axes, *(_COLOR if is_colored else ())], "f8")
    wanted |= {state: "i1"} if state in header.point_fields else {}  # values are 0 to 2
    arrays = {word: np.zeros(count, dtype) for word, dtype in wanted.items()}
    buffers = libe57.VectorSourceDestBuffer()
    for word, array in arrays.items():
        buffers.append(libe57.SourceDestBuffer(file.image_file, word, array, count, True, True))
    reader = header.points.reader(buffers)
    turn, move = header.rotation_matrix, header.translation
    low, high = _color_limits(header) if is_colored else (0.0, 255.0)
    while read := reader.read():
        used = arrays[state][:read] == 0 if state in arrays else np.ones(read, bool)
        points = np.stack([arrays[axis][:read] for axis in axes], axis=1)[used]
        if axes is _SPHERICAL:
            distance, azimuth, elevation = points.T
            flat = distance * np.cos(elevation)
            points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
        columns: Columns = {"positions": (points @ turn.T + move).astype("<f8")}
        if is_colored:
            colors = np.stack([arrays[word][:read] for word in _COLOR], axis=1)[used]
            scaled = np.nan_to_num((colors - low) * (255.0 / (high - low)))
            columns["colors"] = np.rint(np.clip(scaled, 0.0, 255.0)).astype("u1")
        yield columns, read - len(points)
    reader.close()


def _color_limits(header: Any) -> tuple[float, float]:
    """Least and largest value of colors: 0 to 255, unless the scan states others."""
    try:
        low, high = (float(header.node["colorLimits"][f"colorRed{word}"].value()) for word in ("Minimum", "Maximum"))
    except Exception:  # the library's own error for a scan without limits
        return 0.0, 255.0
    return (low, high) if np.isfinite([low, high]).all() and high > low else (0.0, 255.0)


if __name__ == "__main__":
    main()
