"""What many more scenes would take, from what few took: every stage by scene, and commits by what each costs and what its scenes add.

It holds for scenes like those that were measured, and as long as nothing else is met first: docs/scale.md says what is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from bench.flows.requests import KINDS

AROUND = ("plan", "commit", "plan again")
"""Parts of the work that are no stage."""

COMMIT_SCENES = 25
"""Scenes of a commit, as a run makes them at least."""


@dataclasses.dataclass(frozen=True)
class Prices:
    """What a cloud charges [USD]; these are round list prices of an American region, for the reader to change."""

    core_hour: float = 0.04
    thousand_puts: float = 0.005
    thousand_gets: float = 0.0004
    gb_month: float = 0.023


def projection(report: Mapping[str, Any], scenes: int, prices: Prices) -> dict[str, float]:
    """Core hours, bytes, requests of each kind and their price for so many scenes; of a report with two numbers of `requests`.

    Puts and listings have one price, gets and heads the other, deletes none.
    """
    largest = report["scenes"]["sizes"][-1]
    seconds = sum(part["cpu_seconds"] for name, part in largest["stages"].items() if name not in AROUND) / largest["size"]
    core_hours = seconds * scenes / 3600
    held = sum(largest["holds"]["bytes"].values()) / largest["size"] * scenes
    few, many = report["requests"][0], report["requests"][-1]
    asked = {kind: _requests(few, many, kind) * scenes for kind in KINDS}
    return {
        "core_hours": core_hours,
        "bytes": held,
        **asked,
        "core_usd": core_hours * prices.core_hour,
        "requests_usd": ((asked["put"] + asked["list"]) * prices.thousand_puts + (asked["get"] + asked["head"]) * prices.thousand_gets)
        / 1e3,
        "month_usd": held / 1e9 * prices.gb_month,
    }


def _requests(few: Mapping[str, Any], many: Mapping[str, Any], kind: str) -> float:
    """Requests of a kind for a scene: those of its stages, its own of a commit, and its share of what every commit asks."""
    stages = sum(part["requests"][kind] for name, part in many["stages"].items() if name not in AROUND) / many["size"]
    commits = [each["stages"]["commit"]["requests"][kind] for each in (few, many)]
    own = (commits[1] - commits[0]) / (many["size"] - few["size"])
    return float(stages + own + (commits[0] - own * few["size"]) / COMMIT_SCENES)
