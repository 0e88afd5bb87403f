"""Models as they are handed around: weights with the config that they belong to, in memory, in a folder, in the package.

A folder of a model holds `weights.safetensors`, `model.json` and a card for people.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from schemas.errors import InputError
from schemas.files import read_file
from schemas.text import cut, is_one_line
from tasks.batches import parse_json
from tasks.settings import LARGEST, Config, fields_of, shown
from tasks.weights import from_safetensors

WEIGHTS, DOCUMENT, CARD = "weights.safetensors", "model.json", "README.md"
FORMAT = 1
MOST_DOCUMENT_BYTES = 4 << 20
"""Of `model.json`; a few kilobytes are usual."""


MOST_WEIGHT_BYTES = 512 << 20
"""Of the weights in a folder: four times those of the paper's model; they are read as a whole."""


@dataclasses.dataclass(frozen=True)
class Model:
    """A model that a stage scores with. config: That of its learned system, as JSON. weights: safetensors."""

    model_id: str
    kind: str
    architecture: str
    config: str
    weights: bytes = dataclasses.field(repr=False)


def identity(config: Any) -> Any:
    """A config as plain JSON values, without the fields that its class calls `idle`: what changes no weight is no part of a model."""
    if isinstance(config, Config):
        idle = getattr(type(config), "idle", ())
        values = {name: identity(getattr(config, name)) for name in fields_of(type(config)) if name not in idle}
        return ({"kind": config.kind} if config.kind else {}) | values
    if isinstance(config, tuple | list):
        return [identity(item) for item in config]
    return config


def identity_json(config: Any) -> str:
    """`identity` as JSON text; the same config gives the same text."""
    return json.dumps(identity(config), sort_keys=True, separators=(",", ":"), allow_nan=False)


def model_id_of(weights: bytes, config_json: str) -> str:
    """Name of a model, 64 hex digits: hash of its weights and its config."""
    return hashlib.sha256(hashlib.sha256(weights).digest() + config_json.encode()).hexdigest()


_FIELDS: dict[str, type | tuple[type, ...]] = {
    "format": int, "model_id": str, "kind": str, "architecture": str, "parameter_count": int, "config": dict, "dataset": str,
    "dataset_fingerprint": str, "examples": dict, "seed": int, "code_fingerprint": str, "device": str, "license": str,
    "parent_id": (str, type(None)), "is_fallback": bool, "notes": list, "measures": list,
}  # fmt: skip


def _wrong(document: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Fields whose values cannot be used, and why, of a document whose fields have the types that they should have."""
    for field in (name for name in _FIELDS if isinstance(document[name], str)):
        if not is_one_line(document[field]):
            yield field, f"must be one line without control characters, is {shown(document[field])}"
    for field in ("parameter_count", "seed"):
        if not -LARGEST <= document[field] <= LARGEST:
            yield field, "is too large"
    for split, count in document["examples"].items():
        if not re.fullmatch(r"\w[\w .-]*", split):
            yield "examples", f"{cut(repr(split))} is no name of a split"
        if type(count) is not int or not 0 <= count <= LARGEST:
            yield f"examples.{split}", f"must be a whole number of at least 0, is {shown(count)}"
    for place, note in enumerate(document["notes"]):
        if not isinstance(note, str):
            yield "notes", f"line {place + 1} must be a text, is {shown(note)}"
        elif not is_one_line(note):
            yield "notes", f"line {place + 1} must be one line without control characters, is {shown(note)}"
    seconds = document.get("seconds", 0.0)
    if type(seconds) not in (int, float) or not 0 <= seconds <= LARGEST:
        yield "seconds", f"must be a number of at least 0, is {shown(seconds)}"
    names = set[tuple[str, ...]]()
    for place, figure in enumerate(document["measures"]):
        if not isinstance(figure, dict):
            yield "measures", f"item {place + 1} must be a table, is {shown(figure)}"
        elif any(type(value) is int and abs(value) > LARGEST for value in figure.values()):
            yield "measures", f"item {place + 1} has a number that is too large"
        elif any(isinstance(value, str) and not is_one_line(value) for value in figure.values()):
            yield "measures", f"item {place + 1} has a text with a new line or a control character"
        elif _name_of(figure) in names:
            yield "measures", f"item {place + 1} repeats the figure {cut(', '.join(_name_of(figure)))}"
        else:
            names.add(_name_of(figure))


WITHDRAWN = "withdrawn: "
"""Start of the note that a lake adds to a withdrawn model."""

_FACTS = ("kind", "architecture", "parameter_count", "license", "dataset", "dataset_fingerprint", "examples", "seed", "code_fingerprint",
          "device", "parent_id", "is_fallback", "notes")  # fmt: skip


def refuse_difference(name: str, document: Mapping[str, Any], known: Mapping[str, Any], owner: str) -> None:
    """Compare a model's document with the one known for the same weights. A figure that only one of them has is not a difference.

    Args:
        name: file name of `document` for messages.
        document: content of a foreign `model.json`.
        known: content of `model.json` for the model in the lake or the package.
        owner: `known` in words, for messages.

    Raises:
        InputError: a field differs.
    """
    pairs = [(field, _comparable(document, field), _comparable(known, field)) for field in _FACTS]
    known_figures = {_name_of(figure): _values_of(figure) for figure in known["measures"]}
    pairs += [
        (f"measures of {', '.join(_name_of(figure))}", _values_of(figure), known_figures[_name_of(figure)])
        for figure in document["measures"]
        if _name_of(figure) in known_figures
    ]
    for field, value, other in pairs:
        if value != other:
            problem = f"is {shown(value)}, and {shown(other)} in {owner} with the same weights"
            raise InputError(name, field, problem, "ask its author for the unchanged folder")


def _comparable(document: Mapping[str, Any], field: str) -> Any:
    """A fact of a model without the notes that its withdrawal added."""
    value = document[field]
    return [note for note in value if not note.startswith(WITHDRAWN)] if field == "notes" else value


def _name_of(figure: Mapping[str, Any]) -> tuple[str, ...]:
    """Method, dataset, split and metric of a figure."""
    return tuple(str(figure.get(key)) for key in ("method", "dataset", "split", "metric"))


def _values_of(figure: Mapping[str, Any]) -> list[Any]:
    """Value, interval and number of examples of a figure."""
    return [figure[key] for key in ("value", "low", "high", "examples")]


@dataclasses.dataclass(frozen=True)
class ModelFolder:
    """A folder with a model. It is read when it is asked for, and never trusted.

    >>> ModelFolder(Path("tasks/selection/model/shipped/small")).model.model_id  # doctest: +SKIP
    """

    folder: Path

    @cached_property
    def document(self) -> Mapping[str, Any]:
        """What `model.json` says.

        Raises:
            InputError: it cannot be read, lacks a field, or has one of another type.
        """
        name = f"{self.folder.name}/{DOCUMENT}"
        read = parse_json(read_file(self.folder / DOCUMENT, name, MOST_DOCUMENT_BYTES), name)
        if not isinstance(read, dict):
            raise InputError(name, "", "is no table", "export the model again")
        for field, kinds in _FIELDS.items():
            kind = type(read.get(field))
            if field not in read or not issubclass(kind, kinds) or (kind is bool and kinds is int):
                raise InputError(name, field, "is missing" if field not in read else f"is {kind.__name__}", "export the model again")
        if read["format"] != FORMAT:
            raise InputError(name, "format", f"is {read['format']}, this version reads {FORMAT}", "export the model again")
        wrong = next(_wrong(read), None)
        if wrong is not None:
            raise InputError(name, *wrong, "export the model again")
        return read

    @cached_property
    def model(self) -> Model:
        """The model, its weights held against its name.

        Raises:
            InputError: as `document`; or the weights are no safetensors file, or not those that the model's name is made of.
        """
        document, name = self.document, f"{self.folder.name}/{WEIGHTS}"
        weights = read_file(self.folder / WEIGHTS, name, MOST_WEIGHT_BYTES)
        from_safetensors(weights, name)
        config = json.dumps(document["config"], sort_keys=True, separators=(",", ":"))
        if model_id_of(weights, config) != document["model_id"]:
            raise InputError(f"{self.folder.name}/{DOCUMENT}", "model_id", "is not that of its weights and config", "export it again")
        return Model(document["model_id"], document["kind"], document["architecture"], config, weights)


def folders_in(place: Path) -> dict[str, ModelFolder]:
    """Models in folders of a folder, by the folders' names; none where it is not there."""
    return {file.parent.name: ModelFolder(file.parent) for file in sorted(place.glob(f"*/{DOCUMENT}"))}
