"""Rows of the training stage: models, how they were trained, and how good they are."""

from __future__ import annotations

from schemas.families.learned_systems import LEARNED_SYSTEMS
from schemas.record import column, record

TRAINING_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"
HASH = r"[0-9a-f]{64}"
ORIGINS = ("trained", "imported", "shipped")


@record("models", key=("model_id",), stage="training", grain="dataset", rule="append")
class LearnedModel:
    """A model: its weights, what they were learned from, and whether it may be used. Shipped models have no rows."""

    model_id: str = column("Model: hash of its weights and of what they depend on in its config", pattern=HASH)
    training_id: str = column("Training, or import, that it came from", pattern=TRAINING_PATTERN)
    kind: str = column("Learned system that it is a model of", values=LEARNED_SYSTEMS)
    origin: str = column("Where it comes from: trained here, or imported", values=ORIGINS)
    architecture: str = column("Architecture of the network, one of those that the learned system has")
    parameter_count: int = column("Numbers that were learned", minimum=0)
    config: str = column("Config of the learned system as JSON, without what changes no weight")
    weights_blob: str = column("Weights as safetensors", blob=True)
    weights_bytes: int = column("Size of the weights", unit="B", minimum=0)
    dataset: str = column("What it was learned from, as it was called: a snapshot or a release", volatile=True)
    snapshot_id: int | None = column("Snapshot of this lake that it was learned from; null for what was imported", minimum=0, volatile=True)
    release: str | None = column("Release of this lake that it was learned from; null where none was named", volatile=True)
    dataset_fingerprint: str = column("Hash of the runs that wrote the rows that it was learned from", pattern=HASH)
    examples: tuple[str, ...] = column("Examples that it was given, as <split>=<count>")
    seed: int = column("Seed of all that was drawn")
    code_fingerprint: str = column("Hash of the code that trained it", pattern=HASH)
    device: str = column("Device that it was trained on")
    seconds: float = column("Time that training took, over all of its beginnings", unit="s", minimum=0, volatile=True)
    license: str = column("License of what it was learned from, which is that of the model")
    parent_id: str | None = column("Model whose weights training began with; null where it began anew", pattern=HASH)
    is_fallback: bool = column("Whether a part of it stands in for one whose weights were not there")
    is_withdrawn: bool = column("Whether it is not to be used any more")
    notes: tuple[str, ...] = column("What else is to be known of it, a line each")


@record("training_steps", key=("training_id", "step"), stage="training", grain="dataset", rule="append")
class TrainingStep:
    """A point of a training's loss curve: means over the steps since the point before."""

    training_id: str = column("Training", pattern=TRAINING_PATTERN)
    step: int = column("Steps that were taken by then", minimum=1)
    loss: float = column("What is minimized")
    part_names: tuple[str, ...] = column("Parts of the loss")
    part_values: tuple[float, ...] = column("Values of these parts")
    learning_rate: float = column("Step size of the optimizer", minimum=0)
    validation: float | None = column("Measure on examples that are held out of training, higher is better; null where none was taken")
    seconds: float = column("Time since the point before", unit="s", minimum=0, volatile=True)


@record(
    "model_evaluations", key=("training_id", "method", "dataset", "split", "metric"), stage="training", grain="dataset", rule="append"
)  # fmt: skip
class ModelEvaluation:
    """A figure of a model, or of a method that it is held against, on examples of one split."""

    training_id: str = column("Training that measured it", pattern=TRAINING_PATTERN)
    model_id: str | None = column("Model that was measured; null for a method that learns nothing", pattern=HASH)
    method: str = column("Method that was measured: the learned system itself, or what it is held against")
    dataset: str = column("Examples that it was measured on: those of the training, or others by their name")
    split: str = column("Split of these examples")
    metric: str = column("What was measured")
    value: float = column("The figure")
    low: float | None = column("Lower end of its interval of 95 %; null where none was taken")
    high: float | None = column("Upper end of its interval of 95 %; null where none was taken")
    examples: int = column("Examples that it is over", minimum=0)
