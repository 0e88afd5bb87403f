"""The textured twin of an asset: the same triangles with one texture, baked from the images of the scan that it stands in.

The paper marks such candidates with an asterisk (figure A5).
"""

from __future__ import annotations

import dataclasses
import io
import time
from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.errors import InputError
from tasks.geometry.encoded_images import encoded_image
from tasks.geometry.meshes import dump_glb, load_glb, surface_of
from tasks.geometry.rendering import RayScene
from tasks.settings import Config, Count, Share
from tasks.texturing.baking import BakeConfig, atlas_of, baked
from tasks.texturing.charts import ChartFigures, chart_figures
from tasks.texturing.texels import Texels
from tasks.texturing.unwrapping import Unwrapped, Unwrapper, unwrapped
from tasks.texturing.views import ColorView

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class TwinConfig(Config):
    """How a twin is made."""

    bake: BakeConfig = dataclasses.field(default_factory=BakeConfig)
    keeps_hidden: bool = True  # what no image shows keeps the asset's color; False takes it from around it on the surface
    most_overlap: Share = 0.05  # of the texture: more, and parts of the surface show each other's colors
    least_seen: Share = 0.05  # of its texels: a texture of less would be the asset's own, with a stain
    quality: Count = 92  # of the JPEG: differences that nobody sees, a fifth of a PNG


@dataclasses.dataclass(frozen=True)
class Twin:
    """A textured twin, or why there is none. glb: the file, in the asset's own frame and size; empty where `problem` says why. by: who
    made the layout. figures: of its layout. layout_seconds: that it took. seen_share: of its texels. side_px: of its texture. gains:
    exposure of each view. seconds: that all took but a layout that was there already.
    """

    glb: bytes = b""
    problem: str = ""
    by: str = ""
    figures: ChartFigures | None = None
    layout_seconds: float = 0.0
    seen_share: float = 0.0
    side_px: int = 0
    gains: tuple[float, ...] = ()
    seconds: float = 0.0


def textured_twin(
    data: bytes,
    pose: ArrayLike,
    scale: ArrayLike,
    unwrapper: Unwrapper,
    views: Sequence[ColorView],
    config: TwinConfig,
    around: Sequence[trimesh.Trimesh] = (),
    file: str = "asset.glb",
) -> Twin:
    """The textured twin of an asset, for an instance of it.

    data: The asset's GLB. pose: Object to world, 4x4 [m]. scale: along the asset's own axes, shape (3,). around: what else stands in the
    scene and may hide the asset, world frame [m]. An asset that cannot be read or unwrapped, and images that cannot be read, are a
    problem of the twin, never an error.
    """
    clock = time.monotonic()
    try:
        parts = load_glb(data, file)
        surface = surface_of(parts)
        placed = surface.transformed(pose, scale)
        layout, figures = _laid_out(data, file, unwrapper)
        if figures.overlap > config.most_overlap:
            problem = f"{figures.overlap:.1%} of its texture by {layout.by} would be shown in more than one place"
            return Twin(problem=problem, by=layout.by, figures=figures, layout_seconds=layout.seconds, seconds=time.monotonic() - clock)
        scene = RayScene([placed.to_trimesh(), *around])
        atlas = atlas_of(placed.vertices[layout.source], layout.faces, layout.uv, config.bake)
        own = own_colors(parts, atlas.texels) if config.keeps_hidden else None
        texture = baked(atlas, views, scene, config.bake, own)
    except (InputError, ValueError) as error:
        return Twin(problem=str(error), seconds=time.monotonic() - clock)
    made = Twin(
        by=layout.by, figures=figures, layout_seconds=layout.seconds, seen_share=texture.seen_share, side_px=atlas.shape[0],
        gains=tuple(float(g) for g in texture.gains),
    )  # fmt: skip
    if texture.seen_share < config.least_seen:
        problem = f"the images show {texture.seen_share:.1%} of its surface, less than {config.least_seen:.1%}"
        return dataclasses.replace(made, problem=problem, seconds=time.monotonic() - clock)
    mesh = textured_mesh(surface.vertices, layout, texture.image, config.quality)
    name = str(parts[0].metadata.get("name") or "asset")
    return dataclasses.replace(made, glb=dump_glb([mesh], [name]), seconds=time.monotonic() - clock)


@lru_cache(maxsize=8)
def _laid_out(data: bytes, file: str, unwrapper: Unwrapper) -> tuple[Unwrapped, ChartFigures]:
    """A layout of an asset in its own frame and size, and its figures: the same for all instances that it is painted for.

    Raises:
        InputError: the asset cannot be read, or no layout was found.
        ValueError: the layout has no figures.
    """
    surface = surface_of(load_glb(data, file))
    layout = unwrapped(unwrapper, surface.vertices, surface.faces)
    return layout, chart_figures(layout.vertices, layout.faces, layout.uv)


def own_colors(parts: Sequence[trimesh.Trimesh], texels: Texels) -> NDArray[np.uint8]:
    """What an asset's parts show at texels of a layout of `surface_of(parts)`, RGB, shape (t, 3)."""
    counts = np.array([len(part.faces) for part in parts])
    part = np.repeat(np.arange(len(parts)), counts)[texels.face]
    hits: dict[str, NDArray[Any]] = {
        "t_hit": np.zeros(len(part), dtype=np.float32),
        "geometry_ids": part.astype(np.uint32),
        "primitive_ids": (texels.face - (np.cumsum(counts) - counts)[part]).astype(np.uint32),
        "primitive_uvs": texels.weights[:, 1:].astype(np.float32),
    }
    return RayScene(parts).colors(hits)


def textured_mesh(vertices: Array, layout: Unwrapped, image: NDArray[np.uint8], quality: int) -> trimesh.Trimesh:
    """A layout with its texture as a mesh. vertices: of the mesh that was laid out, in any frame [m], shape (n, 3)."""
    import trimesh
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, format="JPEG", quality=quality, subsampling=0)
    mesh = trimesh.Trimesh(vertices[layout.source], layout.faces, process=False)
    material = trimesh.visual.material.PBRMaterial(
        name="baked", baseColorTexture=encoded_image(file.getvalue()), metallicFactor=0.0, roughnessFactor=1.0
    )
    mesh.visual = trimesh.visual.TextureVisuals(uv=layout.uv, material=material)
    return mesh
