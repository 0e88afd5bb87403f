"""`metascenes models`: models of a lake, and those that ship inside the package."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import existing_lake, json_option, lake_option

if TYPE_CHECKING:
    from schemas.training import LearnedModel
    from warehouse.lake import Lake


@click.group("models", short_help="List, show, export, import and withdraw models.")
def command() -> None:
    """Models: those that were trained on a lake or imported into it, and those that ship inside the package.

    Example: metascenes models list --lake ./lake
    """


@command.command("list")
@lake_option
@json_option
def list_(address: str, as_json: bool) -> None:
    """List the models of a lake, the newest first, and those that ship inside the package, which any lake has.

    A stage that asks for the newest model takes the first of its kind that was not withdrawn.

    Example: metascenes models list --lake ./lake
    """
    from flows.training.models import listed_models

    lake = _lake_if_there(address)
    models = listed_models(lake.snapshot() if lake is not None else None)
    if as_json:
        print(json.dumps({"models": [{"name": name or None, **dataclasses.asdict(row)} for row, name in models]}))
        return
    if not models:
        print("no model yet; `metascenes train` makes one")
        return
    rows = [("model", "kind", "architecture", "origin", "numbers", "MB", "learned from", "license", "")]
    for row, name in models:
        state = "withdrawn" if row.is_withdrawn else name
        size = f"{row.weights_bytes / 1e6:.1f}"
        rows.append(
            (row.model_id[:12], row.kind, row.architecture, row.origin, f"{row.parameter_count:,}", size, row.dataset, row.license, state)
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for line in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


@command.command("show")
@click.argument("model", metavar="MODEL_ID")
@lake_option
@json_option
def show(model: str, address: str, as_json: bool) -> None:
    """Print the card of a model; with --json what is known of it. The beginning of its id is enough.

    Example: metascenes models show 3f9a1c --lake ./lake
    """
    from flows.training.folders import card_of, document_of
    from flows.training.models import bundled_folder, evaluations_of_model, found_model

    lake = _lake_if_there(address)
    reader = lake.snapshot() if lake is not None else None
    row, _ = found_model(reader, model)
    bundled = bundled_folder(row.model_id)
    if bundled is not None:
        document: Any = bundled.document
    else:
        assert reader is not None
        document = document_of(row, evaluations_of_model(reader, row))
    if as_json:
        facts = {"origin": row.origin, "training_id": row.training_id, "snapshot_id": row.snapshot_id, "release": row.release}
        print(json.dumps({**document, **facts, "is_withdrawn": row.is_withdrawn, "weights_blob": row.weights_blob}))
    else:
        print(card_of(document, row.weights_bytes) + ("\nwithdrawn\n" if row.is_withdrawn else ""), end="")


@command.command("export")
@click.argument("model", metavar="MODEL_ID")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write.")
@click.option("--force", is_flag=True, help="Replace what is there.")
@lake_option
@json_option
def export(model: str, out: Path, force: bool, address: str, as_json: bool) -> None:
    """Write a model for others: weights as safetensors, model.json with all that is known of it, and a card.

    The same model gives the same bytes.

    Example: metascenes models export 3f9a1c --out ./selection_model --lake ./lake
    """
    from flows.training.folders import export_model

    row, files = export_model(_lake_if_there(address), model, out, force)
    if as_json:
        print(json.dumps({"model_id": row.model_id, "files": [str(file) for file in files]}))
    else:
        print(f"model {row.model_id[:12]} of {row.kind} is in {out}; license: {row.license}")


@command.command("import")
@click.argument("source", metavar="FOLDER", type=click.Path(path_type=Path, exists=True))
@click.option("--dry-run", is_flag=True, help="Check it, and say what it is; write nothing.")
@lake_option
@json_option
def import_(source: Path, dry_run: bool, address: str, as_json: bool) -> None:
    """Take a model in that `metascenes models export` wrote.

    Its weights are arrays and nothing else: files that could run code are refused. It is the newest of its kind then. A model that was
    withdrawn counts again. A model that is bundled or in the lake already must state the same facts.

    Example: metascenes models import ./selection_model --lake ./lake
    """
    from flows.training.folders import import_model
    from warehouse.lake import Lake

    row, is_new = import_model(Lake.open(address), source, dry_run)
    if as_json:
        print(json.dumps({"is_new": is_new, **dataclasses.asdict(row)}))
    else:
        known = "is bundled" if row.origin == "shipped" else "is in the lake already"
        state = known if not is_new else "would be imported" if dry_run else "imported"
        print(f"model {row.model_id} of {row.kind}, {row.architecture}: {state}")


@command.command("withdraw")
@click.argument("model", metavar="MODEL_ID")
@click.option("--reason", default="", help="Why; its row says so.")
@click.option("--dry-run", is_flag=True, help="Say which model it is; write nothing.")
@lake_option
@json_option
def withdraw(model: str, reason: str, dry_run: bool, address: str, as_json: bool) -> None:
    """Let a model be used no more: where settings name none, the newest one before it takes its place; runs whose settings name it are
    refused. What was made with it stays, and says so.

    Example: metascenes models withdraw 3f9a1c --reason "trained on scans that were erased" --lake ./lake
    """
    from flows.training.folders import withdraw_model

    row = withdraw_model(existing_lake(address), model, reason, dry_run)
    print(json.dumps(dataclasses.asdict(row)) if as_json else _withdrawn_line(row, dry_run))


def _withdrawn_line(row: LearnedModel, dry_run: bool) -> str:
    return f"model {row.model_id} of {row.kind} {'would be' if dry_run else 'is'} withdrawn"


def _lake_if_there(address: str) -> Lake | None:
    """The lake at an address; None where there is none: shipped models are there all the same."""
    from warehouse.lake import Lake

    lake = Lake.open(address)
    return lake if lake.exists else None
