"""Which model draws: the newest of an architecture that was trained in the lake, a named one, or a small one that ships."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Protocol

from pydantic import ValidationError

from flows.run.fingerprints import code_fingerprint
from flows.training.models import LIST, found_model, listed_models, loaded_model
from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.settings import Config, adapter, nearest
from tasks.synthesis.inference.drawer import load
from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.model.config import MODELS, Atiss, DiffuScene, Diffusion, SynthesisModel
from warehouse.lake import Lake

SYSTEM = "synthesis"
"""The learned system whose models draw."""

KINDS: tuple[str, ...] = tuple(sorted(model.kind for model in MODELS))
"""Architectures."""

_CODE = "tasks.synthesis.inference.drawer"


class LayoutDrawer(Protocol):
    """Who draws layouts, as `tasks.synthesis.inference` does."""

    def check(self, large: Large) -> None:
        """Refuse a large object, or a kind of room, that it does not know.

        Raises:
            InputError: it does not.
        """

    def draw(self, larges: Sequence[Large], seed: int, numbers: Sequence[int]) -> list[Layout]:
        """Layouts on large objects, of a seed and a number each: what else is drawn, and where, changes nothing."""


@dataclasses.dataclass(frozen=True)
class DrawingModel:
    """A model that can draw. kind: Its architecture. code: Fingerprint of the code that draws."""

    model_id: str
    kind: str
    license: str | None
    code: str
    drawer: LayoutDrawer


def drawing_model(lake: Lake, wanted: str) -> DrawingModel:
    """The model that a text means: an architecture, of which the newest is taken that was trained in or imported into the lake and not
    withdrawn, else the one that ships; or a model's id, or the beginning of one, or the name of one that ships.

    Raises:
        InputError: there is none, or the named one was withdrawn.
    """
    reader = lake.snapshot() if lake.exists else None
    if wanted in KINDS:
        rows = [row for row, _ in listed_models(reader) if row.kind == SYSTEM and not row.is_withdrawn and _kind(row.config) == wanted]
        if not rows:
            remedy = f"`metascenes train {SYSTEM} --set model.kind={wanted}` makes one"
            raise InputError("--model", wanted, "no model of it was trained in this lake, and none ships", remedy)
        row = rows[0]
    else:
        if not re.fullmatch(r"[0-9a-f]{4,64}", wanted) and wanted not in {name for _, name in listed_models(reader)}:
            raise InputError("--model", wanted, "is no model", nearest(wanted, KINDS, "give an id, or one of"))
        row, _ = found_model(reader, wanted, SYSTEM)
        if row.is_withdrawn:
            raise InputError("--model", wanted, "was withdrawn", f"name another; {LIST}")
    model = loaded_model(lake, row)
    config = model_config(model.config, f"model {row.model_id[:12]}")
    drawer = load(model.weights, config, f"model {row.model_id[:12]}")
    return DrawingModel(row.model_id, config.kind, row.license, code_fingerprint(_CODE), drawer)


def model_config(text: str, name: str) -> Diffusion | Atiss:
    """What a model is made of, from the settings of its training as JSON.

    Raises:
        InputError: they are those of no synthesis model.
    """
    try:
        made: _Settings = adapter(_Settings).validate_python({"model": json_value(text)["model"]})
    except (ValidationError, ValueError, KeyError, TypeError) as error:
        raise InputError(name, "config", "is that of no synthesis model", f"{LIST} with what made them") from error
    config: Diffusion | Atiss = made.model
    return config


@dataclasses.dataclass(frozen=True)
class _Settings(Config):
    """What of a training's settings says what the model is."""

    model: SynthesisModel = dataclasses.field(default_factory=DiffuScene)  # never used: the settings have one


def _kind(config: str) -> str:
    try:
        return str(json_value(config)["model"]["kind"])
    except (ValueError, KeyError, TypeError):
        return ""
