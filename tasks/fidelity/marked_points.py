"""Points of a scan marked with how far the replica is from them, as a binary PLY."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError

OBJECT, SHELL, UNLABELED = 0, 1, 2
"""Parts of a scan."""

_ROW = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("distance", "<f4"), ("part", "u1")])


@dataclasses.dataclass(frozen=True)
class MarkedPoints:
    """points: [m], shape (n, 3). distance: to the nearest surface of the replica [m], shape (n,). part: OBJECT, SHELL or UNLABELED,
    shape (n,)."""

    points: NDArray[np.float64]
    distance: NDArray[np.float64]
    part: NDArray[np.uint8]


def dump_marked(marked: MarkedPoints) -> bytes:
    """The PLY of marked points."""
    rows = np.empty(len(marked.points), dtype=_ROW)
    for index, axis in enumerate("xyz"):
        rows[axis] = marked.points[:, index]
    rows["distance"], rows["part"] = marked.distance, marked.part
    properties = "".join(f"property float {name}\n" for name in ("x", "y", "z", "distance")) + "property uchar part\n"
    return f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n".encode() + rows.tobytes()


def read_marked(data: bytes, file: str = "distances.ply") -> MarkedPoints:
    """Marked points of a PLY as `dump_marked` writes it.

    Raises:
        InputError: the bytes are no such PLY.
    """
    head, mark, body = data.partition(b"end_header\n")
    rows = np.frombuffer(body[: len(body) // _ROW.itemsize * _ROW.itemsize], dtype=_ROW)
    if not mark or len(body) % _ROW.itemsize or f"element vertex {len(rows)}\n".encode() not in head:
        raise InputError(file, "header", "is not a file of marked points of this lake", "run the fidelity stage again")
    return MarkedPoints(
        np.stack([rows["x"], rows["y"], rows["z"]], axis=1).astype(np.float64), rows["distance"].astype(np.float64), rows["part"].copy()
    )
