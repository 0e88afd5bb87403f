"""The benchmark of models of others and of what stands in for them: replies, small objects, textures, retrieval, devices; held against
goals."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.goals import goal
from bench.machine import machine
from bench.models.devices import device_report
from bench.models.devices import lacking as networks_lacking
from bench.models.lifting import LiftingFigures
from bench.models.lifting import measured as lifted
from bench.models.replies import reply_report
from bench.models.retrieval import MODELS, RetrievalFigures, RetrievalShares, lacking
from bench.models.retrieval import measured as retrieved
from bench.models.texturing import TexturingBench, run_texturing_bench, steps_of
from bench.models.trained.checkpoints import checkpoints
from bench.models.trained.comparison import trained_report
from bench.models.withheld import WithheldFigures, withheld_figures
from schemas.errors import InputError

REPLIES, LIFTING, WITHHELD, TEXTURES, RETRIEVAL, DEVICES = "replies", "lifting", "withheld", "textures", "retrieval", "devices"
TRAINED = "trained"

USUAL = (REPLIES, LIFTING, WITHHELD, TEXTURES, RETRIEVAL, DEVICES)
"""What is measured where nobody says: what is read of corrupted replies, small objects on desks and shelves, and those of whole rooms that
are not named, layouts and baked textures, scanned models looked up in a library, and networks that see on the devices that there are."""

PARTS = (*USUAL, TRAINED)
"""What can be measured: also a small network that parts small objects, which is trained first."""

CORRUPTIONS = 200
"""Of a reply, for each of what is asked."""

APART, TOUCHING, CORRUPTED, STANDINS = 0.95, 0.75, 0.9, 0.9
"""Precision and recall that are wanted of the classical member where things stand apart and where they touch, of consensus lifting of
masks of which a tenth were split or merged, and of the learned member's chain where networks stand in that blur the truth."""

BACK, ROOM_SHARE = 0.7, 0.3
"""Share of what is not named in rooms that is wanted back, and rooms for each desk."""

WANTED = RetrievalShares(0.8, 0.95, 0.7, 0.9, 0.7, 0.0)
"""Shares of queries that are wanted."""

QUERY_SECONDS = 0.05
"""In which a query is answered, of 10,000 models."""


@dataclasses.dataclass(frozen=True)
class ModelsBench:
    """What is measured. scenes: Desks and shelves of each kind. realdata: Folder with the real models; None for none. blender: See
    `TexturingBench`. parts: Of `PARTS`."""

    scenes: int = 20
    seed: int = 0
    realdata: Path | None = None
    blender: str = ""
    parts: tuple[str, ...] = USUAL

    @property
    def texturing(self) -> TexturingBench:
        """What is measured of textures."""
        library = None if self.realdata is None else str(self.realdata / MODELS)
        return TexturingBench(library=library, blender=self.blender, seed=self.seed)

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        return sum(steps_of(self.texturing) if part == TEXTURES else 1 for part in self.parts)


def run_models_bench(config: ModelsBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report. `advance` is told each part of it that is done.

    Raises:
        InputError: the real models are not where they should be, or packages of networks are not installed.
    """
    why = lacking(config.realdata) if RETRIEVAL in config.parts else None
    if why is not None:
        raise InputError("bench models", "--realdata", why, "or leave `retrieval` out of --parts")
    for part in (DEVICES, TRAINED):
        if part in config.parts and (why := networks_lacking()) is not None:
            raise InputError("bench models", part, why, f"pip install 'metascenes[encoders]', or leave `{part}` out of --parts")
    parts: dict[str, Any] = {}
    if REPLIES in config.parts:
        parts[REPLIES] = reply_report(CORRUPTIONS, config.seed)
        advance(REPLIES)
    if LIFTING in config.parts:
        figures = lifted(scenes=config.scenes, first_seed=config.seed)
        parts[LIFTING] = {"rows": [lifting_row(each) for each in figures], "goals": lifting_goals(figures)}
        advance(LIFTING)
    if WITHHELD in config.parts:
        rooms = withheld_figures(rooms_of(config.scenes), config.seed)
        parts[WITHHELD] = {"rows": [dataclasses.asdict(rooms)], "goals": withheld_goals(rooms)}
        advance(WITHHELD)
    if TEXTURES in config.parts:
        parts[TEXTURES] = run_texturing_bench(config.texturing, lambda: advance(TEXTURES))
    if RETRIEVAL in config.parts and config.realdata is not None:
        looked_up = retrieved(config.realdata)
        parts[RETRIEVAL] = {"rows": retrieval_rows(looked_up), "goals": retrieval_goals(looked_up)}
        advance(RETRIEVAL)
    if DEVICES in config.parts:
        parts[DEVICES] = device_report()
        advance(DEVICES)
    if TRAINED in config.parts:
        parts[TRAINED] = trained_report(config.scenes, rooms_of(config.scenes), config.seed, config.realdata, checkpoints())
        advance(TRAINED)
    return {"machine": machine(), "seed": config.seed, "parts": parts, "goals": [row for part in parts.values() for row in part["goals"]]}


def rooms_of(scenes: int) -> int:
    """Rooms that are scanned beside so many desks and shelves of each kind."""
    return max(1, round(ROOM_SHARE * scenes))


def lifting_row(figures: LiftingFigures) -> dict[str, Any]:
    """Figures as plain values."""
    return {**dataclasses.asdict(figures), "precision": figures.precision, "recall": figures.recall}


def lifting_goals(figures: Sequence[LiftingFigures]) -> list[dict[str, Any]]:
    """Precision and recall over desks and shelves together."""
    goals = []
    wanted = {
        ("classical", False): APART, ("classical", True): TOUCHING, ("corrupted masks", None): CORRUPTED, ("true masks", None): 1.0,
        ("stand-ins", None): STANDINS,
    }  # fmt: skip
    for (method, touching), least in wanted.items():
        rows = [row for row in figures if row.method == method and touching in (None, row.touching)]
        matched, instances, objects = (sum(getattr(row, name) for row in rows) for name in ("matched", "instances", "objects"))
        stand = {False: ", apart", True: ", touching", None: ""}[touching]
        goals.append(goal(f"{method}{stand}: precision", round(matched / max(instances, 1), 4), ">=", least))
        goals.append(goal(f"{method}{stand}: recall", round(matched / max(objects, 1), 4), ">=", least))
    return goals


def withheld_goals(figures: WithheldFigures) -> list[dict[str, Any]]:
    """What comes back, and that nothing is there twice."""
    return [
        goal("rooms without names of small objects: share that is found", round(figures.back / max(figures.withheld, 1), 4), ">=", BACK),
        goal("rooms with all names: found again", figures.doubled, "<=", 0),
    ]


def retrieval_rows(figures: RetrievalFigures) -> list[dict[str, Any]]:
    """Shares and times, as plain values."""
    slow = {"median_seconds": float(np.median(figures.seconds)), "p95_seconds": float(np.quantile(figures.seconds, 0.95))}
    common = {"queries": figures.queries, "models": figures.entries}
    return [{**common, **dataclasses.asdict(figures.shares), **slow}]


def retrieval_goals(figures: RetrievalFigures) -> list[dict[str, Any]]:
    """What retrieval is held against."""
    names = {
        "first": "right model first", "in_ten": "among the ten first", "first_unnamed": "first, category unknown",
        "in_ten_unnamed": "among ten, category unknown", "category_withheld": "model withheld: right category first",
    }  # fmt: skip
    goals = [goal(text, round(getattr(figures.shares, name), 4), ">=", getattr(WANTED, name)) for name, text in names.items()]
    slowest = float(np.quantile(figures.seconds, 0.95))
    return [*goals, goal("seconds of a query among 10,000 models, of 20 the slowest", round(slowest, 4), "<", QUERY_SECONDS)]
