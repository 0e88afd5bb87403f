"""What a selection method is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.models import Model
from tasks.settings import Config

if TYPE_CHECKING:
    from schemas.candidates import Asset
    from tasks.selection.evidence import Evidence, InstanceQuery
    from tasks.stage import Context

Array = NDArray[np.float64]

Need = Literal["image", "text", "model", "clip", "dinov2", "endpoint"]


class Lacking(Exception):
    """A method lacks what it needs for an instance. The text says what; the geometric score stands in, and the rows say so."""


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
    check: Raises an InputError where a config does not name what the method needs; asked before anything is aligned. is_geometric:
    Whether a config's scores are geometric ones or near to them: what loses little of them fits nearly as well, whoever chose. prepare:
    Makes what scoring takes of assets, for those of all candidates at once.
    """

    name: str
    config: type[Config]
    version: str
    score: Callable[[InstanceQuery, Sequence[Evidence], Any, Model | None], Array]
    needs: tuple[Need, ...] = ()
    label: Callable[[Any, Model | None], str] | None = None
    check: Callable[[Any], None] | None = None
    is_geometric: Callable[[Any], bool] = lambda config: False
    prepare: Callable[[Sequence[Asset], Context, Any, Model | None], None] | None = None

    def row_version(self, config: MethodConfig, model: Model | None) -> str:
        """The version as rows have it: with what else the scores follow from."""
        more = self.label(config, model) if self.label is not None else ""
        return f"{self.version}:{more}" if more else self.version


def missing(method: SelectionMethod, query: InstanceQuery, model: Model | None) -> str | None:
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
