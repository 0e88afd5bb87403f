"""Scenes that are made of drawn layouts, through every stage to the exports: what is stable, how far it was moved, what it costs."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.synthesis.trainings import TrainedModel
from flows.inputs.synthesis import DrawingModel, SceneRequest, Synthesized, asked, synthesize
from flows.run.fingerprints import code_fingerprint
from schemas.exports import ExportCheck
from schemas.optimization import Certificate, Placement
from schemas.record import arrow_to_rows
from schemas.runs import StageRun
from schemas.synthesis import Synthesis, SynthesisObject
from tasks.furniture.tops import PAIRS
from tasks.micro_scenes.categories import read_categories
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

ENGINE = "mujoco"
"""Whose verdicts are taken: set as exported scenes are."""

STAGES = ("capture", "optimization", "micro_scenes", "navigation", "exports")
"""Stages whose seconds are told one by one; drawing counts as capture."""


def requests(count: int, known: Sequence[str], seed: int) -> list[tuple[SceneRequest, int]]:
    """What is asked for, and how many of each: so many scenes, as evenly as can be of the pairs of a large object and a kind of room.

    known: Categories of large objects that the model knows.
    """
    merged = read_categories().merged
    pairs = [pair for pair in PAIRS if merged(pair[0]) in known]
    order = np.random.default_rng([seed, 7]).permutation(len(pairs)).tolist()
    counts = Counter(pairs[order[number % len(pairs)]] for number in range(count))
    return [(SceneRequest(large=word, room_type=room_type), of) for (word, room_type), of in sorted(counts.items())]


def drawing_of(model: TrainedModel) -> tuple[DrawingModel, tuple[str, ...]]:
    """A trained model as `synthesize` takes it, and the categories of large objects that it knows."""
    drawer = model.drawer()
    code = code_fingerprint("tasks.synthesis.inference.drawer")
    return DrawingModel(model.weights, drawer.config.kind, "CC0-1.0", code, drawer), drawer.encoding.large


def made_scenes(
    folder: Path, model: DrawingModel, known: Sequence[str], count: int, seed: int, processes: int, advance: Callable[[str], None]
) -> dict[str, Any]:
    """Figures of so many scenes of a model in a lake in the folder; what is there already is not made again.

    known: Categories of large objects that the model knows. `advance` is told each scene made.
    """
    lake, made = Lake.open(folder / f"lake-{model.model_id[:16]}"), []
    for request, of in requests(count, known, seed):
        made.append(synthesize(lake, asked(lake, request), model, count=of, seed=seed, workers=processes))
        for _ in range(of):
            advance(f"{request.large}, {request.room_type}")
    return scene_figures(lake.snapshot(), made)


def scene_figures(reader: Reader, made: Sequence[Synthesized]) -> dict[str, Any]:
    """Figures of scenes that a lake holds; shares are of drawn objects, without the large ones, and of scenes."""
    done = [scene.scene_id for part in made for scene in part.scenes if scene.error is None]
    failed = [f"{scene.scene_id}: {scene.error}" for part in made for scene in part.failed]
    figures = [_of_scene(reader, scene) for scene in done]
    moved = [value for row in figures for value in row["moved_m"]]
    seconds: dict[str, float] = defaultdict(float)
    for row in figures:
        for stage, value in row["seconds"].items():
            seconds[stage] += value / len(figures)
    broken = Counter(rule for row in figures for rule in row["broken"])
    objects = sum(row["objects"] for row in figures)
    return {
        "scenes": len(figures),
        "failed": failed,
        "objects": objects,
        "drawn_stable": _share(sum(row["drawn_stable"] for row in figures), objects),
        "stable_1cm": _share(sum(row["stable_1cm"] for row in figures), objects),
        "stable_5cm": _share(sum(row["stable_5cm"] for row in figures), objects),
        "scenes_stable_1cm": _share(sum(row["stable_1cm"] == row["objects"] for row in figures), len(figures) + len(failed)),
        "moved_median_m": float(np.median(moved)) if moved else math.nan,
        "moved_p95_m": float(np.quantile(moved, 0.95)) if moved else math.nan,
        "passed": _share(sum(not row["broken"] for row in figures), len(figures) + len(failed)),
        "broken": dict(broken.most_common()),
        "seconds": dict(seconds),
        "seconds_per_scene": sum(seconds.values()) if figures else math.nan,
    }


def _share(part: float, whole: int) -> float:
    return part / whole if whole else math.nan


def _of_scene(reader: Reader, scene_id: str) -> dict[str, Any]:
    """Figures of one scene."""
    drawn = {row.instance_id for row in reader.rows(SynthesisObject, scene_id)}
    placed = {row.instance_id: row for row in reader.rows(Placement, scene_id) if row.instance_id in drawn}
    verdicts = [row for row in reader.rows(Certificate, scene_id) if row.instance_id in placed and row.engine == ENGINE]
    checks = reader.rows(ExportCheck, scene_id)
    return {
        "objects": len(drawn),
        "drawn_stable": sum((row.stable_share or 0.0) * row.object_count for row in reader.rows(Synthesis, scene_id)),
        "stable_1cm": sum(row.is_stable_1cm for row in verdicts),
        "stable_5cm": sum(row.is_stable_5cm for row in verdicts),
        "moved_m": [math.hypot(row.displacement_m or 0.0, row.lift_m or 0.0) for row in placed.values()],
        "broken": sorted({f"{row.format}: {row.rule}" for row in checks if not row.passed}) if checks else ["no export was checked"],
        "seconds": _seconds(reader, scene_id),
    }


def _seconds(reader: Reader, scene_id: str) -> Mapping[str, float]:
    """Seconds of the stages that made a scene, the newest run of each."""
    runs = arrow_to_rows(reader.matching("stage_runs", {"scene_id": [scene_id], "outcome": ["done"]}), StageRun)
    return {run.stage: run.seconds for run in sorted(runs, key=lambda run: (run.started_at, run.attempt)) if run.stage in STAGES}
