"""What a selection method is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.settings import Config

if TYPE_CHECKING:
    from tasks.selection.evidence import Evidence, Query

Array = NDArray[np.float64]

Need = Literal["image", "text", "model", "clip", "dinov2", "endpoint"]


class Lacking(Exception):
    """A method lacks what it needs for an instance. The text says what; the geometric score stands in, and the rows say so."""


class ScoringModel(Protocol):
    """A learned model with its weights, as `tasks.models.Model` is one."""

    @property
    def model_id(self) -> str:
        """Its name: 64 hex digits."""
        ...

    @property
    def config(self) -> str:
        """The config that it was trained with, as JSON."""
        ...

    @property
    def weights(self) -> bytes:
        """Its weights, safetensors."""
        ...


class MethodConfig(Protocol):
    """Settings of a method."""

    @property
    def kind(self) -> str:
        """Name of the method."""
        ...


@dataclasses.dataclass(frozen=True)
class SelectionMethod:
    """A member of the family `schemas.families.selection_methods`: by what candidates are scored.

    config: What it can be told. version: Goes up when the same evidence would get other scores. score: Of an instance and its candidates,
    as a config says, with the model where it needs one: shape (k,), in 0..1, higher is better; Lacking where it cannot. needs: What must be
    there. An instance without image, text or model is not scored by it. label: Its version in rows, where that hangs on its config too.
    """

    name: str
    config: type[Config]
    version: str
    score: Callable[[Query, Sequence[Evidence], Any, ScoringModel | None], Array]
    needs: tuple[Need, ...] = ()
    label: Callable[[Any, ScoringModel | None], str] | None = None

    def row_version(self, config: MethodConfig, model: ScoringModel | None) -> str:
        """The version as rows have it: with what else the scores follow from."""
        more = self.label(config, model) if self.label is not None else ""
        return f"{self.version}:{more}" if more else self.version


def missing(method: SelectionMethod, query: Query, model: ScoringModel | None) -> str | None:
    """What of an instance a method needs and lacks; None where all is there."""
    if "image" in method.needs:
        try:
            if query.crop is None:
                return "no crop of it"
        except InputError as error:
            return str(error)
    if "text" in method.needs and query.text is None and not query.category:
        return "neither caption nor category"
    if "model" in method.needs and model is None:
        return "no model"
    return None


def chances(logits: Array) -> Array:
    """Scores of any range, shape (k,), as shares of one: their softmax."""
    if not len(logits):
        return logits
    powers = np.exp(logits - logits.max())
    return np.asarray(powers / powers.sum())
