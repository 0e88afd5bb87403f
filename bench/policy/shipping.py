"""The policy that ships inside the package: exported from the benchmark's lake, with a card that says what was measured.

metascenes bench policy --parts loop --folder policy --json > policy.json
python -m bench.policy.shipping --report policy.json --out tasks/policy/model/shipped
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bench.policy.report import agent_of
from flows.training.folders import export_model
from flows.training.models import found_model
from schemas.errors import InputError
from schemas.files import write_whole
from tasks.models import CARD
from tasks.policy.model.config import config_from
from warehouse.lake import Lake

NAME = "objectnav"
"""Of the model that ships."""

MOST_BYTES = 5_000_000
"""Of the weights of a model that ships."""

FIGURES = {
    "found": "found [%]", "found_in_view": "in view at the start [%]", "success": "within 1 m [%]", "arrived": "within 0.1 m [%]",
    "found_spl": "SPL [%]", "sel": "SEL [%]",
}  # fmt: skip
"""Shares that the card has, by their names in the report."""

LIMITS = (
    "It learned in rooms of the project's own generator alone, rendered without light: no photograph of a real room was ever seen.",
    "It knows the categories of these rooms as goals; all others are one to it.",
    "It saw through one camera, 0.88 m above the floor, level, 79 degrees wide, on a robot of 0.18 m radius, in rooms where nothing moves.",
)


SENSES = (
    "It is told how far away each pixel is and which ones show its goal; outside of the simulator that takes a depth camera and a detector."
)
"""A limit of all but those that see colors alone."""


def ship(report: Mapping[str, Any], out: Path) -> Path:
    """Write the benchmark's agent of the first seed to `<out>/objectnav`; the folder.

    Raises:
        InputError: the report has no such model, the lake with it is gone, or its weights are too large to ship.
    """
    loop = report["parts"].get("loop", {"figures": {}, "trainings": []})
    agent = agent_of(loop["figures"])
    row = next((row for row in loop["trainings"] if (row["name"], row["seed"]) == (agent, 0)), None)
    if row is None:
        raise InputError("report", "trainings", "has no agent of seed 0", "measure one: --parts loop --variants dagger")
    lake = Lake.open(loop["lake"])
    if not lake.exists:
        raise InputError("report", "lake", f"{loop['lake']} is gone", "measure again: metascenes bench policy --parts loop --json")
    model, _ = found_model(lake.snapshot(), row["model_id"])
    if model.weights_bytes > MOST_BYTES:
        raise InputError("report", "trainings", f"{model.weights_bytes:,} bytes are too many to ship", f"train one below {MOST_BYTES:,}")
    place = out / NAME
    export_model(lake, model.model_id, place, force=True)
    plain = (place / CARD).read_text()
    config = config_from(model.config)
    lines = measured(report["seed"], loop, row["name"], config.senses_depth or config.senses_goal)
    write_whole(place / CARD, (plain.rstrip() + "\n" + "\n".join(lines) + "\n").encode())
    return place


def measured(seed: int, loop: Mapping[str, Any], agent: str, senses: bool) -> Iterator[str]:
    """What the benchmark found of the agent and of whom it is held against, and limits, as Markdown. senses: Whether it senses more than
    colors."""
    rooms, episodes = loop["rooms"], loop["episodes"]
    yield from ("", "## Data", "")
    yield (
        f"`metascenes bench policy`, seed {seed}: {episodes['train']:,} episodes of {rooms['train']} generated rooms to learn from, "
        f"{episodes['test']:,} of {rooms['test']} other rooms to act in."
    )
    yield from ("", "## In rooms that nobody learned from", "")
    yield "Found: stopped by itself within 1 m of a view point with the target in view; in brackets Wilson's interval, 95 %."
    yield ""
    yield "| who | seeds | episodes | " + " | ".join(FIGURES.values()) + " |"
    yield "|---|" + "---:|" * (2 + len(FIGURES))
    for name, row in loop["figures"].items():
        cells = []
        for key in FIGURES:
            interval = row.get(f"{key}_interval")
            around = "" if interval is None else f" ({100 * interval['low']:.1f}-{100 * interval['high']:.1f})"
            cells.append("n/a" if row[key] is None else f"{100 * row[key]:.1f}{around}")
        title = f"**{name}**, this one is of seed 0" if name == agent else name
        yield f"| {title} | {row['seeds']} | {row['n']:,} | " + " | ".join(cells) + " |"
    yield from ("", "## Limits", "")
    yield from (f"- {line}" for line in ((SENSES, *LIMITS) if senses else LIMITS))


def main() -> None:
    """Ship the policy, as the module says."""
    parser = argparse.ArgumentParser(prog="python -m bench.policy.shipping", description=__doc__)
    parser.add_argument("--report", type=Path, required=True, help="what the benchmark printed with --json")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    print(ship(json.loads(options.report.read_bytes()), options.out))


if __name__ == "__main__":
    main()
