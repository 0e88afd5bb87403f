"""Points as a file states them, and the meaning of its columns by their names."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.capture.files.ply_elements import PlyColumn, as_bytes, color_names

Array = NDArray[np.float64]

MIN_POINTS = 100
"""Fewer points show no surface of a room."""

INSTANCE_NAMES = (
    "instance",
    "instance_id",
    "instanceid",
    "instance_label",
    "inst",
    "ins",
    "object_id",
    "objectid",
    "object",
    "predinstance",
)
LABEL_NAMES = ("label", "labels", "semantic", "semantic_label", "sem", "class", "class_id", "category", "category_id", "scalar_label")
"""Columns that programs write for the object and for the class of a point, in lower case."""

NO_OBJECT = -1
"""Number of points without an object."""

NORMAL_NAMES = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"), ("normalx", "normaly", "normalz"))
_PADDING = ("_", "alpha", "a")
"""Columns that state nothing: padding of PCD rows, and opacity."""


@dataclasses.dataclass(frozen=True)
class LabelledPoints:
    """Objects of points. owner: number of the object of each point, `NO_OBJECT` for none, shape (n,). named: id and label of each."""

    owner: NDArray[np.int64]
    named: tuple[tuple[str, str], ...]


@dataclasses.dataclass(frozen=True)
class Points:
    """Points in a file's own frame and unit.

    positions: shape (n, 3). colors: displayed colors, shape (n, 3); None without any. normals: as stated, shape (n, 3).
    sensors: positions of sensors, shape (k, 3). sensor_of: sensor that saw each point, -1 for an unknown one, shape (n,).
    unit_m: meters per unit, None if the file does not state it. from_file: the file's own coordinates to those here, 4x4, None if equal.
    """

    positions: Array
    colors: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None
    objects: LabelledPoints | None = None
    sensors: Array | None = None
    sensor_of: NDArray[np.int32] | None = None
    unit_m: float | None = None
    from_file: Array | None = None
    notes: tuple[str, ...] = ()

    def at(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Points:
        """Some of the points."""
        objects = self.objects
        return dataclasses.replace(
            self,
            positions=self.positions[rows],
            colors=None if self.colors is None else self.colors[rows],
            normals=None if self.normals is None else self.normals[rows],
            objects=None if objects is None else dataclasses.replace(objects, owner=objects.owner[rows]),
            sensor_of=None if self.sensor_of is None else self.sensor_of[rows],
        )


def check_count(count: int, name: str) -> None:
    """Raise InputError for more points than the budget has."""
    if count > BUDGET.vertices:
        raise InputError(name, "points", f"are {count}, more than {BUDGET.vertices}", "thin the cloud, to a point per centimeter")


def points_of_columns(columns: Mapping[str, PlyColumn], name: str, notes: Sequence[str] = ()) -> Points:
    """Points of named columns; columns without a use are noted.

    Raises:
        InputError: coordinates are missing.
    """
    lower = {key.lower(): key for key, column in columns.items() if column.counts is None}
    missing = [axis for axis in "xyz" if axis not in lower]
    if missing:
        raise InputError(name, "fields", f"lack {missing[0]}", "export the points again, with x, y and z")
    positions = stacked([columns[lower[axis]].values for axis in "xyz"])
    used = {lower[axis] for axis in "xyz"}
    colors = normals = None
    channels = color_names(set(lower.values()))
    if channels is not None:
        # All channels have one scale: that of fractions if any has fractions, otherwise that of the widest type.
        kind = max((columns[channel].kind for channel in channels), key=lambda kind: (kind[0] == "f", int(kind[1:])))
        colors = as_bytes(np.stack([columns[channel].values for channel in channels], axis=1), kind)
        used |= set(channels)
    axes = next((names for names in NORMAL_NAMES if all(axis in lower for axis in names)), None)
    if axes is not None:
        normals = stacked([columns[lower[axis]].values for axis in axes]).astype(np.float32)
        used |= {lower[axis] for axis in axes}
    instance = next((lower[word] for word in INSTANCE_NAMES if word in lower), None)
    label = next((lower[word] for word in LABEL_NAMES if word in lower), None)
    objects, own = None, list(notes)
    if instance is not None:
        labels = None if label is None else whole_numbers(columns[label].values)
        objects = labelled(whole_numbers(columns[instance].values), labels)
        used |= {instance, *([label] if label is not None else [])}
    unused = [key for key in columns if key not in used and key.lower() not in _PADDING]
    if unused:
        own.append(f"{name}: {', '.join(unused[:8])}{' and others' if len(unused) > 8 else ''}: not used")
    return Points(positions, colors, normals, objects, notes=tuple(own))


def stacked(columns: Sequence[NDArray[np.generic]]) -> Array:
    """Columns of three coordinates as one array, shape (n, 3)."""
    with np.errstate(invalid="ignore"):  # a signaling NaN is not a number; it is left out later
        return np.stack(columns, axis=1).astype(np.float64)


def whole_numbers(values: NDArray[np.generic]) -> NDArray[np.int64]:
    """Numbers of objects or classes; values that are not whole numbers are `NO_OBJECT`."""
    if values.dtype.kind in "iub":
        return values.astype(np.int64)
    numbers = values.astype(np.float64)
    is_whole = np.isfinite(numbers) & (np.abs(numbers) < 2**53)
    numbers = np.where(is_whole, numbers, NO_OBJECT)
    return np.where(numbers == np.floor(numbers), numbers, NO_OBJECT).astype(np.int64)


def labelled(instances: NDArray[np.int64], labels: NDArray[np.int64] | None) -> LabelledPoints:
    """Objects of points by their numbers. Negative numbers are of no object. An object has the label of most of its points.

    labels: number of the class of each point, shape (n,), None without classes.
    """
    numbers, owner = np.unique(instances, return_inverse=True)
    first = int(np.searchsorted(numbers, 0))
    owner = np.where(owner >= first, owner - first, NO_OBJECT)
    words = ["unlabeled"] * (len(numbers) - first)
    if labels is not None and len(words):
        is_of_one = owner >= 0
        pairs, votes = np.unique(np.stack([owner[is_of_one], labels[is_of_one]], axis=1), axis=0, return_counts=True)
        for row in np.lexsort((-pairs[:, 1], votes)).tolist():  # the last stays: most points, then the lowest class
            words[int(pairs[row, 0])] = f"class {int(pairs[row, 1])}"
    named = tuple((str(int(number)), word) for number, word in zip(numbers[first:], words, strict=True))
    return LabelledPoints(owner.astype(np.int64), named)
