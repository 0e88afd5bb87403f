"""Models in folders: written for others, and taken in from them. What could run is never opened."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import resource
import socket
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from flows.run.fingerprints import digest
from flows.training.models import (
    bundled_folder,
    evaluations_of_model,
    found_model,
    is_known,
    loaded_model,
    row_of_document,
    shipped_rows,
    system_names,
)
from schemas.errors import InputError
from schemas.files import read_file, write_whole
from schemas.parsing import json_value
from schemas.runs import StageRun
from schemas.text import markdown_cell, one_line
from schemas.training import LearnedModel, ModelEvaluation
from tasks.models import CARD, DOCUMENT, FORMAT, MOST_DOCUMENT_BYTES, WEIGHTS, Model, ModelFolder, refuse_difference
from warehouse.lake import Lake


def export_model(lake: Lake | None, wanted: str, out: Path, force: bool = False) -> tuple[LearnedModel, list[Path]]:
    """Write a model as a folder: weights, what is known of it, and a card for people.

    The same model gives the same bytes. Returns its row and what was written.

    Raises:
        InputError: there is no such model, its weights are gone, or something is at `out` and `force` is not set.
    """
    reader = lake.snapshot() if lake is not None else None
    row, _ = found_model(reader, wanted)
    files = _files(lake, reader, row)
    if out.exists() and not force:
        raise InputError(str(out), "--out", "is there already", "name another place, or give --force")
    if out.exists() and not out.is_dir():
        raise InputError(str(out), "--out", "is no folder", "name a folder")
    out.mkdir(parents=True, exist_ok=True)
    for each, data in files.items():
        write_whole(out / each, data)
    return row, [out / each for each in files]


def _files(lake: Lake | None, reader: Any, row: LearnedModel) -> dict[str, bytes]:
    """Files of a model by name; `model.json` last, so that a folder without it is none."""
    folder = bundled_folder(row.model_id)
    if folder is not None:
        return {
            WEIGHTS: folder.model.weights,
            **{each: read_file(folder.folder / each, each, MOST_DOCUMENT_BYTES) for each in (CARD, DOCUMENT)},
        }
    assert lake is not None
    document, weights = document_of(row, evaluations_of_model(reader, row)), loaded_model(lake, row).weights
    text = json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    return {WEIGHTS: weights, CARD: card_of(document, len(weights)).encode(), DOCUMENT: text.encode()}


def document_of(row: LearnedModel, figures: list[ModelEvaluation]) -> dict[str, Any]:
    """What `model.json` says of a model: all that its row has but times and where it lies, and its figures."""
    kept = ("model_id", "kind", "architecture", "parameter_count", "dataset", "dataset_fingerprint", "seed", "code_fingerprint", "device",
            "license", "parent_id", "is_fallback")  # fmt: skip
    measures = ("method", "dataset", "split", "metric", "value", "low", "high", "examples")
    return {
        "format": FORMAT,
        **{name: getattr(row, name) for name in kept},
        "config": json_value(row.config),
        "examples": {split: int(count) for split, _, count in (entry.partition("=") for entry in row.examples)},
        "notes": list(row.notes),
        "measures": [{name: getattr(figure, name) for name in measures} for figure in figures],
    }


def card_of(document: Mapping[str, Any], size: int) -> str:
    """The model card: what it is of, what it learned from, under which license, and its figures."""
    examples = ", ".join(f"{count:,} {split}" for split, count in sorted(document["examples"].items())) or "not known"
    lines = [
        f"# {document['kind']}, {document['architecture']}, {document['model_id'][:12]}",
        "",
        f"A model of the learned system `{document['kind']}`: {document['parameter_count']:,} numbers in {size / 1e6:.2f} MB.",
        "",
        f"- model: `{document['model_id']}`",
        f"- learned from: {one_line(document['dataset'])} (content `{document['dataset_fingerprint'][:12]}`), examples: {examples}",
        f"- license of what it learned from, and its own: {one_line(document['license'])}",
        f"- seed {document['seed']}, code `{document['code_fingerprint'][:12]}`, on {document['device']}",
    ]
    if document["parent_id"]:
        lines.append(f"- training began with the weights of `{document['parent_id'][:12]}`")
    if document["is_fallback"]:
        lines.append("- a part of it stands in for one whose weights were not there")
    lines += [f"- {one_line(note)}" for note in document["notes"]]
    if document["measures"]:
        lines += ["", "| of | examples | split | figure | value | 95 % interval | n |", "|---|---|---|---|---|---|---|"]
    for figure in document["measures"]:
        interval = f"{figure['low']:.4g} to {figure['high']:.4g}" if figure["low"] is not None and figure["high"] is not None else ""
        head = "| " + " | ".join(markdown_cell(figure[name]) for name in ("method", "dataset", "split", "metric"))
        lines.append(f"{head} | {figure['value']:.4g} | {interval} | {figure['examples']:,} |")
    lines += ["", f"`metascenes models import` takes this folder into a lake; its settings are in `{DOCUMENT}`.", ""]
    return "\n".join(lines)


def import_model(lake: Lake, source: Path, dry_run: bool = False) -> tuple[LearnedModel, bool]:
    """Take a model in from a folder that `export_model` wrote; its row, and whether it is new to the lake.

    Raises:
        InputError: something that is no model of this kind: another format, a file that could run, weights that are cut off or not
            those of its name, a learned system that is not known here, or other facts than those of the same model in the lake or
            the package.
    """
    if not source.is_dir():
        remedy = f"give a folder with {DOCUMENT} and {WEIGHTS}, as `metascenes models export` writes it"
        raise InputError(source.name, "", "is no folder of a model; of weights only safetensors are read: others could run code", remedy)
    return _taken_in(lake, ModelFolder(source), source.name, dry_run)


def _taken_in(lake: Lake, folder: ModelFolder, name: str, dry_run: bool) -> tuple[LearnedModel, bool]:
    document, model = folder.document, folder.model
    if not is_known(model.kind):
        remedy = f"there are {', '.join(system_names()) or 'none'}"
        raise InputError(f"{name}/{DOCUMENT}", "kind", f"there is no learned system {model.kind!r}", remedy)
    config = _checked_config(name, model.kind, document["config"])
    training_id = f"import-{model.model_id[:16]}"
    row = row_of_document(document, training_id, "imported", f"{hashlib.sha256(model.weights).hexdigest()}.weights", len(model.weights))
    figures = _figures(document, row, name)
    bundled = bundled_folder(row.model_id)
    if bundled is not None:
        refuse_difference(f"{name}/{DOCUMENT}", document, bundled.document, "the bundled model")
        return next(each for each in shipped_rows().values() if each.model_id == row.model_id), False
    reader = lake.snapshot() if lake.exists else None
    rows_of_lake = reader.rows(LearnedModel) if reader is not None else []
    known = next((each for each in rows_of_lake if each.model_id == row.model_id), None)
    if known is not None and reader is not None:
        refuse_difference(f"{name}/{DOCUMENT}", document, document_of(known, evaluations_of_model(reader, known)), "the model in the lake")
    if any(each.training_id == training_id and each.model_id != row.model_id for each in rows_of_lake):
        problem = "begins like the id of another model that was imported into the lake"
        raise InputError(f"{name}/{DOCUMENT}", "model_id", problem, "train the model with another seed")
    if known is not None and not known.is_withdrawn:
        return known, False
    if known is None or known.origin != "trained":  # what was trained here fits
        _check_fit(name, model, config)
    rows: dict[str, list[Any]] = {"models": [row], "model_evaluations": figures}
    if known is not None:  # the lake knows more of it than the folder: where it comes from, and what it learned from
        row = dataclasses.replace(known, is_withdrawn=False)
        rows = {"models": [row]}
    if not dry_run:
        lake.blobs.put(model.weights, "weights")
        _keep(
            lake,
            row.training_id,
            rows,
            {"import": row.model_id},
            f"import of model {row.model_id[:12]}",
        )
    return row, True


def _check_fit(name: str, model: Model, config: Any) -> None:
    """Refuse weights that are not those of the settings, before a stage takes them for the newest model."""
    from tasks.families import member
    from tasks.training.learned_systems import SYSTEMS

    member(SYSTEMS, model.kind).fits(model.weights, config, name)


def _checked_config(name: str, kind: str, config: Any) -> Any:
    """Settings of the learned system; refuses those that it does not have: what loads the weights is built by them."""
    from pydantic import ValidationError

    from tasks.families import member
    from tasks.settings import adapter, first_of
    from tasks.training.learned_systems import SYSTEMS

    try:
        return adapter(member(SYSTEMS, kind).config).validate_python(config)
    except ValidationError as error:
        path, problem, remedy = first_of(error)
        raise InputError(f"{name}/{DOCUMENT}", ".".join(["config", *path]), problem, remedy or "export it with this version") from error


def _figures(document: Mapping[str, Any], row: LearnedModel, name: str) -> list[ModelEvaluation]:
    """Rows of the figures that came with a model.

    Raises:
        InputError: they are none.
    """
    from schemas.errors import RecordError
    from schemas.record import check

    try:
        figures = [
            ModelEvaluation(
                training_id=row.training_id, model_id=row.model_id if each["method"] == row.kind else None,
                **{key: each[key] for key in ("method", "dataset", "split", "metric", "value", "low", "high", "examples")},
            )
            for each in document["measures"]
        ]  # fmt: skip
        check(figures, ModelEvaluation)
        check([row], LearnedModel)
    except RecordError as error:
        raise InputError(f"{name}/{DOCUMENT}", error.field, error.rule, "export the model again") from error
    except (KeyError, TypeError) as error:
        raise InputError(f"{name}/{DOCUMENT}", "measures", f"cannot be read ({error})", "export the model again") from error
    return figures


def withdraw_model(lake: Lake, wanted: str, reason: str, dry_run: bool = False) -> LearnedModel:
    """Say of a model that it is not to be used any more. Its row stays, and so does what was made with it.

    Raises:
        InputError: there is no such model, or it is one of the package, which no lake can withdraw.
    """
    row, name = found_model(lake.snapshot(), wanted)
    if name:
        raise InputError("models", name, "ships inside the package and is in no lake", "name another model where stages use one")
    if row.is_withdrawn:
        return row
    notes = (*row.notes, f"withdrawn: {reason}") if reason else row.notes
    gone = dataclasses.replace(row, is_withdrawn=True, notes=notes)
    if not dry_run:
        _keep(lake, row.training_id, {"models": [gone]}, {"withdrawn": row.model_id}, f"model {row.model_id[:12]} withdrawn")
    return gone


def _keep(lake: Lake, training_id: str, rows: Mapping[str, list[Any]], reasons: Mapping[str, str], note: str) -> None:
    """Stage rows of a training that nobody computed here, and commit them."""
    run = StageRun(
        scene_id=training_id, stage="training", fingerprint=digest("models-1", training_id, *(f"{k}={v}" for k, v in reasons.items())),
        attempt=1, outcome="done", upstream=(), reasons=tuple(f"{name}={value}" for name, value in reasons.items()), config="{}",
        row_counts=(), degradations=(), error=None, error_kind=None, started_at=datetime.now(UTC), seconds=0.0,
        host=f"{socket.gethostname()}:{os.getpid()}", peak_memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        snapshot_id=0,
    )  # fmt: skip
    lake.stage_rows(run, rows)
    lake.commit(note=note, scenes=[training_id])
