"""Models of a lake, and those that ship inside the package: which there are, which one is meant, and what is done with them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

from schemas.errors import InputError
from schemas.record import arrow_to_rows
from schemas.training import LearnedModel, ModelEvaluation
from tasks.families import member
from tasks.models import Model, ModelFolder, model_id_of
from tasks.stage import WantedModel
from tasks.training.learned_systems import SYSTEMS
from warehouse.lake import Lake
from warehouse.tables.history import order
from warehouse.tables.snapshot import Reader

LIST = "`metascenes models list` names them"


def shipped_models(kind: str | None = None) -> Iterator[tuple[str, ModelFolder]]:
    """Models inside the package by name, of one learned system or of all: the first of a system is the one that stands in."""
    for system in SYSTEMS:
        if kind in (None, system.name):
            yield from system.shipped().items()


def bundled_folder(model_id: str) -> ModelFolder | None:
    """The folder of the bundled model with an id."""
    return next((folder for _, folder in shipped_models() if folder.document["model_id"] == model_id), None)


def row_of_document(document: Mapping[str, Any], training_id: str, origin: str, blob: str, size: int) -> LearnedModel:
    """A row of `models` made of what a model's `model.json` says; of a model that was not trained in this lake."""
    return LearnedModel(
        model_id=document["model_id"], training_id=training_id, kind=document["kind"], origin=origin,
        architecture=document["architecture"], parameter_count=document["parameter_count"],
        config=json.dumps(document["config"], sort_keys=True, separators=(",", ":")), weights_blob=blob, weights_bytes=size,
        dataset=document["dataset"], snapshot_id=None, release=None, dataset_fingerprint=document["dataset_fingerprint"],
        examples=tuple(f"{split}={count}" for split, count in sorted(document["examples"].items())), seed=document["seed"],
        code_fingerprint=document["code_fingerprint"], device=document["device"], seconds=float(document.get("seconds", 0.0)),
        license=document["license"], parent_id=document["parent_id"], is_fallback=document["is_fallback"], is_withdrawn=False,
        notes=tuple(document["notes"]),
    )  # fmt: skip


def shipped_rows() -> dict[str, LearnedModel]:
    """Rows, as `models` would have them, of the models inside the package, by name."""
    rows = {}
    for name, folder in shipped_models():
        blob = f"{_sha256(folder.model.weights)}.weights"
        rows[name] = row_of_document(folder.document, f"shipped-{name}", "shipped", blob, len(folder.model.weights))
    return rows


def listed_models(reader: Reader | None) -> list[tuple[LearnedModel, str]]:
    """All models, with the names of bundled ones: those of a lake with the newest first, then the bundled ones.

    A lake cannot replace a bundled model: its rows with the id of a bundled model are left out, and so are rows that claim to be bundled.
    """
    bundled = shipped_rows()
    bundled_ids = {row.model_id for row in bundled.values()}
    rows = _newest_first(reader) if reader is not None else []
    of_lake = [(row, "") for row in rows if row.origin != "shipped" and row.model_id not in bundled_ids]
    return of_lake + [(row, name) for name, row in bundled.items()]


def _newest_first(reader: Reader) -> list[LearnedModel]:
    """Models of a lake by when they were trained or imported."""
    rows = reader.rows(LearnedModel)
    if not rows:
        return []
    from schemas.runs import StageRun

    runs = arrow_to_rows(reader.matching("stage_runs", {"stage": ["training"], "outcome": ["done"]}), StageRun)
    newest = {run.scene_id: order(run) for run in sorted(runs, key=order)}
    return sorted(rows, key=lambda row: (newest.get(row.training_id, ()), row.model_id), reverse=True)


def found_model(reader: Reader | None, wanted: str, kind: str | None = None) -> tuple[LearnedModel, str]:
    """The model of a text: a bundled name, an id, or a prefix of only one id; with its name if it is bundled.

    Raises:
        InputError: none or several are meant, or it is of another learned system.
    """
    every = listed_models(reader) if wanted else []
    # A bundled name comes first: ids are hashes, and one that begins like a name can be searched for.
    meant = [(row, name) for row, name in every if name == wanted]
    meant = meant or [(row, name) for row, name in every if row.model_id.startswith(wanted)]
    if len(meant) != 1:
        problem = f"{len(meant)} models begin with {wanted!r}" if meant else f"there is no model {wanted!r}"
        raise InputError("models", "model_id", problem, "give more digits" if meant else LIST)
    if kind is not None and meant[0][0].kind != kind:
        raise InputError("models", "model_id", f"{wanted} is a model of {meant[0][0].kind}", f"name one of {kind}; {LIST}")
    return meant[0]


def wanted_model(reader: Reader | None, wanted: WantedModel) -> LearnedModel:
    """The model that a stage is to use: the one that it names, else the newest of its kind, else the first shipped one.

    Raises:
        InputError: there is none, or the named one was withdrawn.
    """
    if wanted.model_id:
        row, _ = found_model(reader, wanted.model_id, wanted.kind)
        if row.is_withdrawn:
            raise InputError("models", "model_id", f"{row.model_id[:12]} was withdrawn", f"name another; {LIST}")
        return row
    for row, _ in listed_models(reader):
        if row.kind == wanted.kind and not row.is_withdrawn:
            return row
    raise InputError("models", wanted.kind, "there is no model of it", f"`metascenes train {wanted.kind}` makes one")


def loaded_model(lake: Lake, row: LearnedModel) -> Model:
    """A model with its weights, from the lake or from the package.

    Raises:
        InputError: the weights are gone, or are not those of the model.
    """
    bundled = bundled_folder(row.model_id)
    if bundled is not None:
        return bundled.model
    try:
        weights = lake.blobs[row.weights_blob]
    except KeyError:
        raise InputError(lake.address, row.weights_blob, "is not in the lake", "restore it, or withdraw the model") from None
    if model_id_of(weights, row.config) != row.model_id:
        raise InputError(lake.address, row.model_id, "is not the model of its weights and config", "`metascenes doctor lake` says more")
    return Model(row.model_id, row.kind, row.architecture, row.config, weights)


@lru_cache(maxsize=4)
def model_for_worker(address: str, kind: str, model_id: str) -> Model:
    """The model that a stage's job names, once for a process: many scenes are scored with the same."""
    lake = Lake.open(address)
    return loaded_model(lake, found_model(lake.snapshot(), model_id, kind)[0])


def evaluations_of_model(reader: Reader, row: LearnedModel) -> list[ModelEvaluation]:
    """Figures of a training: of its model, and of what it was held against."""
    rows = arrow_to_rows(reader.matching("model_evaluations", {"training_id": [row.training_id]}), ModelEvaluation)
    return sorted(rows, key=lambda figure: (figure.dataset, figure.split, figure.metric, figure.method != row.kind, figure.method))


def figure_lines(figures: Sequence[ModelEvaluation]) -> list[str]:
    """Figures for people, a line each, in columns; none where there are none."""
    if not figures:
        return []
    rows = [("of", "examples", "split", "figure", "value", "95 % interval", "n")]
    for row in figures:
        interval = f"{row.low:.4g} to {row.high:.4g}" if row.low is not None and row.high is not None else ""
        rows.append((row.method, row.dataset, row.split, row.metric, f"{row.value:.4g}", interval, f"{row.examples:,}"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["", *("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows)]


def system_names() -> list[str]:
    """Names of the learned systems."""
    return [system.name for system in SYSTEMS]


def is_known(kind: str) -> bool:
    """Whether there is a learned system of that name."""
    return any(system.name == kind for system in SYSTEMS)


def reads_of(kind: str) -> tuple[str, ...]:
    """Tables that a learned system learns from."""
    return member(SYSTEMS, kind).reads


def paths_of(kind: str, config: Any) -> Mapping[str, str]:
    """Files and folders that the settings of a learned system name, by field."""
    return member(SYSTEMS, kind).paths(config)


def _sha256(data: bytes) -> str:
    import hashlib

    return hashlib.sha256(data).hexdigest()
