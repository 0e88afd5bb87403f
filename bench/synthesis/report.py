"""The benchmark of learned synthesis from rooms to figures: rooms, trainings, draws, goals. Resumes at every step."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.goals import goal
from bench.machine import machine
from bench.selection.trainings import mapped
from bench.synthesis.draws import PART, drawn_part
from bench.synthesis.house import house_figures, house_layouts, lacking
from bench.synthesis.measures import (
    DRAWN,
    INDEPENDENT,
    NEAREST,
    SHUFFLED,
    TABLE,
    TRUTH,
    UNGUIDED,
    Measurement,
    measured,
    parts,
    table_in,
)
from bench.synthesis.rooms import ROOM_TYPES
from bench.synthesis.trainings import PRESETS, TrainedModel, Training, TrainingRooms, held_layouts, learned_layouts, trained, training_row
from tasks.synthesis.inference.drawer import Drawer
from tasks.synthesis.layout import Layout

MODEL = "physcene"
"""The model that goals of collisions, of support, of likeness and of kinds of rooms are of; another one where it is not trained."""

MINUTES = 15.0
"""The most that a training may take."""

PARTS = ("layouts", "scenes")
"""What can be measured: layouts as they are drawn, and scenes made of them, through every stage."""

PICTURED = 6
"""Layouts side by side in a picture."""


@dataclasses.dataclass(frozen=True)
class SynthesisBench:
    """What is measured. folder: of models, figures and pictures, from which the same command goes on. rooms: that are generated; a fifth of
    them is held out by the training. seeds: trainings of each model. steps: of each training; 0 for the system's own. models: presets
    that are trained, of `PRESETS`. scenes: held-out layouts that figures are of. per_room: layouts of one table in each kind of room.
    realdata: folder with the AWS small house, which is measured, too; None for none. inception: TorchScript file of a feature network;
    None for an own one, whose figures are not comparable. parts: of `PARTS`. made: scenes that are made of drawn layouts."""

    folder: Path
    rooms: int = 3000
    seeds: int = 3
    steps: int = 0
    models: tuple[str, ...] = PRESETS
    scenes: int = 1000
    per_room: int = 1000
    seed: int = 0
    processes: int = 1
    realdata: Path | None = None
    inception: Path | None = None
    parts: tuple[str, ...] = PARTS
    made: int = 100

    @property
    def data(self) -> TrainingRooms:
        """Rooms that are learned from."""
        return TrainingRooms(self.rooms, self.seed)

    @property
    def trainings(self) -> list[Training]:
        """What is trained; of scenes alone, one model."""
        trainings = [Training(name, seed, self.data, self.steps) for name in self.models for seed in range(self.seeds)]
        return trainings if "layouts" in self.parts else sorted(trainings, key=lambda item: item.name != MODEL)[:1]

    @property
    def plain(self) -> list[Measurement]:
        """What is measured without a model."""
        return [self.measurement(name, 0, None) for name in (TRUTH, SHUFFLED, INDEPENDENT, NEAREST) if "layouts" in self.parts]

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        drawn = [name for training in self.trainings for name in _names(training.name)] if "layouts" in self.parts else []
        of_rooms = sum(name != UNGUIDED for name in drawn) * math.ceil(len(ROOM_TYPES) * self.per_room / PART)
        made = self.made if "scenes" in self.parts and self.trainings else 0
        return len(self.trainings) + len(drawn) * (1 + math.ceil(self.scenes / PART)) + of_rooms + len(self.plain) + made

    def measurement(self, name: str, seed: int, model: TrainedModel | None) -> Measurement:
        """A measurement with these settings."""
        return Measurement(name, seed, model, self.data, self.scenes, self.per_room, self.inception)

    def of_models(self, models: Sequence[TrainedModel]) -> list[Measurement]:
        """What is measured of models; PhyScene with and without guidance."""
        chosen = models if "layouts" in self.parts else ()
        return [self.measurement(name, model.training.seed, model) for model in chosen for name in _names(model.training.name)]


def _names(preset: str) -> tuple[str, ...]:
    """What the figures of a preset are called."""
    return (MODEL, UNGUIDED) if preset == MODEL else (preset,)


def run_synthesis_bench(config: SynthesisBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report. `advance` is told each model trained, and whoever was measured.

    Raises:
        InputError: a training fails, or the network of features cannot be read.
    """
    with mapped(config.processes) as spread:
        models = []
        for model in spread(partial(trained, config.folder / "models"), config.trainings):
            models.append(model)
            advance(f"{model.training.name} {model.training.seed}")
        rows: dict[str, list[dict[str, Any]]] = {}
        measurements = [*config.of_models(models), *config.plain]
        drawn = [part for measurement in measurements for part in parts(config.folder, measurement)]
        for part in spread(partial(drawn_part, config.folder / DRAWN), drawn):
            advance(f"{part.model.training.name} {part.model.training.seed}, drawn from {part.first}")
        for row in spread(partial(measured, config.folder), measurements):
            rows.setdefault(row["name"], []).append(row)
            advance(row["name"])
    scenes = _scenes(config, models, advance)
    house, absent = _house(config, models)
    pictures = drawn_pictures(config, models)
    trainings = [training_row(model) for model in models]
    return {
        "machine": machine(), "seed": config.seed, "processes": config.processes, "rooms": config.rooms, "scenes": config.scenes,
        "per_room": config.per_room, "learned": len(learned_layouts(config.data)),
        "held_out": len(held_layouts(config.scenes, config.data)), "figures": {name: summed(of) for name, of in rows.items()},
        "measured": rows, "trainings": trainings, "scenes_made": scenes, "house": house, "not_measured": absent,
        "pictures": pictures, "goals": [*goals({name: summed(of) for name, of in rows.items()}, trainings), *scene_goals(scenes)],
    }  # fmt: skip


def flattened(row: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """All numbers of a row of figures, by the path to them: `nearest.ratio`."""
    numbers: dict[str, float] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            numbers |= flattened(value, f"{prefix}{key}.")
        elif isinstance(value, int | float) and key != "seed":
            numbers[f"{prefix}{key}"] = float(value)
    return numbers


def summed(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean and range over the seeds of every number, by the path to it."""
    flat = [flattened(row) for row in rows]
    figures = {}
    for key in flat[0]:
        values = np.array([row[key] for row in flat])
        figures[key] = {"mean": float(values.mean()), "low": float(values.min()), "high": float(values.max())}
    return {"seeds": len(rows), **figures}


def worst_room(figures: Mapping[str, Any]) -> float:
    """Mean over the seeds of the total variation from what is stated, in the kind of room where it is largest."""
    return max(figures[f"rooms.{room_type}.own"]["mean"] for room_type in ROOM_TYPES)


def goals(figures: Mapping[str, Any], trainings: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What the figures, means over seeds, are held against."""
    drawn = [name for name in figures if name in (*PRESETS, UNGUIDED)]
    chosen = MODEL if MODEL in figures else drawn[0] if drawn else ""
    made = [goal(f"CKL of {name}", figures[name]["ckl"]["mean"], "<", 0.05) for name in drawn if name != UNGUIDED]
    if MODEL in figures:
        made += [
            goal(f"objects of {MODEL}, guided, that collide [%]", _percent(figures, MODEL, "collides"), "<", 1.0),
            goal(f"objects of {MODEL}, guided, off their support [%]", _percent(figures, MODEL, "off_support"), "<", 1.0),
        ]
    if chosen:
        own = figures[chosen]
        made += [
            goal(f"{chosen} told from the truth by a classifier (SCA) [%]", _percent(figures, chosen, "sca.value"), "<", 60.0),
            goal(f"total variation of {chosen} in the kind of room where it is largest", worst_room(own), "<", 0.1),
            goal(f"distance of {chosen} to what it learned from, over the truth's", _found(own, "nearest.ratio"), ">=", 0.8),
        ]
    if SHUFFLED in figures:
        made.append(goal("shuffled layouts told from the truth (SCA) [%]", _percent(figures, SHUFFLED, "sca.value"), ">=", 90.0))
    longest = max((row["seconds"] for row in trainings), default=math.nan)
    made.append(goal("longest training [min]", None if math.isnan(longest) else longest / 60.0, "<=", MINUTES))
    return made


def scene_goals(scenes: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What figures of made scenes are held against."""
    if not scenes:
        return []
    matches = {key: None if math.isnan(scenes[key]) else scenes[key] for key in ("scenes_stable_1cm", "moved_median_m", "passed")}
    stable, moved, passed = matches["scenes_stable_1cm"], matches["moved_median_m"], matches["passed"]
    return [
        goal("made scenes whose drawn objects are all stable at 1 cm [%]", None if stable is None else 100 * stable, ">=", 99.0),
        goal("median move of drawn objects by the optimization [mm]", None if moved is None else 1000 * moved, "<", 10.0),
        goal("made scenes whose exports pass all gates [%]", None if passed is None else 100 * passed, ">=", 100.0),
    ]


def _found(figures: Mapping[str, Any], key: str) -> float | None:
    value = float(figures[key]["mean"])
    return None if math.isnan(value) else value


def _percent(figures: Mapping[str, Any], name: str, key: str) -> float | None:
    value = _found(figures[name], key)
    return None if value is None else 100.0 * value


def chosen_model(models: Sequence[TrainedModel]) -> TrainedModel | None:
    """What draws for scenes, the house and pictures: the first of `MODEL`, else of another one."""
    named = [model for model in models if model.training.name == MODEL] or list(models)
    return named[0] if named else None


def chosen_drawer(models: Sequence[TrainedModel]) -> Drawer | None:
    """The drawer of `chosen_model`."""
    model = chosen_model(models)
    return None if model is None else model.drawer()


def _scenes(config: SynthesisBench, models: Sequence[TrainedModel], advance: Callable[[str], None]) -> dict[str, Any]:
    """Figures of scenes made of drawn layouts; none without a model."""
    from bench.synthesis.scenes import drawing_of, made_scenes

    model = chosen_model(models)
    if model is None or "scenes" not in config.parts:
        return {}
    return made_scenes(config.folder, *drawing_of(model), config.made, config.seed, config.processes, advance)


def _house(config: SynthesisBench, models: Sequence[TrainedModel]) -> tuple[dict[str, Any], list[str]]:
    """Figures of the AWS house, and what was not measured, a line each."""
    lack = lacking(config.realdata) if "layouts" in config.parts else "the part `layouts` was not asked for"
    if lack is not None or config.realdata is None:
        return {}, [f"the AWS small house: {lack}"]
    drawer = chosen_drawer(models)
    known = drawer.encoding.large if drawer is not None else ()
    return house_figures(house_layouts(config.realdata), learned_layouts(config.data), drawer, known), []


def drawn_pictures(config: SynthesisBench, models: Sequence[TrainedModel]) -> list[str]:
    """Pictures of what the model draws, as files of the folder, by name: one table in each kind of room, and large objects of each kind
    beside what is true of them; none without a model."""
    from tasks.synthesis.pictures import figure_of

    drawer = chosen_drawer(models)
    if drawer is None or "layouts" not in config.parts:
        return []
    place = config.folder / "pictures"
    place.mkdir(parents=True, exist_ok=True)
    rooms = [(room_type, drawer.draw([table_in(room_type)] * PICTURED, config.seed)) for room_type in ROOM_TYPES]
    truth: dict[str, list[Layout]] = {}
    for layout in held_layouts(config.scenes, config.data):
        truth.setdefault(layout.large.category, []).append(layout)
    compared = []
    for category, layouts in sorted(truth.items()):
        some = layouts[:PICTURED]
        compared += [
            (f"{category.replace('_', ' ')}: true", some), ("drawn", drawer.draw([layout.large for layout in some], config.seed)),
        ]  # fmt: skip
    names = []
    for name, rows, title in (
        ("rooms.png", rooms, f"one {TABLE}, six layouts in each kind of room"),
        ("larges.png", compared, "held-out layouts, and drawn ones on the same large objects"),
    ):
        figure_of(rows, title).savefig(place / name, dpi=110)
        names.append(str(place / name))
    return names
