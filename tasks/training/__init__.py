"""Training: a learned system reads a snapshot or release of the lake and leaves a model.

What is learned, and how, is the learned system's (`tasks.training.systems`). What is here makes rows of it and computes nothing.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from schemas.training import LearnedModel, ModelEvaluation, TrainingStep
from tasks.families import member
from tasks.models import Model, identity_json, model_id_of
from tasks.settings import Config, Texts, union_of
from tasks.stage import Blobs, Context, Outcome, Stage
from tasks.training.dataset import Dataset, Provenance
from tasks.training.learned_systems import SYSTEMS
from tasks.training.trained import Measure, Trained
from tasks.weights import from_safetensors

__all__ = ["STAGE", "SYSTEMS", "TrainingConfig", "run"]

if TYPE_CHECKING:
    AnySystem = Any
else:
    AnySystem = union_of(system.config for system in SYSTEMS)

NOT_COMPARED = "test rooms were not compared with the rooms of the model that training began with, which it may know:"
"""Said of models that begin with another: splits may have been others then."""


@dataclasses.dataclass(frozen=True)
class TrainingConfig(Config):
    """What is trained, and how."""

    system: AnySystem = dataclasses.field(default_factory=SYSTEMS[0].config)  # the first learned system; `metascenes train` names one
    datasets: Texts = ()  # of the lake, by the first part of their scenes' names; none: all of them


def run(*, dataset: Dataset, start: Model | None, provenance: Provenance, context: Context, config: TrainingConfig) -> Outcome:
    """A model of the learned system that the config names, its curve and its figures. `context.scene_id` is the training.

    `start` is the model whose weights training begins with; None where it begins anew.

    Raises:
        InputError: the dataset has nothing to learn from, or what training needs is not installed.
        Diverged: it led nowhere.
    """
    system = member(SYSTEMS, config.system.kind)
    trained = system.train(dataset=dataset, start=start.weights if start else None, context=context, config=config.system)
    from_safetensors(trained.weights, f"{system.name}: weights")
    blobs = Blobs()
    config_json = identity_json(config.system)
    model = LearnedModel(
        model_id=model_id_of(trained.weights, config_json),
        training_id=context.scene_id,
        kind=system.name,
        origin="trained",
        architecture=trained.architecture,
        parameter_count=trained.parameter_count,
        config=config_json,
        weights_blob=blobs.add(trained.weights, "weights"),
        weights_bytes=len(trained.weights),
        dataset=dataset.name,
        snapshot_id=provenance.snapshot_id,
        release=provenance.release,
        dataset_fingerprint=provenance.fingerprint,
        examples=tuple(f"{split}={count}" for split, count in sorted(trained.examples.items())),
        seed=context.seed,
        code_fingerprint=provenance.code,
        device=trained.device,
        seconds=trained.seconds,
        license=trained.license,
        parent_id=start.model_id if start else None,
        is_fallback=trained.is_fallback,
        is_withdrawn=False,
        notes=trained.notes if start is None else (*trained.notes, f"{NOT_COMPARED} {start.model_id[:12]}"),
    )
    notes = [f"{system.name}: {note}" for note in trained.notes] if trained.is_fallback else []
    return Outcome(
        models=[model],
        training_steps=_curve(trained, context.scene_id),
        model_evaluations=evaluations_of(trained.measures, model),
        selection_outcomes=[dataclasses.replace(row, training_id=context.scene_id) for row in trained.outcomes],
        blobs=blobs,
        degradations=notes,
    )


def _curve(trained: Trained, training_id: str) -> list[TrainingStep]:
    return [
        TrainingStep(
            training_id=training_id, step=point.step, loss=point.loss, part_names=tuple(point.parts),
            part_values=tuple(point.parts.values()), learning_rate=point.learning_rate, validation=point.validation, seconds=point.seconds,
        )
        for point in trained.steps
    ]  # fmt: skip


def evaluations_of(measures: tuple[Measure, ...], model: LearnedModel) -> list[ModelEvaluation]:
    """Rows of figures that came with a model; those of a method beside it name no model."""
    return [
        ModelEvaluation(
            training_id=model.training_id, model_id=None if figure.method else model.model_id, method=figure.method or model.kind,
            dataset=figure.dataset or "training", split=figure.split, metric=figure.metric, value=figure.value, low=figure.low,
            high=figure.high, examples=figure.examples,
        )
        for figure in measures
    ]  # fmt: skip


STAGE = Stage(
    name="training",
    reads=(),
    writes=("models", "training_steps", "model_evaluations", "selection_outcomes"),
    config=TrainingConfig,
    run=run,
    grain="dataset",
    outside=("dataset", "start", "provenance"),
    streams=tuple(dict.fromkeys(table for system in SYSTEMS for table in system.reads)),
)
