"""What a model sees of rows and samples: an instance in its frame, and candidates as they are aligned to it."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Mapping, MutableMapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.geometry.meshes import sample_surface, surface_of_glb
from tasks.selection.model.clouds import Array, ColoredCloud, packed, spread_cloud, unpacked
from tasks.selection.model.config import NoQuery, OwnImage, SelectionModel
from tasks.selection.model.features import Scanned, square_crop
from tasks.settings import adapter
from tasks.stage import Context

LEAST_CLOUD = 512
"""Points that an asset's cloud has at least, for distances point by point."""


def scan_points(config: SelectionModel) -> int:
    """How many of an instance's points are kept: twice what the encoder takes, so that leaving some out leaves enough."""
    return max(2 * config.architecture.points, 2 * config.residual_points)


def asset_points(config: SelectionModel) -> int:
    """How many points of an asset's surface are kept."""
    return max(2 * config.architecture.points, LEAST_CLOUD)


def scan_cloud(points: NDArray[np.floating], colors: NDArray[np.uint8], config: SelectionModel) -> ColoredCloud:
    """An instance's cloud, of its points in its frame, shape (n, 3) [m]; of many, evenly drawn ones."""
    count = scan_points(config)
    if len(points) > 4 * count:
        index = np.sort(np.random.default_rng(0).permutation(len(points))[: 4 * count])
        points, colors = points[index], colors[index]
    return spread_cloud(points, colors, count)


def surface_cloud(mesh_blob: str, blobs: Mapping[str, bytes], config: SelectionModel, memory: MutableMapping[str, bytes]) -> bytes:
    """The packed cloud of an asset's surface, with normals, in its own frame; made once for each content.

    Raises:
        InputError: the mesh cannot be read.
        ValueError: its surface has no area.
        KeyError: it is not among the blobs.
    """
    count = asset_points(config)
    key = _key(mesh_blob, count)
    data = memory.get(key)
    if data is None:
        data = memory[key] = _surface_cloud(mesh_blob, blobs[mesh_blob], count)
    return data


PARTS = 8
"""Parts that meshes are dealt out to, for as many cores as there are: few enough that handing them over costs little."""


def remember_clouds(mesh_blobs: Iterable[str], context: Context, config: SelectionModel, memory: MutableMapping[str, bytes]) -> None:
    """Make clouds of surfaces that a memory lacks at once, in other processes where cores are free. What cannot be made is left out."""
    count = asset_points(config)
    lacked = [name for name in dict.fromkeys(mesh_blobs) if name in context.blobs and _key(name, count) not in memory]
    work = [(count, {name: context.blobs[name] for name in lacked[k::PARTS]}) for k in range(min(PARTS, len(lacked)))]
    for made in context.spread(_clouds, work):
        memory.update(made)


def _clouds(work: tuple[int, Mapping[str, bytes]]) -> dict[str, bytes]:
    """Packed clouds of meshes that can be read, as they are remembered."""
    made = {}
    for name, mesh in work[1].items():
        with contextlib.suppress(InputError, ValueError):  # who asks for it is told
            made[_key(name, work[0])] = _surface_cloud(name, mesh, work[0])
    return made


def _key(mesh_blob: str, count: int) -> str:
    return f"surface {mesh_blob} {count}"


def _surface_cloud(mesh_blob: str, mesh: bytes, count: int) -> bytes:
    """The packed cloud of a mesh."""
    rng = np.random.default_rng(list(hashlib.sha256(_key(mesh_blob, count).encode()).digest()))
    points, colors, normals = sample_surface(surface_of_glb(mesh, mesh_blob), 2 * count, rng)
    return packed(spread_cloud(points, colors, count, normals))


def scanned(
    points: NDArray[np.floating], colors: NDArray[np.uint8], extents: NDArray[np.floating], category: str, caption: str | None,
    image: NDArray[np.uint8] | None, config: SelectionModel,
) -> Scanned:  # fmt: skip
    """An instance as a model sees it.

    points, colors: In its frame, shapes (n, 3) [m] and (n, 3). extents: Of its box [m]. caption: A sentence; None without. image: The crop
    of its best view, shape (h, w, 3); None without.
    """
    if image is not None and isinstance(config.image, OwnImage):
        image = square_crop(image, config.image.side)
    cloud = unpacked(packed(scan_cloud(points, colors, config)))
    return Scanned(cloud, np.asarray(extents, dtype=np.float32), category, caption, None if isinstance(config.image, NoQuery) else image)


def evidence(
    *, coverage: float, box_iou: float, color: float, foreign: float | None, chamfer_m: float, diagonal_m: float,
    scale: Sequence[float] | NDArray, category: str, asset: Asset, is_own: bool,
) -> Array:  # fmt: skip
    """Values by `features.EVIDENCE`: what the rows of a candidate, its asset and its alignment say.

    foreign: None where nobody looked. diagonal_m: of the instance's box. scale: of the alignment, shape (3,). category: of the instance.
    is_own: the asset is made of the instance's own points.
    """
    stretch = np.log(np.maximum(np.asarray(scale, dtype=np.float64), 1e-3))
    values = [
        coverage, box_iou, color, foreign or 0.0, float(foreign is not None), float(np.exp(-chamfer_m / (0.04 * max(diagonal_m, 1e-3)))),
        *np.clip(stretch, -1.0, 1.0), float(min(np.ptp(stretch), 1.0)), float(np.exp(-20.0 * np.abs(stretch).mean())),
        float(category.lower() == asset.category.lower()), float(is_own), float(asset.is_watertight),
    ]  # fmt: skip
    return np.array(values, dtype=np.float32)


def config_from(text: str) -> SelectionModel:
    """The network's config in that of the learned system, as JSON (`tasks.models.Model.config`).

    Raises:
        InputError: there is none in it.
    """
    try:
        return adapter(SelectionModel).validate_python(json_value(text)["model"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            "model", "config", "is not that of a selection model", "train it again, or import it with its own config"
        ) from error
