"""The benchmark of asset selection from data to figures: rooms, annotations, training, held-out rooms, goals. Resumes at every step."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.goals import goal
from bench.machine import machine
from bench.selection.annotations import annotate
from bench.selection.data import DataSettings, SelectionData, counts_of, generate
from bench.selection.kept import keep
from bench.selection.measures import MeasuredMethod, TrueSurface, check_committed, measured_room
from bench.selection.naming import naming_report, namings_of
from bench.selection.rooms import made_room, split_of_room
from bench.selection.trainings import ABLATIONS, BLIND, LEARNED, MODEL, mapped, train_all, training_row
from flows.training.models import loaded_model, wanted_model
from schemas.errors import InputError
from schemas.files import write_whole
from schemas.selection import SelectionOutcome
from schemas.training import LearnedModel
from tasks.geometry.meshes import surface_of
from tasks.geometry.transforms import matrix
from tasks.models import Model
from tasks.selection import SelectionConfig
from tasks.selection.methods.color_histogram import ColorHistogram
from tasks.selection.methods.extents import Extents
from tasks.selection.methods.geometric import Geometric
from tasks.selection.methods.image_similarity import ImageSimilarity
from tasks.selection.methods.model import ModelScores, wanted
from tasks.selection.metrics.bootstrap import difference
from tasks.selection.metrics.outcomes import figures_of
from tasks.selection.metrics.rankings import hits
from tasks.stage import WantedModel
from warehouse.lake import Lake

PLAIN = {"geometric": Geometric(), "extents": Extents(), "color_histogram": ColorHistogram(), "image_similarity": ImageSimilarity()}
"""Methods that learn nothing and need nothing from elsewhere."""

ELSEWHERE = ("clip", "acdc", "vision_language")
"""Methods that need weights or an endpoint that the user names."""

TAUGHT = ModelScores.kind
"""A model that is there already, of the lake or the package, by settings of its own."""

DEFAULT = "default"
"""What chooses where nobody says anything."""

BUNDLED = "bundled"
"""The bundled model, among candidates that fit nearly as well as the best."""

HOURS = 8.0
TRAINING_MINUTES = 20.0
EXAMPLES = {"train": 2000, "test": 500}


@dataclasses.dataclass(frozen=True)
class SelectionBench:
    """What is measured. folder: of data, measured rooms and everything else that the same command goes on from. steps: of each training;
    0 for the system's own. variants: presets that are trained, of `MODEL`, `LEARNED`, `ABLATIONS` and `BLIND`. realdata: folder with the
    AWS small house and its models, which is measured, too; None for none. methods: settings of methods of `ELSEWHERE`, and of
    `TAUGHT`."""

    folder: Path
    rooms: int = 130
    seeds: int = 3
    steps: int = 0
    seed: int = 0
    processes: int = 1
    variants: tuple[str, ...] = (MODEL, *LEARNED, *ABLATIONS, BLIND)
    realdata: Path | None = None
    methods: tuple[Any, ...] = ()

    @property
    def trainings(self) -> list[tuple[str, int]]:
        """What is trained: preset and seed."""
        return [(name, seed) for name in self.variants for seed in range(1 if name in (*ABLATIONS, BLIND) else self.seeds)]

    @property
    def tested(self) -> list[int]:
        """Numbers of the rooms that are held out."""
        return [index for index in range(self.rooms) if split_of_room(index) == "test"]

    @property
    def steps_of_progress(self) -> int:
        """How often the benchmark advances."""
        return self.rooms + len(self.trainings) + len(self.tested)


def with_earlier(path: Path, spent: Mapping[str, float]) -> dict[str, float]:
    """Seconds by part of this command and of those before it in the same folder, which are kept there."""
    try:
        earlier = dict(json.loads(path.read_bytes()))
    except (OSError, ValueError):
        earlier = {}
    seconds = {part: float(earlier.get(part, 0.0)) + value for part, value in spent.items()}
    write_whole(path, json.dumps(seconds).encode())
    return seconds


def run_selection_bench(config: SelectionBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report. `advance` is told each room made, each model trained and each room measured.

    Raises:
        InputError: no room is held out, or the folder holds data of other settings, or more rooms.
    """
    if not config.tested:
        raise InputError("bench selection", "--rooms", f"{config.rooms}: none of these rooms is held out", "ask for 10 or more")
    clock = time.perf_counter()
    data = SelectionData(config.folder / "data", DataSettings(config.seed))
    failed = make_data(config, data, advance)
    truths = data.truths()
    if beyond := sum(truth["index"] >= config.rooms for truth in truths):
        problem = f"{config.rooms}: {config.folder / 'data'} has {beyond} more, on which models would be trained, too"
        raise InputError("bench selection", "--rooms", problem, "ask for as many as it has, or name another folder")
    made = time.perf_counter() - clock
    models = train_all(data.lake, config.trainings, config.steps, config.processes, advance)
    fitted = time.perf_counter() - clock - made
    scorers = scorers_of(data.lake, models, config.methods)
    check_committed(data.lake.snapshot(), truths)
    outcomes: list[SelectionOutcome] = []
    with mapped(config.processes) as spread:
        for measured in spread(partial(_measured_room, config, scorers), [row for row in truths if row["split"] == "test"]):
            outcomes += measured
            advance(measured[0].scene_id if measured else "room")
    keep(data.lake, outcomes, config.seed)
    named = naming_of(data.lake, truths, scorers, config.seed)
    foreign, not_measured = _foreign(config, scorers)
    spent = {"data": made, "training": fitted, "measuring": time.perf_counter() - clock - made - fitted}
    seconds = with_earlier(config.folder / "seconds.json", spent)
    if not data.is_of_this_code:
        not_measured.append(f"rooms of this code: those in {data.folder} are of another state of it; another --folder has them made again")
    counts = counts_of(truths)
    figures = {name: table_row(rows, config.seed) for name, rows in by_method(outcomes).items()}
    rare = {name: table_row([r for r in rows if r.is_held_out_category], config.seed) for name, rows in by_method(outcomes).items()}
    return {
        "machine": machine(), "seed": config.seed, "processes": config.processes, "counts": counts, "failed_rooms": failed,
        "methods": figures, "held_out_categories": rare, "naming": named, "house": foreign, "not_measured": not_measured,
        "trainings": [training_row(name, seed, model) for name, seed, model in models],
        "seconds": seconds,
        "margin": margin(outcomes, config.seed),
        "goals": goals(counts, figures, rare, models, seconds),
    }  # fmt: skip


def make_data(config: SelectionBench, data: SelectionData, advance: Callable[[str], None]) -> list[str]:
    """Make what rooms are lacking and answer for them; lines on rooms that failed."""
    failed = []
    for index in range(config.rooms):
        if data.truth_file(index).exists():
            advance(f"room {index}")
    for made in generate(data, range(config.rooms), processes=config.processes):
        if isinstance(made, str):
            failed.append(made)
        advance("room")
    for _ in annotate(data.lake, data.truths(), data.settings.rule, data.settings.seed):
        pass
    return failed


def _measured_room(config: SelectionBench, scorers: Sequence[MeasuredMethod], truth: Mapping[str, Any]) -> list[SelectionOutcome]:
    """Outcomes of a held-out room."""
    lake = SelectionData(config.folder / "data", DataSettings(config.seed)).lake
    surfaces, folder = true_surfaces(truth, config.seed), config.folder / "measured"
    return measured_room(lake, lake.snapshot(), truth, surfaces, scorers, "held-out rooms", folder, config.seed)


def scorers_of(lake: Lake, models: Sequence[tuple[str, int, LearnedModel]], methods: Sequence[Any] = ()) -> list[MeasuredMethod]:
    """Every method that is measured. methods: settings of those that the user named; the default is measured, too."""
    learned = [MeasuredMethod(name, ModelScores(row.model_id, within=1.0), seed, loaded_model(lake, row)) for name, seed, row in models]
    named = [
        MeasuredMethod(name, method, 0, None if (asked := wanted(method)) is None else held_model(lake, asked))
        for name, method in (
            (DEFAULT, SelectionConfig().provider),
            (BUNDLED, ModelScores("small")),
            *((method.kind, method) for method in methods),
        )
    ]
    return [*(MeasuredMethod(name, method) for name, method in PLAIN.items()), *named, *learned]


def held_model(lake: Lake, asked: WantedModel) -> Model:
    """The model that a method's settings mean, of the lake, or the one that ships."""
    return loaded_model(lake, wanted_model(lake.snapshot(), asked))


def naming_of(lake: Lake, truths: Sequence[Mapping[str, Any]], scorers: Sequence[MeasuredMethod], seed: int) -> dict[str, Any]:
    """How the model names scans, with its first seed; nothing where it was not trained."""
    models = [scorer.model for scorer in scorers if scorer.name == MODEL and scorer.model is not None]
    return naming_report(namings_of(lake, truths, models[0], seed), seed) if models else {}


def true_surfaces(truth: Mapping[str, Any], seed: int) -> dict[str, TrueSurface]:
    """The models that a room's instances show, where they stand; rooms are furnished again for that."""
    models = {obj.name: obj for obj in made_room(truth["index"], seed).furnished.objects}
    return {
        instance_id: TrueSurface(surface_of(models[known["model"]].parts), matrix(known["pose"]))
        for instance_id, known in truth["instances"].items()
    }


def by_method(outcomes: Sequence[SelectionOutcome]) -> dict[str, list[SelectionOutcome]]:
    """Outcomes by method, in the order of their first."""
    rows: dict[str, list[SelectionOutcome]] = {}
    for row in outcomes:
        rows.setdefault(row.method, []).append(row)
    return rows


def table_row(rows: Sequence[SelectionOutcome], seed: int) -> dict[str, Any]:
    """Figures of a method as plain values: mean, ends of the interval of 95 % over rooms, and how many instances these are of."""
    return {
        "seeds": len({row.seed for row in rows}),
        "instances": len({(row.scene_id, row.instance_id) for row in rows}),
        "fallbacks": sum(row.is_fallback for row in rows),
        "figures": {name: dataclasses.asdict(figure) for name, figure in figures_of(rows, seed).items()},
    }


def best_plain(figures: Mapping[str, Any]) -> str:
    """The method that learns nothing from these rooms with the best top-1."""
    return max((name for name in figures if name in (*PLAIN, *ELSEWHERE)), key=lambda name: (top(figures, name), name))


def top(figures: Mapping[str, Any], name: str, metric: str = "top_1") -> float:
    """A figure of a method; NaN where there is none."""
    row = figures.get(name, {"figures": {}})["figures"].get(metric)
    return float("nan") if row is None else float(row["value"])


def margin(outcomes: Sequence[SelectionOutcome], seed: int) -> dict[str, Any]:
    """By how much the model's top-1 is above each other method's, of the same instances, over its seeds; intervals over rooms."""
    rows = by_method(outcomes)
    means = {name: _mean_hits(of) for name, of in rows.items()}
    if MODEL not in means:
        return {}
    margins: dict[str, Any] = {}
    for name, other in means.items():
        keys = sorted(set(means[MODEL]) & set(other))
        if name != MODEL and keys:
            own, its = [means[MODEL][key] for key in keys], [other[key] for key in keys]
            margins[name] = dataclasses.asdict(difference(own, its, [key[0] for key in keys], seed))
    return margins


def _mean_hits(rows: Sequence[SelectionOutcome]) -> dict[tuple[str, str], float]:
    """Share of the seeds that hit, by room and instance."""
    values: dict[tuple[str, str], list[float]] = {}
    for row, hit in zip(rows, hits([row.truth_rank for row in rows], 1), strict=True):
        values.setdefault((row.room_id, f"{row.scene_id} {row.instance_id}"), []).append(float(hit))
    return {key: float(np.mean(value)) for key, value in values.items()}


def goals(
    counts: Mapping[str, Any], figures: Mapping[str, Any], rare: Mapping[str, Any], models: Sequence[tuple[str, int, LearnedModel]],
    seconds: Mapping[str, float],
) -> list[dict[str, Any]]:  # fmt: skip
    """What the figures are held against."""
    plain = best_plain(figures)
    own, other = top(figures, MODEL), top(figures, plain)
    wanted = other + min(0.1, 0.5 * (1 - other))
    rivals = [name for name in rare if name not in (MODEL, TAUGHT, DEFAULT, BUNDLED, *ABLATIONS, BLIND)]
    rest = max((top(rare, name) for name in rivals if np.isfinite(top(rare, name))), default=float("nan"))
    longest = max((model.seconds for name, _, model in models if name == MODEL), default=float("nan"))
    return [
        *(goal(f"instances, {split}", counts["instances"][split], ">=", least) for split, least in EXAMPLES.items()),
        goal(f"top-1 of {MODEL} [%]; {plain} has {100 * other:.1f}", _percent(own), ">=", 100 * wanted),
        goal(f"top-1 of the {DEFAULT} method above that of {plain} [%]", _percent(top(figures, DEFAULT) - other), ">=", 0),
        goal(f"top-5 of {MODEL} [%]", _percent(top(figures, MODEL, "top_5")), ">=", 95),
        goal(f"top-1 of {MODEL} on held-out categories, above the best of others [%]", _percent(top(rare, MODEL) - rest), ">=", 0),
        goal(f"top-1 of {BLIND}, which does not see the scan [%]", _percent(top(figures, BLIND)), "<=", 25),
        goal(f"longest training of {MODEL} [min]", None if np.isnan(longest) else longest / 60, "<=", TRAINING_MINUTES),
        goal("hours, of the commands in this folder together", sum(seconds.values()) / 3600, "<=", HOURS),
    ]


def _percent(share: float) -> float | None:
    return None if np.isnan(share) else 100 * share


def _foreign(config: SelectionBench, scorers: Sequence[MeasuredMethod]) -> tuple[dict[str, Any], list[str]]:
    """Figures of the AWS house, and what was not measured, a line each."""
    from bench.selection.foreign import house_outcomes, lacking

    measured = {method.kind for method in config.methods}
    lines = [f"{name}: needs weights or an endpoint that the user names (--method)" for name in ELSEWHERE if name not in measured]
    lack = lacking(config.realdata)
    if lack is not None or config.realdata is None:
        return {}, [*lines, f"the AWS small house: {lack}"]
    outcomes = house_outcomes(config.realdata, config.folder, scorers, config.seed)
    return {name: table_row(rows, config.seed) for name, rows in by_method(outcomes).items()}, lines
