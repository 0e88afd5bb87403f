"""The model that ships inside the package: exported from the benchmark's lake, with a card that says what was measured.

metascenes bench selection --folder selection --json > selection.json
python -m bench.selection.shipping --folder selection --report selection.json --out tasks/selection/model/shipped
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bench.selection.data import DataSettings, SelectionData
from bench.selection.report import best_plain
from bench.selection.tables import CHOICES, SURFACES
from bench.selection.trainings import MODEL
from flows.training.folders import export_model
from schemas.errors import InputError
from schemas.files import write_whole
from tasks.models import CARD

MOST_BYTES = 5_000_000
"""Of the weights of a model that ships."""

GROUPS = {"methods": "held-out rooms", "held_out_categories": "held-out categories", "house": "AWS small house"}

LIMITS = (
    "It learned from what programs chose by a stated rule (`tasks/annotation/simulation.py`), not from people, in generated rooms alone.",
    "One of ten candidates was nearly always the scanned model or a close variant of it. Where none is, it takes what looks like the "
    "object and passes over pieces of the scan; so by default it chooses among what fits nearly as well as the best (docs/selection.md).",
    "Crops were rendered from the scans' own cameras; photographs of real rooms were never seen.",
)


def ship(folder: Path, report: Mapping[str, Any], out: Path) -> Path:
    """Write the model of the benchmark's first seed to `<out>/<its name>`; the folder.

    Raises:
        InputError: the report has no such model, or its weights are too large to ship.
    """
    row = next((row for row in report["trainings"] if row["name"] == MODEL and row["seed"] == 0), None)
    if row is None:
        raise InputError("report", "trainings", f"has no model {MODEL} of seed 0", "measure it: --variants small")
    if row["bytes"] > MOST_BYTES:
        raise InputError("report", "trainings", f"{row['bytes']:,} bytes are too many to ship", f"train one below {MOST_BYTES:,}")
    place = out / MODEL
    export_model(SelectionData(folder / "data", DataSettings(report["seed"])).lake, row["model_id"], place, force=True)
    plain = (place / CARD).read_text()
    write_whole(place / CARD, (plain.rstrip() + "\n" + "\n".join(measured(report)) + "\n").encode())
    return place


def measured(report: Mapping[str, Any]) -> Iterator[str]:
    """What the benchmark found of the model and of the best method that learns nothing from its rooms, and limits, as Markdown."""
    counts, other = report["counts"], best_plain(report["methods"])
    yield from ("", "## Data", "")
    rooms, instances = counts["rooms"], counts["instances"]
    strange = counts["held_out"]["test"]
    yield (
        f"`metascenes bench selection`, seed {report['seed']}: {instances['train']:,} instances of {rooms['train']} generated rooms to "
        f"learn from, {instances['test']:,} of {rooms['test']} other rooms to measure on, {strange:,} of these of categories that were "
        "never learned from. Ten candidates each, ranked by simulated annotators with noise: the figures above are of their choices, "
        "those below of what their rule says without noise."
    )
    columns = (*CHOICES, *SURFACES)
    yield from ("", f"## Held against `{other}`", "")
    yield "| on | method | instances | " + " | ".join(header for _, header, _, _ in columns) + " |"
    yield "|" + "---|" * (3 + len(columns))
    for group, title in GROUPS.items():
        for name in (other, MODEL):
            if name in report[group]:
                row = report[group][name]
                cells = (_cell(row["figures"].get(key), times, digits) for key, _, times, digits in columns)
                yield f"| {title} | {name} | {row['instances']:,} | " + " | ".join(cells) + " |"
    yield from ("", "## Limits", "")
    yield from (f"- {line}" for line in (*LIMITS, *_naming(report["naming"])))


def _naming(naming: Mapping[str, Any]) -> Iterator[str]:
    """How well the encoder names what a scan shows, by its points alone."""
    if naming:
        rows = [naming["shares"][group] for group in ("ruled", "all")]
        rules, model = ([f"{100 * row[who]['value']:.1f}" for row in rows] for who in ("by_rules", "by_model"))
        yield (
            f"Its encoder names {model[0]} % of the scans of categories that the rules of sizes of capture know, and {model[1]} % of all; "
            f"the rules {rules[0]} and {rules[1]} %. Capture goes by the rules."
        )


def _cell(figure: Mapping[str, Any] | None, times: float, digits: int) -> str:
    return "n/a" if figure is None else f"{times * figure['value']:.{digits}f}"


def main() -> None:
    """Ship the model, as the module says."""
    parser = argparse.ArgumentParser(prog="python -m bench.selection.shipping", description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--report", type=Path, required=True, help="what the benchmark printed with --json")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    print(ship(options.folder, json.loads(options.report.read_bytes()), options.out))


if __name__ == "__main__":
    main()
