"""The trainings of the benchmark: which models are made of which rooms, each kept in a folder until its code or data change."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

from bench.synthesis.rooms import LARGE_COUNTS, micro_scene_rows
from flows.run.fingerprints import ModuleCaches, code_fingerprint, digest
from schemas.files import write_whole
from tasks.models import identity_json
from tasks.stage import Blobs, Context
from tasks.synthesis.inference.drawer import Drawer, load
from tasks.synthesis.layout import Layout, layouts_of
from tasks.training.dataset import RowsInMemory
from tasks.training.fitting import forget
from tasks.training.systems.synthesis import SynthesisTraining, collected, held_out, preset, train

PRESETS = ("atiss", "diffuscene", "physcene")
"""Models that are trained, at sizes that one processor trains, by name of preset."""

HELD = 1_000_003
"""Added to the seed of rooms for those that no model learns from: others of the same rules."""


@dataclasses.dataclass(frozen=True)
class TrainingRooms:
    """Generated rooms: so many of a seed."""

    count: int
    seed: int

    @property
    def mark(self) -> str:
        """What the rooms follow from, code and all."""
        own = Path(__file__).with_name("rooms.py").read_text()
        return digest(own, code_fingerprint("tasks.furniture.tops"), str(self.count), str(self.seed))

    def dataset(self) -> RowsInMemory:
        """Their micro-scenes."""
        scenes, objects = micro_scene_rows(self.count, self.seed)
        return RowsInMemory(f"{self.count} rooms of seed {self.seed}", *scenes, *objects)


@dataclasses.dataclass(frozen=True)
class Training:
    """A training of a preset on rooms. steps: 0 for the system's own."""

    name: str
    seed: int
    rooms: TrainingRooms
    steps: int = 0

    @property
    def config(self) -> SynthesisTraining:
        """Its settings."""
        system = preset(self.name)
        if not self.steps:
            return system
        warmup = min(system.fitting.warmup_steps, self.steps // 4)
        validate, record = (max(1, min(every, self.steps // 4)) for every in (system.fitting.validate_steps, system.fitting.record_steps))
        fitting = dataclasses.replace(
            system.fitting, steps=self.steps, warmup_steps=warmup, validate_steps=validate, record_steps=record
        )  # fmt: skip
        return dataclasses.replace(system, fitting=fitting)

    @property
    def mark(self) -> str:
        """What the weights follow from, code and all."""
        code = code_fingerprint("tasks.training.systems.synthesis")
        return digest("bench-synthesis-1", code, self.rooms.mark, self.name, identity_json(self.config), str(self.seed))


@dataclasses.dataclass(frozen=True)
class TrainedModel:
    """What a training came to. weights: SHA-256 of the file in the folder of models, which is called by the training's mark."""

    training: Training
    file: Path
    weights: str
    parameters: int
    seconds: float
    device: str

    def drawer(self) -> Drawer:
        """What draws by its weights."""
        return load(self.file.read_bytes(), self.training.config.model, self.file.name)


def trained(folder: Path, training: Training) -> TrainedModel:
    """The model of a training: as the folder holds it, or trained now; a training that was killed goes on where it was."""
    mark = training.mark
    stem = f"{training.name}-{training.seed}-{mark[:16]}"
    file, facts = folder / f"{stem}.safetensors", folder / f"{stem}.json"
    if not (file.exists() and facts.exists()):
        context = Context(f"bench-{mark[:16]}", "training", training.seed, Blobs(), caches=ModuleCaches())
        made = train(dataset=training.rooms.dataset(), start=None, context=context, config=training.config)
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(file, made.weights)
        known = {"parameters": made.parameter_count, "seconds": made.seconds, "device": made.device, "notes": list(made.notes)}
        write_whole(facts, json.dumps(known).encode())
        forget(context.caches["tasks.training.fitting"], context.scene_id)
    known = json.loads(facts.read_bytes())
    return TrainedModel(
        training, file, hashlib.sha256(file.read_bytes()).hexdigest(), known["parameters"], known["seconds"], known["device"]
    )


@cache
def learned_layouts(rooms: TrainingRooms) -> list[Layout]:
    """The layouts of rooms that are learned from: those of training rooms that nothing is validated on."""
    plain = SynthesisTraining()
    return held_out(collected(rooms.dataset(), plain.test_share).train, plain.validation_share)[0]


@cache
def held_layouts(count: int, rooms: TrainingRooms) -> list[Layout]:
    """So many layouts of other rooms of the same rules; fewer where few rooms leave a category of large objects to be learned from out."""
    known = {layout.large.category for layout in learned_layouts(rooms)}
    neighbors = layouts_of(*micro_scene_rows(count // LARGE_COUNTS[0] + 1, rooms.seed + HELD))
    return [layout for layout in neighbors if layout.large.category in known][:count]


def training_row(model: TrainedModel) -> dict[str, Any]:
    """What a training came to, as plain values."""
    return {"name": model.training.name, "seed": model.training.seed, "parameters": model.parameters, "seconds": model.seconds,
            "device": model.device}  # fmt: skip
