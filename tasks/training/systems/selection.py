"""The learned system `selection`: which candidate stands in for a scanned object, learned from what annotators chose."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from tasks.models import folders_in
from tasks.selection.metrics.bootstrap import interval
from tasks.selection.model.batches import BatchConfig, SelectionObjective, predicted
from tasks.selection.model.collection import READS, Collected, collected
from tasks.selection.model.config import OwnImage, OwnText, SelectionModel
from tasks.selection.model.examples import Example, by_room
from tasks.selection.model.figures import hits
from tasks.selection.model.foreign import begin_with_foreign
from tasks.selection.model.frozen import is_frozen, seen_by_frozen, widths_of
from tasks.selection.model.inference import check_fit
from tasks.selection.model.presets import PRESETS
from tasks.selection.model.scoring import begin_with
from tasks.settings import Config, Count, Positive, Share
from tasks.stage import Context
from tasks.training.dataset import Dataset
from tasks.training.fitting import FittingConfig, check_installed, fit, seeded, weights_of
from tasks.training.system import LearnedSystem
from tasks.training.trained import Measure, Trained

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SHIPPED = Path(__file__).parents[2] / "selection" / "model" / "shipped"


@dataclasses.dataclass(frozen=True)
class SelectionFitting(FittingConfig):
    """How long and how fast it is fitted."""

    steps: Count = 2000  # 24,000 looks at objects: below 20 minutes on two cores
    learning_rate: Positive = 2e-3  # the peak; the network is small and trained from scratch
    validate_steps: Count = 200  # looking at all held-out objects takes as long as some steps


@dataclasses.dataclass(frozen=True)
class SelectionTraining(Config):
    """What is trained, and how."""

    kind: ClassVar[str] = "selection"
    model: SelectionModel = dataclasses.field(default_factory=SelectionModel)  # below 2 M parameters; scored without torch
    batch: BatchConfig = dataclasses.field(default_factory=BatchConfig)  # 12 objects a step
    fitting: SelectionFitting = dataclasses.field(default_factory=SelectionFitting)  # as networks of this size want it
    trains: Literal["all", "last"] = "all"  # the release trains head, last block and norm alone, and its projection stays as it was drawn
    foreign: str = ""  # file of weights of Point-BERT, ULIP-2 or Uni3D to begin with; none: from scratch
    half: bool = True  # weights are kept at half precision, and figures are of these
    validation_share: Share = 0.05  # of the training rooms, as the paper's split has none and its release looks at the test rooms
    test_share: Share = 0.2  # of the rooms, where `splits` has no row; as navigation has it


def preset(name: str, fitting: SelectionFitting | None = None) -> SelectionTraining:
    """The settings of a preset, with the default budget or another one.

    Raises:
        KeyError: there is none of that name.
    """
    named, plain = PRESETS[name], SelectionTraining()
    return SelectionTraining(
        named.model, named.batch, fitting or plain.fitting, trains="last" if named.trains == "last" else "all",
        validation_share=plain.validation_share if named.validates else 0.0,
    )  # fmt: skip


def train(*, dataset: Dataset, start: bytes | None, context: Context, config: SelectionTraining) -> Trained:
    """A selection model of the choices of a dataset; no room is on two sides, and figures are of the weights as they are kept.

    Raises:
        InputError: nobody chose anything, weights to begin with do not fit, or torch is not there.
        Diverged: the loss is no finite number any more.
    """
    check_installed()
    data = collected(dataset, context, config.model, config.test_share)
    data, widths = with_frozen(data, context, config.model), widths_of(config.model)
    learning, held = by_room(data.train, config.validation_share)
    notes = notes_of(data, config)
    module = network(config.model, context.seed, widths)
    if config.foreign:
        notes.append(begin_with_foreign(module, config.foreign))
    if start is not None:
        begin_with(module, start)
    freeze(module, config.trains)
    objective = SelectionObjective(learning, held, data.clouds, config.model, config.batch, context.seed)
    fitted = fit(
        module, objective, config.fitting, seed=context.seed, checkpoints=context.caches["tasks.training.fitting"], key=context.scene_id,
        report=context.report,
    )  # fmt: skip
    weights = weights_of(fitted.state_dict, half=config.half)
    begin_with(module, weights)
    module.cpu()
    splits = {"train": learning, "validation": held, "test": data.test}
    measures = [
        figure for split in ("validation", "test") for figure in figures_of(module, splits[split], data.clouds, split, context.seed)
    ]
    return Trained(
        architecture=config.model.architecture.kind,
        weights=weights,
        parameter_count=sum(parameter.numel() for parameter in module.parameters()),
        steps=fitted.steps,
        measures=tuple(measures),
        examples={split: len(rows) for split, rows in splits.items()},
        license=data.license,
        is_fallback=isinstance(config.model.image, OwnImage) or isinstance(config.model.text, OwnText),
        notes=tuple(notes),
        device=fitted.device,
        seconds=fitted.seconds,
    )


def with_frozen(data: Collected, context: Context, model: SelectionModel) -> Collected:
    """Examples with the vectors of frozen encoders, each made once."""
    if not any(map(is_frozen, (model.image, model.text))):
        return data
    memory = context.caches["tasks.selection.model.frozen"]
    train, test = (
        [dataclasses.replace(e, scanned=seen_by_frozen(e.scanned, model, memory)) for e in part] for part in (data.train, data.test)
    )
    return dataclasses.replace(data, train=train, test=test)


def network(model: SelectionModel, seed: int, widths: tuple[int, int] = (0, 0)) -> Any:
    """A network whose first weights follow from the seed. widths: of what frozen encoders of image and text give."""
    from tasks.selection.model.networks.selector import Selector

    with seeded(seed, "selection", "weights"):
        return Selector(model, image_width=widths[0], text_width=widths[1])


def freeze(module: Any, trains: str) -> None:
    """Leave as they are the weights that are not to be trained; `last`: all but the head, the last block and the last norm."""
    if trains == "all":
        return
    depth = getattr(module.config.architecture, "depth", 1)
    names = ("quality.", "point_encoder.norm.", f"point_encoder.blocks.blocks.{depth - 1}.")
    for name, parameter in module.named_parameters():
        parameter.requires_grad_(name.startswith(names))


def figures_of(module: Any, examples: Sequence[Example], clouds: Mapping[str, bytes], split: str, seed: int) -> list[Measure]:
    """Top-1 and top-5, and top-1 where candidates made of the scan do not compete, with intervals over rooms."""
    if not examples:
        return []
    scores = predicted(module, examples, clouds)
    rooms = [example.room_id for example in examples]
    kinds = {
        "top_1": hits(examples, scores, 1),
        "top_5": hits(examples, scores, 5),
        "top_1_without_own": hits(examples, scores, 1, without_own=True),
    }
    made = []
    for metric, values in kinds.items():
        mean = interval(values, rooms, seed)
        if mean.examples:
            made.append(Measure("", split, metric, mean.value, mean.low, mean.high, mean.examples))
    return made


def notes_of(data: Collected, config: SelectionTraining) -> list[str]:
    """What must be known of a model: who answered, what was left out, what stands in."""
    notes = []
    if data.simulated:
        notes.append(f"{data.simulated} of {len(data.train) + len(data.test)} objects were answered for by programs alone")
    notes += [f"{count} objects left out: {reason}" for reason, count in sorted(data.left_out.items())]
    if config.trains == "last" and not config.foreign:
        notes.append("most of the encoder and the projection stayed as they were drawn: nobody named foreign weights")
    for name, encoder in (("image", config.model.image), ("text", config.model.text)):
        if isinstance(encoder, OwnImage | OwnText):
            notes.append(f"{name}: an encoder of ours, trained with the rest, stands in for a foreign one; name weights to have that")
    return notes


def fits(weights: bytes, config: SelectionTraining, file: str) -> None:
    """Hold the weights of a model by others against its config. Raises `InputError` as `check_fit`."""
    check_fit(weights, config.model, file)


def paths(config: SelectionTraining) -> dict[str, str]:
    """Foreign weights that a config names, by field."""
    encoders = {f"model.{name}.weights": getattr(getattr(config.model, name), "weights", "") for name in ("image", "text")}
    return {field: path for field, path in {"foreign": config.foreign, **encoders}.items() if path}


SELECTION = LearnedSystem(
    name="selection",
    config=SelectionTraining,
    reads=READS,
    train=train,
    shipped=lambda: folders_in(SHIPPED),
    fits=fits,
    paths=paths,
)
