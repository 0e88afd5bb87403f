"""Small pictures for galleries: a scan beside its replica, the scan of an object beside its candidates."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tasks.stats.scenes import PictureConfig, ScenePictures, fitting_camera, render

if TYPE_CHECKING:
    import trimesh
    from PIL import Image

SCENE_PX = (300, 210)
"""Width and height of a scene's thumbnail: sharp at the 150 pixels that it has on a page, 10 kB as JPEG."""

OBJECT_PX = 132
"""Edge of an object's thumbnail: 3 kB as JPEG."""

SCENE_LOOK = PictureConfig(width=480, height=336, jpeg_quality=95)
OBJECT_LOOK = PictureConfig(width=OBJECT_PX, height=OBJECT_PX, horizontal_fov_radians=0.5, oversampling=3, jpeg_quality=80)

_FROM = np.array([0.80, 0.42, 0.46])  # before the front (+x), a little to its side and above: three faces of a box are seen


@dataclasses.dataclass(frozen=True)
class SceneTile:
    """A scene of the gallery: JPEG of scan and replica. `excuse` says why there are none."""

    scene_id: str
    scan: bytes | None
    replica: bytes | None
    excuse: str = ""


@dataclasses.dataclass(frozen=True)
class CandidateTile:
    """What fills one slot of an object. `note` says why it is empty or has no picture, or why a fallback filled it."""

    slot: int
    provider: str
    score: float | None
    is_chosen: bool
    is_fallback: bool
    is_filled: bool
    note: str
    picture: bytes | None


@dataclasses.dataclass(frozen=True)
class CandidateStrip:
    """An object of the gallery: JPEG of how the scan shows it, and its candidates by slot. `origin` is who chose."""

    scene_id: str
    instance_id: str
    category: str
    crop: bytes | None
    origin: str
    tiles: tuple[CandidateTile, ...]


def scene_tile(scene_id: str, pictures: ScenePictures | tuple[bytes, bytes] | str) -> SceneTile:
    """The thumbnail of a scene: from its large pictures, from two others of one size, or without any.

    Both are cut to what either of them shows.
    """
    if isinstance(pictures, str):
        return SceneTile(scene_id, None, None, pictures)
    pair = (pictures.corner_scan, pictures.corner_replica) if isinstance(pictures, ScenePictures) else pictures
    images = [_opened(file) for file in pair]
    box = _shown_box(images)
    scan, replica = (_jpeg(image.resize(SCENE_PX, box=box, resample=_LANCZOS)) for image in images)
    return SceneTile(scene_id, scan, replica)


def object_thumbnail(
    parts: Sequence[trimesh.Trimesh], scale: Sequence[float] = (1.0, 1.0, 1.0), turn: ArrayLike | None = None, px: int = OBJECT_PX
) -> bytes:
    """JPEG of a canonical asset (+Z up, front +X) seen from before, beside and above, with edges of `px` pixels.

    `scale` is along its own axes; `turn`, a rotation (3, 3), comes after it.
    """
    look = dataclasses.replace(OBJECT_LOOK, width=px, height=px)
    grown = np.eye(4)
    grown[:3, :3] = (np.eye(3) if turn is None else np.asarray(turn, dtype=np.float64)) @ np.diag(np.asarray(scale, dtype=np.float64))
    placed = [part.copy().apply_transform(grown) for part in parts]
    low = np.min([part.bounds[0] for part in placed], axis=0)
    high = np.max([part.bounds[1] for part in placed], axis=0)
    # everything is made as large as a metre: the camera keeps a distance, and a mug would be small in its picture
    unit, middle = 1.0 / max(float((high - low).max()), 1e-6), (low + high) / 2
    for part in placed:
        part.apply_translation(-middle)
        part.apply_scale(unit)
    vertices = np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in placed])
    camera = fitting_camera(vertices, np.zeros(3), _FROM / np.linalg.norm(_FROM), look)
    return render(placed, camera, look)


def fitted(file: bytes, size: tuple[int, int]) -> bytes:
    """JPEG of an image file as large as `size` [px] allows, in its middle, on the pictures' background.

    Raises:
        OSError: it is no image that can be read.
    """
    from PIL import ImageOps

    return _jpeg(ImageOps.pad(_opened(file), size, method=_LANCZOS, color=PictureConfig.background))


_LANCZOS: Any = 1  # Pillow's number of it, so that Pillow is loaded when it is used


def _opened(file: bytes) -> Image.Image:
    from PIL import Image

    with Image.open(io.BytesIO(file)) as opened:
        return opened.convert("RGB")


def _jpeg(image: Image.Image) -> bytes:
    made = io.BytesIO()
    image.save(made, "JPEG", quality=80, optimize=True)
    return made.getvalue()


def _shown_box(images: Sequence[Image.Image]) -> tuple[float, float, float, float]:
    """The smallest box [px] with a thumbnail's proportions around what is not background in any of the images of one size."""
    pixels = np.stack([np.asarray(image, dtype=np.int16) for image in images])
    shown = (np.abs(pixels - np.array(PictureConfig.background, dtype=np.int16)).max(axis=-1) > 14).any(axis=0)
    height, width = shown.shape
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    if not len(rows):
        return (0.0, 0.0, float(width), float(height))
    tall, wide = 1.06 * (np.ptp(rows) + 1), 1.06 * (np.ptp(columns) + 1)
    factor = min(max(wide / SCENE_PX[0], tall / SCENE_PX[1]), width / SCENE_PX[0], height / SCENE_PX[1])
    wide, tall = factor * SCENE_PX[0], factor * SCENE_PX[1]
    left = float(np.clip((columns[0] + columns[-1] + 1 - wide) / 2, 0, width - wide))
    top = float(np.clip((rows[0] + rows[-1] + 1 - tall) / 2, 0, height - tall))
    return (left, top, left + float(wide), top + float(tall))
