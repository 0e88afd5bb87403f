"""Shap-E: text or a picture to a colored mesh, in this process, from a folder that diffusers wrote (specs B.2)."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from schemas.errors import InputError
from tasks.candidates.assets import MadeAsset
from tasks.candidates.generation.generated import GeneratorInput, GeneratorSettings, generated
from tasks.candidates.provider import CandidateProvider
from tasks.geometry.meshes import dump_glb
from tasks.settings import WHOLE, Count, NonNegative
from tasks.vision.devices import Device, device_of
from tasks.weights import files_digest

if TYPE_CHECKING:
    from tasks.candidates.request import CandidateRequest

WHERE = "candidates.slots"
"""The settings, as errors name them."""

TEXT_GUIDANCE, IMAGE_GUIDANCE = 15.0, 3.0
"""How strongly text and picture are followed; as published."""


@dataclasses.dataclass(frozen=True)
class ShapE(GeneratorSettings):
    """What Shap-E makes of the caption's sentence or of the crop."""

    kind: ClassVar[str] = "shap_e"
    weights: str = ""  # folder that diffusers wrote: ShapEPipeline for text, ShapEImg2ImgPipeline for pictures; nothing is fetched
    model: str = "shap-e"  # as its authors call it
    license: str = "MIT"  # of openai/shap-e
    author: str = "OpenAI"
    source_url: str = "https://github.com/openai/shap-e"
    steps: Count = 64  # as published
    guidance: NonNegative | None = None  # as published, where left out: 15 for text, 3 for pictures
    grid: Annotated[int, Field(ge=8, le=512), WHOLE] = 128  # that the surface is taken from; as published
    device: Device = "auto"  # the first graphics card where there is one; cuda:1 is the second
    version: str = "1"  # goes up when the same weights would make another asset


def _offer(request: CandidateRequest, config: ShapE) -> MadeAsset:
    """What Shap-E makes for an instance."""
    digest = folder_digest(config.weights)
    more = {"weights": digest, "by": config.by, "steps": config.steps, "guidance": guidance_of(config), "grid": config.grid}
    return generated(request, config, config.kind, config.version, lambda asked, begun: made(asked, config, digest, begun), **more)


def guidance_of(config: ShapE) -> float:
    """How strongly what it is asked is followed."""
    return config.guidance if config.guidance is not None else TEXT_GUIDANCE if config.by == "text" else IMAGE_GUIDANCE


def made(asked: GeneratorInput, config: ShapE, digest: str, begun: Callable[[], None]) -> bytes:
    """The GLB of a mesh that is drawn with a seed; on a CPU the same bytes every time.

    Raises:
        InputError: packages or weights are not there, or the mesh has no faces.
    """
    check_installed()
    import PIL.Image
    import torch
    import trimesh

    pipeline = _pipeline(config.weights, digest, config.by, device_of(config.device, WHERE))
    begun()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums in one order: the same mesh on every worker
    try:
        generator = torch.Generator("cpu").manual_seed(asked.seed)
        given: Any = asked.text
        if asked.picture is not None:
            with PIL.Image.open(io.BytesIO(asked.picture)) as picture:
                given = picture.convert("RGB")
        more = {"generator": generator, "num_inference_steps": config.steps, "guidance_scale": guidance_of(config)}
        with torch.no_grad():
            latent = pipeline(given, output_type="latent", **more).images[0]
            mesh = pipeline.shap_e_renderer.decode_to_mesh(latent[None, :], pipeline.device, grid_size=config.grid)
    except (ValueError, RuntimeError, ZeroDivisionError) as error:  # of a field that is empty everywhere diffusers makes no mesh
        raise InputError(WHERE, "shap_e", f"made no mesh: {error}"[:200], "take another seed, or more steps") from error
    finally:
        torch.set_num_threads(threads)
    vertices, faces = mesh.verts.cpu().numpy().astype(np.float64), mesh.faces.cpu().numpy().astype(np.int64)
    if not len(faces):
        raise InputError(WHERE, "shap_e", "made a mesh without faces", "take another seed, or more steps")
    colors = np.stack([mesh.vertex_channels[channel].cpu().numpy() for channel in "RGB"], axis=1)
    paint = np.column_stack([np.clip(colors * 255, 0, 255).round(), np.full(len(colors), 255)]).astype(np.uint8)
    return dump_glb([trimesh.Trimesh(vertices, faces, vertex_colors=paint, process=False)])


def check_installed() -> None:
    """Refuse to generate where the packages for it are not there.

    Raises:
        InputError: one line that says how they get there.
    """
    gone = [name for name in ("torch", "transformers", "diffusers") if find_spec(name) is None]
    if gone:
        raise InputError(WHERE, gone[0], "is not installed", "pip install 'metascenes[generators]'")


def folder_digest(folder: str) -> str:
    """Hash of the weights and configs of a pipeline's folder and of the folders in it, 64 hex digits.

    Raises:
        InputError: none is named, or it holds no safetensors.
    """
    if not folder:
        raise InputError(WHERE, "weights", "names no folder", "give one that diffusers wrote: save_pretrained(folder)")
    files = sorted(path for path in Path(folder).rglob("*") if path.suffix in (".safetensors", ".json", ".txt") and path.is_file())
    if not any(path.suffix == ".safetensors" for path in files):
        raise InputError(folder, "", "holds no *.safetensors", "name a folder that diffusers wrote: save_pretrained(folder)")
    return files_digest(Path(folder), files)


@lru_cache(maxsize=2)
def _pipeline(folder: str, digest: str, by: str, device: str) -> Any:
    """The pipeline of a folder, opened once in a process.

    Raises:
        InputError: it holds none.
    """
    import diffusers

    kind = diffusers.ShapEPipeline if by == "text" else diffusers.ShapEImg2ImgPipeline
    try:
        pipeline = kind.from_pretrained(folder, local_files_only=True, use_safetensors=True).to(device)
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError) as error:
        problem = f"holds no {kind.__name__}: {next(iter(str(error).strip().splitlines()), repr(error))}"
        raise InputError(folder, "", problem, "name a folder that it was saved to, or another `by`") from error
    pipeline.set_progress_bar_config(disable=True)
    return pipeline


SHAP_E = CandidateProvider(name="shap_e", config=ShapE, offer=_offer)
