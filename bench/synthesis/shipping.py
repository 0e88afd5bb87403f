"""The models that ship inside the package: trained on generated rooms, with a card that says what they know and do not.

python -m bench.synthesis.shipping --model physcene --out tasks/synthesis/model/shipped
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

from bench.synthesis.rooms import micro_scene_rows
from bench.synthesis.trainings import PRESETS, Training, TrainingRooms
from flows.progress import Progress
from flows.run.fingerprints import ModuleCaches, code_fingerprint
from flows.training.folders import card_of, document_of
from schemas.errors import InputError
from schemas.files import write_whole
from tasks.models import CARD, DOCUMENT, WEIGHTS
from tasks.stage import Blobs, Context
from tasks.training import TrainingConfig
from tasks.training import run as train
from tasks.training.dataset import Provenance, RowsInMemory

MOST_BYTES = 5_000_000
"""Of the weights of a model that ships."""

LICENSE = "CC0-1.0"
"""Of generated rooms, and so of what learned from them alone."""

ROOMS = 3000
"""That a shipped model learned from."""

LIMITS = (
    "It learned from rooms of the project's own generator alone (`tasks/furniture/tops`), whose rules it repeats: no person arranged them.",
    "It knows the categories and kinds of rooms of these rules, and large objects of about their sizes.",
    "What it draws is a proposal: boxes become assets, and the optimization puts them to rest (docs/synthesis.md).",
)


def ship(training: Training, out: Path) -> Path:
    """Train a preset, going on where it was stopped, and write its model to `<out>/<its name>`; the folder.

    Raises:
        InputError: its weights are too large to ship.
    """
    rows = micro_scene_rows(training.rooms.count, training.rooms.seed)
    dataset = RowsInMemory(f"{training.rooms.count} generated rooms of seed {training.rooms.seed}", *(row for part in rows for row in part))
    provenance = Provenance(None, None, training.rooms.mark, code_fingerprint("tasks.training.systems.synthesis"))
    with Progress("steps", training.config.fitting.steps, lines=True) as progress:
        context = Context(
            f"shipped-{training.mark[:16]}", "training", training.seed, Blobs(), caches=ModuleCaches(),
            report=lambda done, of, text: progress.advance(text),
        )  # fmt: skip
        outcome = train(dataset=dataset, start=None, provenance=provenance, context=context, config=TrainingConfig(training.config))
    model = dataclasses.replace(outcome.rows["models"][0], license=LICENSE)
    if model.weights_bytes > MOST_BYTES:
        raise InputError(training.name, "weights", f"have {model.weights_bytes:,} bytes", f"ship a model below {MOST_BYTES:,}")
    document = document_of(model, outcome.rows["model_evaluations"])
    place = out / training.name
    place.mkdir(parents=True, exist_ok=True)
    write_whole(place / WEIGHTS, outcome.blobs[model.weights_blob])
    limits = ["## Limits", "", *(f"- {line}" for line in LIMITS)]
    write_whole(place / CARD, (card_of(document, model.weights_bytes).rstrip() + "\n\n" + "\n".join(limits) + "\n").encode())
    write_whole(place / DOCUMENT, (json.dumps(document, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode())
    return place


def main() -> None:
    """Ship a model, as the module says."""
    parser = argparse.ArgumentParser(prog="python -m bench.synthesis.shipping", description=__doc__)
    parser.add_argument("--model", choices=PRESETS, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=0, help="of the training; the system's own by default")
    options = parser.parse_args()
    print(ship(Training(options.model, 0, TrainingRooms(ROOMS, 0), options.steps), options.out))


if __name__ == "__main__":
    main()
