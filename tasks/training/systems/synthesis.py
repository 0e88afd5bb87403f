"""The learned system `synthesis`: what stands on a table, learned from micro-scenes (supplementary B.2)."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from schemas.capture import SYNTHESIS as DRAWN_FORMAT
from schemas.capture import Scene
from schemas.errors import InputError
from schemas.lineage.licenses import stated
from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.navigation import Split
from tasks.models import folders_in
from tasks.navigation import split_of
from tasks.settings import Config, Count, Natural, NonNegative, Positive, Share
from tasks.stage import Context
from tasks.synthesis.inference.drawer import check_sizes
from tasks.synthesis.layout import Layout, layouts_of
from tasks.synthesis.model.config import Atiss, ClipText, DiffuScene, Diffusion, LearnedText, SynthesisModel, Transformer
from tasks.synthesis.model.encoding import Encoding, encoding_in, encoding_of
from tasks.synthesis.model.foreign import begin_with_foreign
from tasks.synthesis.model.objective import SynthesisObjective, examples_of
from tasks.synthesis.model.presets import PRESETS
from tasks.synthesis.model.shapes import check_fit
from tasks.synthesis.model.text import begin_with_clip
from tasks.training.dataset import Dataset
from tasks.training.fitting import Decay, FittingConfig, check_installed, fit, seeded, weights_of
from tasks.training.system import LearnedSystem
from tasks.training.trained import Measure, Trained
from tasks.weights import from_safetensors, to_safetensors

SHIPPED = Path(__file__).parents[2] / "synthesis" / "model" / "shipped"

READS = ("micro_scenes", "micro_scene_objects", "scenes", "splits")


@dataclasses.dataclass(frozen=True)
class SynthesisFitting(FittingConfig):
    """How long and how fast it is fitted."""

    steps: Count = 8000  # 500,000 looks at micro-scenes: some ten minutes on one processor
    learning_rate: Positive = 2.5e-3  # the peak; the network is small and trained from scratch, and 1.5e-3 comes less far in these steps
    warmup_steps: Natural = 100  # attention from scratch wants more than the usual 50
    weight_decay: NonNegative = 0.01  # there are more layouts to draw than weights could keep
    averaging: Decay = 0.998  # over some 500 steps: without, numbers of objects hang on the last steps
    validate_steps: Count = 500  # the loss on held-out layouts falls slowly and evenly
    record_steps: Count = 50  # losses of single steps jump with the noise


@dataclasses.dataclass(frozen=True)
class SynthesisTraining(Config):
    """What is trained, and how."""

    kind: ClassVar[str] = "synthesis"
    model: SynthesisModel = dataclasses.field(default_factory=DiffuScene)  # the paper's own baseline in shape
    scenes: Count = 64  # of a step; as specs D.7
    fitting: SynthesisFitting = dataclasses.field(default_factory=SynthesisFitting)
    foreign: str = ""  # file of weights of ATISS, DiffuScene or PhyScene to begin with; none: from scratch
    half: bool = True  # weights are kept at half precision, and figures are of these
    validation_share: Share = 0.05  # of the training rooms, to see that nothing is learned by heart
    test_share: Share = 0.2  # of the rooms, where `splits` has no row; as navigation has it


ATISS_FITTING = SynthesisFitting(learning_rate=1e-3)
"""Norms behind the layers, as published, want smaller steps."""

PAPER_FITTING = SynthesisFitting(
    steps=200_000, learning_rate=2e-4, final_learning_rate=2e-5, weight_decay=0.0, betas=(0.9, 0.999), clip_norm=10.0, averaging=0.0,
    validate_steps=2000,
)  # fmt: skip
"""Adam as published, for as long as some hundred scenes need (specs D.4); upstream trains a hundred times as long."""


def preset(name: str, fitting: SynthesisFitting | None = None) -> SynthesisTraining:
    """The settings of a preset, with its budget or another one.

    Raises:
        KeyError: there is none of that name.
    """
    model = PRESETS[name]
    if not name.endswith("-paper"):
        return SynthesisTraining(model, fitting=fitting or (ATISS_FITTING if isinstance(model, Atiss) else SynthesisFitting()))
    rate = 1e-4 if isinstance(model, Atiss) else PAPER_FITTING.learning_rate
    published = dataclasses.replace(PAPER_FITTING, learning_rate=rate, final_learning_rate=0.1 * rate)
    return SynthesisTraining(model, scenes=128, fitting=fitting or published)


@dataclasses.dataclass(frozen=True)
class CollectedLayouts:
    """What a dataset has to learn from: layouts with the names of their rooms, by split, and the licenses of their scans, each once."""

    train: list[tuple[str, Layout]]
    test: list[tuple[str, Layout]]
    license: str


def collected(dataset: Dataset, test_share: float) -> CollectedLayouts:
    """The micro-scenes of a dataset by the split of their room, but for those of scenes that a model drew.

    Raises:
        InputError: there is none in a training room.
    """
    scenes = list(dataset.rows(Scene))
    drawn = {scene.scene_id for scene in scenes if scene.scan_format == DRAWN_FORMAT}  # nobody put these things there
    micro_scenes = [row for row in dataset.rows(MicroScene) if row.scene_id not in drawn]
    layouts = layouts_of(micro_scenes, (row for row in dataset.rows(MicroSceneObject) if row.scene_id not in drawn))
    splits = {row.room_id: row.split for row in dataset.rows(Split)}
    scans = {scene.scene_id: scene.license for scene in scenes}
    licenses = {stated(scans.get(row.scene_id)) for row in micro_scenes}
    made: dict[str, list[tuple[str, Layout]]] = {"train": [], "test": []}
    for row, layout in zip(micro_scenes, layouts, strict=True):
        if len(layout):
            made[splits.get(row.room_id) or split_of(row.room_id, test_share)].append((row.room_id, layout))
    if not made["train"]:
        raise InputError(
            "train synthesis", "micro_scenes", "has none in a training room", "run the stage micro_scenes on rooms of the split 'train'"
        )
    return CollectedLayouts(made["train"], made["test"], ", ".join(sorted(licenses)))


def held_out(layouts: Sequence[tuple[str, Layout]], share: float) -> tuple[list[Layout], list[Layout]]:
    """Layouts to learn from, and those of a share of the rooms, drawn by the rooms' names, to choose the best weights by.

    At least one room is held out where there are two.
    """
    rooms = sorted({room for room, _ in layouts}, key=lambda room: hashlib.sha256(f"validation {room}".encode()).digest())
    count = min(max(round(share * len(rooms)), 1), len(rooms) - 1) if share > 0 else 0
    held = {*rooms[:count]}
    return [layout for room, layout in layouts if room not in held], [layout for room, layout in layouts if room in held]


def train(*, dataset: Dataset, start: bytes | None, context: Context, config: SynthesisTraining) -> Trained:
    """A synthesis model of the micro-scenes of a dataset; no room is on two sides, and figures are of the weights as they are kept.

    With weights to begin with, their vocabulary and bounds stay.

    Raises:
        InputError: there is no micro-scene, weights to begin with do not fit, or torch or diffusers are not there.
        Diverged: the loss is no finite number any more.
    """
    check_installed()
    check_diffusers(config.model)
    model = config.model
    check_sizes(model, "train synthesis")
    data = collected(dataset, config.test_share)
    learning, held = held_out(data.train, config.validation_share)
    first = None if start is None else from_safetensors(start)
    encoding = encoding_of(learning, all_classes(model), model.heights) if first is None else encoding_in(first)
    if encoding.heights != model.heights:
        problem = f"is {model.heights!r}, but the weights to begin with tell {encoding.heights}"
        raise InputError("train synthesis", "system.model.heights", problem, f"set it to {encoding.heights}")
    splits = {"train": learning, "validation": held, "test": [layout for _, layout in data.test]}
    known = {split: [layout for layout in rows if is_known(layout, encoding)] for split, rows in splits.items()}
    if not known["train"]:
        raise InputError("train synthesis", "start", "knows none of the categories in training rooms", "begin from scratch")
    examples = {split: examples_of(rows, encoding, model.slots) for split, rows in known.items()}
    notes = notes_of(splits, known, config)
    module = network(model, encoding, context.seed)
    if isinstance(model.text, ClipText):
        begin_with_clip(module, model.text, encoding)
    if config.foreign:
        notes.append(begin_with_foreign(module, config.foreign))
    if first is not None:
        begin_with(module, first, encoding)
    objective = SynthesisObjective(examples["train"], examples["validation"], encoding, model, config.scenes, context.seed)
    fitted = fit(
        module, objective, config.fitting, seed=context.seed, checkpoints=context.caches["tasks.training.fitting"], key=context.scene_id,
        report=context.report,
    )  # fmt: skip
    weights = to_safetensors({**from_safetensors(weights_of(fitted.state_dict, half=config.half)), **encoding.arrays()})
    begin_with(module, from_safetensors(weights), encoding)
    module.cpu().eval()
    measures = []
    for split in ("validation", "test"):
        if len(examples[split]):
            figures = objective.losses(module, examples[split])
            measures += [Measure("", split, _metric(name), value, examples=len(examples[split])) for name, value in figures.items()]
    return Trained(
        architecture=model.kind if isinstance(model, Atiss) else f"{model.kind}-{model.architecture.kind}",
        weights=weights,
        parameter_count=sum(parameter.numel() for parameter in module.parameters()),
        steps=fitted.steps,
        measures=tuple(measures),
        examples={split: len(rows) for split, rows in known.items()},
        license=data.license,
        is_fallback=isinstance(model.text, LearnedText),
        notes=tuple(notes),
        device=fitted.device,
        seconds=fitted.seconds,
    )


def _metric(part: str) -> str:
    return part if part == "loss" else f"loss_{part}"


def check_diffusers(model: Diffusion | Atiss) -> None:
    """Refuse to train a diffusion where its schedules are not installed. Raises `InputError`."""
    from importlib.util import find_spec

    if isinstance(model, Diffusion) and find_spec("diffusers") is None:
        raise InputError("train", "diffusers", "is not installed", "pip install 'metascenes[train]', or `make train` in a checkout")


def all_classes(model: Diffusion | Atiss) -> tuple[str, ...]:
    """Categories that a model's vocabulary has whatever the data."""
    if model.classes == "seen":
        return ()
    from tasks.micro_scenes.categories import read_categories

    return read_categories().names


def is_known(layout: Layout, encoding: Encoding) -> bool:
    """Whether a vocabulary has the categories of a layout."""
    return layout.large.category in encoding.large and {*layout.categories} <= {*encoding.classes}


def network(model: Diffusion | Atiss, encoding: Encoding, seed: int) -> Any:
    """A network whose first weights follow from the seed."""
    from tasks.synthesis.model.networks.atiss import AtissNet
    from tasks.synthesis.model.networks.denoiser import Denoiser

    sizes = len(encoding.classes), len(encoding.large), len(encoding.rooms)
    with seeded(seed, "synthesis", "weights"):
        return AtissNet(model, *sizes) if isinstance(model, Atiss) else Denoiser(model, *sizes)


def begin_with(module: Any, arrays: Mapping[str, Any], encoding: Encoding, file: str = "weights") -> None:
    """Give a network all of its weights.

    Raises:
        InputError: some are missing, too many or of another shape.
    """
    import torch

    check_fit(arrays, module.config, file)
    state = module.state_dict()
    names = arrays.keys() - encoding.arrays().keys()
    module.load_state_dict({name: torch.from_numpy(np.array(arrays[name])).to(state[name].dtype) for name in names})


def opened(weights: bytes, model: Diffusion | Atiss, file: str = "weights") -> tuple[Any, Encoding]:
    """The network of a model's weights in torch, and its encoding. Raises `InputError` as `check_fit`."""
    arrays = from_safetensors(weights, file)
    encoding = check_fit(arrays, model, file)
    module = network(model, encoding, 0)
    begin_with(module, arrays, encoding, file)
    return module.eval(), encoding


def notes_of(splits: Mapping[str, Sequence[Layout]], known: Mapping[str, Sequence[Layout]], config: SynthesisTraining) -> list[str]:
    """What must be known of a model: what was left out, what stands in, and where it is not as published."""
    model, notes = config.model, []
    lost = {split: len(splits[split]) - len(known[split]) for split in splits}
    notes += [
        f"{count} micro-scenes ({split}) left out: they have categories that the vocabulary lacks" for split, count in lost.items() if count
    ]
    full = sum(len(layout) > model.slots - 1 for layout in known["train"])
    if full:
        notes.append(f"{full} micro-scenes (train) have more than {model.slots - 1} small objects: each look at one leaves some out")
    if isinstance(model.text, LearnedText):
        notes.append("text: learned vectors of large object and room stand in for CLIP's; name weights to have those")
    if model.heights != "middles":
        notes.append("not as published: heights are those of bottoms over the large object's top")
    if isinstance(model, Diffusion):
        published = ("v", "eps") if isinstance(model, DiffuScene) else ("eps",)
        if model.noise.target not in published or (model.noise.target == "v" and model.noise.weighting == "none"):
            notes.append("not as published: the denoiser tells v, each step weighted alike")
        if model.categories == "chances":
            notes.append("not as published: the denoiser says how likely categories are")
        if isinstance(model.architecture, Transformer):
            notes.append("not as published: the denoiser is a plain transformer over slots")
        if model.noise.steps != 1000 or model.noise.curve != "linear":
            notes.append(f"not as published: {model.noise.steps} steps of noise, {model.noise.curve.replace('_', ' ')}; 1000, linear, are")
    elif model.prefixes == "even":
        notes.append("not as published: all beginnings of all scenes are learned from alike, since fewer objects follow otherwise")
    return notes


def fits(weights: bytes, config: SynthesisTraining, file: str) -> None:
    """Hold the weights of a model by others against its config. Raises `InputError` as `check_fit`."""
    check_fit(from_safetensors(weights, file), config.model, file)


def paths(config: SynthesisTraining) -> dict[str, str]:
    """Foreign weights that a config names, by field."""
    named = {"foreign": config.foreign, "model.text.weights": getattr(config.model.text, "weights", "")}
    return {field: path for field, path in named.items() if path}


SYNTHESIS = LearnedSystem(
    name="synthesis",
    config=SynthesisTraining,
    reads=READS,
    train=train,
    shipped=lambda: folders_in(SHIPPED),
    fits=fits,
    paths=paths,
)
