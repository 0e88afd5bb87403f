"""Textures painted by a program of others, named by a person: Paint3D and its like.

A mesh, an image and a prompt go in as files and words, a GLB comes out, and is held against what was asked: the same surface, with
places in a texture and the texture itself. A program that fails, hangs or leaves something else is a result, never an error.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file, stays_in, write_whole
from schemas.machine.scratch import temporary_folder
from tasks.calls.command import filled, places_in, run_apart
from tasks.containers import GLB_MAGIC
from tasks.geometry.gltf.plain import read_features
from tasks.geometry.meshes import Surface, load_glb, material_of, sample_surface, surface_of
from tasks.geometry.proximity import closest_points
from tasks.settings import Config, Count, Natural, Positive, Share, Texts
from tasks.texturing.charts import ChartFigures, chart_figures
from tasks.views.pictures import png_of

if TYPE_CHECKING:
    import trimesh

_PLACES = ("mesh", "image", "prompt", "out", "seed")

_PROBES = 4000
"""Points on either surface that must lie near the other one, besides all corners."""

_LONGEST_PROMPT = 4000
"""Characters: more is no prompt, and arguments have a limit of their own."""


@dataclasses.dataclass(frozen=True)
class TextureCommand(Config):
    """A program that textures. Its words may hold `{mesh}` (a GLB), `{image}` (a PNG), `{prompt}`, `{seed}` and `{out}`, the GLB that it
    has to leave. No shell reads them."""

    kind: ClassVar[str] = "texture_command"
    words: Texts = ()  # without any, no program is asked
    model: str = ""  # its name, as rows have it
    model_version: str = ""  # where the same name paints otherwise today than it did
    license: str = ""  # of what it paints, SPDX where there is one; whoever runs it has to know
    source_url: str = ""  # where the program is from
    seed: Natural = 0  # the same seed, mesh and picture give the same texture, where the program keeps its word
    pixels: Count = 512  # of the picture's side: what diffusion models look at
    timeout_s: Positive = 600.0  # a diffusion model on a small card
    tolerance: Positive = 0.005  # of the box's diagonal: such tools write in single precision and weld, but must not remesh
    max_faces: Count = 500_000  # as assets may have
    most_overlap: Share = 0.05  # of the texture: more, and parts of the surface show each other's paint
    version: str = "1"  # goes up when the same words would paint otherwise

    def __post_init__(self) -> None:
        super().__post_init__()
        named = places_in(self.words)
        unknown = sorted(named - set(_PLACES))
        if unknown:
            raise ValueError(f"words: {{{unknown[0]}}} stands for nothing, {', '.join(f'{{{name}}}' for name in _PLACES)} do")
        if self.words and not {"mesh", "out"} <= named:
            raise ValueError("words: must name {mesh}, which is read, and {out}, which is written")


@dataclasses.dataclass(frozen=True)
class PaintedTwin:
    """What a program made of an asset, or why it is not used. glb: as it was left, empty where `problem` says why. figures: of its
    layout."""

    glb: bytes = b""
    problem: str = ""
    figures: ChartFigures | None = None
    seconds: float = 0.0


def painted(
    command: TextureCommand, data: bytes, image: NDArray[np.uint8] | None = None, prompt: str = "", seed: int = 0, file: str = "asset.glb"
) -> PaintedTwin:
    """An asset as a program textures it. data: its GLB. image: what it should look like, RGB or RGBA, shape (h, w, 3 or 4).

    Whatever the program does ends in a `PaintedTwin`; nothing that it wrote stays on the disk.

    Raises:
        InputError: the asset itself cannot be read.
    """
    wanted = surface_of(load_glb(data, file))
    if not command.words:
        return PaintedTwin(problem="no program is named")
    needs_image = any("{image}" in word for word in command.words)
    if needs_image and image is None:
        return PaintedTwin(problem="the program wants an image, and there is none")
    with temporary_folder() as folder:
        out = folder / "out.glb"
        write_whole(folder / "mesh.glb", data, cache=True)
        if image is not None:
            write_whole(folder / "image.png", png_of(image), cache=True)
        values = {
            "mesh": str(folder / "mesh.glb"), "image": str(folder / "image.png"), "out": str(out),
            "prompt": prompt[:_LONGEST_PROMPT], "seed": str(seed),
        }  # fmt: skip
        try:
            ending = run_apart(filled(command.words, values), folder, command.timeout_s)
        except (OSError, ValueError) as error:
            return PaintedTwin(problem=f"{command.words[0]} cannot be run: {error}")
        if ending.problem:
            return PaintedTwin(problem=f"{command.words[0]} {ending.problem}", seconds=ending.seconds)
        try:
            if not stays_in(out, folder):
                raise InputError("out.glb", "file", "is a link that leads out of its folder", "")
            left = read_file(out, "out.glb", BUDGET.asset_bytes, "the program has to leave it", magic=GLB_MAGIC)
            left = read_features(left, "out.glb").data
            figures = checked(wanted, left, command)
        except (InputError, ValueError) as error:
            return PaintedTwin(problem=str(error), seconds=ending.seconds)
    return PaintedTwin(glb=left, figures=figures, seconds=ending.seconds)


def checked(wanted: Surface, data: bytes, command: TextureCommand) -> ChartFigures:
    """Hold a textured GLB against the surface that was to be textured, +Z up [m]; figures of its layout.

    Raises:
        InputError: it cannot be read, has no texture or no places in it, shows another surface, or is laid out in layers.
        ValueError: its layout has no figures.
    """
    parts = load_glb(data, "out.glb")
    surface = surface_of(parts)
    if len(surface.faces) > command.max_faces:
        raise InputError("out.glb", "faces", f"has {len(surface.faces)}, at most {command.max_faces} are taken", "")
    uv = np.concatenate([_places(part) for part in parts])
    reach = command.tolerance * float(np.linalg.norm(np.ptp(wanted.bounds, axis=0)))
    for of, held, words in ((surface, wanted, "has surface"), (wanted, surface, "lacks surface")):
        away = float(closest_points(held.vertices, held.faces, _probes(of)).distance.max())
        if away > reach:
            raise InputError("out.glb", "vertices", f"{words} {away:.3g} m from the asset's, at most {reach:.3g} m are taken", "")
    figures = chart_figures(surface.vertices, surface.faces, uv)
    if len(parts) == 1 and figures.overlap > command.most_overlap:  # parts of their own have textures of their own
        raise InputError("out.glb", "uv", f"{figures.overlap:.0%} of its texture are shown in more than one place", "")
    return figures


def _places(part: trimesh.Trimesh) -> NDArray[np.float64]:
    """Places in the texture of a part's vertices, shape (n, 2).

    Raises:
        InputError: it has no texture, or no place for every vertex.
    """
    visual = part.visual
    uv = getattr(visual, "uv", None)
    if getattr(visual, "kind", None) != "texture" or material_of(part)[0] is None:
        raise InputError("out.glb", "material", "has no texture of base colors", "")
    if uv is None or uv.shape != (len(part.vertices), 2) or not np.isfinite(uv).all():
        raise InputError("out.glb", "TEXCOORD_0", "has no place in the texture for every vertex", "")
    return np.asarray(uv, dtype=np.float64)


def _probes(surface: Surface) -> NDArray[np.float64]:
    """Corners of a surface and points spread over it [m], shape (k, 3); the same for the same surface."""
    points, _, _ = sample_surface(surface, _PROBES, np.random.default_rng(len(surface.faces)))
    return np.concatenate([surface.vertices[np.unique(surface.faces)], points])
