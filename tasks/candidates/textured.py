"""Textured twins: the asset of another slot, painted anew. By what the scan's frames show of the instance, or by a program of others.

Figure A5 of the paper marks such candidates with an asterisk. A twin is the same solid as its sibling, with the same convex pieces.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import Field

from schemas.errors import InputError
from schemas.lineage.licenses import BESIDE, OF_THE_SCAN, all_of, is_of_scan
from tasks.alignment import AlignmentConfig, align, covered_within, sample_asset
from tasks.calls.asking import call_key, new_call, pixels_digest, recorded
from tasks.calls.endpoint import CallAnswer
from tasks.candidates.assets import MadeAsset, make_asset
from tasks.candidates.generation.generated import PROMPT, sentence_of
from tasks.candidates.provider import CandidateProvider, NothingToOffer
from tasks.geometry.meshes import load_glb, surface_of
from tasks.geometry.transforms import yaw_pose
from tasks.settings import WHOLE, Config, union_of
from tasks.texturing.baking import BakeConfig
from tasks.texturing.charts import ChartFigures
from tasks.texturing.commanded import TextureCommand, checked, painted
from tasks.texturing.rows import charts_row, picture_size
from tasks.texturing.twin import TwinConfig, textured_twin
from tasks.texturing.unwrapping import SmartUvUnwrapper, Unwrapper, XatlasUnwrapper
from tasks.views.crops import squared
from tasks.views.pictures import png_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tasks.candidates.request import CandidateRequest

    Layout = Unwrapper
else:
    Layout = union_of((XatlasUnwrapper, SmartUvUnwrapper))

SIDE_PX = 512
"""Of textures, at most: 3 mm on a chair, as cameras see it from two metres, for a third of the time that 1024 takes."""

WHERE = "candidates.slots"
"""The settings, as errors name them."""

BESIDE_SLOT = " textured"
"""What the provider of a twin's asset has behind its sibling's: whoever asks who made the solid finds it by the beginning."""


@dataclasses.dataclass(frozen=True)
class FramePainting(Config):
    """A texture baked from the frames of the scan, onto the asset where alignment puts it."""

    kind: ClassVar[str] = "frames"
    unwrapper: Layout = dataclasses.field(default_factory=XatlasUnwrapper)  # in this process, and at once; smart_uv needs Blender
    twin: TwinConfig = dataclasses.field(default_factory=lambda: TwinConfig(bake=BakeConfig(max_px=SIDE_PX)))


if TYPE_CHECKING:
    Painter = FramePainting | TextureCommand
else:
    Painter = union_of((FramePainting, TextureCommand))


@dataclasses.dataclass(frozen=True)
class Textured(Config):
    """The textured twin of another slot's asset."""

    kind: ClassVar[str] = "textured"
    of: Annotated[int, Field(ge=1, le=10), WHOLE] = 1  # the slot whose asset is painted; no twin itself
    painter: Painter = dataclasses.field(default_factory=FramePainting)  # needs no weights, and shows what is there
    version: str = "1"  # goes up when the same asset and frames would give another twin

    @property
    def seed(self) -> int | None:
        """Seed that the painter is given; None where nothing is drawn."""
        return self.painter.seed if isinstance(self.painter, TextureCommand) else None

    @property
    def method(self) -> str:
        """Who lays out the texture: the unwrapper, or the program that paints."""
        painter = self.painter
        return painter.unwrapper.kind if isinstance(painter, FramePainting) else painter.model or painter.kind


@dataclasses.dataclass(frozen=True)
class _Painted:
    """A painted asset as a file. by: Tool that laid it out, with its version. seconds: That the layout took, or painting all of it."""

    glb: bytes
    by: str | None
    figures: ChartFigures
    seconds: float | None
    seen_share: float | None = None
    call_id: str | None = None


def twin_asset(request: CandidateRequest, config: Textured) -> MadeAsset:
    """The twin of the asset in another slot of an instance.

    Raises:
        NothingToOffer: there is nothing in that slot, or nothing to paint it with.
        InputError: a program refuses or fails, what it left cannot be used, or its license is not stated.
    """
    plain = request.filled.get(config.of)
    if plain is None:
        raise NothingToOffer(f"slot {config.of} holds no asset to be painted")
    asset, painter = plain.asset, config.painter
    licenses = [asset.license, OF_THE_SCAN]
    if isinstance(painter, FramePainting):
        done = _from_frames(request, plain, painter)
    else:
        done = _by_program(request, plain, config, painter)
        licenses.append(painter.license)
    whence = "" if is_of_scan(asset.license) else f"{BESIDE}{asset.source}"
    parts = load_glb(done.glb, "twin.glb")
    made = make_asset(
        parts, provider=f"{asset.provider}{BESIDE_SLOT}",
        name=f"{asset.name} {asset.asset_id[:12]} {request.context.scene_id} {request.instance.instance_id} {config.method}",
        category=asset.category, source=f"scan {request.context.scene_id}{whence}", license=all_of(licenses), author=asset.author,
        source_url=asset.source_url,
    )  # fmt: skip
    row, files = made.asset, dict(made.files)
    if isinstance(painter, FramePainting):  # the same triangles, whatever joining corners that a texture has split would make of them
        row = dataclasses.replace(row, is_watertight=asset.is_watertight, open_reason=asset.open_reason, volume_m3=asset.volume_m3)
    if asset.pieces_blob is not None:  # the same solid collides as its sibling does
        row = dataclasses.replace(row, pieces_blob=asset.pieces_blob, volume_m3=asset.volume_m3)
        files[asset.pieces_blob] = _file(request, plain, asset.pieces_blob)
    side = max((max(size) for part in parts if (size := picture_size(part)) is not None), default=1)
    charts = charts_row(row.asset_id, asset.asset_id, config.method, done.by, side, done.figures, done.seconds)
    return MadeAsset(row, files, done.call_id, charts=charts, seen_share=done.seen_share)


def _file(request: CandidateRequest, made: MadeAsset, name: str) -> bytes:
    """A file of an asset; the lake has those of its libraries."""
    if name in made.files or request.retrieval is None:
        return made.files[name]
    return request.retrieval.library.blobs[name]


def _from_frames(request: CandidateRequest, plain: MadeAsset, painter: FramePainting) -> _Painted:
    """An asset with what the frames of the scan show of the instance.

    Raises:
        NothingToOffer: there are none, they show too little of it, or it has no layout.
    """
    if not request.views:
        raise NothingToOffer(request.unseen or "no frame shows it")
    data = _file(request, plain, plain.asset.mesh_blob)
    pose, scale = laid(request, plain)
    twin = textured_twin(data, pose, scale, painter.unwrapper, request.views, painter.twin, file=plain.asset.mesh_blob)
    if not twin.glb or twin.figures is None:
        raise NothingToOffer(twin.problem)
    return _Painted(twin.glb, twin.by, twin.figures, twin.layout_seconds, twin.seen_share)


def laid(request: CandidateRequest, plain: MadeAsset) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where an asset stands in the world, 4x4 [m], and its scale along its own axes, shape (3,): as selection lays it by default.

    The pose of the box would not do: which of its sides is the front nobody knows before.
    """
    config = AlignmentConfig()
    frame, target = request.target
    rng = request.context.rng("asset", plain.asset.asset_id)
    sample = sample_asset(plain.asset, _file(request, plain, plain.asset.mesh_blob), config, rng)
    fit, _ = align(target, sample, covered_within(target.diagonal), config)
    return frame @ yaw_pose(fit.yaw, fit.offset), fit.scale


def _by_program(request: CandidateRequest, plain: MadeAsset, config: Textured, command: TextureCommand) -> _Painted:
    """An asset as a program paints it: as it is in the ledger, else painted now.

    Raises:
        InputError: the program fails, or what it left cannot be used.
    """
    name = command.model or command.kind
    if not command.words or not command.license:
        field, problem = ("license", f"of what {name} paints is not stated") if command.words else ("words", "name no program")
        raise InputError(WHERE, field, problem, "state it")
    data = _file(request, plain, plain.asset.mesh_blob)
    crop = request.view if any("{image}" in word for word in command.words) else None
    picture = None if crop is None else squared(crop.on_white(), command.pixels)
    shown, text = None if picture is None else png_of(picture), sentence_of(request)
    facts = {"mesh": hashlib.sha256(data).hexdigest(), "text": text, "seed": command.seed, "words": list(command.words)}
    call_id = call_key(
        "texture", config.kind, config.version, name, command.model_version,
        facts | {"picture": None if shown is None else pixels_digest(shown), "program": command.version},
    )  # fmt: skip
    glb = request.context.ledger.reply(call_id)
    if glb is None:
        seen = None if shown is None else base64.b64encode(shown).decode()
        call = new_call(request.context, call_id, "texture", request.instance.instance_id, (name, command.model_version), PROMPT)

        def send(begun: Callable[[], None]) -> CallAnswer:
            begun()
            left = painted(command, data, picture, text, command.seed, plain.asset.mesh_blob)
            if left.problem:
                raise InputError(WHERE, name, left.problem, "run it by hand to see more")
            return CallAnswer(left.glb)

        glb = recorded(request.context, call, json.dumps(facts | {"picture": seen}, sort_keys=True).encode(), send)
    figures = checked(surface_of(load_glb(data, plain.asset.mesh_blob)), glb, command)
    return _Painted(glb, " ".join(filter(None, (name, command.model_version))), figures, None, call_id=call_id)


def _label(config: Textured) -> str:
    return f"{config.kind}:{config.method}"


TEXTURED = CandidateProvider(
    name="textured", config=Textured, offer=twin_asset, label=_label, paints=lambda config: config.of,
    frames=lambda config: isinstance(config.painter, FramePainting),
)  # fmt: skip
