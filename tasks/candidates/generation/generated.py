"""What a generator is asked for an instance, and the asset that its answer becomes (specs B.2, B.4)."""

from __future__ import annotations

import base64
import dataclasses
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from schemas.errors import InputError
from tasks.calls.asking import call_key, new_call, pixels_digest, recorded
from tasks.calls.endpoint import CallAnswer
from tasks.candidates.assets import MadeAsset, charted, make_asset
from tasks.candidates.provider import NothingToOffer
from tasks.geometry.meshes import load_glb, surface_of
from tasks.settings import Config, Count, Natural
from tasks.views.crops import squared
from tasks.views.pictures import png_of

if TYPE_CHECKING:
    import trimesh

    from tasks.candidates.request import CandidateRequest

Send = Callable[["GeneratorInput", Callable[[], None]], bytes]
"""Asks a generator; told what is called before every request. GLB comes back."""

PROMPT = ("generation", "1")
"""Name and version of how instances are described to generators."""

FRONTS = {"+x": 0, "+y": 3, "-x": 2, "-y": 1}
"""Quarter turns about +Z that bring a front to +X."""


@dataclasses.dataclass(frozen=True)
class GeneratorSettings(Config):
    """What a generator is, and what it makes: what rows say of its assets."""

    model: str = ""  # its name, as rows have it
    model_version: str = ""  # where the same name makes another thing today than it did
    license: str = ""  # of what it makes, SPDX where there is one; whoever runs it has to know
    author: str = ""  # of the model
    source_url: str = ""  # where the model is from
    by: Literal["image", "text"] = "image"  # what it is shown: the crop on white, or the caption's sentence
    pixels: Count = 512  # of the picture's side: what image-to-3D models look at
    away: Literal["fallback", "retry"] = "fallback"  # where it does not answer; `retry` leaves the scene to the next run
    seed: Natural = 0  # the same seed and picture make the same model, where the generator keeps its word
    up: Literal["y", "z"] = "y"  # of its files; glTF says +Y, and some write +Z
    front: Literal["+x", "-x", "+y", "-y", "unknown"] = "unknown"  # of its files, once +Z is up; alignment turns what is unknown


@dataclasses.dataclass(frozen=True)
class GeneratorInput:
    """What a generator is asked. picture: PNG of the crop in a white square; None where it is asked by text."""

    text: str
    picture: bytes | None
    seed: int

    def facts(self) -> dict[str, Any]:
        """As JSON has it."""
        shown = None if self.picture is None else base64.b64encode(self.picture).decode()
        return {"text": self.text, "picture": shown, "seed": self.seed}


def asked_of(request: CandidateRequest, settings: GeneratorSettings) -> GeneratorInput:
    """What a generator is asked for an instance.

    Raises:
        NothingToOffer: there is no picture of it to be shown.
        InputError: the picture cannot be read.
    """
    text = sentence_of(request)
    if settings.by == "text":
        return GeneratorInput(text, None, settings.seed)
    crop = request.view
    if crop is None:
        raise NothingToOffer("no picture of it")
    return GeneratorInput(text, png_of(squared(crop.on_white(), settings.pixels)), settings.seed)


def sentence_of(request: CandidateRequest) -> str:
    """What an instance is, in a sentence: its caption's, or its category."""
    caption = request.caption
    return caption.sentence if caption is not None and caption.sentence else f"A photo of a {request.category}."


def generated(request: CandidateRequest, settings: GeneratorSettings, kind: str, version: str, send: Send, **more: Any) -> MadeAsset:
    """The asset that a generator makes for an instance: as it is in the ledger, else made now. more: What else its answer follows from.

    Raises:
        NothingToOffer: there is no picture of it to be shown.
        InputError: the generator refuses, or what it made cannot be used.
        EndpointAway: it does not answer, or no further call may be made.
    """
    if not settings.license:
        raise InputError("candidates.slots", "license", f"of what {settings.model or kind} makes is not stated", "state it: rows cite it")
    asked, context = asked_of(request, settings), request.context
    facts = {**asked.facts(), **more}
    model = settings.model or kind
    shown = None if asked.picture is None else pixels_digest(asked.picture)
    call_id = call_key("asset", kind, version, model, settings.model_version, {**facts, "picture": shown})
    data = context.ledger.reply(call_id)
    if data is None:
        call = new_call(context, call_id, "asset", request.instance.instance_id, (model, settings.model_version), PROMPT)
        sent = json.dumps(facts, sort_keys=True).encode()
        data = recorded(context, call, sent, lambda begun: CallAnswer(send(asked, begun)))
    parts = standing(load_glb(data, f"{model}.glb"), settings)
    made = make_asset(
        fitted(parts, request.extents), provider=kind, name=f"{model} {call_id[:12]}", category=request.category,
        source=settings.source_url or model, license=settings.license, author=settings.author or None,
        source_url=settings.source_url or None,
    )  # fmt: skip
    return dataclasses.replace(charted(made, parts), call_id=call_id)


def standing(parts: list[trimesh.Trimesh], settings: GeneratorSettings) -> list[trimesh.Trimesh]:
    """Parts of a GLB, read as glTF has it, with what the generator calls up along +Z and its front along +X."""
    import trimesh

    turn = np.eye(4)
    if settings.up == "z":  # the file's +Z was taken for glTF's
        turn[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    quarter = FRONTS.get(settings.front, 0) * 0.5 * np.pi
    turn = trimesh.transformations.rotation_matrix(quarter, [0, 0, 1]).round(12) @ turn
    moved = [part.copy() for part in parts]
    for part in moved:
        part.apply_transform(turn)
    return moved


def fitted(parts: list[trimesh.Trimesh], extents: tuple[float, float, float]) -> list[trimesh.Trimesh]:
    """Parts of unknown scale in the scale of an instance's box [m]: of the same volume of box; their proportions stay.

    Raises:
        ValueError: they have no extents.
    """
    own = np.ptp(surface_of(parts).bounds, axis=0)
    if not (np.isfinite(own).all() and (own > 0).sum() >= 2):
        raise ValueError("has no extents")
    scale = float(np.exp(np.mean(np.log(np.maximum(extents, 1e-3))) - np.mean(np.log(np.maximum(own, 1e-3 * own.max())))))
    moved = [part.copy() for part in parts]
    for part in moved:
        part.apply_scale(scale)
    return moved
